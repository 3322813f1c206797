"""The interface of a flight mode's behaviour, its inputs, and what the modes of one vehicle share.

Consumer: `autopilot.navigation.setpoints.Navigator`, which has one behaviour per mode. The built-in ones are
in `autopilot.navigation.modes`. Whether a mode may be entered is decided in `autopilot.commander`.
"""

import math
from typing import Protocol

from msgspec.structs import replace

from autopilot.control.params import PositionParams, TrajectoryParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.guide import Guide, Moment
from autopilot.navigation.manual import ManualInput
from autopilot.navigation.params import NavigationParams
from foundation.types import Array, AttitudeSetpoint, Course, EstimatorState, TrajectorySetpoint

ON_GROUND_M = 0.3
"""A target less than this above the last position on the ground counts as on the ground, given the accuracy
of heights."""


class ModeEntry(Moment, frozen=True, kw_only=True):
    """Inputs at the entry of a mode; ``dt_s`` is 0."""

    again: bool
    """The mode is restarted, after a reset of the estimate or by a repeated request."""
    takeoff_down_m: float
    """Final height of a take-off, NED down in metres."""


class ModeInputs(Moment, frozen=True, kw_only=True):
    """Inputs of a step of a mode."""

    manual: ManualInput | None
    """Sticks; None: centred."""
    hover_thrust: float | None
    """Thrust at mid throttle, 0..1; None: MPC_THR_HOVER."""
    disturbance_ned_m_s2: Array | None
    """(3,) acceleration that the controller compensates."""


class FlightModeBehaviour(Protocol):
    """Setpoints of one flight mode of one vehicle.

    Call order: `enter`, then `update` at every step of position control (8 ms) until another mode is entered;
    the other members are read or called in between. Positions are NED metres from the estimator's origin.
    Time is the sum of ``dt_s``; there is no clock, no I/O and no randomness: equal calls give equal bytes.
    """

    def enter(self, entry: ModeEntry) -> None:
        """Start from the present motion; if ``entry.again``, continue what the mode was doing."""

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint | AttitudeSetpoint:
        """Return the setpoint of this step, which must be continuous while the mode lasts.

        A landed vehicle gets `autopilot.navigation.landing.IDLE`, unless the mode is to lift off.
        """

    def next_mode(self, state: EstimatorState, /) -> FlightMode | None:
        """Return the mode that the vehicle is to change to; None: it stays in this one."""

    def completed(self, state: EstimatorState, /) -> bool:
        """Return whether the mode has reached its aim; False for modes without one."""

    @property
    def course(self) -> Course:
        """Whether the vehicle takes off or lands, for land detection and failsafes."""

    @property
    def target_ned_m(self) -> Array | None:
        """Target position (3,); None in modes without one."""

    def apply_limits(self) -> None:
        """Continue with the present parameters of `ModeContext`, which have changed."""

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Change the ground speed until the mode ends; None: as by the parameters."""


class ModeContext:
    """What the modes of one vehicle share: parameters, the path to a target, and the speed of legs."""

    def __init__(self, params: NavigationParams, limits: TrajectoryParams, position: PositionParams) -> None:
        self.params, self.limits, self.position = params, limits, position
        self.guide = Guide(limits)
        self.ground_down_m = math.inf
        """Down position when a mode was last entered on the ground; infinite before."""
        self.speed_m_s: float | None = None
        """Ground speed requested in the present mode; None: MPC_XY_CRUISE."""

    @property
    def is_target_on_ground(self) -> bool:
        """Whether the guide's target is on the ground, as far as heights are accurate."""
        return bool(self.guide.target_ned_m[2] > self.ground_down_m - ON_GROUND_M)

    def apply_leg_limits(self) -> None:
        """Set the guide's limits for a leg."""
        limits = self.limits
        if self.speed_m_s is not None:
            limits = replace(limits, xy_cruise_m_s=min(self.speed_m_s, self.position.xy_vel_max_m_s))
        self.guide.set_limits(limits)
