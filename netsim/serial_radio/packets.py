"""Selection of the bytes of the next packet, and boundaries of MAVLink frames.

Facts of Firmware/radio/packet.c of ArduPilot/SiK, revision 50189f2. With framing a packet has one or more
whole MAVLink frames, which are recognised by their first byte and length byte alone. A frame that is not
complete in the buffer, or does not fit into the rest of the window, leaves the packet empty, by which the
modem yields its window. If it is still incomplete, or does not fit, after the time that it takes at the
serial port, its bytes are sent as they are. Frames with a payload of more than `Timing.max_frame_bytes` - 25
bytes, 225 with the default settings, are not recognised.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from netsim.serial_radio.timing import TICK_NS

if TYPE_CHECKING:
    from netsim.serial_radio.serial_ports import SerialInput

STX_1, STX_2 = 254, 253
"""First byte of a MAVLink frame, by version."""
OVERHEAD_1, OVERHEAD_2, SIGNATURE = 8, 12, 13
"""Bytes of a frame beside its payload."""
RESEND_THRESHOLD_BYTES = 32
_LEAST_FRAME_BYTES = 8
_MOST_OVERHEAD = OVERHEAD_2 + SIGNATURE
_HEARTBEAT_BYTES = 9


def frame_bytes(data: bytes | bytearray, at: int = 0) -> int:
    """Return the length of the MAVLink frame that begins at ``at``, by its first bytes; 0: there is none."""
    if len(data) - at < 3 or data[at] not in (STX_1, STX_2):
        return 0
    if data[at] == STX_1:
        return data[at + 1] + OVERHEAD_1
    return data[at + 1] + OVERHEAD_2 + (SIGNATURE if data[at + 2] & 1 else 0)


def whole_frames(data: bytes) -> Iterator[bytes]:
    """Yield the bytes in order: each whole MAVLink frame on its own, then the rest as one piece."""
    at = 0
    while (length := frame_bytes(data, at)) and at + length <= len(data):
        yield data[at : at + length]
        at += length
    if at < len(data):
        yield data[at:]


def heartbeat_version(frame: bytes | bytearray) -> int:
    """Return the MAVLink version of a HEARTBEAT, or 0 if the frame is another one."""
    if frame[0] == STX_1 and frame[1] == _HEARTBEAT_BYTES and frame[5] == 0:
        return 1
    short = frame[0] == STX_2 and frame[1] <= _HEARTBEAT_BYTES and len(frame) > OVERHEAD_2 - 2
    return 2 if short and frame[7] == frame[8] == frame[9] == 0 else 0


class PacketSource:
    """Chooses the bytes of each packet from the bytes of the host."""

    def __init__(
        self,
        source: "SerialInput",
        *,
        framing: bool,
        resend: bool,
        max_frame_bytes: int,
        serial_rate_baud: int,
    ) -> None:
        self._source = source
        self._framing = framing
        self._resend = resend
        self._max_frame_bytes = max_frame_bytes
        # of the rate in kbit/s, rounded down: a tenth less than a byte really takes at 57600 baud
        self._wait_per_byte_ns = (65_536 // (serial_rate_baud // 1_000 * 125) + 1) * TICK_NS
        self._expected = 0
        """Length of the frame at the beginning of the buffer; 1: only its first byte is there; 0: unknown."""
        self._deadline_ns = 0
        """Time after which an incomplete frame is sent as it is."""
        self._last = b""
        self.is_resend = False
        """Whether the last packet was sent before."""
        self.heartbeat_version = 0
        """MAVLink version of the last HEARTBEAT that was sent; the modem resets it."""

    def next(self, most_bytes: int, at_ns: int) -> bytes:
        """Return the data of a packet that begins now, at most ``most_bytes``; empty: none."""
        source = self._source
        source.absorb(at_ns)
        if self._resend and not self.is_resend and self._last and len(source.buffer) < RESEND_THRESHOLD_BYTES:
            if len(self._last) > most_bytes:
                return b""
            self.is_resend = True
            return self._last
        self.is_resend = False
        available = min(len(source.buffer), most_bytes)
        if available == 0:
            self._last = b""
        elif self._framing:
            self._last = self._framed(available, most_bytes, at_ns)
        else:
            self._last = source.read(available)
        return self._last

    def _framed(self, available: int, most_bytes: int, at_ns: int) -> bytes:
        """Return whole frames, or bytes that are in no frame."""
        if self._expected and available < max(self._expected, 2):
            if at_ns <= self._deadline_ns:
                return b""
            self._expected = 0
            return self._source.read(available)
        if self._expected > 1:
            return self._frames(most_bytes)
        self._expected = 0
        return self._unframed(available, most_bytes, at_ns)

    def _unframed(self, available: int, most_bytes: int, at_ns: int) -> bytes:
        """Return the bytes before the next frame, or frames if one begins here."""
        buffer, skipped = self._source.buffer, 0
        while skipped < available:
            first = buffer[skipped]
            if first not in (STX_1, STX_2):
                skipped += 1
                continue
            if skipped + 1 == available:
                if skipped == 0:
                    self._expect(1, at_ns)
                    return b""
                break
            payload = buffer[skipped + 1]
            if payload >= 255 - _MOST_OVERHEAD or payload + _MOST_OVERHEAD > self._max_frame_bytes:
                skipped += 1  # too large: its bytes are sent without framing
                continue
            signed = first == STX_2 and skipped + 2 < available and buffer[skipped + 2] & 1
            overhead = OVERHEAD_1 if first == STX_1 else OVERHEAD_2 + (SIGNATURE if signed else 0)
            length = payload + overhead
            self._expect(length, at_ns)
            if skipped == 0:
                return self._frames(most_bytes) if length <= available else b""
            break
        return self._source.read(skipped)

    def _expect(self, length: int, at_ns: int) -> None:
        self._expected, self._deadline_ns = length, at_ns + length * self._wait_per_byte_ns

    def _frames(self, most_bytes: int) -> bytes:
        """Return as many whole frames as fit, perhaps none."""
        self._expected = 0
        buffer, end = self._source.buffer, 0
        while len(buffer) - end >= _LEAST_FRAME_BYTES:
            length = frame_bytes(buffer, end)
            if length == 0 or length >= 255 or end + length > min(most_bytes, len(buffer)):
                break
            self.heartbeat_version = heartbeat_version(buffer[end : end + length]) or self.heartbeat_version
            end += length
        return self._source.read(end)
