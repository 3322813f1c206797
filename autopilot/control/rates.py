"""Rate control: PID with feed-forward from body rates to normalised torque; D acts on the filtered gyro."""

import math

import numpy as np
from numba import njit

from autopilot.control.block import Block, new_block
from autopilot.control.params import RateParams
from foundation.types import Array

_ERROR_FADE_RAD_S = math.radians(400.0)
"""Rate error at which the integrator stops, for instance during a flip (same in PX4)."""


@njit(cache=True)
def rate_torque(
    rate: Array, setpoint: Array, unallocated: Array, dt_s: float, gains: Array, integral_max: float,
    cutoff_hz: float, state: Array, integrate: bool,  # noqa: FBT001 - kernels take positions
) -> Array:  # fmt: skip
    """Return the normalised torque (3,), FRD, and update ``state``.

    ``state`` (3, 3): previous rate, filtered angular acceleration, integral. ``gains`` (4, 3): P, I, D,
    feed-forward. The integral is constant unless ``integrate``.
    """
    p, i, d, ff = gains[0], gains[1], gains[2], gains[3]
    alpha = dt_s / (dt_s + 1.0 / (2.0 * math.pi * cutoff_hz))
    torque = np.empty(3)
    for k in range(3):
        state[1, k] += alpha * ((rate[k] - state[0, k]) / dt_s - state[1, k])
        state[0, k] = rate[k]
        error = setpoint[k] - rate[k]
        torque[k] = p[k] * error + state[2, k] - d[k] * state[1, k] + ff[k] * setpoint[k]
        # anti-windup: do not integrate in the direction of a saturated axis
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
        """Rows as in `rate_torque`"""
        self._integral_max: Array = block["integral_max"]
        self._cutoff_hz: Array = block["rate_cutoff_hz"]
        self.set_params(params)
        self._started = False

    def set_params(self, params: RateParams) -> None:
        """Change the settings, in effect from the next update; integrals and gyro history are kept."""
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
        """Normalised torque (3,) of the integrators, FRD."""
        return np.array(self.state[2])

    def reset(self) -> None:
        """Reset the integrals and the gyro history."""
        self.state[:] = 0.0
        self._started = False

    def reset_integral(self) -> None:
        """Reset the integrals only."""
        self.state[2] = 0.0

    def update(
        self, rate_rad_s: Array, setpoint_rad_s: Array, unallocated: Array, *, dt_s: float, integrate: bool
    ) -> Array:
        """Return the normalised torque (3,) about FRD axes.

        ``unallocated`` (3,) is the part of the last torque demand that was not achieved
        (`Allocator.unallocated`); an integrator does not grow in its direction.
        """
        self.start(rate_rad_s)
        torque: Array = rate_torque(
            rate_rad_s, setpoint_rad_s, unallocated, dt_s, self.gains,
            float(self._integral_max[0]), float(self._cutoff_hz[0]), self.state, integrate,
        )  # fmt: skip
        return torque

    def start(self, rate_rad_s: Array) -> None:
        """Use the first rate (3,) after a reset also as the previous rate; later calls have no effect."""
        if not self._started:
            self.state[0] = rate_rad_s
            self._started = True
