"""What Bullet holds of the vehicles, and how a step of it is read.

Bullet integrates ``v <- v + a(x) dt``, then ``x <- x + v dt``: its poses are half a step ahead of its
velocities. With v(t_k) it holds x(t_k + dt/2), and so read it is the leapfrog scheme, of second order: forces
belong to the middle of their step, and the pose at t_k is Bullet's less half a step of motion. Free fall, for
one, comes out exactly; taken at face value it would be off by half a step of speed.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from autopilot.estimation.rotation import (
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
)
from autopilot.types import Array


class Bodies(NamedTuple):
    """State of n vehicles as Bullet has it; the poses are half a step ahead of the velocities."""

    pos_ned_m: Array
    """(n, 3)"""
    q_ned_frd: Array
    """(n, 4) wxyz"""
    vel_ned_m_s: Array
    """(n, 3)"""
    omega_ned_rad_s: Array
    """(n, 3)"""


class Observation(NamedTuple):
    """Fields of `harness.physics.truth.Truth`, by the same names."""

    pos_ned_m: Array
    q_ned_frd: Array
    omega_frd_rad_s: Array
    acc_ned_m_s2: Array
    specific_force_frd_m_s2: Array
    mean_omega_frd_rad_s: Array


@njit(cache=True)
def observe(before: Bodies, after: Bodies, gravity_m_s2: float, step_s: float) -> Observation:
    """Read the state at the end of a step from what Bullet held before and after it."""
    pos_ned_m = after.pos_ned_m - 0.5 * step_s * after.vel_ned_m_s
    acc_ned_m_s2 = (after.vel_ned_m_s - before.vel_ned_m_s) / step_s
    q_ned_frd = np.empty_like(after.q_ned_frd)
    omega_frd_rad_s = np.empty_like(acc_ned_m_s2)
    specific_force_frd_m_s2 = np.empty_like(acc_ned_m_s2)
    mean_omega_frd_rad_s = np.empty_like(acc_ned_m_s2)
    for vehicle in range(pos_ned_m.shape[0]):
        omega_ned = after.omega_ned_rad_s[vehicle]
        half_turn_back = quat_from_rotation_vector(-0.5 * step_s * omega_ned)
        q_ned_frd[vehicle] = quat_multiply(half_turn_back, after.q_ned_frd[vehicle])
        omega_frd_rad_s[vehicle] = quat_rotate_inverse(after.q_ned_frd[vehicle], omega_ned)
        mid_step_q = before.q_ned_frd[vehicle]
        specific_force_ned = acc_ned_m_s2[vehicle].copy()
        specific_force_ned[2] -= gravity_m_s2
        specific_force_frd_m_s2[vehicle] = quat_rotate_inverse(mid_step_q, specific_force_ned)
        mean_omega_ned = 0.5 * (before.omega_ned_rad_s[vehicle] + omega_ned)
        mean_omega_frd_rad_s[vehicle] = quat_rotate_inverse(mid_step_q, mean_omega_ned)
    return Observation(
        pos_ned_m, q_ned_frd, omega_frd_rad_s, acc_ned_m_s2, specific_force_frd_m_s2, mean_omega_frd_rad_s
    )


@njit(cache=True)
def in_body_axes(q_ned_frd: Array, vector_ned: Array) -> Array:
    """One vector (3,) as each of n bodies at ``q_ned_frd`` (n, 4) sees it: (n, 3) FRD."""
    vectors_frd = np.empty((q_ned_frd.shape[0], 3))
    for vehicle in range(q_ned_frd.shape[0]):
        vectors_frd[vehicle] = quat_rotate_inverse(q_ned_frd[vehicle], vector_ned)
    return vectors_frd


@njit(cache=True)
def integrable_torques(inertia_kg_m2: Array, bodies: Bodies, torque_ned_n_m: Array, step_s: float) -> Array:
    """Torques (n, 3) to hand to Bullet, in newton metres, NED, so that those given act on the bodies.

    Bullet adds the gyroscopic torque -ω x Iω as it is at the start of a step, which feeds energy into a
    spinning body. The difference to its value at the middle of the step, added here, makes that the midpoint
    rule. ``inertia_kg_m2`` (3,) is diagonal in the body's axes.
    """
    corrected_ned_n_m = np.empty_like(torque_ned_n_m)
    for vehicle in range(torque_ned_n_m.shape[0]):
        q_ned_frd = bodies.q_ned_frd[vehicle]
        omega = quat_rotate_inverse(q_ned_frd, bodies.omega_ned_rad_s[vehicle])
        torque = quat_rotate_inverse(q_ned_frd, torque_ned_n_m[vehicle])
        gyroscopic = _gyroscopic_torque(inertia_kg_m2, omega)
        mid_omega = omega + 0.5 * step_s * (torque + gyroscopic) / inertia_kg_m2
        correction = _gyroscopic_torque(inertia_kg_m2, mid_omega) - gyroscopic
        corrected_ned_n_m[vehicle] = torque_ned_n_m[vehicle] + quat_rotate(q_ned_frd, correction)
    return corrected_ned_n_m


@njit(cache=True)
def _gyroscopic_torque(inertia_kg_m2: Array, omega_rad_s: Array) -> Array:
    """(3,) -ω x Iω for a diagonal inertia."""
    torque = np.empty(3)
    torque[0] = (inertia_kg_m2[1] - inertia_kg_m2[2]) * omega_rad_s[1] * omega_rad_s[2]
    torque[1] = (inertia_kg_m2[2] - inertia_kg_m2[0]) * omega_rad_s[2] * omega_rad_s[0]
    torque[2] = (inertia_kg_m2[0] - inertia_kg_m2[1]) * omega_rad_s[0] * omega_rad_s[1]
    return torque
