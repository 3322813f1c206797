"""Everything that acts on the vehicles over a step, in one kernel, for each call of one has its price."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.types import Array
from harness.physics.bodies import Bodies, integrable_torques
from harness.physics.environment import Surroundings
from harness.physics.rotors import RotorKernelModel, rotor_speeds, wrenches


@njit(cache=True)
def loads(
    model: RotorKernelModel,
    inertia_kg_m2: Array,
    bodies: Bodies,
    rotor_speed_rad_s: Array,
    controls: Array,
    powered: NDArray[np.bool_],
    wind_force_ned_n: Array,
    surroundings: Surroundings,
    step_s: float,
) -> tuple[Array, Array, Array]:
    """Rotor speeds (n, 4) one step on, and force and torque (n, 3) at the centres of mass for Bullet, NED.

    Arguments are those of `rotor_speeds`, `wrenches` and `integrable_torques`; the wind's force is (n, 3).
    """
    after_rad_s = rotor_speeds(model, rotor_speed_rad_s, controls, powered)
    force_ned_n, torque_ned_n_m = wrenches(
        model, bodies.q_ned_frd, bodies.vel_ned_m_s, bodies.omega_ned_rad_s, after_rad_s, surroundings
    )
    force_ned_n += wind_force_ned_n
    return after_rad_s, force_ned_n, integrable_torques(inertia_kg_m2, bodies, torque_ned_n_m, step_s)
