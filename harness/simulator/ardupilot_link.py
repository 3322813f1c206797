"""Connection to one ArduPilot: states and servo packets by UDP, MAVLink by TCP. An I/O module.

ArduPilot sends its servo packets to a UDP port of the simulator and expects states where it sent them from.
Its MAVLink link connects to the TCP port of the same number ("tcpclient" of one of its serial ports): it
takes the receiver's fixes and reports mode and state. The first servo packet is sent before any state.
"""

import contextlib
import socket
import time

from autopilot.mavlink.codec import Message, Parser
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from harness.simulator.ardupilot_json import servo_packet
from harness.simulator.slot_guard import UNGUARDED, Guard

_DATAGRAM_BYTES = 4096
_RECEIVE_BYTES = 4096
_MAVLINK_PERIOD = 25
"""Steps between two reads of the MAVLink connection, on which some messages a second arrive."""
_LINE_FEED = b"\n"
REPEAT_AFTER_S = 0.5
"""Wall time after a state from which on a repeated packet shows that the state was lost. ArduPilot repeats a
packet after a second without a state; one that arrives earlier than this has crossed the state. A state more
than one per packet would be read one step later for the rest of the flight."""
MAX_PENDING = 64
"""Open TCP connections without a message of the vehicle; one more closes the oldest."""
MOST_OTHER_BYTES = 1_000
"""Bytes without a message that such a connection may send; ArduPilot sends a few at its start."""
_WAITING = 1_000
"""Most datagrams that are read at once."""


