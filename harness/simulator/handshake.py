"""Who is let into a vehicle's seat at the simulator: whoever says who it is.

An edge: accepts connections at the seats' doors. A PX4 introduces itself on connecting, with a HEARTBEAT
and a COMMAND_LONG of its system number, in either order; coflight's own vehicles do so with a HEARTBEAT. Who
says anything else, or nothing, is sent away, and holds up nobody.
"""

import selectors
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import HilActuatorControls, HilParser

INTRODUCTION_LIMIT_S = 10.0
"""Wall time that a newcomer has for its first words; the others are attended to meanwhile."""
MOST_NEWCOMERS = 8
"""That a door hears at once, for each of its seats; one more sends the first away."""
_FIRST_WORDS = {common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_COMMAND_LONG}
_RECEIVE_BYTES = 4096


class Listener(NamedTuple):
    """A listening socket, and the instances whose seats can be taken there."""

    listener: socket.socket
    seats: frozenset[int]


class Arrival(NamedTuple):
    """A vehicle that may take its seat; the connection is the caller's."""

    instance: int
    connection: socket.socket
    said: list[Message]
    """So far, its introduction first; its parser has the rest."""
    parser: HilParser


@dataclass(slots=True, kw_only=True, eq=False)
class _PendingConnection:
    """A connection whose owner is not known yet."""

    door: Listener
    connection: socket.socket
    wall_deadline_s: float
    parser: HilParser


class Handshake:
    """Listens for the vehicles of empty seats, each of which has one door or several. Close it."""

    def __init__(self, doors: Sequence[Listener]) -> None:
        self._selector = selectors.DefaultSelector()
        self._vacant = set().union(*(door.seats for door in doors))
        self._newcomers: dict[Listener, list[_PendingConnection]] = {door: [] for door in doors}
        """By open door, the longest there first."""
        for door in doors:
            self._selector.register(door.listener, selectors.EVENT_READ, door)

    @property
    def waiting_for(self) -> list[int]:
        """Seats that are empty still."""
        return sorted(self._vacant)

    def look(self, wall_limit_s: float) -> Iterator[Arrival]:
        """Wait for something to happen, and give those who may take their seats."""
        for key, _ in self._selector.select(wall_limit_s):
            if isinstance(key.data, _PendingConnection):
                newcomer = key.data
                if newcomer in self._newcomers.get(newcomer.door, ()):  # else sent away a moment ago
                    yield from self._hear(newcomer)
            elif key.data in self._newcomers:
                self._accept(key.data)
        wall_s = time.monotonic()
        for newcomers in self._newcomers.values():
            for newcomer in [each for each in newcomers if wall_s > each.wall_deadline_s]:
                self._send_away(newcomer)

    def close(self) -> None:
        """Send away who has not been let in; the listeners stay open. Harmless when repeated."""
        for newcomers in self._newcomers.values():
            for newcomer in list(newcomers):
                self._send_away(newcomer)
        self._selector.close()

    def _accept(self, door: Listener) -> None:
        connection, _ = door.listener.accept()
        newcomer = _PendingConnection(
            door=door,
            connection=connection,
            wall_deadline_s=time.monotonic() + INTRODUCTION_LIMIT_S,
            parser=HilParser(HilActuatorControls),
        )
        newcomers = self._newcomers[door]
        if len(newcomers) == MOST_NEWCOMERS * len(door.seats):
            self._send_away(newcomers[0])
        newcomers.append(newcomer)
        self._selector.register(connection, selectors.EVENT_READ, newcomer)

    def _hear(self, newcomer: _PendingConnection) -> Iterator[Arrival]:
        try:
            data = newcomer.connection.recv(_RECEIVE_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        said = newcomer.parser.push(data)
        instance = _introduced(said[0]) if said else None
        if instance is not None and instance in newcomer.door.seats & self._vacant:
            self._take_leave(newcomer)
            self._fill(instance)
            yield Arrival(instance, newcomer.connection, said, newcomer.parser)
        elif said or newcomer.parser.bad_bytes or not data:
            self._send_away(newcomer)

    def _fill(self, instance: int) -> None:
        """Close the doors that led to this seat alone of the empty ones."""
        self._vacant.remove(instance)
        for door in [each for each in self._newcomers if not each.seats & self._vacant]:
            for late in list(self._newcomers[door]):
                self._send_away(late)
            del self._newcomers[door]
            self._selector.unregister(door.listener)

    def _take_leave(self, newcomer: _PendingConnection) -> None:
        self._newcomers[newcomer.door].remove(newcomer)
        self._selector.unregister(newcomer.connection)

    def _send_away(self, newcomer: _PendingConnection) -> None:
        self._take_leave(newcomer)
        newcomer.connection.close()


def _introduced(message: Message | HilActuatorControls) -> int | None:
    """The instance of the vehicle whose first words these are; None if they are no introduction."""
    if isinstance(message, HilActuatorControls) or message.get_msgId() not in _FIRST_WORDS:
        return None
    return int(message.get_srcSystem()) - 1
