"""A MAVLink service of the user: the same interface, with a check of what the user's code returns."""

from collections.abc import Callable, Iterable, Sequence

from msgspec import Struct
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.parameters.table import ParameterSet
from autopilot.services.flight_data import FlightData
from autopilot.services.service import NEVER_US, Addressed, MavlinkService, Partner
from foundation.extension_call import ExtensionCall
from foundation.extensions import ExtensionError


class ServiceContext(Struct, frozen=True, kw_only=True):
    """What a service of the user is made for: one vehicle, for its lifetime."""

    instance: int
    """Number of the UAV; its MAVLink system id is this plus one."""
    flight: FlightData
    """The vehicle's present values, updated in place: to be read only."""
    parameters: ParameterSet
    """The vehicle's parameters: to be read only."""
    wake: Callable[[], None]
    """Reads all deadlines again; to be called if `next_deadline_us` changes other than in a call of the
    service."""


class UserService:
    """Calls a service of the user; all methods raise ExtensionFailure if it fails."""

    def __init__(self, service: MavlinkService, title: str) -> None:
        """``title`` begins the lines of its failures."""
        self._service = service
        self._call = ExtensionCall(title)
        with self._call:
            takes: object = service.takes
        if not isinstance(takes, frozenset | set) or not all(type(kind) is int for kind in takes):
            raise self._call.refused(f"takes is {takes!r:.100}; expected a frozenset of message ids")
        self.takes = frozenset(takes)
        """Ids of the messages that it handles."""

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Return the service's answers to a message."""
        with self._call:
            return self._checked("on_message", self._service.on_message(message, now_us, partner))

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Return the service's messages that are due."""
        with self._call:
            return self._checked("on_timer", self._service.on_timer(now_us))

    def next_deadline_us(self) -> int:
        """Return the time of the service's next work."""
        with self._call:
            due_us = self._service.next_deadline_us()
        if type(due_us) is not int or not 0 <= due_us <= NEVER_US:
            raise self._call.refused(f"next_deadline_us returned {due_us!r:.100}; expected 0 to NEVER_US")
        return due_us

    def _checked(self, method: str, messages: Iterable[object]) -> list[Addressed]:
        """Return messages of which each can be sent."""
        checked = list(messages)
        for each in checked:
            if not (isinstance(each, Addressed) and hasattr(each.message, "get_msgId")):
                raise self._call.refused(f"{method} returned {each!r:.100}; expected messages of `reply`")
        return [each for each in checked if isinstance(each, Addressed)]


def check_ids(services: Sequence[tuple[str, MavlinkService]], built_in: Sequence[MavlinkService]) -> None:
    """Check that no service of the user, named by its title, takes a message of another service.

    Raises ExtensionError.
    """
    owners = {kind: "a built-in service" for service in built_in for kind in service.takes}
    for title, service in services:
        for kind in sorted(service.takes):
            if kind in owners:
                known = common.mavlink_map.get(kind)
                name = f"message {kind}" if known is None else known.msgname
                raise ExtensionError(f"{title}: {name} is already handled by {owners[kind]}")
        owners |= dict.fromkeys(service.takes, title)
