"""Rate control: PID with feed-forward from body rates to normalised torque; D acts on the filtered gyro."""

import math
from typing import Annotated

import numpy as np

from autopilot.control.params import RateParams
from foundation.kernels.inner import inner
from foundation.types import Array

_ERROR_FADE_RAD_S = math.radians(400.0)
"""Rate error at which the integrator stops, for instance during a flip (same in PX4)."""


class Rates:
    """Record: gains and state of the rate controller, about FRD axes; torques are normalised."""

    p: Annotated[Array, 3]
    i: Annotated[Array, 3]
    d: Annotated[Array, 3]
    feed_forward: Annotated[Array, 3]
    integral_max: float
    cutoff_hz: float
    """Of the low-pass for D."""
    previous_rad_s: Annotated[Array, 3]
    acc_rad_s2: Annotated[Array, 3]
    """Filtered angular acceleration."""
    integral: Annotated[Array, 3]
    """Torque of the integrators."""


@inner
def rate_torque(
    rates: Rates, rate: Array, setpoint: Array, unallocated: Array, dt_s: float,
    integrate: bool,  # noqa: FBT001 - kernels take positions
) -> Array:  # fmt: skip
    """Return the normalised torque (3,), FRD, for the present and the demanded body rates.

    ``unallocated`` (3,) is the part of the last torque demand that was not achieved; an integrator does not
    grow in its direction, and is constant unless ``integrate``.
    """
    alpha = dt_s / (dt_s + 1.0 / (2.0 * math.pi * rates.cutoff_hz))
    acc, integral = rates.acc_rad_s2, rates.integral
    torque = np.empty(3)
    for k in range(3):
        acc[k] += alpha * ((rate[k] - rates.previous_rad_s[k]) / dt_s - acc[k])
        rates.previous_rad_s[k] = rate[k]
        error = setpoint[k] - rate[k]
        torque[k] = (
            rates.p[k] * error + integral[k] - rates.d[k] * acc[k] + rates.feed_forward[k] * setpoint[k]
        )
        # anti-windup: do not integrate in the direction of a saturated axis
        if integrate and error * unallocated[k] <= 0.0:
            share = error / _ERROR_FADE_RAD_S
            fade = max(0.0, 1.0 - share * share)
            grown = integral[k] + fade * rates.i[k] * error * dt_s
            integral[k] = min(max(grown, -rates.integral_max), rates.integral_max)
    return torque


class RateController:
    """Settings and resets of the record."""

    def __init__(self, params: RateParams, record: Rates) -> None:
        self._record = record
        self.integral = record.integral
        """(3,) view"""
        self.set_params(params)
        self._started = False

    def set_params(self, params: RateParams) -> None:
        """Change the settings, in effect from the next update; integrals and gyro history are kept."""
        record = self._record
        k = np.array((params.roll_k, params.pitch_k, params.yaw_k))
        record.p[:] = k * (params.roll_p, params.pitch_p, params.yaw_p)
        record.i[:] = k * (params.roll_i, params.pitch_i, params.yaw_i)
        record.d[:] = k * (params.roll_d, params.pitch_d, params.yaw_d)
        record.feed_forward[:] = (params.roll_ff, params.pitch_ff, params.yaw_ff)
        record.integral_max, record.cutoff_hz = params.integral_max, params.derivative_cutoff_hz

    def reset(self) -> None:
        """Reset the integrals and the gyro history."""
        self._record.previous_rad_s[:] = 0.0
        self._record.acc_rad_s2[:] = 0.0
        self.integral[:] = 0.0
        self._started = False

    def start(self, rate_rad_s: Array) -> None:
        """Use the first rate (3,) after a reset also as the previous rate; later calls have no effect."""
        if not self._started:
            self._record.previous_rad_s[:] = rate_rad_s
            self._started = True
