"""One step of all vehicles in one kernel, to save the overhead of several calls.

Computes forces and torques, integrates free bodies, and derives the true state.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from foundation.types import Array
from harness.world.physics.bodies import integrable_torque, near_something, observe
from harness.world.physics.environment import Surroundings
from harness.world.physics.free_flight import coast
from harness.world.physics.rotors import RotorKernelModel, rotor_speeds, wrenches


class StepModel(NamedTuple):
    """Constants of all steps, as an argument of kernels."""

    rotors: RotorKernelModel
    inertia_kg_m2: Array
    """(n, 3)"""
    mass_kg: Array
    """(n,)"""
    gravity_m_s2: float
    step_s: float
    reach_m: float
    release_ratio: float
    """See `near_something`"""


@njit(cache=True)
def fly(
    model: StepModel,
    before: NDArray[np.void],
    rotor_speed_before_rad_s: Array,
    controls: Array,
    armed: NDArray[np.bool_],
    stopped: NDArray[np.bool_],
    effectiveness: Array,
    wind_force_ned_n: Array,
    air_vel_ned_m_s: Array,
    density_ratio: Array,
    near: NDArray[np.bool_],
    applied: Array,
    after: NDArray[np.void],
    rotor_speed_rad_s: Array,
    truth: NDArray[np.void],
) -> bool:
    """Step n vehicles; returns whether ``near`` has changed, if all are free.

    ``before`` and ``after`` (n,) are rows of `BODY`, ``truth`` (n,) of `TRUTH`; the speeds of the rotors
    before the step are input, those after it, ``rotor_speed_rad_s`` (n, R), output. Rotors that are
    ``stopped`` (n, R), or not ``armed`` (n,), run down. ``effectiveness`` (n, R), ``air_vel_ned_m_s`` (n, 3)
    and ``density_ratio`` (n,) are those of `wrenches`; ``wind_force_ned_n`` (n, 3) acts at the centres of
    mass. If some vehicles are ``near`` (n,) something, Bullet must step those with force and torque
    ``applied`` (n, 2, 3), NED, and `finish_step` must be called afterwards.
    """
    n = len(before)
    any_near = False
    for i in range(n):
        any_near |= near[i]
    speed_rad_s = rotor_speeds(model.rotors, rotor_speed_before_rad_s, controls, armed, stopped)
    force_ned_n, torque_ned_n_m = wrenches(
        model.rotors, before, speed_rad_s, Surroundings(air_vel_ned_m_s, density_ratio, effectiveness)
    )
    for i in range(n):
        for axis in range(3):
            applied[i, 0, axis] = force_ned_n[i, axis] + wind_force_ned_n[i, axis]
        applied[i, 1, 0], applied[i, 1, 1], applied[i, 1, 2] = integrable_torque(
            model.inertia_kg_m2[i],
            before[i]["q_ned_frd"],
            before[i]["omega_ned_rad_s"],
            torque_ned_n_m[i],
            model.step_s,
        )
        for rotor in range(speed_rad_s.shape[1]):
            rotor_speed_rad_s[i, rotor] = speed_rad_s[i, rotor]
    coast(model.mass_kg, model.inertia_kg_m2, model.gravity_m_s2, model.step_s, before, applied, after)
    return not any_near and finish_step(model, before, after, near, truth)


@njit(cache=True)
def finish_step(
    model: StepModel,
    before: NDArray[np.void],
    after: NDArray[np.void],
    near: NDArray[np.bool_],
    truth: NDArray[np.void],
) -> bool:
    """Compute the true state after a step and update ``near``; returns whether that has changed."""
    observe(before, after, model.gravity_m_s2, model.step_s, truth)
    return near_something(after, model.reach_m, model.release_ratio, near)
