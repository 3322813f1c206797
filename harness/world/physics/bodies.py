"""State of the bodies in Bullet's scheme, and its conversion to the true state.

Bullet integrates ``v <- v + a(x) dt``, then ``x <- x + v dt``. If its poses are read as half a step ahead of
its velocities, x(t_k + dt/2) with v(t_k), this is the leapfrog scheme of second order: forces act at the
middle of their step, and the pose at t_k is Bullet's minus half a step of motion. Free fall is then exact;
without this reading its position would be wrong by half a step of motion.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from foundation.types import Array
from harness.world.physics.rotation import Vector, in_frd, in_ned, turned

BODY = np.dtype(
    [("pos_ned_m", "f8", 3), ("q_ned_frd", "f8", 4), ("vel_ned_m_s", "f8", 3), ("omega_ned_rad_s", "f8", 3)]
)
"""Row of one vehicle in Bullet's scheme, wxyz; the pose is half a step ahead of the velocities."""


@njit(cache=True)
def observe(
    before: NDArray[np.void],
    after: NDArray[np.void],
    gravity_m_s2: float,
    step_s: float,
    truth: NDArray[np.void],
) -> None:
    """Compute the true state at the end of a step from the rows (n,) of `BODY` before and after it.

    Fills ``truth`` (n,), rows of `harness.world.physics.truth.TRUTH`, except the rotors' speeds.
    """
    for i in range(len(after)):
        vel_ned, omega_ned = after[i]["vel_ned_m_s"], after[i]["omega_ned_rad_s"]
        q_mid_step, q_ahead = before[i]["q_ned_frd"], after[i]["q_ned_frd"]
        seen = truth[i]
        for axis in range(3):
            seen["vel_ned_m_s"][axis] = vel_ned[axis]
            seen["pos_ned_m"][axis] = after[i]["pos_ned_m"][axis] - 0.5 * step_s * vel_ned[axis]
            seen["acc_ned_m_s2"][axis] = (vel_ned[axis] - before[i]["vel_ned_m_s"][axis]) / step_s
        half_step_back_s = -0.5 * step_s
        q = seen["q_ned_frd"]
        q[0], q[1], q[2], q[3] = turned(
            half_step_back_s * omega_ned[0],
            half_step_back_s * omega_ned[1],
            half_step_back_s * omega_ned[2],
            q_ahead,
        )
        omega_frd = seen["omega_frd_rad_s"]
        omega_frd[0], omega_frd[1], omega_frd[2] = in_frd(q_ahead, omega_ned[0], omega_ned[1], omega_ned[2])
        acc_ned, force_frd = seen["acc_ned_m_s2"], seen["specific_force_frd_m_s2"]
        force_frd[0], force_frd[1], force_frd[2] = in_frd(
            q_mid_step, acc_ned[0], acc_ned[1], acc_ned[2] - gravity_m_s2
        )
        omega_before_ned, mean_frd = before[i]["omega_ned_rad_s"], seen["mean_omega_frd_rad_s"]
        mean_frd[0], mean_frd[1], mean_frd[2] = in_frd(
            q_mid_step,
            0.5 * (omega_before_ned[0] + omega_ned[0]),
            0.5 * (omega_before_ned[1] + omega_ned[1]),
            0.5 * (omega_before_ned[2] + omega_ned[2]),
        )


@njit(cache=True)
def near_something(
    bodies: NDArray[np.void], reach_m: float, release_ratio: float, near: NDArray[np.bool_]
) -> bool:
    """Update which of ``bodies``, rows (n,) of `BODY`, are near the ground or another body.

    A body is near if it is within ``reach_m`` of another one along every axis, or within half of that above
    the ground; it stays near up to ``release_ratio`` times that distance. ``near`` (n,) is input and output;
    returns whether it has changed for any body.
    """
    was_near = near.copy()
    near[:] = False
    for i in range(len(bodies)):
        here = bodies[i]["pos_ned_m"]
        ground_m = 0.5 * reach_m * (release_ratio if was_near[i] else 1.0)
        near[i] |= -here[2] <= ground_m
        for j in range(i):
            there = bodies[j]["pos_ned_m"]
            pair_m = reach_m * (release_ratio if was_near[i] and was_near[j] else 1.0)
            if (
                abs(here[0] - there[0]) <= pair_m
                and abs(here[1] - there[1]) <= pair_m
                and abs(here[2] - there[2]) <= pair_m
            ):
                near[i] = near[j] = True
    changed = False
    for i in range(len(bodies)):
        changed |= near[i] != was_near[i]
    return changed


@njit(cache=True)
def in_body_axes(truth: NDArray[np.void], vector_ned: Array) -> Array:
    """Transform one vector (3,) from NED to the FRD axes of vehicles with the state `TRUTH` (n,): (n, 3)."""
    vectors_frd = np.empty((len(truth), 3))
    for i in range(len(truth)):
        x, y, z = in_frd(truth[i]["q_ned_frd"], vector_ned[0], vector_ned[1], vector_ned[2])
        vectors_frd[i, 0], vectors_frd[i, 1], vectors_frd[i, 2] = x, y, z
    return vectors_frd


@njit(cache=True)
def integrable_torque(
    inertia_kg_m2: Array, q_ned_frd: Array, omega_ned_rad_s: Array, torque_ned_n_m: Array, step_s: float
) -> Vector:
    """Return the torque for Bullet, in N m, NED, so that ``torque_ned_n_m`` (3,) acts on a body.

    Bullet adds the gyroscopic torque -ω x Iω of the start of a step, which increases the energy of a spinning
    body. Adding the difference to its value at the middle of the step turns this into the midpoint rule.
    ``inertia_kg_m2`` (3,) is diagonal in the body's axes.
    """
    ix, iy, iz = inertia_kg_m2[0], inertia_kg_m2[1], inertia_kg_m2[2]
    p, q, r = in_frd(q_ned_frd, omega_ned_rad_s[0], omega_ned_rad_s[1], omega_ned_rad_s[2])
    tx, ty, tz = in_frd(q_ned_frd, torque_ned_n_m[0], torque_ned_n_m[1], torque_ned_n_m[2])
    gx, gy, gz = _gyroscopic_torque(ix, iy, iz, p, q, r)
    mid_x, mid_y, mid_z = _gyroscopic_torque(
        ix,
        iy,
        iz,
        p + 0.5 * step_s * (tx + gx) / ix,
        q + 0.5 * step_s * (ty + gy) / iy,
        r + 0.5 * step_s * (tz + gz) / iz,
    )
    x, y, z = in_ned(q_ned_frd, mid_x - gx, mid_y - gy, mid_z - gz)
    return torque_ned_n_m[0] + x, torque_ned_n_m[1] + y, torque_ned_n_m[2] + z


@njit(cache=True)
def _gyroscopic_torque(ix: float, iy: float, iz: float, p: float, q: float, r: float) -> Vector:
    """Return -ω x Iω for a diagonal inertia and body rates."""
    return (iy - iz) * q * r, (iz - ix) * r * p, (ix - iy) * p * q
