"""The shape that every MAVLink service has, and the addressing that comes before all of them."""

from collections.abc import Sequence
from typing import Protocol

from autopilot.mavlink.codec import Message

AUTOPILOT_COMPONENT = 1
NEVER_US = 1 << 62
"""A deadline that does not come."""


class Service(Protocol):
    """A state machine that is fed messages and time and returns the messages to send."""

    def on_message(self, message: Message, now_us: int) -> Sequence[Message]:
        """Take a message that is addressed to this vehicle; one of no concern gives nothing."""
        ...

    def on_timer(self, now_us: int) -> Sequence[Message]:
        """Do what is due."""
        ...

    def next_deadline_us(self) -> int:
        """When `on_timer` next has something to do; NEVER_US if it has not."""
        ...


def is_addressed_to(message: Message, *, system: int, component: int) -> bool:
    """Whether a message is for this component, by number or as broadcast (0), or has no target at all."""
    # MANUAL_CONTROL and a few others call it by another name
    target_system = getattr(message, "target_system", getattr(message, "target", 0))
    target_component = getattr(message, "target_component", 0)
    return target_system in {0, system} and target_component in {0, component}