class _Pending:
    """A TCP connection that has not sent a message of the vehicle yet."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.parser = Parser()
        self.messages: list[Message] = []


class ArduPilotLink:
    """The two sockets of one ArduPilot; implements `harness.simulator.lockstep.Link`.

    ``states`` is the bound UDP socket, ``listener`` the TCP socket at which the MAVLink link arrives: the
    first connection with a message of MAVLink system ``system``, which is the vehicle's number plus one.
    ``guard`` decides which senders and connections may be the vehicle's. Sends what
    `harness.simulator.ardupilot_json.StateEncoder` returns: the line as a datagram, the rest to the MAVLink
    link. It receives servo packets, each once: ArduPilot repeats a packet whose state it has missed, which is
    answered by repeating the state.
    """

    def __init__(
        self, states: socket.socket, listener: socket.socket, *, system: int, guard: Guard = UNGUARDED
    ) -> None:
        self._guard = guard
        self.states = states
        self._system = system
        self._listener = listener
        self._listener.settimeout(0.0)  # non-blocking
        self._mavlink: socket.socket | None = None
        self._pending: list[_Pending] = []
        """The oldest first."""
        self._parser = Parser()
        self._messages: list[Message] = []
        """Received on the MAVLink link."""
        self._steps = 0
        self._line: bytes = b""
        """The newest state."""
        self._wall_sent_s = 0.0
        """Wall time of its newest sending."""
        self._frame_count = -1
        """Number of the newest servo packet."""
        self._ended = False
        """Whether the MAVLink link has closed, as it does when ArduPilot ends."""

    def arrive(self) -> bool:
        """Take a first servo packet, if one has arrived; from then on only its sender is received from."""
        for _ in range(_WAITING):
            try:
                data, sender = self.states.recvfrom(_DATAGRAM_BYTES, socket.MSG_DONTWAIT)
            except OSError:
                return False
            packet = servo_packet(data)
            if packet is not None and self._guard.admits_sender(
                self._system - 1, self.states.getsockname(), sender, time.monotonic()
            ):
                self.states.connect(sender)
                self._frame_count = packet.frame_count
                self._discard()  # from other senders, or repeated
                return True
        return False

    def sendall(self, data: bytes | memoryview, /) -> None:
        """Send a state and what follows it. Raises OSError."""
        data = bytes(data)
        end = data.index(_LINE_FEED, 1) + 1
        self._line, rest = data[:end], data[end:]
        wall_s = time.monotonic()
        if wall_s - self._wall_sent_s > REPEAT_AFTER_S:
            self._discard()  # repeated while the simulation rested
        self._wall_sent_s = wall_s
        try:
            self.states.send(self._line)
        except ConnectionRefusedError:
            self._ended = True
        if rest and self._mavlink is not None:
            try:
                self._mavlink.sendall(rest)
            except BlockingIOError:  # it does not read: the message is lost
                pass
            except OSError:  # its end is noticed by the next read
                self._ended = True

    def recv_into(self, buffer: memoryview, /) -> int:
        """Receive the next servo packet into a buffer; returns its length, 0 if ArduPilot has ended."""
        data = self.recv(_DATAGRAM_BYTES)
        buffer[: len(data)] = data
        return len(data)

    def recv(self, size: int, flags: int = 0, /) -> bytes:
        """Receive the next servo packet; empty if ArduPilot has ended. Raises BlockingIOError."""
        while True:
            try:
                data = self.states.recv(size, flags)
            except BlockingIOError:
                self._read()
                if self._ended:
                    return b""
                raise
            packet = servo_packet(data)
            if packet is None:
                continue
            if packet.frame_count != self._frame_count:
                self._frame_count = packet.frame_count
                return data
            wall_s = time.monotonic()
            if wall_s - self._wall_sent_s > REPEAT_AFTER_S:
                self._wall_sent_s = wall_s
                self.states.send(self._line)

    def messages(self) -> list[Message]:
        """Return the vehicle's messages that have arrived on the MAVLink link; call once a step.

        ArduPilot forwards those of other links, too: of the application, of ground stations.
        """
        self._steps += 1
        if self._steps % _MAVLINK_PERIOD == 0:
            self._read()
        messages, self._messages = self._messages, []
        return messages

    def close(self) -> None:
        """Close the sockets; harmless when repeated."""
        with contextlib.ExitStack() as stack:
            pending = [each.connection for each in self._pending]
            for each in (self.states, self._listener, self._mavlink, *pending):
                if each is not None:
                    stack.callback(each.close)

    def _discard(self) -> None:
        """Discard all packets that have arrived."""
        for _ in range(_WAITING):
            try:
                packet = servo_packet(self.states.recv(_DATAGRAM_BYTES, socket.MSG_DONTWAIT))
            except OSError:
                return
            if packet is not None and self._line:
                self._frame_count = packet.frame_count

    def _read(self) -> None:
        """Read the MAVLink link, and note its end."""
        if self._mavlink is None:
            self._identify()
            return
        data = _received(self._mavlink)
        if data is not None:
            self._ended |= not data
            self._messages += filter(self._is_vehicles, self._parser.push(data))

    def _identify(self) -> None:
        """Accept connections; the first with a message of the vehicle is its MAVLink link."""
        accepted = []
        with contextlib.suppress(OSError):  # no more, or one that was reset meanwhile
            for _ in range(MAX_PENDING):
                connection, _ = self._listener.accept()
                connection.settimeout(0.0)  # non-blocking
                accepted.append((self._system - 1, connection))
        for (_, connection), admitted in zip(accepted, self._guard.admits(accepted), strict=True):
            if admitted:
                self._pending.append(_Pending(connection))
            else:
                connection.close()
        for pending in list(self._pending):
            data = _received(pending.connection)
            if data is None:
                continue
            pending.messages += pending.parser.push(data)
            if any(map(self._is_vehicles, pending.messages)):
                self._accept(pending)
                return
            if not data or pending.messages or pending.parser.bad_bytes > MOST_OTHER_BYTES:
                self._pending.remove(pending)
                pending.connection.close()
        for pending in self._pending[:-MAX_PENDING]:
            pending.connection.close()
        del self._pending[:-MAX_PENDING]

    def _is_vehicles(self, message: Message) -> bool:
        source: tuple[int, int] = (message.get_srcSystem(), message.get_srcComponent())
        return source == (self._system, AUTOPILOT_COMPONENT)

    def _accept(self, pending: _Pending) -> None:
        """Use a connection as MAVLink link, and close the others."""
        self._pending.remove(pending)
        self._mavlink, self._parser = pending.connection, pending.parser
        self._mavlink.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._messages += filter(self._is_vehicles, pending.messages)
        self._listener.close()
        for other in self._pending:
            other.connection.close()
        self._pending.clear()


def _received(connection: socket.socket) -> bytes | None:
    """Return bytes that have arrived, empty at the end of the connection; None: nothing has."""
    try:
        return connection.recv(_RECEIVE_BYTES, socket.MSG_DONTWAIT)
    except BlockingIOError:
        return None
    except OSError:
        return b""
