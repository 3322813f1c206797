"""Attitude, rates and allocation in one compiled step.

All three run at every inertial sample, and one call of compiled code instead of three saves more time than
the arithmetic takes.
"""

import numpy as np
from numba import njit

from autopilot.control.allocation import allocate
from autopilot.control.attitude import rate_setpoint
from autopilot.control.rates import rate_torque
from autopilot.control.state import CascadeState
from foundation.kernels.inner import inner
from foundation.kernels.records import Records
from foundation.types import Array


@njit(cache=True)
def follow_attitude(
    cascade: Records, q_ned_frd: Array, omega_frd_rad_s: Array, q_setpoint: Array, yaw_rate_rad_s: float,
    thrust: float, dt_s: float,
    integrate: bool, airmode_above: float,  # noqa: FBT001 - kernels take positions
) -> None:  # fmt: skip
    """Compute the motor controls and the intermediate results from an attitude and a collective thrust.

    ``cascade`` is (1,) of `CascadeState`. The integrators of the rates are constant unless ``integrate``.
    Above the thrust ``airmode_above``, torque may raise the collective.
    """
    c: CascadeState = cascade[0]
    rate = rate_setpoint(c.attitude, q_ned_frd, q_setpoint, yaw_rate_rad_s)
    highest = 1.0 if thrust > airmode_above else 0.0
    if c.by_tilt:
        thrust *= max(c.attitude.tilt_cosine, 0.0)
    _follow_rate(c, omega_frd_rad_s, rate, thrust, highest, dt_s, integrate)


@njit(cache=True)
def follow_rates(
    cascade: Records, omega_frd_rad_s: Array, demanded_frd_rad_s: Array, thrust: float, dt_s: float,
    integrate: bool, airmode_above: float,  # noqa: FBT001 - kernels take positions
) -> None:  # fmt: skip
    """Compute the same as `follow_attitude`, but from demanded body rates, which are limited."""
    c: CascadeState = cascade[0]
    rate_max_rad_s = c.attitude.rate_max_rad_s
    rate = np.empty(3)
    for i in range(3):
        rate[i] = min(max(demanded_frd_rad_s[i], -rate_max_rad_s[i]), rate_max_rad_s[i])
    c.attitude.tilt_cosine = 1.0  # there is no tilt error
    _follow_rate(c, omega_frd_rad_s, rate, thrust, 1.0 if thrust > airmode_above else 0.0, dt_s, integrate)


@njit(cache=True)
def follow_demand(cascade: Records, thrust: float, torque: Array, airmode_above: float) -> None:
    """Compute the motor controls from a collective thrust and a normalised torque (3,), FRD.

    The arguments are those of `follow_attitude`.
    """
    c: CascadeState = cascade[0]
    for axis in range(3):
        c.torque[axis] = torque[axis]
    allocate(c.allocation, thrust, torque, 1.0 if thrust > airmode_above else 0.0)


@inner
def _follow_rate(
    c: CascadeState, omega_frd_rad_s: Array, rate_frd_rad_s: Array, thrust: float, highest: float,
    dt_s: float, integrate: bool,  # noqa: FBT001 - kernels take positions
) -> None:  # fmt: skip
    """Convert rates to torque, and torque with collective thrust to controls.

    Torque may raise the collective thrust to ``highest``.
    """
    torque = rate_torque(c.rates, omega_frd_rad_s, rate_frd_rad_s, c.allocation.unallocated, dt_s, integrate)
    for axis in range(3):
        c.rate_setpoint_frd_rad_s[axis], c.torque[axis] = rate_frd_rad_s[axis], torque[axis]
    allocate(c.allocation, thrust, torque, highest)
