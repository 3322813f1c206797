"""Connection to one ArduPilot: states and servo packets by UDP, MAVLink by TCP. An I/O module.

ArduPilot sends its servo packets to a UDP port of the simulator and expects states where it sent them from.
Its MAVLink link connects to the TCP port of the same number ("tcpclient" of one of its serial ports): it
takes the receiver's fixes and reports mode and state. The first servo packet is sent before any state.
"""

import contextlib
import socket

from autopilot.mavlink.codec import Message, Parser
from harness.simulator.ardupilot_json import servo_packet

_DATAGRAM_BYTES = 4096
_RECEIVE_BYTES = 4096
_MAVLINK_PERIOD = 25
"""Steps between two reads of the MAVLink connection, on which some messages a second arrive."""
_LINE_FEED = b"\n"


class ArduPilotLink:
    """The two sockets of one ArduPilot; implements `harness.simulator.lockstep.Link`.

    ``states`` is the bound UDP socket, ``listener`` the TCP socket at which the MAVLink link arrives. Sends
    what `harness.simulator.ardupilot_json.StateEncoder` returns: the line as a datagram, the rest to the
    MAVLink link. It receives servo packets, each once: ArduPilot repeats a packet whose state it has missed,
    which is answered by repeating the state.
    """

    def __init__(self, states: socket.socket, listener: socket.socket) -> None:
        self.states = states
        self._listener = listener
        self._listener.settimeout(0.0)  # non-blocking
        self._mavlink: socket.socket | None = None
        self._parser = Parser()
        self._messages: list[Message] = []
        """Received on the MAVLink link."""
        self._steps = 0
        self._line: bytes = b""
        """The newest state."""
        self._frame_count = -1
        """Number of the newest servo packet."""
        self._ended = False
        """Whether the MAVLink link has closed, as it does when ArduPilot ends."""

    def arrive(self) -> bool:
        """Take a first servo packet, if one has arrived; from then on only its sender is received from."""
        try:
            data, sender = self.states.recvfrom(_DATAGRAM_BYTES, socket.MSG_DONTWAIT)
        except OSError:
            return False
        packet = servo_packet(data)
        if packet is None:
            return False
        self.states.connect(sender)
        self._frame_count = packet.frame_count
        return True

    def sendall(self, data: bytes | memoryview, /) -> None:
        """Send a state and what follows it. Raises OSError."""
        data = bytes(data)
        end = data.index(_LINE_FEED, 1) + 1
        self._line, rest = data[:end], data[end:]
        self.states.send(self._line)
        if rest and self._mavlink is not None:
            try:
                self._mavlink.sendall(rest)
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
            if packet.frame_count == self._frame_count:
                self.states.send(self._line)
                continue
            self._frame_count = packet.frame_count
            return data

    def messages(self) -> list[Message]:
        """Return the messages that have arrived on the MAVLink link; call once a step."""
        self._steps += 1
        if self._steps % _MAVLINK_PERIOD == 0:
            self._read()
        messages, self._messages = self._messages, []
        return messages

    def close(self) -> None:
        """Close the sockets; harmless when repeated."""
        with contextlib.ExitStack() as stack:
            for each in (self.states, self._listener, self._mavlink):
                if each is not None:
                    stack.callback(each.close)

    def _read(self) -> None:
        """Read the MAVLink link, and note its end."""
        self._mavlink = self._mavlink or self._accept()
        if self._mavlink is None:
            return
        try:
            data = self._mavlink.recv(_RECEIVE_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self._ended |= not data
        self._messages += self._parser.push(data)

    def _accept(self) -> socket.socket | None:
        """Return the MAVLink link if it has arrived."""
        try:
            link, _ = self._listener.accept()
        except BlockingIOError:
            return None
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return link
