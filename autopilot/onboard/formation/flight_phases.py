"""State machine of a flight: selects the phase and the command for the autopilot. No I/O.

At the hand-over of the take-off (`autopilot.onboard.client.take_off`) the application takes over in offboard
mode, with a setpoint that continues the climb at the same speed over the corrected position. A UAV does not
take off before the formation's shape on the ground is known to `SHAPE_STD_M`, or `LOCALISE_TIMEOUT_US` has
passed. A held flight waits before all that.
"""

from collections.abc import Callable

from msgspec import Struct

from autopilot.mavlink.modes import FlightMode
from autopilot.onboard.client.autopilots import PX4, AutopilotInterface
from autopilot.onboard.client.commands import CommandSender
from autopilot.onboard.client.own_state import OwnState
from autopilot.onboard.client.take_off import TakeOff
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.predicted_shape import LOCALISE_TIMEOUT_US, SHAPE_STD_M

TAKE_OFF_HEIGHT_M = 2.5
FLOWN_HEIGHT_M = 0.3
"""A vehicle disarmed after exceeding this height has landed and does not take off again."""
HEARTBEAT_LAG_US = 1_500_000
"""Longest time until a HEARTBEAT (1 Hz) shows a change that a COMMAND_ACK has confirmed."""


class Situation(Struct, frozen=True, kw_only=True):
    """Inputs of the state machine besides the state of the own autopilot."""

    shape_std_m: float
    """Expected error of the formation's shape; 0 without localisation, inf while it is unknown."""
    miss_m: float
    """Estimated distance from the own place."""
    place_height_m: float
    """Height of the own place above the ground."""


class FlightSequence:
    """The phases of one UAV's flight, in the order of `FlightPhase`.

    ``shortfall`` returns why the shape is not known at a time, for the message at the time-out.
    """

    def __init__(
        self, *, commands: CommandSender, on_station_tolerance_m: float, on_station_hold_s: float, held: bool,
        shortfall: Callable[[int], str], autopilot: AutopilotInterface = PX4,
    ) -> None:  # fmt: skip
        self.phase = FlightPhase.WAITING
        self.held = held
        """The flight must not begin yet; clearing it releases the flight."""
        self.texts: list[str] = []
        """Messages for the ground station; the owner sends and removes them."""
        self._autopilot = autopilot
        self._commands = commands
        self._shortfall = shortfall
        self._tolerance_m = on_station_tolerance_m
        self._hold_us = on_station_hold_s * 1e6
        self._phase_since_us = 0
        self._arrived_us: int | None = None
        self._offboard_seen = False
        self._has_flown = False
        self._take_off = TakeOff(commands, autopilot)

    @property
    def in_air(self) -> bool:
        """Whether take-off has been commanded."""
        return FlightPhase.TAKE_OFF <= self.phase <= FlightPhase.LANDED

    @property
    def needs_setpoint(self) -> bool:
        """Whether the autopilot is sent a setpoint."""
        if self._autopilot.follows_before_take_off:
            return self.in_formation
        return FlightPhase.ARMING <= self.phase <= FlightPhase.YIELDED

    @property
    def in_formation(self) -> bool:
        """Whether the application controls the vehicle."""
        return self.phase in {FlightPhase.JOINING, FlightPhase.ON_STATION}

    def update(self, own: OwnState, situation: Situation, now_us: int) -> None:
        """Update the phase from the present state, and request the command that it needs."""
        phase = self._next(own, situation, now_us)
        if phase is not self.phase:
            self.phase, self._phase_since_us = phase, now_us

    def _next(self, own: OwnState, situation: Situation, now_us: int) -> FlightPhase:
        disarmed = not own.armed and own.heartbeat_us > self._phase_since_us + HEARTBEAT_LAG_US
        match self.phase:
            case FlightPhase.JOINING | FlightPhase.ON_STATION:  # first, because it is the most frequent
                return self._in_formation(own, situation, now_us, disarmed=disarmed)
            case FlightPhase.WAITING if own.origin_ned_m is not None and own.fix is not None:
                return FlightPhase.HELD if self.held else self._begin(situation)
            case FlightPhase.HELD if not self.held:
                return self._begin(situation)
            case FlightPhase.LOCALISING:
                if situation.shape_std_m < SHAPE_STD_M:
                    return FlightPhase.ARMING
                if now_us - self._phase_since_us > LOCALISE_TIMEOUT_US:
                    waited_s = LOCALISE_TIMEOUT_US // 1_000_000
                    self.texts.append(
                        f"formation not localised in {waited_s} s: {self._shortfall(now_us)}; "
                        "taking off with the accuracy of GPS"
                    )
                    return FlightPhase.ARMING
            case FlightPhase.ARMING:
                if self._take_off.arm(own, now_us, since_us=self._phase_since_us):
                    return FlightPhase.TAKE_OFF
            case FlightPhase.TAKE_OFF:
                return self._taking_off(own, situation, now_us, disarmed=disarmed)
            case FlightPhase.YIELDED:
                self._commands.request(None, now_us)
                if own.mode is FlightMode.OFFBOARD and not own.failsafe:
                    return FlightPhase.JOINING
                return FlightPhase.LANDED if disarmed else self.phase
            case FlightPhase.LANDED:
                self._commands.request(None, now_us)
        return self.phase

    @staticmethod
    def _begin(situation: Situation) -> FlightPhase:
        return FlightPhase.LOCALISING if situation.shape_std_m > 0.0 else FlightPhase.ARMING

    def _taking_off(self, own: OwnState, situation: Situation, now_us: int, *, disarmed: bool) -> FlightPhase:
        height_m = -own.odometry_ned_m[2]
        take_off_height_m = min(TAKE_OFF_HEIGHT_M, situation.place_height_m)
        if disarmed:
            return FlightPhase.LANDED if self._has_flown else FlightPhase.ARMING
        if own.failsafe:
            return self._yield("failsafe", now_us)
        self._has_flown |= height_m > FLOWN_HEIGHT_M
        if not self._take_off.climb(own, now_us, height_m=take_off_height_m):
            return FlightPhase.TAKE_OFF
        self._offboard_seen = False
        return FlightPhase.JOINING

    def _in_formation(
        self, own: OwnState, situation: Situation, now_us: int, *, disarmed: bool
    ) -> FlightPhase:
        if disarmed:
            return FlightPhase.LANDED
        if own.failsafe:
            return self._yield("failsafe", now_us)
        if own.mode is FlightMode.OFFBOARD:
            self._offboard_seen = True
        elif self._offboard_seen:
            return self._yield("offboard left", now_us)
        if not situation.miss_m <= self._tolerance_m:  # also for NaN
            self._arrived_us = None
        elif self._arrived_us is None:
            self._arrived_us = now_us
        elif now_us - self._arrived_us >= self._hold_us:
            return FlightPhase.ON_STATION
        return self.phase

    def _yield(self, why: str, now_us: int) -> FlightPhase:
        """Leave the control of the vehicle to its new mode, and send no further commands."""
        self._offboard_seen = False
        self._arrived_us = None
        self._commands.request(None, now_us)
        self.texts.append(f"{why}: yielding")
        return FlightPhase.YIELDED
