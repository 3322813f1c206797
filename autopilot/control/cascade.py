"""Control cascade of one sample in compiled code, for trajectory setpoints, which most steps use.

Disturbance observer, hover thrust, position, attitude, rates and allocation also have classes that can be
used separately. Here their kernels run in sequence over the block with the settings and states of all of
them. One call of compiled code instead of five saves several times the time that the arithmetic takes.
"""

import numpy as np
from numba import njit

from autopilot.control.block import Block
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
from autopilot.estimation.horizon import ACC, OMEGA, STD
from autopilot.estimation.kernels import GYRO_BIAS, POS, VEL
from foundation.geometry.rotations import quat_from_euler
from foundation.types import Array

ABOVE_LEAST = 1.001
"""Tolerance for rounding: a thrust up to this multiple of the least thrust counts as the least thrust"""
YAW, YAW_RATE, CLIMB_MAX = range(3)
"""Elements of the block's ``turn``: heading, rad; its rate, rad/s; greatest climb rate, m/s"""
_HOVER_LEARN_UP = 0.5
"""Least cosine of the tilt at which the hover thrust estimate is updated"""


@njit(cache=True)
def airmode_above(landed: bool, thr_min: float) -> float:  # noqa: FBT001 - kernels take positions
    """Return the thrust above which torque may raise the collective.

    At the least thrust the vehicle may be touching down, and torque against the ground must not lift it.
    """
    return np.inf if landed else thr_min * ABOVE_LEAST


@njit(cache=True)
def follow_trajectory(block: Block, estimate: Array) -> None:
    """Compute the block's ``controls`` (4,), 0..1, and intermediate results from its input fields.

    ``estimate`` (31,) has the layout of `autopilot.estimation.horizon`, NED and FRD. The position loop runs
    at every ``position_divider``-th call. The hover thrust estimate is updated from its second run on.
    """
    c = block[0]
    q_ned_frd, omega, acc = estimate[:VEL], estimate[OMEGA:STD], estimate[ACC:OMEGA]
    dt_s, velocity_valid, landed = c["dt_s"], c["velocity_valid"] != 0, c["landed"] != 0
    goes_on = c["updates"] > 0
    c["since_position_s"] += dt_s
    position_dt_s = 0.0
    if c["updates"] % c["position_divider"] == 0:
        position_dt_s = c["since_position_s"]
        c["since_position_s"] = 0.0
    c["updates"] += 1
    # whole slices have the type of the arrays that Python passes, so one compilation serves both
    observer, observer_settings = c["observer"][:], c["observer_settings"][:]
    hover, decided, limits, turn = c["hover"], c["decided"], c["position_limits"], c["turn"]
    yaw_rad, yaw_rate_rad_s = turn[YAW], turn[YAW_RATE]
    observe_disturbance(
        observer, observer_settings, acc, q_ned_frd, c["thrust"], hover[HOVER], dt_s,
        velocity_valid and not landed,
    )  # fmt: skip
    if position_dt_s > 0.0:
        disturbance, position = observer[OBSERVED:THRUST], c["position"]
        x, y = q_ned_frd[1], q_ned_frd[2]
        up = 1.0 - 2.0 * (x * x + y * y)
        if goes_on and c["flies"] and velocity_valid and up >= _HOVER_LEARN_UP:
            before = hover[HOVER]
            learn_hover_thrust(hover, c["hover_settings"], -acc[2], observer[THRUST] * up, position_dt_s)
            acc_down = decided[ACCELERATION, 2] - disturbance[2]
            position[INTEGRAL, 2] += integral_shift_m_s2(before, hover[HOVER], acc_down)
        control_position(
            c["setpoint"], c["mask"], estimate[POS:GYRO_BIAS], estimate[VEL:POS], acc, disturbance,
            hover[HOVER], yaw_rad, turn[CLIMB_MAX], position_dt_s, c["position_gains"], limits, position,
            decided,
        )  # fmt: skip
    if c["idles"]:
        level = quat_from_euler(0.0, 0.0, yaw_rad)
        for i in range(4):
            decided[ATTITUDE, i] = level[i]
        decided[THRUST_VECTOR, COLLECTIVE] = 0.0
        yaw_rate_rad_s = 0.0
    c["by_tilt"] = 1
    follow_attitude(
        block, q_ned_frd, omega, decided[ATTITUDE], yaw_rate_rad_s, decided[THRUST_VECTOR, COLLECTIVE],
        dt_s, not landed, airmode_above(landed, limits[THR_MIN]),
    )  # fmt: skip
