"""Attitude control: quaternion error to body rates, tilt before yaw.

D. Brescianini, M. Hehn, R. D'Andrea, "Nonlinear quadrocopter attitude control", ETH Zurich 2013, as PX4
applies it.
"""

import math

import numpy as np
from numba import njit

from autopilot.control.params import AttitudeParams
from autopilot.estimation.rotation import (
    quat_conjugate,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_rotate_inverse,
)
from autopilot.types import Array, AttitudeSetpoint


@njit(cache=True)
def rate_setpoint(
    q_ned_frd: Array,
    q_ned_setpoint: Array,
    yaw_rate_rad_s: float,
    gain: Array,
    yaw_weight: float,
    rate_max_rad_s: Array,
) -> tuple[Array, float]:
    """Rate setpoint, and the cosine of the angle between wanted and present thrust axis."""
    down = np.array([0.0, 0.0, 1.0])
    z_now = quat_rotate(q_ned_frd, down)
    z_wanted = quat_rotate(q_ned_setpoint, down)
    cosine = z_now[0] * z_wanted[0] + z_now[1] * z_wanted[1] + z_now[2] * z_wanted[2]
    if 1.0 + cosine < 1e-10:
        # upside down: every tilt axis is as short as any other, so take the one that also brings the yaw
        q_wanted = q_ned_setpoint
    else:
        tilt = np.empty(4)  # the shortest rotation from z_now to z_wanted, in NED
        tilt[0] = 1.0 + cosine
        tilt[1] = z_now[1] * z_wanted[2] - z_now[2] * z_wanted[1]
        tilt[2] = z_now[2] * z_wanted[0] - z_now[0] * z_wanted[2]
        tilt[3] = z_now[0] * z_wanted[1] - z_now[1] * z_wanted[0]
        q_tilted = quat_multiply(quat_normalise(tilt), q_ned_frd)
        q_yaw = quat_multiply(quat_conjugate(q_tilted), q_ned_setpoint)  # about body z alone
        if q_yaw[0] < 0.0:
            q_yaw = -q_yaw
        half_yaw_rad = yaw_weight * math.atan2(q_yaw[3], q_yaw[0])
        part = np.array([math.cos(half_yaw_rad), 0.0, 0.0, math.sin(half_yaw_rad)])
        q_wanted = quat_multiply(q_tilted, part)

    error = quat_multiply(quat_conjugate(q_ned_frd), q_wanted)
    twice_sign = 2.0 if error[0] >= 0.0 else -2.0
    feed_forward = quat_rotate_inverse(q_ned_frd, np.array([0.0, 0.0, yaw_rate_rad_s]))
    rate = np.empty(3)
    for i in range(3):
        wanted = twice_sign * error[1 + i] * gain[i] + feed_forward[i]
        rate[i] = min(max(wanted, -rate_max_rad_s[i]), rate_max_rad_s[i])
    return rate, cosine


class AttitudeController:
    """P controller from attitude error to body rates."""

    def __init__(self, params: AttitudeParams) -> None:
        self.tilt_cosine = 1.0
        """Cosine of the angle between the wanted and the present thrust axis at the last `update`"""
        self.set_params(params)

    def set_params(self, params: AttitudeParams) -> None:
        """Act by these from the next update on."""
        self.yaw_weight = params.yaw_weight
        # only the weighted part of a yaw error enters the error quaternion: undo that in the gain
        yaw_gain = params.yaw_p / params.yaw_weight if params.yaw_weight > 1e-4 else 0.0
        self.gain: Array = np.array((params.roll_p, params.pitch_p, yaw_gain))
        self.rate_max_rad_s: Array = np.array(
            (params.roll_rate_max_rad_s, params.pitch_rate_max_rad_s, params.yaw_rate_max_rad_s)
        )

    def update(self, q_ned_frd: Array, setpoint: AttitudeSetpoint) -> Array:
        """(3,) body rate setpoint, FRD, within the limits; the setpoint's yaw rate is about NED down."""
        rate: Array
        rate, self.tilt_cosine = rate_setpoint(
            q_ned_frd,
            setpoint.q_ned_frd,
            setpoint.yaw_rate_rad_s,
            self.gain,
            self.yaw_weight,
            self.rate_max_rad_s,
        )
        return rate
