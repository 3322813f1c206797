"""The UDP socket between an application and the autopilot beside it. An I/O module."""

import contextlib
import socket

from autopilot.mavlink.codec import Message, Parser
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.telemetry import TelemetryParser

LARGEST_DATAGRAM_BYTES = 65_535
MOST_WAITING = 2_000
"""Datagrams that are read at once; a socket holds some hundreds."""


class AutopilotSocket:
    """A socket that accepts datagrams from one autopilot alone; close it. Raises OSError.

    ``local`` is bound. The autopilot is at ``remote``; without it, at the address from which the first
    message of the autopilot with MAVLink system ``system`` arrives: ArduPilot sends from any free port.
    """

    def __init__(self, local: tuple[str, int], remote: tuple[str, int] | None, *, system: int) -> None:
        self.parser = TelemetryParser(system=system, component=AUTOPILOT_COMPONENT)
        self._system = system
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._remote: tuple[str, int] | None = None
        """Address of the autopilot; None: it has not been received from."""
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
            if self._remote is None and any(map(self._is_autopilots, Parser().push_datagram(datagram))):
                self._connect(sender)
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

    def _connect(self, remote: tuple[str, int]) -> None:
        self._socket.connect(remote)
        self._remote = self._socket.getpeername()

    def _is_autopilots(self, message: Message) -> bool:
        source: tuple[int, int] = (message.get_srcSystem(), message.get_srcComponent())
        return source == (self._system, AUTOPILOT_COMPONENT)
