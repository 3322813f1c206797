"""Attitude, rates and allocation in one compiled step.

Each stage also has a class that can be used separately. In flight all three run at every inertial sample, and
one call of compiled code instead of three saves more time than the arithmetic takes.
"""

import numpy as np
from numba import njit

from autopilot.control.allocation import Allocator, allocate
from autopilot.control.attitude import rate_setpoint
from autopilot.control.block import Block
from autopilot.control.rates import RateController, rate_torque
from foundation.types import Array, AttitudeSetpoint, RateSetpoint

RATE_SETPOINT, TORQUE = range(2)
"""Rows of the block's ``stages``"""


@njit(cache=True)
def follow_attitude(
    block: Block, q_ned_frd: Array, omega_frd_rad_s: Array, q_setpoint: Array, yaw_rate_rad_s: float,
    thrust: float, dt_s: float,
    integrate: bool, airmode_above: float,  # noqa: FBT001 - kernels take positions
) -> None:  # fmt: skip
    """Compute the block's ``controls`` and intermediate results from an attitude and a collective thrust."""
    c = block[0]
    rate, cosine = rate_setpoint(
        q_ned_frd, q_setpoint, yaw_rate_rad_s, c["attitude_gain"], c["yaw_weight"], c["rate_max_rad_s"]
    )
    c["tilt_cosine"] = cosine
    highest = 1.0 if thrust > airmode_above else 0.0
    if c["by_tilt"]:
        thrust *= max(cosine, 0.0)
    _follow_rate(block, omega_frd_rad_s, rate, thrust, highest, dt_s, integrate)


@njit(cache=True)
def follow_rates(
    block: Block, omega_frd_rad_s: Array, demanded_frd_rad_s: Array, thrust: float, dt_s: float,
    integrate: bool, airmode_above: float,  # noqa: FBT001 - kernels take positions
) -> None:  # fmt: skip
    """Compute the same as `follow_attitude`, but from demanded body rates."""
    c = block[0]
    rate_max_rad_s = c["rate_max_rad_s"]
    rate = np.empty(3)
    for i in range(3):
        rate[i] = min(max(demanded_frd_rad_s[i], -rate_max_rad_s[i]), rate_max_rad_s[i])
    c["tilt_cosine"] = 1.0  # there is no tilt error
    highest = 1.0 if thrust > airmode_above else 0.0
    _follow_rate(block, omega_frd_rad_s, rate, thrust, highest, dt_s, integrate)


@njit(cache=True)
def _follow_rate(
    block: Block, omega_frd_rad_s: Array, rate_frd_rad_s: Array, thrust: float, highest: float, dt_s: float,
    integrate: bool,  # noqa: FBT001 - kernels take positions
) -> None:  # fmt: skip
    """Convert rates to torque, and torque with collective thrust to controls.

    Torque may raise the collective thrust to ``highest``.
    """
    c = block[0]
    torque = rate_torque(
        omega_frd_rad_s, rate_frd_rad_s, c["unallocated"], dt_s,
        c["rate_gains"], c["integral_max"], c["rate_cutoff_hz"], c["rate_state"], integrate,
    )  # fmt: skip
    stages = c["stages"]
    for axis in range(3):
        stages[RATE_SETPOINT, axis], stages[TORQUE, axis] = rate_frd_rad_s[axis], torque[axis]
    c["thrust"] = allocate(
        thrust, torque, c["mix"], c["yaw_thrust_margin"], highest, c["thrust_model_factor"],
        c["controls"], c["unallocated"],
    )  # fmt: skip


class InnerLoop:
    """The three stages over a shared block; `reset` resets rate controller and allocator."""

    def __init__(self, block: Block, rates: RateController, allocator: Allocator) -> None:
        self._block = block
        self._rates = rates
        self._allocator = allocator
        self._stages: Array = block["stages"][0]
        self._controls: Array = block["controls"][0]
        self.rate_setpoint_frd_rad_s: Array = self._stages[RATE_SETPOINT]
        """(3,) of the last step; overwritten in place, like the torque"""
        self.torque: Array = self._stages[TORQUE]
        """(3,) normalised, FRD"""

    def reset(self) -> None:
        """Reset setpoints, rate controller and allocator."""
        self._stages[:] = 0.0
        self._rates.reset()
        self._allocator.reset()

    def update(
        self, q_ned_frd: Array, omega_frd_rad_s: Array, setpoint: AttitudeSetpoint, *, dt_s: float,
        by_tilt: bool, integrate: bool, airmode_above: float,
    ) -> Array:  # fmt: skip
        """Return the motor controls (4,), 0..1.

        Args:
            q_ned_frd: (4,) present attitude.
            omega_frd_rad_s: (3,) present rates.
            setpoint: attitude, yaw rate and collective thrust.
            dt_s: time since the last call.
            by_tilt: apply only the component of the thrust along the present axis, none while upside down.
            integrate: update the rate integrators.
            airmode_above: above this thrust, torque may raise the collective thrust.

        """
        self._rates.start(omega_frd_rad_s)
        self._block["by_tilt"] = by_tilt
        follow_attitude(
            self._block, q_ned_frd, omega_frd_rad_s, setpoint.q_ned_frd, setpoint.yaw_rate_rad_s,
            setpoint.thrust, dt_s, integrate, airmode_above,
        )  # fmt: skip
        return self._controls.copy()

    def follow_rates(
        self, omega_frd_rad_s: Array, setpoint: RateSetpoint, *, dt_s: float, integrate: bool,
        airmode_above: float,
    ) -> Array:  # fmt: skip
        """Return the motor controls (4,), 0..1, for a collective thrust and body rates.

        The rates are limited to those of the attitude controller. The arguments are those of `update`.
        """
        self._rates.start(omega_frd_rad_s)
        follow_rates(
            self._block, omega_frd_rad_s, setpoint.rate_frd_rad_s, setpoint.thrust, dt_s, integrate,
            airmode_above,
        )  # fmt: skip
        return self._controls.copy()
