"""The whole cascade of one sample in compiled code, for whoever follows a trajectory: nearly every step.

Disturbance observer, hover thrust, position, attitude, rates and allocation are classes of their own that can
be used alone. Here their kernels run one after the other over the block that holds settings and memories of
one of each: crossing into compiled code once instead of five times, and leaving the objects alone in between,
is worth several times their arithmetic.
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
"""A thrust is the least one up to rounding"""
BY_TILT = True
"""Only the thrust along the present axis is given; see `InnerLoop.update`."""
YAW, YAW_RATE, CLIMB_MAX = range(3)
"""Of the block's ``turn``: heading, rad, its rate, rad/s, and the greatest climb, m/s"""
_HOVER_LEARN_UP = 0.5
"""Least cosine of the tilt at which the hover thrust is learned"""


@njit(cache=True)
def airmode_above(landed: bool, thr_min: float) -> float:  # noqa: FBT001 - kernels take positions
    """Give the thrust above which torque may raise the collective.

    At the least thrust it may be touching down: torque against the ground must not lift it again.
    """
    return np.inf if landed else thr_min * ABOVE_LEAST


@njit(cache=True)
def follow_trajectory(block: Block, estimate: Array) -> None:
    """Fill the block's ``controls`` (4,) 0..1, and what led to them, from what is laid out in it.

    That is the setpoint and what is so in this sample. ``estimate`` (31,) is as `horizon` lays it out, NED
    and FRD. The position loop acts at every ``position_divider``-th call. What flight teaches of the hover
    thrust it teaches from the second on.
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
    observer, hover, decided = c["observer"], c["hover"], c["decided"]
    limits, turn = c["position_limits"], c["turn"]
    yaw_rad, yaw_rate_rad_s = turn[YAW], turn[YAW_RATE]
    observe_disturbance(
        observer, c["observer_settings"], acc, q_ned_frd, c["thrust"], hover[HOVER], dt_s,
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
            c["wanted"], c["mask"], estimate[POS:GYRO_BIAS], estimate[VEL:POS], acc, disturbance,
            hover[HOVER], yaw_rad, turn[CLIMB_MAX], position_dt_s, c["position_gains"], limits, position,
            decided,
        )  # fmt: skip
    if c["idles"]:
        decided[ATTITUDE] = quat_from_euler(0.0, 0.0, yaw_rad)
        decided[THRUST_VECTOR, COLLECTIVE] = 0.0
        yaw_rate_rad_s = 0.0
    follow_attitude(
        block, q_ned_frd, omega, decided[ATTITUDE], yaw_rate_rad_s, decided[THRUST_VECTOR, COLLECTIVE],
        dt_s, BY_TILT, not landed, airmode_above(landed, limits[THR_MIN]),
    )  # fmt: skip
