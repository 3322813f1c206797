"""Control cascade of one sample in compiled code, for trajectory setpoints, which most steps use.

Disturbance observer, hover thrust, position, attitude, rates and allocation run in sequence over one record.
One call of compiled code instead of five saves several times the time that the arithmetic takes.
"""

import numpy as np
from numba import njit

from autopilot.control.disturbance import observe_disturbance
from autopilot.control.hover_thrust import learn_hover_thrust
from autopilot.control.inner_loop import follow_attitude
from autopilot.control.position import control_position, integral_shift_m_s2
from autopilot.control.state import CascadeState
from autopilot.estimation.horizon import ACC, OMEGA, STD
from autopilot.estimation.kernels import GYRO_BIAS, POS, VEL
from foundation.geometry.rotations import quat_from_euler
from foundation.kernels.inner import inner
from foundation.kernels.records import Records
from foundation.types import Array

ABOVE_LEAST = 1.001
"""Tolerance for rounding: a thrust up to this multiple of the least thrust counts as the least thrust"""
_HOVER_LEARN_UP = 0.5
"""Least cosine of the tilt at which the hover thrust estimate is updated"""


@njit(cache=True)
def airmode_above(landed: bool, thr_min: float) -> float:  # noqa: FBT001 - kernels take positions
    """Return the thrust above which torque may raise the collective.

    At the least thrust the vehicle may be touching down, and torque against the ground must not lift it.
    """
    return np.inf if landed else thr_min * ABOVE_LEAST


@inner
def _observe(c: CascadeState, q_ned_frd: Array, acc: Array) -> float:
    """Update disturbance and hover thrust; return the time since the position loop ran, 0 if it is not due.

    The hover thrust is updated at its steps, from the second one on.
    """
    goes_on = c.updates > 0
    c.since_position_s += c.dt_s
    position_dt_s = 0.0
    if c.updates % c.position_divider == 0:
        position_dt_s = c.since_position_s
        c.since_position_s = 0.0
    c.updates += 1
    disturbance, hover = c.disturbance, c.hover
    observe_disturbance(
        disturbance, acc, q_ned_frd, c.allocation.thrust, hover.thrust, c.dt_s,
        bool(c.velocity_valid and not c.landed),
    )  # fmt: skip
    if position_dt_s > 0.0 and goes_on and c.flies and c.velocity_valid:
        x, y = q_ned_frd[1], q_ned_frd[2]
        up = 1.0 - 2.0 * (x * x + y * y)
        if up >= _HOVER_LEARN_UP:
            learn_hover_thrust(hover, -acc[2], disturbance.thrust * up, position_dt_s)
    return position_dt_s


@njit(cache=True)
def observe(cascade: Records, estimate: Array) -> None:
    """Update disturbance and hover thrust from the inputs in the record, for a controller of the user.

    The arguments are those of `follow_trajectory`.
    """
    _observe(cascade[0], estimate[:VEL], estimate[ACC:OMEGA])


@njit(cache=True)
def follow_trajectory(cascade: Records, estimate: Array) -> None:
    """Compute the motor controls and the intermediate results from the inputs in the record.

    ``cascade`` is (1,) of `CascadeState`; ``estimate`` (31,) has the layout of
    `autopilot.estimation.horizon`, NED and FRD. The position loop runs at every ``position_divider``-th call.
    The hover thrust estimate is updated from its second run on.
    """
    c: CascadeState = cascade[0]
    q_ned_frd, omega, acc = estimate[:VEL], estimate[OMEGA:STD], estimate[ACC:OMEGA]
    disturbance, hover, position = c.disturbance, c.hover, c.position
    before = hover.thrust
    position_dt_s = _observe(c, q_ned_frd, acc)
    if position_dt_s > 0.0:
        if hover.thrust != before:
            acc_down = position.output.acc_ned_m_s2[2] - disturbance.acc_ned_m_s2[2]
            position.integral_ned_m_s2[2] += integral_shift_m_s2(before, hover.thrust, acc_down)
        control_position(
            position, estimate[POS:GYRO_BIAS], estimate[VEL:POS], acc, disturbance.acc_ned_m_s2, hover.thrust,
            c.yaw_rad, c.climb_max_m_s, position_dt_s,
        )  # fmt: skip
    output, yaw_rate_rad_s = position.output, c.yaw_rate_rad_s
    if c.idles:
        level = quat_from_euler(0.0, 0.0, c.yaw_rad)
        for i in range(4):
            output.q_ned_frd[i] = level[i]
        output.thrust = 0.0
        yaw_rate_rad_s = 0.0
    c.by_tilt = True
    # the whole slice has the type of the arrays that Python passes, so one compilation serves both
    follow_attitude(
        cascade, q_ned_frd, omega, output.q_ned_frd[:], yaw_rate_rad_s, output.thrust, c.dt_s,
        not c.landed, airmode_above(bool(c.landed), position.settings.thr_min),
    )  # fmt: skip
