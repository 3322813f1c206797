"""Rate control: PID with feed-forward from body rates to normalised torque, D on the filtered gyro."""

import math

import numpy as np
from numba import njit

from autopilot.control.block import Block, new_block
from autopilot.control.params import RateParams
from foundation.types import Array

_ERROR_FADE_RAD_S = math.radians(400.0)
"""Rate error at which the integrator stops: a flip is no steady torque (PX4: the same)."""


@njit(cache=True)
def rate_torque(
    rate: Array, setpoint: Array, unallocated: Array, dt_s: float, gains: Array, integral_max: float,
    cutoff_hz: float, state: Array, integrate: bool,  # noqa: FBT001 - kernels take positions
) -> Array:  # fmt: skip
    """``state`` (3, 3): previous rate, filtered angular acceleration, integral; updated in place.

    ``gains`` (4, 3): P, I, D, feed-forward. Without ``integrate`` the integral stays.
    """
    p, i, d, ff = gains[0], gains[1], gains[2], gains[3]
    alpha = dt_s / (dt_s + 1.0 / (2.0 * math.pi * cutoff_hz))
    torque = np.empty(3)
    for k in range(3):
        state[1, k] += alpha * ((rate[k] - state[0, k]) / dt_s - state[1, k])
        state[0, k] = rate[k]
        error = setpoint[k] - rate[k]
        torque[k] = p[k] * error + state[2, k] - d[k] * state[1, k] + ff[k] * setpoint[k]
        # where the motors have no more to give the integral must not follow
        if integrate and error * unallocated[k] <= 0.0:
            share = error / _ERROR_FADE_RAD_S
            fade = max(0.0, 1.0 - share * share)
            integral = state[2, k] + fade * i[k] * error * dt_s
            state[2, k] = min(max(integral, -integral_max), integral_max)
    return torque


class RateController:
    """PID from body rate error to normalised torque."""

    def __init__(self, params: RateParams, block: Block | None = None) -> None:
        block = new_block() if block is None else block
        self.gains: Array = block["rate_gains"][0]
        """(4, 3) P, I, D, feed-forward about FRD axes"""
        self.state: Array = block["rate_state"][0]
        """Rows as `rate_torque` has them"""
        self._integral_max: Array = block["integral_max"]
        self._cutoff_hz: Array = block["rate_cutoff_hz"]
        self.set_params(params)
        self._started = False

    def set_params(self, params: RateParams) -> None:
        """Act by these from the next update on; integrals and the gyro's history stay."""
        k = np.array((params.roll_k, params.pitch_k, params.yaw_k))
        self.gains[:] = (
            k * (params.roll_p, params.pitch_p, params.yaw_p),
            k * (params.roll_i, params.pitch_i, params.yaw_i),
            k * (params.roll_d, params.pitch_d, params.yaw_d),
            (params.roll_ff, params.pitch_ff, params.yaw_ff),
        )  # fmt: skip
        self._integral_max[0] = params.integral_max
        self._cutoff_hz[0] = params.derivative_cutoff_hz

    @property
    def integral(self) -> Array:
        """(3,) normalised torque held by the integrators, FRD."""
        return np.array(self.state[2])

    def reset(self) -> None:
        """Forget integrals and the gyro's history."""
        self.state[:] = 0.0
        self._started = False

    def reset_integral(self) -> None:
        """Empty the integrators alone."""
        self.state[2] = 0.0

    def update(
        self, rate_rad_s: Array, setpoint_rad_s: Array, unallocated: Array, *, dt_s: float, integrate: bool
    ) -> Array:
        """(3,) normalised torque about FRD axes.

        ``unallocated`` (3,) is the torque that the last demand did not get (`Allocator.unallocated`): an
        integrator does not grow in its direction.
        """
        self.start(rate_rad_s)
        torque: Array = rate_torque(
            rate_rad_s, setpoint_rad_s, unallocated, dt_s, self.gains,
            float(self._integral_max[0]), float(self._cutoff_hz[0]), self.state, integrate,
        )  # fmt: skip
        return torque

    def start(self, rate_rad_s: Array) -> None:
        """Take the first rate (3,) since a reset for the one before it; later ones change nothing."""
        if not self._started:
            self.state[0] = rate_rad_s
            self._started = True
