"""Handshake: assigns new TCP connections to vehicle slots by the system number in their first message.

An I/O module: accepts connections at the listeners. On connecting, a PX4 sends a HEARTBEAT and a COMMAND_LONG
with its system number, in either order; coflight's own vehicles send a HEARTBEAT. A connection that sends
anything else, or nothing, is closed and delays no other; so is one that the guard does not admit, before it
is read. An ArduPilot has a port of its own, and arrives with its first servo packet.
"""

import errno
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
from harness.simulator.slot_guard import UNGUARDED, Guard

INTRODUCTION_LIMIT_S = 10.0
"""Wall time that a new connection has for its first message; the others are served meanwhile."""
MAX_PENDING = 16
"""Unidentified connections per listener; one more closes the oldest."""
ACCEPTED_AT_ONCE = 32
"""Connections that are accepted in one poll, at all listeners together but one at each, and per listener half
of `MAX_PENDING`, so that a connection is read before later ones can close it."""
_INTRODUCTIONS = {common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_COMMAND_LONG}
_RECEIVE_BYTES = 4096
_NO_DESCRIPTORS = {errno.EMFILE, errno.ENFILE}


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

    instance: int
    connection: socket.socket
    wall_deadline_s: float
    parser: HilParser


class Handshake:
    """Accepts the vehicles of empty slots at their listeners; closes each of these when its slot is filled.

    Close it, and the listeners of slots that have stayed empty.

    ``ardupilots`` are the links of ArduPilots that have not arrived, by vehicle; their owner closes them.
    ``guard`` decides which connections are read at all.
    """

    def __init__(
        self,
        listeners: Mapping[int, socket.socket],
        ardupilots: Mapping[int, ArduPilotLink] | None = None,
        *,
        guard: Guard = UNGUARDED,
    ) -> None:
        self._listeners = listeners
        self._guard = guard
        self._selector = selectors.DefaultSelector()
        self._vacant = {*listeners, *(ardupilots or ())}
        for instance, link in (ardupilots or {}).items():
            self._selector.register(link.states, selectors.EVENT_READ, ArduPilotArrival(instance, link))
        self._pending: dict[int, list[_PendingConnection]] = {instance: [] for instance in listeners}
        """By vehicle whose listener is open, the oldest first."""
        for instance, server in listeners.items():
            server.settimeout(0.0)  # non-blocking
            self._selector.register(server, selectors.EVENT_READ, instance)

    @property
    def missing(self) -> list[int]:
        """Instances whose slots are empty."""
        return sorted(self._vacant)

    def poll(self, wall_limit_s: float) -> Iterator[Arrival | ArduPilotArrival]:
        """Wait for activity, at most ``wall_limit_s``, and yield the vehicles that can take their slots."""
        calling: list[int] = []
        for key, _ in self._selector.select(wall_limit_s):
            match key.data:
                case ArduPilotArrival() as arrival:
                    if arrival.link.arrive():
                        self._selector.unregister(key.fileobj)
                        self._vacant.remove(arrival.instance)
                        yield arrival
                case _PendingConnection() as pending:
                    if pending in self._pending.get(pending.instance, ()):  # else closed a moment ago
                        yield from self._receive(pending)
                case instance:
                    calling.append(instance)
        self._accept([instance for instance in calling if instance in self._pending])
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

    def _accept(self, calling: Sequence[int]) -> None:
        """Accept connections at these listeners; close those that the guard does not admit."""
        if not calling:
            return
        most = min(max(1, ACCEPTED_AT_ONCE // len(calling)), MAX_PENDING // 2)
        accepted = [each for instance in calling for each in self._accepted(instance, most)]
        # all at once: the guard reads a table of all connections of this machine
        for (instance, connection), admitted in zip(accepted, self._guard.admits(accepted), strict=True):
            if admitted:
                self._add(instance, connection)
            else:
                connection.close()

    def _accepted(self, instance: int, most: int) -> Iterator[tuple[int, socket.socket]]:
        for _ in range(most):
            try:
                connection, _ = self._listeners[instance].accept()
            except OSError as error:  # no more, or one that was reset meanwhile
                pending = self._pending[instance]
                if error.errno in _NO_DESCRIPTORS and not pending:
                    raise
                if error.errno in _NO_DESCRIPTORS:
                    self._reject(pending[0])
                return
            yield instance, connection

    def _add(self, instance: int, connection: socket.socket) -> None:
        pending = _PendingConnection(
            instance=instance,
            connection=connection,
            wall_deadline_s=time.monotonic() + INTRODUCTION_LIMIT_S,
            parser=HilParser(HilActuatorControls),
        )
        connections = self._pending[instance]
        if len(connections) == MAX_PENDING:
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
        if messages and _introduced(messages[0]) == pending.instance:
            self._remove(pending)
            self._fill(pending.instance)
            yield Arrival(pending.instance, pending.connection, messages, pending.parser)
        elif messages or pending.parser.bad_bytes or not data:
            self._reject(pending)

    def _fill(self, instance: int) -> None:
        """Mark a slot as filled, and close its listener."""
        self._vacant.remove(instance)
        for late in list(self._pending[instance]):
            self._reject(late)
        del self._pending[instance]
        self._selector.unregister(self._listeners[instance])
        self._listeners[instance].close()

    def _remove(self, pending: _PendingConnection) -> None:
        self._pending[pending.instance].remove(pending)
        self._selector.unregister(pending.connection)

    def _reject(self, pending: _PendingConnection) -> None:
        self._remove(pending)
        pending.connection.close()


def _introduced(message: Message | HilActuatorControls) -> int | None:
    """Return the instance that a first message identifies; None if it is no introduction."""
    if isinstance(message, HilActuatorControls) or message.get_msgId() not in _INTRODUCTIONS:
        return None
    return int(message.get_srcSystem()) - 1
