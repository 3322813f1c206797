"""A step of all vehicles in one kernel, for each call of one has its price.

What acts on them, where that leads those that are free, and what is to be known of it.
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
    """What is the same in every step, in the form that compiled code takes."""

    rotors: RotorKernelModel
    inertia_kg_m2: Array
    """(3,)"""
    mass_kg: float
    gravity_m_s2: float
    step_s: float
    reach_m: float
    lasting: float
    """See `near_something`"""


@njit(cache=True)
def fly(
    model: StepModel,
    before: NDArray[np.void],
    truth_before: NDArray[np.void],
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
    truth: NDArray[np.void],
) -> bool:
    """Bring n vehicles a step further, if all are free; returns whether any comes near something by it.

    ``before`` and ``after`` (n,) are rows of `BODY`, ``truth_before`` and ``truth`` (n,) of `TRUTH`; rotors
    that are ``stopped`` (n, 4), or not ``armed`` (n,), run down; the next three, (n, 4), (n, 3) and (n, 3),
    are as in `wrenches`, the wind's force is at the centres of mass. If some are ``near`` (n,) something,
    Bullet is to move those as ``applied`` (n, 2, 3) says, which are force and torque, NED, and `look` does
    what is left here.
    """
    n = len(before)
    powered = np.empty((n, 4), dtype=np.bool_)
    height_m = np.empty(n)
    any_near = False
    for i in range(n):
        height_m[i] = -before[i]["pos_ned_m"][2]
        any_near |= near[i]
        for rotor in range(4):
            powered[i, rotor] = armed[i] and not stopped[i, rotor]
    rotor_speed_rad_s = rotor_speeds(model.rotors, truth_before["rotor_speed_rad_s"], controls, powered)
    force_ned_n, torque_ned_n_m = wrenches(
        model.rotors,
        before["q_ned_frd"],
        before["vel_ned_m_s"],
        before["omega_ned_rad_s"],
        rotor_speed_rad_s,
        Surroundings(air_vel_ned_m_s, density_ratio, height_m, effectiveness),
    )
    for i in range(n):
        for axis in range(3):
            applied[i, 0, axis] = force_ned_n[i, axis] + wind_force_ned_n[i, axis]
        applied[i, 1] = integrable_torque(
            model.inertia_kg_m2,
            before[i]["q_ned_frd"],
            before[i]["omega_ned_rad_s"],
            torque_ned_n_m[i],
            model.step_s,
        )
        truth[i]["rotor_speed_rad_s"][:] = rotor_speed_rad_s[i]
    coast(model.mass_kg, model.inertia_kg_m2, model.gravity_m_s2, model.step_s, before, applied, after)
    return not any_near and look(model, before, after, near, truth)


@njit(cache=True)
def look(
    model: StepModel,
    before: NDArray[np.void],
    after: NDArray[np.void],
    near: NDArray[np.bool_],
    truth: NDArray[np.void],
) -> bool:
    """Observe where a step has led; returns whether it has changed who is near something, which it notes."""
    observe(before, after, model.gravity_m_s2, model.step_s, truth)
    return near_something(after, model.reach_m, model.lasting, near)
