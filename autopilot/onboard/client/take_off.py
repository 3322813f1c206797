"""From the ground to the mode that follows setpoints: arming, take-off, hand-over. No I/O.

The autopilot performs the take-off itself, because its spool-up and landed-state logic are designed for it.
It holds the uncorrected position, however, which drifts with the GPS bias. At `HAND_OVER_HEIGHT_M`, during
the climb, its mode is therefore changed to the one that follows setpoints. That is also done where the
autopilot ends its take-off lower, as it does if its own height drifts by metres while the motors spool up.
"""

from autopilot.mavlink.modes import FlightMode
from autopilot.onboard.client.autopilots import AutopilotInterface
from autopilot.onboard.client.commands import ARM, CommandSender, RepeatedCommand
from autopilot.onboard.client.own_state import OwnState

HAND_OVER_HEIGHT_M = 0.5
"""Lowest height at which the vehicle certainly flies: below it wind and GPS errors move it unchecked."""
READY_TIMEOUT_US = 20_000_000
"""Longest time for which arming waits for the autopilot's pre-arm checks, whose reasons it reports itself."""


class TakeOff:
    """The commands of one take-off, in the order that the autopilot requires."""

    def __init__(self, commands: CommandSender, autopilot: AutopilotInterface) -> None:
        self._commands = commands
        self._autopilot = autopilot
        self._command: RepeatedCommand | None = None
        self._has_begun = False
        """Whether the autopilot has been seen in its take-off."""

    def arm(self, own: OwnState, now_us: int, *, since_us: int) -> bool:
        """Request what arming needs next; return whether arming is accepted.

        ``since_us`` is the time at which arming began to be tried.
        """
        self._command, self._has_begun = None, False
        if own.is_ready is False and now_us - since_us < READY_TIMEOUT_US:
            self._commands.request(None, now_us)
            return False
        own.on_arming()
        if self._autopilot.follows_before_take_off and own.mode is not FlightMode.OFFBOARD:
            self._commands.request(self._autopilot.follow, now_us)
            return False
        self._commands.request(ARM, now_us)
        return self._commands.accepted

    def climb(self, own: OwnState, now_us: int, *, height_m: float) -> bool:
        """Request the take-off to a height, then the mode of setpoints; return whether that is accepted."""
        commands, autopilot = self._commands, self._autopilot
        self._has_begun |= own.mode is FlightMode.TAKEOFF
        ended = self._has_begun and own.mode is FlightMode.HOLD
        low = -own.odometry_ned_m[2] < min(HAND_OVER_HEIGHT_M, 0.5 * height_m)
        if low and not ended and not commands.is_requested(autopilot.follow):
            if self._command is None:  # once: the altitude of the ground, as the autopilot sees it, drifts
                ground_alt_m = own.origin_alt_m - own.height.autopilot_down_m
                self._command = autopilot.take_off(height_m, ground_alt_m)
            commands.request(self._command, now_us)
            return False
        commands.request(autopilot.follow, now_us)
        return commands.accepted
