"""Who is let into a vehicle's seat at the simulator: whoever says who it is.

An edge: accepts TCP connections on the seats' listeners. A PX4 introduces itself on connecting, with a
HEARTBEAT and a COMMAND_LONG of its system number, in either order; coflight's own vehicles do so with a
HEARTBEAT. Who says anything else, or nothing, is sent away, and holds up nobody.
"""

import selectors
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import HilActuatorControls, HilParser

INTRODUCTION_LIMIT_S = 10.0
"""Wall time that a newcomer has for its first words; the others are attended to meanwhile."""
MOST_NEWCOMERS = 8
"""That a seat hears at once; a ninth sends the first away."""
_FIRST_WORDS = {common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_COMMAND_LONG}
_RECEIVE_BYTES = 4096


@dataclass(slots=True, kw_only=True)
class Newcomer:
    """A connection whose owner is not known yet, or just has become known."""

    instance: int
    """Of the seat that it wants."""
    connection: socket.socket
    wall_deadline_s: float
    parser: HilParser
    said: list[Message]
    """So far, its introduction first; its parser has the rest."""


class Reception:
    """Listens for the vehicles of empty seats. Close it.

    ``listeners`` are the empty seats' by instance.
    """

    def __init__(self, listeners: Mapping[int, socket.socket]) -> None:
        self._selector = selectors.DefaultSelector()
        self._listeners = dict(listeners)
        self._newcomers: dict[int, list[Newcomer]] = {instance: [] for instance in listeners}
        for instance, listener in listeners.items():
            self._selector.register(listener, selectors.EVENT_READ, instance)

    @property
    def waiting_for(self) -> list[int]:
        """Seats that are empty still."""
        return sorted(self._listeners)

    def look(self, wall_limit_s: float) -> Iterator[Newcomer]:
        """Wait for something to happen, and give those who may take their seats; they are the caller's."""
        for key, _ in self._selector.select(wall_limit_s):
            if isinstance(key.data, Newcomer):
                newcomer = key.data
                if newcomer in self._newcomers.get(newcomer.instance, ()):  # else sent away a moment ago
                    yield from self._hear(newcomer)
            elif key.data in self._listeners:
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

    def _accept(self, instance: int) -> None:
        connection, _ = self._listeners[instance].accept()
        newcomer = Newcomer(
            instance=instance,
            connection=connection,
            wall_deadline_s=time.monotonic() + INTRODUCTION_LIMIT_S,
            parser=HilParser(HilActuatorControls),
            said=[],
        )
        newcomers = self._newcomers[instance]
        if len(newcomers) == MOST_NEWCOMERS:
            self._send_away(newcomers[0])
        newcomers.append(newcomer)
        self._selector.register(connection, selectors.EVENT_READ, newcomer)

    def _hear(self, newcomer: Newcomer) -> Iterator[Newcomer]:
        try:
            data = newcomer.connection.recv(_RECEIVE_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        newcomer.said += newcomer.parser.push(data)
        if newcomer.said and _introduces(newcomer.said[0], newcomer.instance):
            self._selector.unregister(newcomer.connection)
            self._newcomers[newcomer.instance].remove(newcomer)
            yield self._let_in(newcomer)
        elif newcomer.said or newcomer.parser.bad_bytes or not data:
            self._send_away(newcomer)

    def _let_in(self, newcomer: Newcomer) -> Newcomer:
        instance = newcomer.instance
        self._selector.unregister(self._listeners.pop(instance))
        for late in list(self._newcomers[instance]):
            self._send_away(late)
        return newcomer

    def _send_away(self, newcomer: Newcomer) -> None:
        self._newcomers[newcomer.instance].remove(newcomer)
        self._selector.unregister(newcomer.connection)
        newcomer.connection.close()


def _introduces(message: Message | HilActuatorControls, instance: int) -> bool:
    """Whether these are the first words of the vehicle that the seat is for."""
    if isinstance(message, HilActuatorControls) or message.get_msgId() not in _FIRST_WORDS:
        return False
    return bool(message.get_srcSystem() == instance + 1)
