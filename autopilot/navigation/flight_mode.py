"""The interface of a flight mode's behaviour, its inputs, and what the built-in modes have in common.

Consumer: `autopilot.navigation.setpoints.Navigator`, which has one behaviour per mode. Whether a mode may be
entered is decided in `autopilot.commander`.
"""

import math
from typing import ClassVar, Protocol

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from autopilot.commander.mode_table import ModeTraits
from autopilot.control.params import PositionParams, TrajectoryParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.guide import Guide
from autopilot.navigation.params import NavigationParams
from foundation.types import Array, AttitudeSetpoint, Course, EstimatorState, TrajectorySetpoint

ON_GROUND_M = 0.3
"""Height above the last position on the ground, given its accuracy, below which a target is on the ground."""
VERTICAL = (False, False, True)
IDLE = TrajectorySetpoint(vel_ned_m_s=np.zeros(3), vel_axes=VERTICAL)
"""Setpoint of an armed vehicle that stays on the ground."""

HomePosition = tuple[float, float, float]
"""NED metres from the estimator's origin."""


class ManualInput(Struct, frozen=True, kw_only=True):
    """Stick input of MANUAL_CONTROL. The creator must limit the values to their ranges."""

    time_us: int
    roll: float = 0.0
    """-1 .. 1, right positive"""
    pitch: float = 0.0
    """-1 .. 1, forward (nose down) positive"""
    yaw: float = 0.0
    """-1 .. 1, clockwise positive"""
    throttle: float = 0.5
    """0 .. 1"""


CENTRED = ManualInput(time_us=0)


class Moment(Struct, frozen=True, kw_only=True):
    """Inputs of a mode at one step."""

    state: EstimatorState
    dt_s: float
    landed: bool
    touching: bool
    """Ground contact is suspected, so the setpoint must not push against the ground."""
    home_ned_m: HomePosition | None = None

    @property
    def home_down_m(self) -> float:
        """Down position of home; without a home position heights are relative to the origin."""
        return self.home_ned_m[2] if self.home_ned_m is not None else 0.0


class ModeEntry(Moment, frozen=True, kw_only=True):
    """Inputs at the entry of a mode; ``dt_s`` is 0."""

    again: bool
    """The mode is restarted, after a reset of the estimate or by a repeated request."""
    takeoff_down_m: float
    """Final height of a take-off, NED down in metres."""


class ModeInputs(Moment, frozen=True, kw_only=True):
    """Inputs of a step of a mode."""

    manual: ManualInput | None = None
    """Sticks; None: centred."""
    hover_thrust: float | None = None
    """Thrust at mid throttle, 0..1; None: MPC_THR_HOVER."""
    disturbance_ned_m_s2: Array | None = None
    """(3,) acceleration that the controller compensates."""

    @property
    def sticks(self) -> ManualInput:
        """The sticks, centred without input."""
        return self.manual or CENTRED


