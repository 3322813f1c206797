"""One MAVLink command at a time to the own autopilot, repeated until acknowledged, again later if refused."""

from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from autopilot.mavlink.components import AUTOPILOT_COMPONENT

SILENCE_US = 500_000
"""Without a COMMAND_ACK for this time the command is repeated with a higher confirmation counter, as MAVLink
requires."""
REFUSAL_US = 1_000_000
"""A refused command is repeated after this time: reasons such as a missing GPS fix are temporary."""

NEVER_US = 1 << 62
"""A deadline that is never reached."""


@dataclass(frozen=True, slots=True)
class RepeatedCommand:
    """A COMMAND_LONG: its MAV_CMD and seven parameters."""

    number: int
    params: tuple[float, float, float, float, float, float, float]


ARM = RepeatedCommand(common.MAV_CMD_COMPONENT_ARM_DISARM, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


class CommandSender:
    """Sends the requested command until it is accepted."""

    def __init__(self, *, target_system: int) -> None:
        self.accepted = False
        """The requested command has been acknowledged as accepted or in progress."""
        self.refusals = 0
        self._target_system = target_system
        self._requested: RepeatedCommand | None = None
        self._send_us = 0
        self._confirmation = 0

    def request(self, command: RepeatedCommand | None, now_us: int) -> None:
        """Set the command to send; None: none. Requesting the same command again has no effect."""
        if command == self._requested:
            return
        self._requested = command
        self.accepted = False
        self._send_us = now_us
        self._confirmation = 0

    def is_requested(self, command: RepeatedCommand) -> bool:
        """Return whether this command is the one requested last."""
        return command == self._requested

    def on_ack(self, ack: common.MAVLink_command_ack_message, now_us: int) -> None:
        """Process a COMMAND_ACK; those of other commands are ignored."""
        if self._requested is None or ack.command != self._requested.number or self.accepted:
            return
        if ack.result in {common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_IN_PROGRESS}:
            self.accepted = True
        else:
            self.refusals += 1
            self._confirmation = 0
            self._send_us = now_us + REFUSAL_US

    def next_deadline_us(self) -> int:
        """Return the time at which the command is sent next; NEVER_US if none is pending."""
        return NEVER_US if self._requested is None or self.accepted else self._send_us

    def on_timer(self, now_us: int) -> list[common.MAVLink_message]:
        """Return a COMMAND_LONG if one is due."""
        if now_us < self.next_deadline_us() or self._requested is None:
            return []
        number, params = self._requested.number, self._requested.params
        message = common.MAVLink_command_long_message(
            self._target_system, AUTOPILOT_COMPONENT, number, self._confirmation, *params
        )
        self._confirmation = min(self._confirmation + 1, 255)
        self._send_us = now_us + SILENCE_US
        return [message]
