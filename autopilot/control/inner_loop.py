"""Attitude, rates and allocation in one step of compiled code.

Each stage is a class of its own that can be used alone. In flight all three run at every inertial sample, and
crossing into compiled code once instead of three times is worth more than all of their arithmetic.
"""

import numpy as np
from numba import njit

from autopilot.control.allocation import Allocator, allocate
from autopilot.control.attitude import AttitudeController, rate_setpoint
from autopilot.control.rates import RateController, rate_torque
from autopilot.types import Array, AttitudeSetpoint, RateSetpoint


@njit(cache=True)
def follow_attitude(
    q_ned_frd: Array, omega_frd_rad_s: Array, q_setpoint: Array, yaw_rate_rad_s: float, thrust: float,
    dt_s: float, by_tilt: bool, integrate: bool, airmode_above: float,  # noqa: FBT001 - kernels take positions
    attitude_gain: Array, yaw_weight: float, rate_max_rad_s: Array,
    rate_gains: Array, integral_max: float, cutoff_hz: float, rate_state: Array,
    mix: Array, yaw_margin: float, thrust_factor: float, unallocated: Array,
    stages: Array, controls: Array,
) -> tuple[float, float]:  # fmt: skip
    """Fill ``stages`` (2, 3) with rate setpoint and torque, and ``controls`` (4,).

    Returns achieved collective and cosine of the tilt error.
    """
    rate, cosine = rate_setpoint(
        q_ned_frd, q_setpoint, yaw_rate_rad_s, attitude_gain, yaw_weight, rate_max_rad_s
    )
    torque = rate_torque(
        omega_frd_rad_s, rate, unallocated, dt_s, rate_gains, integral_max, cutoff_hz, rate_state, integrate
    )
    stages[0] = rate
    stages[1] = torque
    highest = 1.0 if thrust > airmode_above else 0.0
    if by_tilt:
        thrust *= max(cosine, 0.0)
    collective = allocate(thrust, torque, mix, yaw_margin, highest, thrust_factor, controls, unallocated)
    return collective, cosine


@njit(cache=True)
def _rate_step(
    omega_frd_rad_s: Array, wanted_frd_rad_s: Array, rate_max_rad_s: Array, thrust: float,
    dt_s: float, integrate: bool, airmode_above: float,  # noqa: FBT001 - kernels take positions
    rate_gains: Array, integral_max: float, cutoff_hz: float, rate_state: Array,
    mix: Array, yaw_margin: float, thrust_factor: float, unallocated: Array,
    stages: Array, controls: Array,
) -> float:  # fmt: skip
    """Do as `follow_attitude`, with rates that were asked for in place of those towards an attitude."""
    rate = np.empty(3)
    for i in range(3):
        rate[i] = min(max(wanted_frd_rad_s[i], -rate_max_rad_s[i]), rate_max_rad_s[i])
    torque = rate_torque(
        omega_frd_rad_s, rate, unallocated, dt_s, rate_gains, integral_max, cutoff_hz, rate_state, integrate
    )
    stages[0] = rate
    stages[1] = torque
    highest = 1.0 if thrust > airmode_above else 0.0
    return allocate(thrust, torque, mix, yaw_margin, highest, thrust_factor, controls, unallocated)


class InnerLoop:
    """The three stages, whose settings and memories it uses."""

    def __init__(self, attitude: AttitudeController, rates: RateController, allocator: Allocator) -> None:
        self._attitude = attitude
        self._rates = rates
        self._allocator = allocator
        self.stages: Array = np.zeros((2, 3))
        """As `follow_attitude` has them"""
        self.rate_setpoint_frd_rad_s: Array = self.stages[0]
        """(3,) of the last step, like the torque rewritten in place"""
        self.torque: Array = self.stages[1]
        """(3,) normalised, FRD"""

    def reset(self) -> None:
        """Forget what was flown."""
        self.stages[:] = 0.0
        self._rates.reset()
        self._allocator.reset()

    def update(
        self, q_ned_frd: Array, omega_frd_rad_s: Array, setpoint: AttitudeSetpoint, *, dt_s: float,
        by_tilt: bool, integrate: bool, airmode_above: float,
    ) -> Array:  # fmt: skip
        """(4,) motor controls 0..1.

        Args:
            q_ned_frd: (4,) present attitude.
            omega_frd_rad_s: (3,) present rates.
            setpoint: attitude, yaw rate and collective thrust.
            dt_s: since the last call.
            by_tilt: give the share of the thrust that lies along the present axis, none while upside down.
            integrate: let the rate integrators learn.
            airmode_above: a thrust above this lets torque raise the collective.

        """
        attitude, rates, allocator = self._attitude, self._rates, self._allocator
        rates.start(omega_frd_rad_s)
        controls = np.empty(4)
        allocator.thrust, attitude.tilt_cosine = follow_attitude(
            q_ned_frd, omega_frd_rad_s, setpoint.q_ned_frd, setpoint.yaw_rate_rad_s, setpoint.thrust,
            dt_s, by_tilt, integrate, airmode_above,
            attitude.gain, attitude.yaw_weight, attitude.rate_max_rad_s,
            rates.gains, rates.integral_max, rates.cutoff_hz, rates.state,
            allocator.mix, allocator.params.yaw_thrust_margin, allocator.params.thrust_model_factor,
            allocator.unallocated, self.stages, controls,
        )  # fmt: skip
        return controls

    def follow_rates(
        self, omega_frd_rad_s: Array, setpoint: RateSetpoint, *, dt_s: float, integrate: bool,
        airmode_above: float,
    ) -> Array:  # fmt: skip
        """(4,) motor controls 0..1 for body rates, within the attitude controller's limits, and thrust.

        The arguments are those of `update`.
        """
        attitude, rates, allocator = self._attitude, self._rates, self._allocator
        rates.start(omega_frd_rad_s)
        controls = np.empty(4)
        attitude.tilt_cosine = 1.0  # there is no tilt to miss
        allocator.thrust = _rate_step(
            omega_frd_rad_s, setpoint.rate_frd_rad_s, attitude.rate_max_rad_s, setpoint.thrust,
            dt_s, integrate, airmode_above,
            rates.gains, rates.integral_max, rates.cutoff_hz, rates.state,
            allocator.mix, allocator.params.yaw_thrust_margin, allocator.params.thrust_model_factor,
            allocator.unallocated, self.stages, controls,
        )  # fmt: skip
        return controls
