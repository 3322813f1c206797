"""The interface of a MAVLink service, its addresses and its base, and all services of a vehicle as one."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeVar

from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import by_id

GROUND_STATION, COMPANION, APPLICATION = 0, 1, 2
"""Link numbers: two external links, and the application in this process."""
BROADCAST = -1
"""As a partner's number: all partners on the link. As a link's number: all links."""
NEVER_US = 1 << 62
"""A deadline that never arrives."""


class Partner(NamedTuple):
    """A remote endpoint on a link, identified by the number that the link assigned to its address.

    MAVLink's system and component numbers do not identify a partner: two programs may use the same pair.
    """

    link: int
    number: int = BROADCAST


ALL = Partner(BROADCAST)
"""All partners on all links."""
APPLICATION_PARTNER = Partner(APPLICATION, 0)


class Addressed(NamedTuple):
    """A message and its source or destination."""

    partner: Partner
    message: Message


class MavlinkService(Protocol):
    """A state machine that receives messages and time and returns the messages to send.

    Consumers: `autopilot.services.service.Services` and `autopilot.vehicle.messaging`. A vehicle has one
    instance of each service for all of its links. Conversation state is kept per partner.

    Time is the vehicle's simulated time in us and never decreases; there is no other clock and no I/O. Equal
    calls give equal messages. Call order: `on_message` at any time, `on_timer` at the first step at or after
    `next_deadline_us`, which is read again after every call of either.

    A service of the user (``autopilot.services``) is created as ``Class(context)`` with a `ServiceContext`;
    with a class attribute ``Settings``, a msgspec Struct or dataclass, as ``Class(context, settings)``.
    """

    @property
    def takes(self) -> frozenset[int]:
        """Ids of the messages that it handles; constant.

        Built-in services may share an id. A service of the user must not take one that another service takes.
        """
        ...

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Handle a message of `takes` that is addressed to this vehicle's autopilot; return the answers.

        ``partner`` is the sender; an answer to it is ``reply(partner, message)``, one to all
        ``reply(ALL, message)``. Messages need no sequence number or source.
        """
        ...

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Return the messages that are due."""
        ...

    def next_deadline_us(self) -> int:
        """Time of the next `on_timer` that has work, in us; NEVER_US if there is none."""
        ...


Handler = Callable[[Message, int, Partner], Sequence[Addressed]]
"""Handles one kind of message; the arguments are those of `MavlinkService.on_message`."""


class Service:
    """Base of the services: a table of handlers, and no deadline until one is set."""

    def __init__(self, **handlers: Handler) -> None:
        """``handlers`` are given by message name."""
        self._handlers = by_id(**handlers)
        self.takes = frozenset(self._handlers)
        self.due_us = NEVER_US
        """Time of the next `on_timer` that has work."""

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Handle a message by its kind; return the answers."""
        return self._handlers[message.get_msgId()](message, now_us, partner)

    def on_timer(self, _now_us: int) -> Sequence[Addressed]:
        """Return no messages."""
        return ()

    def next_deadline_us(self) -> int:
        """Time of the next `on_timer` that has work; NEVER_US if there is none."""
        return self.due_us


class Services:
    """A vehicle's services. A message is passed to all that handle its id, in the order given."""

    def __init__(self, services: Sequence[MavlinkService]) -> None:
        self._services = tuple(services)
        self._of_kind: dict[int, list[MavlinkService]] = {}
        for service in services:
            for kind in service.takes:
                self._of_kind.setdefault(kind, []).append(service)
        self.deadline_us = 0
        """Time of the next `on_timer` that has work, in us."""

    def on_message(self, message: Message, now_us: int, partner: Partner) -> list[Addressed]:
        """Answers to a message that is addressed to the autopilot."""
        answers: list[Addressed] = []
        for service in self._of_kind.get(message.get_msgId(), ()):
            answers += service.on_message(message, now_us, partner)
            self.deadline_us = min(self.deadline_us, service.next_deadline_us())
        return answers

    def on_timer(self, now_us: int) -> list[Addressed]:
        """Messages of all services whose deadline has passed."""
        messages: list[Addressed] = []
        for service in self._services:
            if now_us >= service.next_deadline_us():
                messages += service.on_timer(now_us)
        self.look_again()
        return messages

    def look_again(self) -> None:
        """Recompute the deadline after a service was changed by something other than a message."""
        self.deadline_us = min(service.next_deadline_us() for service in self._services)


_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


class Newest(dict[_Key, _Value]):
    """A dictionary of at most ``most`` entries, ordered by assignment; a new one replaces the oldest."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self._most = most

    def __setitem__(self, key: _Key, value: _Value) -> None:
        self.pop(key, None)
        super().__setitem__(key, value)
        if len(self) > self._most:
            del self[next(iter(self))]


def reply(partner: Partner, *messages: Message) -> list[Addressed]:
    """Address messages to one partner, or to all that a partner with number BROADCAST stands for."""
    return [Addressed(partner, message) for message in messages]


def is_addressed_to(message: Message, *, system: int, component: int) -> bool:
    """Whether a message targets this component, by number or as broadcast (0), or has no target field."""
    # MANUAL_CONTROL and a few others name the field `target`
    target_system = getattr(message, "target_system", getattr(message, "target", 0))
    target_component = getattr(message, "target_component", 0)
    return target_system in {0, system} and target_component in {0, component}
