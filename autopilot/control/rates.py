"""Rate control: PID with feed-forward from body rates to normalised torque, D on the filtered gyro."""

import math

import numpy as np
from numba import njit

from autopilot.control.params import RateParams
from autopilot.types import Array

_ERROR_FADE_RAD_S = math.radians(400.0)
"""Rate error at which the integrator stops: a flip is no steady torque (PX4: the same)."""
_NO_INTEGRAL: Array = np.zeros(3)


@njit(cache=True)
def _torque(
    rate: Array, setpoint: Array, unallocated: Array, dt_s: float, p: Array, i: Array, d: Array, ff: Array,
    integral_max: float, cutoff_hz: float, state: Array,
) -> Array:  # fmt: skip
    """``state`` (3, 3): previous rate, filtered angular acceleration, integral; updated in place."""
    alpha = dt_s / (dt_s + 1.0 / (2.0 * math.pi * cutoff_hz))
    torque = np.empty(3)
    for k in range(3):
        state[1, k] += alpha * ((rate[k] - state[0, k]) / dt_s - state[1, k])
        state[0, k] = rate[k]
        error = setpoint[k] - rate[k]
        torque[k] = p[k] * error + state[2, k] - d[k] * state[1, k] + ff[k] * setpoint[k]
        if error * unallocated[k] <= 0.0:  # else the motors have no more to give in this direction
            fade = max(0.0, 1.0 - (error / _ERROR_FADE_RAD_S) ** 2)
            integral = state[2, k] + fade * i[k] * error * dt_s
            state[2, k] = min(max(integral, -integral_max), integral_max)
    return torque


class RateController:
    """PID from body rate error to normalised torque."""

    def __init__(self, params: RateParams) -> None:
        k = np.array((params.roll_k, params.pitch_k, params.yaw_k))
        self._p: Array = k * (params.roll_p, params.pitch_p, params.yaw_p)
        self._i: Array = k * (params.roll_i, params.pitch_i, params.yaw_i)
        self._d: Array = k * (params.roll_d, params.pitch_d, params.yaw_d)
        self._ff: Array = np.array((params.roll_ff, params.pitch_ff, params.yaw_ff))
        self._integral_max = params.integral_max
        self._cutoff_hz = params.derivative_cutoff_hz
        self._state: Array = np.zeros((3, 3))
        self._started = False

    @property
    def integral(self) -> Array:
        """(3,) normalised torque held by the integrators, FRD."""
        return np.array(self._state[2])

    def reset(self) -> None:
        """Forget integrals and the gyro's history."""
        self._state[:] = 0.0
        self._started = False

    def reset_integral(self) -> None:
        """Empty the integrators alone."""
        self._state[2] = 0.0

    def update(
        self, rate_rad_s: Array, setpoint_rad_s: Array, unallocated: Array, *, dt_s: float, integrate: bool
    ) -> Array:
        """(3,) normalised torque about FRD axes.

        ``unallocated`` (3,) is the torque that the last demand did not get (`Allocator.unallocated`): an
        integrator does not grow in its direction.
        """
        if not self._started:
            self._state[0] = rate_rad_s
            self._started = True
        torque: Array = _torque(
            rate_rad_s, setpoint_rad_s, unallocated, dt_s, self._p, self._i if integrate else _NO_INTEGRAL,
            self._d, self._ff, self._integral_max, self._cutoff_hz, self._state,
        )  # fmt: skip
        return torque
