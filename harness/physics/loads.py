"""Everything that acts on the vehicles over a step, in one kernel, for each call of one has its price."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.types import Array
from harness.physics.bodies import integrable_torque
from harness.physics.environment import Surroundings
from harness.physics.rotors import RotorKernelModel, rotor_speeds, wrenches


@njit(cache=True)
def loads(
    model: RotorKernelModel,
    inertia_kg_m2: Array,
    bodies: NDArray[np.void],
    rotor_speed_rad_s: Array,
    controls: Array,
    armed: NDArray[np.bool_],
    stopped: NDArray[np.bool_],
    effectiveness: Array,
    wind_force_ned_n: Array,
    air_vel_ned_m_s: Array,
    density_ratio: Array,
    step_s: float,
) -> tuple[Array, Array]:
    """Rotor speeds (n, 4) one step on, and what Bullet is to apply at the centres of mass.

    The latter are force and torque of each vehicle, NED: (n, 2, 3). ``bodies`` (n,) are rows of `BODY`;
    rotors that are ``stopped`` (n, 4), or not ``armed`` (n,), run down. The rest is as in `rotor_speeds`,
    `wrenches` and `integrable_torque`; the wind's force is (n, 3).
    """
    n = len(bodies)
    powered = np.empty((n, 4), dtype=np.bool_)
    height_m = np.empty(n)
    for i in range(n):
        height_m[i] = -bodies[i]["pos_ned_m"][2]
        for rotor in range(4):
            powered[i, rotor] = armed[i] and not stopped[i, rotor]
    after_rad_s = rotor_speeds(model, rotor_speed_rad_s, controls, powered)
    force_ned_n, torque_ned_n_m = wrenches(
        model,
        bodies["q_ned_frd"],
        bodies["vel_ned_m_s"],
        bodies["omega_ned_rad_s"],
        after_rad_s,
        Surroundings(air_vel_ned_m_s, density_ratio, height_m, effectiveness),
    )
    applied = np.empty((n, 2, 3))
    for i in range(n):
        applied[i, 0] = force_ned_n[i] + wind_force_ned_n[i]
        applied[i, 1] = integrable_torque(
            inertia_kg_m2, bodies[i]["q_ned_frd"], bodies[i]["omega_ned_rad_s"], torque_ned_n_m[i], step_s
        )
    return after_rad_s, applied
