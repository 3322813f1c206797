"""The UDP socket between an application and the autopilot beside it. An I/O module."""

import contextlib
import socket
import time
from collections.abc import Callable

from autopilot.mavlink.codec import Message, Parser
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.telemetry import TelemetryParser
from foundation.processes.socket_owners import UDP_TABLES, ChildSockets, mark_beside, read_tables
from foundation.processes.socket_table import Address, at_address, entries, is_on_this_machine

LARGEST_DATAGRAM_BYTES = 65_535
MOST_WAITING = 2_000
"""Datagrams that are read at once; a socket holds some hundreds."""
REFUSED_S = 1.0
"""Wall time for which a refused sender is not examined again."""
MOST_REFUSED = 64
"""Refused senders that are kept."""


def sender_check(host: str, instance: int) -> Callable[[Address], bool]:
    """Return whether a sender of datagrams to ``host`` is the run's process of that vehicle.

    Senders of other machines are, and all if this process is of no run or the system has no tables.
    """
    mark = mark_beside(f"uav {instance}")

    def is_autopilot(sender: Address) -> bool:
        if mark is None or not is_on_this_machine(sender[0], host):
            return True
        table = read_tables(*UDP_TABLES)
        if table is None:
            return True
        return ChildSockets(pid=None, mark=mark).has(at_address(entries(table, sender[1]), sender))

    return is_autopilot


class AutopilotSocket:
    """A socket that accepts datagrams from one autopilot alone; close it. Raises OSError.

    ``local`` is bound. The autopilot is at ``remote``; without it, at the address from which the first
    message of the autopilot with MAVLink system ``system`` arrives: ArduPilot sends from any free port.
    ``is_autopilot`` decides whether a sender can be the autopilot; it examines processes, and is asked until
    one has been admitted.
    """

    def __init__(
        self,
        local: Address,
        remote: Address | None,
        *,
        system: int,
        is_autopilot: Callable[[Address], bool] = lambda _: True,
    ) -> None:
        self.parser = TelemetryParser(system=system, component=AUTOPILOT_COMPONENT)
        self._system = system
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._remote: Address | None = None
        """Address of the autopilot; None: it has not been received from."""
        self._is_autopilot = is_autopilot
        self._admitted = False
        """Whether the sender at that address is the autopilot."""
        self._refused: dict[Address, float] = {}
        """Other senders, with the wall times until which they are not examined again."""
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
        wall_s = time.monotonic()
        is_due = wall_s >= self._refused.get(sender, wall_s)
        if is_due and self._is_autopilot(sender):
            self._admitted = True
            if self._remote is None:
                self._connect(sender)
            return True
        self.foreign_datagrams += 1
        if is_due:
            if len(self._refused) >= MOST_REFUSED:
                self._refused.clear()
            self._refused[sender] = wall_s + REFUSED_S
        return False

    def _connect(self, remote: Address) -> None:
        self._socket.connect(remote)
        self._remote = self._socket.getpeername()

    def _is_autopilots(self, message: Message) -> bool:
        source: tuple[int, int] = (message.get_srcSystem(), message.get_srcComponent())
        return source == (self._system, AUTOPILOT_COMPONENT)
