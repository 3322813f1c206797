"""Attitude control: quaternion error to body rates, with priority of tilt over yaw.

D. Brescianini, M. Hehn, R. D'Andrea, "Nonlinear quadrocopter attitude control", ETH Zurich 2013, as
implemented in PX4.
"""

import math

import numpy as np
from numba import njit

from autopilot.control.block import Block, new_block
from autopilot.control.params import AttitudeParams
from foundation.geometry.rotations import conjugate, multiply, normalise, rotate
from foundation.types import Array, AttitudeSetpoint

_DOWN = (0.0, 0.0, 1.0)


@njit(cache=True)
def rate_setpoint(
    q_ned_frd: Array,
    q_ned_setpoint: Array,
    yaw_rate_rad_s: float,
    gain: Array,
    yaw_weight: float,
    rate_max_rad_s: Array,
) -> tuple[Array, float]:
    """Return the rate setpoint, and the cosine of the angle between desired and present thrust axis."""
    q_now = (q_ned_frd[0], q_ned_frd[1], q_ned_frd[2], q_ned_frd[3])
    q_goal = (q_ned_setpoint[0], q_ned_setpoint[1], q_ned_setpoint[2], q_ned_setpoint[3])
    a, b, c = rotate(q_now, _DOWN)
    d, e, f = rotate(q_goal, _DOWN)
    cosine = a * d + b * e + c * f
    if 1.0 + cosine < 1e-10:
        # upside down: all tilt axes are equally short, so use the rotation that also corrects the yaw
        q_target = q_goal
    else:
        # shortest rotation from the present thrust axis (a, b, c) to the desired one (d, e, f), in NED
        tilt = normalise((1.0 + cosine, b * f - c * e, c * d - a * f, a * e - b * d))
        q_tilted = multiply(tilt, q_now)
        w, _, _, z = multiply(conjugate(q_tilted), q_goal)  # about body z only
        if w < 0.0:
            w, z = -w, -z
        half_yaw_rad = yaw_weight * math.atan2(z, w)
        q_target = multiply(q_tilted, (math.cos(half_yaw_rad), 0.0, 0.0, math.sin(half_yaw_rad)))

    error = multiply(conjugate(q_now), q_target)
    twice_sign = 2.0 if error[0] >= 0.0 else -2.0
    feed_forward = rotate(conjugate(q_now), (0.0, 0.0, yaw_rate_rad_s))
    rate = np.empty(3)
    for i in range(3):
        demanded = twice_sign * error[1 + i] * gain[i] + feed_forward[i]
        rate[i] = min(max(demanded, -rate_max_rad_s[i]), rate_max_rad_s[i])
    return rate, cosine


class AttitudeController:
    """P controller from attitude error to body rates."""

    def __init__(self, params: AttitudeParams, block: Block | None = None) -> None:
        block = new_block() if block is None else block
        self.gain: Array = block["attitude_gain"][0]
        self.rate_max_rad_s: Array = block["rate_max_rad_s"][0]
        self._yaw_weight: Array = block["yaw_weight"]
        self._tilt_cosine: Array = block["tilt_cosine"]
        self._tilt_cosine[0] = 1.0
        self.set_params(params)

    @property
    def tilt_cosine(self) -> float:
        """Cosine of the angle between the desired and the present thrust axis at the last update."""
        return float(self._tilt_cosine[0])

    def set_params(self, params: AttitudeParams) -> None:
        """Change the settings, in effect from the next update."""
        self._yaw_weight[0] = params.yaw_weight
        # only the weighted part of a yaw error is in the error quaternion: compensate that in the gain
        yaw_gain = params.yaw_p / params.yaw_weight if params.yaw_weight > 1e-4 else 0.0
        self.gain[:] = (params.roll_p, params.pitch_p, yaw_gain)
        self.rate_max_rad_s[:] = (
            params.roll_rate_max_rad_s, params.pitch_rate_max_rad_s, params.yaw_rate_max_rad_s,
        )  # fmt: skip

    def update(self, q_ned_frd: Array, setpoint: AttitudeSetpoint) -> Array:
        """Return the limited body rate setpoint (3,), FRD; the setpoint's yaw rate is about NED down."""
        rate: Array
        rate, self._tilt_cosine[0] = rate_setpoint(
            q_ned_frd,
            setpoint.q_ned_frd,
            setpoint.yaw_rate_rad_s,
            self.gain,
            float(self._yaw_weight[0]),
            self.rate_max_rad_s,
        )
        return rate
