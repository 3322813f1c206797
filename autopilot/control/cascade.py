"""The whole cascade of one sample in compiled code, for whoever follows a trajectory: nearly every step.

Disturbance observer, hover thrust, position, attitude, rates and allocation are classes of their own that can
be used alone. Here their kernels run one after the other over the memories and settings of one of each:
crossing into compiled code once instead of five times, and leaving the objects alone in between, is worth
several times their arithmetic.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.control.disturbance import OBSERVED, THRUST, observe_disturbance
from autopilot.control.hover_thrust import HOVER, learn_hover_thrust
from autopilot.control.inner_loop import follow_attitude
from autopilot.control.position import (
    ACCELERATION,
    ATTITUDE,
    COLLECTIVE,
    INTEGRAL,
    THR_MIN,
    control_position,
    integral_shift_m_s2,
)
from autopilot.control.position import THRUST as THRUST_VECTOR
from autopilot.estimation.rotation import quat_from_euler
from autopilot.types import Array

ABOVE_LEAST = 1.001
"""A thrust is the least one up to rounding"""
BY_TILT = True
"""Only the thrust along the present axis is given; see `InnerLoop.update`."""
_HOVER_LEARN_UP = 0.5
"""Least cosine of the tilt at which the hover thrust is learned"""


@njit(cache=True)
def airmode_above(landed: bool, thr_min: float) -> float:  # noqa: FBT001 - kernels take positions
    """Give the thrust above which torque may raise the collective.

    At the least thrust it may be touching down: torque against the ground must not lift it again.
    """
    return np.inf if landed else thr_min * ABOVE_LEAST


@njit(cache=True)
def follow_trajectory(
    # the estimate, NED and FRD, and whether the velocity in it is known
    q_ned_frd: Array, omega: Array, pos: Array, vel: Array, acc: Array, velocity_valid: bool,  # noqa: FBT001
    # the setpoint as `PositionController.take` lays it out
    wanted: Array, mask: NDArray[np.bool_], yaw_rad: float, yaw_rate_rad_s: float,
    # the moment: since the last sample, since the last position loop (0: it has a rest), collective given
    dt_s: float, position_dt_s: float, thrust: float,
    # the take-off: idling on the ground, on the ground at all, whether flight teaches the hover thrust
    idles: bool, landed: bool, teaches: bool, climb_max_m_s: float,  # noqa: FBT001
    controls: Array,
    # settings and memories of the observer, the hover thrust, position, attitude, rates, allocation
    observer_settings: Array, observer: Array, hover_settings: Array, hover: Array,
    position_gains: Array, position_limits: Array, position: Array, decided: Array,
    attitude_gain: Array, yaw_weight: float, rate_max_rad_s: Array,
    rate_gains: Array, integral_max: float, cutoff_hz: float, rate_state: Array,
    mix: Array, yaw_margin: float, thrust_factor: float, unallocated: Array,
    stages: Array,
) -> tuple[float, float]:  # fmt: skip
    """Fill ``controls`` (4,) 0..1, and ``decided`` and ``stages`` with what led to them.

    Returns achieved collective and cosine of the tilt error.
    """
    observe_disturbance(
        observer, observer_settings, acc, q_ned_frd, thrust, hover[HOVER], dt_s,
        velocity_valid and not landed,
    )  # fmt: skip
    disturbance = observer[OBSERVED:THRUST]
    if position_dt_s > 0.0:
        x, y = q_ned_frd[1], q_ned_frd[2]
        up = 1.0 - 2.0 * (x * x + y * y)
        if teaches and velocity_valid and up >= _HOVER_LEARN_UP:
            before = hover[HOVER]
            learn_hover_thrust(hover, hover_settings, -acc[2], observer[THRUST] * up, position_dt_s)
            acc_down = decided[ACCELERATION, 2] - disturbance[2]
            position[INTEGRAL, 2] += integral_shift_m_s2(before, hover[HOVER], acc_down)
        control_position(
            wanted, mask, pos, vel, acc, disturbance, hover[HOVER], yaw_rad, climb_max_m_s, position_dt_s,
            position_gains, position_limits, position, decided,
        )  # fmt: skip
    if idles:
        decided[ATTITUDE] = quat_from_euler(0.0, 0.0, yaw_rad)
        decided[THRUST_VECTOR, COLLECTIVE] = 0.0
        yaw_rate_rad_s = 0.0
    return follow_attitude(
        q_ned_frd, omega, decided[ATTITUDE], yaw_rate_rad_s, decided[THRUST_VECTOR, COLLECTIVE],
        dt_s, BY_TILT, not landed, airmode_above(landed, position_limits[THR_MIN]),
        attitude_gain, yaw_weight, rate_max_rad_s, rate_gains, integral_max, cutoff_hz, rate_state,
        mix, yaw_margin, thrust_factor, unallocated, stages, controls,
    )  # fmt: skip
