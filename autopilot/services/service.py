"""The shape that every MAVLink service has, whom messages are from and for, and who is meant by them."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from autopilot.mavlink.codec import Message

GROUND_STATION, COMPANION, APPLICATION = 0, 1, 2
"""Numbers of the links: two to the outside, and the application in this process."""
EVERYBODY = -1
"""In place of a partner's number: all on the link; in place of a link's: all links."""
NEVER_US = 1 << 62
"""A deadline that does not come."""


class Partner(NamedTuple):
    """Whoever speaks on a link, by the number that the link's edge gave to an address.

    MAVLink's system and component numbers do not tell partners apart: two programs may have the same.
    """

    link: int
    number: int = EVERYBODY


ALL = Partner(EVERYBODY)
"""Everybody on every link."""
APPLICATION_PARTNER = Partner(APPLICATION, 0)


class Addressed(NamedTuple):
    """A message and whom it is from, or for."""

    partner: Partner
    message: Message


class Service(Protocol):
    """A state machine that is fed messages and time and returns the messages to send.

    There is one of each in a vehicle, whatever the number of links; what it keeps of a conversation it keeps
    by partner.
    """

    @property
    def takes(self) -> frozenset[int]:
        """Ids of the messages that it is given."""
        ...

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Take a message of `takes` that is addressed to this vehicle's autopilot."""
        ...

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Do what is due."""
        ...

    def next_deadline_us(self) -> int:
        """When `on_timer` next has something to do; NEVER_US if it has not."""
        ...


class Listener:
    """A service that acts on messages only: nothing of it is ever due."""

    def on_timer(self, now_us: int) -> Sequence[Addressed]:  # noqa: ARG002  # part of the shape
        """Nothing is ever due."""
        return ()

    def next_deadline_us(self) -> int:
        """Never."""
        return NEVER_US


def reply(partner: Partner, *messages: Message) -> list[Addressed]:
    """Messages for one partner, or for all that a partner with EVERYBODY for a number stands for."""
    return [Addressed(partner, message) for message in messages]


def is_addressed_to(message: Message, *, system: int, component: int) -> bool:
    """Whether a message is for this component, by number or as broadcast (0), or has no target at all."""
    # MANUAL_CONTROL and a few others call it by another name
    target_system = getattr(message, "target_system", getattr(message, "target", 0))
    target_component = getattr(message, "target_component", 0)
    return target_system in {0, system} and target_component in {0, component}
