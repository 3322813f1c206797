"""Attitude control: quaternion error to body rates, with priority of tilt over yaw.

D. Brescianini, M. Hehn, R. D'Andrea, "Nonlinear quadrocopter attitude control", ETH Zurich 2013, as
implemented in PX4.
"""

import math
from typing import Annotated

import numpy as np

from autopilot.control.params import AttitudeParams
from foundation.geometry.rotations import conjugate, multiply, normalise, rotate
from foundation.kernels.inner import inner
from foundation.types import Array

_DOWN = (0.0, 0.0, 1.0)


class Attitude:
    """Record: settings of attitude control, and the angle of its last update."""

    gain: Annotated[Array, 3]
    """About FRD axes, 1/s."""
    rate_max_rad_s: Annotated[Array, 3]
    yaw_weight: float
    tilt_cosine: float
    """Cosine of the angle between the desired and the present thrust axis."""


@inner
def rate_setpoint(
    attitude: Attitude, q_ned_frd: Array, q_ned_setpoint: Array, yaw_rate_rad_s: float
) -> Array:
    """Return the limited body rate setpoint (3,), FRD; the yaw rate is about NED down."""
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
        half_yaw_rad = attitude.yaw_weight * math.atan2(z, w)
        q_target = multiply(q_tilted, (math.cos(half_yaw_rad), 0.0, 0.0, math.sin(half_yaw_rad)))

    error = multiply(conjugate(q_now), q_target)
    twice_sign = 2.0 if error[0] >= 0.0 else -2.0
    feed_forward = rotate(conjugate(q_now), (0.0, 0.0, yaw_rate_rad_s))
    rate = np.empty(3)
    for i in range(3):
        demanded = twice_sign * error[1 + i] * attitude.gain[i] + feed_forward[i]
        rate[i] = min(max(demanded, -attitude.rate_max_rad_s[i]), attitude.rate_max_rad_s[i])
    attitude.tilt_cosine = cosine
    return rate


def set_attitude(attitude: Attitude, params: AttitudeParams, *, controls_yaw: bool = True) -> None:
    """Change the settings, in effect from the next update; without control of yaw its error has no effect."""
    attitude.yaw_weight = weight = params.yaw_weight if controls_yaw else 0.0
    # only the weighted part of a yaw error is in the error quaternion: compensate that in the gain
    yaw_gain = params.yaw_p / weight if weight > 1e-4 else 0.0
    attitude.gain[:] = (params.roll_p, params.pitch_p, yaw_gain)
    attitude.rate_max_rad_s[:] = (
        params.roll_rate_max_rad_s, params.pitch_rate_max_rad_s, params.yaw_rate_max_rad_s,
    )  # fmt: skip
