"""Handshake: assigns new connections to vehicle slots by the system number in their first message.

An I/O module: accepts connections at the listeners. On connecting, a PX4 sends a HEARTBEAT and a COMMAND_LONG
with its system number, in either order; coflight's own vehicles send a HEARTBEAT. A connection that sends
anything else, or nothing, is closed and delays no other. An ArduPilot has a port of its own, and arrives with
its first servo packet.
"""

import selectors
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import HilActuatorControls, HilParser
from harness.simulator.ardupilot_link import ArduPilotLink

INTRODUCTION_LIMIT_S = 10.0
"""Wall time that a new connection has for its first message; the others are served meanwhile."""
MAX_PENDING = 8
"""Unidentified connections per slot of a listener; one more closes the oldest."""
_INTRODUCTIONS = {common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_COMMAND_LONG}
_RECEIVE_BYTES = 4096


class Listener(NamedTuple):
    """A listening socket, and the instances whose slots can be filled through it."""

    server: socket.socket
    instances: frozenset[int]


class Arrival(NamedTuple):
    """A vehicle that has identified itself; the caller owns the connection."""

    instance: int
    connection: socket.socket
    messages: list[Message]
    """Messages received so far, the introduction first; the parser holds the rest."""
    parser: HilParser


class ArduPilotArrival(NamedTuple):
    """An ArduPilot that has sent its first servo packet."""

    instance: int
    link: ArduPilotLink


@dataclass(slots=True, kw_only=True, eq=False)
class _PendingConnection:
    """A connection that has not identified itself yet."""

    listener: Listener
    connection: socket.socket
    wall_deadline_s: float
    parser: HilParser


class Handshake:
    """Accepts the vehicles of empty slots, each of which is reached by one or more listeners. Close it.

    ``ardupilots`` are the links of ArduPilots that have not arrived, by vehicle; their owner closes them.
    """

    def __init__(
        self, listeners: Sequence[Listener], ardupilots: Mapping[int, ArduPilotLink] | None = None
    ) -> None:
        self._selector = selectors.DefaultSelector()
        self._vacant = set(ardupilots or ()).union(*(listener.instances for listener in listeners))
        for instance, link in (ardupilots or {}).items():
            self._selector.register(link.states, selectors.EVENT_READ, ArduPilotArrival(instance, link))
        self._pending: dict[Listener, list[_PendingConnection]] = {listener: [] for listener in listeners}
        """By open listener, the oldest first."""
        for listener in listeners:
            self._selector.register(listener.server, selectors.EVENT_READ, listener)

    @property
    def missing(self) -> list[int]:
        """Instances whose slots are empty."""
        return sorted(self._vacant)

    def poll(self, wall_limit_s: float) -> Iterator[Arrival | ArduPilotArrival]:
        """Wait for activity, at most ``wall_limit_s``, and yield the vehicles that can take their slots."""
        for key, _ in self._selector.select(wall_limit_s):
            if isinstance(key.data, ArduPilotArrival):
                if key.data.link.arrive():
                    self._selector.unregister(key.fileobj)
                    self._vacant.remove(key.data.instance)
                    yield key.data
            elif isinstance(key.data, _PendingConnection):
                pending = key.data
                if pending in self._pending.get(pending.listener, ()):  # else closed a moment ago
                    yield from self._receive(pending)
            elif key.data in self._pending:
                self._accept(key.data)
        wall_s = time.monotonic()
        for connections in self._pending.values():
            for pending in [each for each in connections if wall_s > each.wall_deadline_s]:
                self._reject(pending)

    def close(self) -> None:
        """Close all unidentified connections; the listeners stay open. Harmless when repeated."""
        for connections in self._pending.values():
            for pending in list(connections):
                self._reject(pending)
        self._selector.close()

    def _accept(self, listener: Listener) -> None:
        connection, _ = listener.server.accept()
        pending = _PendingConnection(
            listener=listener,
            connection=connection,
            wall_deadline_s=time.monotonic() + INTRODUCTION_LIMIT_S,
            parser=HilParser(HilActuatorControls),
        )
        connections = self._pending[listener]
        if len(connections) == MAX_PENDING * len(listener.instances):
            self._reject(connections[0])
        connections.append(pending)
        self._selector.register(connection, selectors.EVENT_READ, pending)

    def _receive(self, pending: _PendingConnection) -> Iterator[Arrival]:
        try:
            data = pending.connection.recv(_RECEIVE_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        messages = pending.parser.push(data)
        instance = _introduced(messages[0]) if messages else None
        if instance is not None and instance in pending.listener.instances & self._vacant:
            self._remove(pending)
            self._fill(instance)
            yield Arrival(instance, pending.connection, messages, pending.parser)
        elif messages or pending.parser.bad_bytes or not data:
            self._reject(pending)

    def _fill(self, instance: int) -> None:
        """Mark a slot as filled and stop polling the listeners that lead to no empty slot any more."""
        self._vacant.remove(instance)
        for listener in [each for each in self._pending if not each.instances & self._vacant]:
            for late in list(self._pending[listener]):
                self._reject(late)
            del self._pending[listener]
            self._selector.unregister(listener.server)

    def _remove(self, pending: _PendingConnection) -> None:
        self._pending[pending.listener].remove(pending)
        self._selector.unregister(pending.connection)

    def _reject(self, pending: _PendingConnection) -> None:
        self._remove(pending)
        pending.connection.close()


def _introduced(message: Message | HilActuatorControls) -> int | None:
    """Return the instance that a first message identifies; None if it is no introduction."""
    if isinstance(message, HilActuatorControls) or message.get_msgId() not in _INTRODUCTIONS:
        return None
    return int(message.get_srcSystem()) - 1
