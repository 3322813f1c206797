"""The UDP socket between an application and the autopilot beside it. An I/O module."""

import contextlib
import socket
import time
from collections.abc import Callable

from autopilot.mavlink.codec import Message, Parser
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.telemetry import TelemetryParser
from foundation.processes.child_senders import ChildSenders
from foundation.processes.socket_owners import ChildSockets, mark_beside
from foundation.processes.socket_table import Address, is_on_this_machine

LARGEST_DATAGRAM_BYTES = 65_535
MOST_WAITING = 2_000
"""Datagrams that are read at once; a socket holds some hundreds."""


def sender_check(host: str, instance: int) -> Callable[[Address, float], bool]:
    """Return whether a sender of datagrams to ``host`` is, at a wall time, the run's process of that vehicle.

    Senders of other machines are, and all if this process is of no run or the system has no tables.
    """
    mark = mark_beside(f"uav {instance}")
    senders = ChildSenders(lambda: ChildSockets(pid=None, mark=mark))

    def is_autopilot(sender: Address, wall_s: float) -> bool:
        return mark is None or not is_on_this_machine(sender[0], host) or senders.admits(sender, wall_s)

    return is_autopilot


class AutopilotSocket:
    """A socket that accepts datagrams from one autopilot alone; close it. Raises OSError.

    ``local`` is bound. The autopilot is at ``remote``; without it, at the address from which the first
    message of the autopilot with MAVLink system ``system`` arrives: ArduPilot sends from any free port.
    ``is_autopilot`` decides whether a sender can be the autopilot, at the present wall time; it is asked
    until one has been admitted.
    """

    def __init__(
        self,
        local: Address,
        remote: Address | None,
        *,
        system: int,
        is_autopilot: Callable[[Address, float], bool] = lambda *_: True,
    ) -> None:
        self.parser = TelemetryParser(system=system, component=AUTOPILOT_COMPONENT)
        self._system = system
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._remote: Address | None = None
        """Address of the autopilot; None: it has not been received from."""
        self._is_autopilot = is_autopilot
        self._admitted = False
        """Whether the sender at that address is the autopilot."""
        self.foreign_datagrams = 0
        """Datagrams of senders that are not the autopilot."""
        try:
            self._socket.bind(local)
            if remote is not None:
                self._connect(remote)
        except OSError:
            self._socket.close()
            raise
        self._socket.settimeout(0.0)  # non-blocking

    def receive(self) -> list[Message]:
        """Return the messages that have arrived."""
        messages: list[Message] = []
        for _ in range(MOST_WAITING):
            try:
                datagram, sender = self._socket.recvfrom(LARGEST_DATAGRAM_BYTES)
            except OSError:  # no more data, or the autopilot does not listen yet
                break
            if not (self._admitted or self._admits(datagram, sender)):
                continue
            if sender == self._remote:  # others may have arrived before the connection
                messages += self.parser.push_datagram(datagram)
        return messages

    def send(self, data: bytes) -> None:
        """Send a datagram; it is lost while the autopilot does not listen."""
        if self._remote is not None:
            with contextlib.suppress(OSError):
                self._socket.send(data)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _admits(self, datagram: bytes, sender: Address) -> bool:
        """Whether a datagram is to be read; the first of the autopilot makes its sender the partner."""
        if self._remote is None and not any(map(self._is_autopilots, Parser().push_datagram(datagram))):
            return False
        if self._remote is not None and sender != self._remote:
            return False
        if self._is_autopilot(sender, time.monotonic()):
            self._admitted = True
            if self._remote is None:
                self._connect(sender)
            return True
        self.foreign_datagrams += 1
        return False

    def _connect(self, remote: Address) -> None:
        self._socket.connect(remote)
        self._remote = self._socket.getpeername()

    def _is_autopilots(self, message: Message) -> bool:
        source: tuple[int, int] = (message.get_srcSystem(), message.get_srcComponent())
        return source == (self._system, AUTOPILOT_COMPONENT)