class FlightModeBehaviour(Protocol):
    """Setpoints of one flight mode of one vehicle.

    A mode of the user (``autopilot.modes``) is created as ``Class(context)`` with a `ModeContext`; with a
    class attribute ``Settings``, a msgspec Struct or dataclass, as ``Class(context, settings)``.

    Call order: `enter`, then `update` at every inertial sample (4 ms) until another mode is entered;
    the other members are read or called in between. Positions are NED metres from the estimator's origin.
    Time is the sum of ``dt_s``; there is no clock, no I/O and no randomness: equal calls give equal bytes.
    """

    @property
    def traits(self) -> ModeTraits:
        """Its properties for commander and ground stations; an attribute of the class."""

    def enter(self, entry: ModeEntry) -> None:
        """Start from the present motion; if ``entry.again``, continue what the mode was doing."""

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint | AttitudeSetpoint:
        """Return the setpoint of this step, which must be continuous while the mode lasts.

        A landed vehicle gets `autopilot.navigation.flight_mode.IDLE`, unless the mode is to lift off.
        """

    def next_mode(self, state: EstimatorState, /) -> FlightMode | None:
        """Return the mode that the vehicle is to change to; None: it stays in this one."""

    @property
    def course(self) -> Course:
        """Whether the vehicle takes off or lands, for land detection and failsafes."""

    def apply_limits(self) -> None:
        """Continue with the present parameters of `ModeContext`, which have changed."""

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Change the ground speed until the mode ends; None: as by the parameters."""


class ModeContext:
    """What the modes of one vehicle share: parameters, the path to a target, and the speed of legs."""

    def __init__(self, params: NavigationParams, limits: TrajectoryParams, position: PositionParams) -> None:
        self.set_params(params, limits, position)
        self.guide = Guide(limits)
        self.ground_down_m = math.inf
        """Down position when a mode was last entered on the ground; infinite before."""
        self.speed_m_s: float | None = None
        """Ground speed requested in the present mode; None: MPC_XY_CRUISE."""

    def set_params(
        self, params: NavigationParams, limits: TrajectoryParams, position: PositionParams
    ) -> None:
        """Change the parameters, in effect from the next leg; see `FlightModeBehaviour.apply_limits`."""
        self.params, self.limits, self.position = params, limits, position

    def leg_limits(self, speed_m_s: float | None) -> TrajectoryParams:
        """Return the limits of a leg at a ground speed; None: MPC_XY_CRUISE."""
        if speed_m_s is None:
            return self.limits
        return replace(self.limits, xy_cruise_m_s=min(speed_m_s, self.position.xy_vel_max_m_s))

    def apply_leg_limits(self) -> None:
        """Set the guide's limits for a leg."""
        self.guide.set_limits(self.leg_limits(self.speed_m_s))

    def change_speed(self, speed_m_s: float | None) -> None:
        """Change the ground speed of the present leg and the following ones."""
        self.speed_m_s = speed_m_s
        self.apply_leg_limits()

    def is_near(self, state: EstimatorState, place_ned_m: Array, *, radius_m: float) -> bool:
        """Return whether the vehicle is within the radius and NAV_MC_ALT_RAD of a position (3,)."""
        pos_ned_m = state.pos_ned_m
        return (
            abs(pos_ned_m[2] - place_ned_m[2]) <= self.params.altitude_acceptance_m
            and math.hypot(pos_ned_m[0] - place_ned_m[0], pos_ned_m[1] - place_ned_m[1]) <= radius_m
        )

    def turn_by_yaw_mode(self, place_ned_m: Array, home_ned_m: HomePosition | None, *, near_m: float) -> None:
        """Set the heading by MPC_YAW_MODE on the way to a position (3,).

        It is kept if the target is nearer than ``near_m``, or the path slower than a tenth of it per second.
        """
        mode, guide = self.params.yaw_mode, self.guide
        pos_ned_m = guide.pos_ned_m
        if mode == 3:
            way = guide.vel_ned_m_s
            near_m *= 0.1
        elif mode == 0:
            way = place_ned_m - pos_ned_m
        elif home_ned_m is None:
            return
        else:
            way = np.array(home_ned_m) - pos_ned_m
            if mode == 2:
                way = -way
        if math.hypot(way[0], way[1]) >= near_m:
            guide.turn_to(math.atan2(way[1], way[0]))


class StopMode:
    """Stops, and stays there; base of the other modes, which override what differs."""

    traits: ClassVar[ModeTraits]

    def __init__(self, context: ModeContext) -> None:
        self._context = context
        self._guide = context.guide

    def enter(self, entry: ModeEntry) -> None:
        """Stop from the present motion."""
        self._context.apply_leg_limits()
        self._guide.restart(entry.state)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint | AttitudeSetpoint:
        """Return the setpoint of the stop; idle on the ground."""
        return IDLE if inputs.landed else self._guide.update(inputs.dt_s)

    def next_mode(self, _state: EstimatorState, /) -> FlightMode | None:
        """Return None: it stays in this mode."""
        return None

    @property
    def course(self) -> Course:
        """Neither take-off nor landing."""
        return Course.OTHER

    def apply_limits(self) -> None:
        """Apply the parameters to the present leg."""
        self._context.apply_leg_limits()

    def change_speed(self, _speed_m_s: float | None, /) -> None:
        """Do nothing: the mode has no legs."""
