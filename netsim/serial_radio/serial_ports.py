"""Serial ports of a modem: bytes from its host with their buffer, and bytes to its host.

Sizes are those of Firmware/radio/serial.c of ArduPilot/SiK, revision 50189f2, for the Si1000. There is no
flow control (RTSCTS = 0): a modem discards what does not fit, as does the host's own driver. Times are ns.
"""

from collections import deque

from netsim.serial_radio.packets import whole_frames

RECEIVE_BUFFER_BYTES = 1850
"""Buffer of bytes from the host; one byte stays free."""
TRANSMIT_BUFFER_BYTES = 645
"""Buffer of bytes to the host."""
BITS_PER_BYTE = 10
"""Start bit, eight bits, stop bit."""


class SerialInput:
    """Bytes from a host: its driver's buffer, the line, and the modem's receive buffer."""

    __slots__ = (
        "_byte_ns",
        "_free_ns",
        "_host_bytes",
        "_line",
        "buffer",
        "host_dropped_bytes",
        "overflow_bytes",
    )

    def __init__(self, byte_ns: int, host_bytes: int) -> None:
        self._byte_ns = byte_ns
        self._host_bytes = host_bytes
        self._line: deque[tuple[int, bytes]] = deque()
        """Bytes that have not arrived, with the beginning of their transmission."""
        self._free_ns = 0
        """Time at which the host's buffer is empty."""
        self.buffer = bytearray()
        """Bytes that have arrived and have not been sent, as of the last `absorb`."""
        self.host_dropped_bytes = 0
        self.overflow_bytes = 0

    def submit(self, data: bytes, at_ns: int) -> bool:
        """Begin to transfer bytes at ``at_ns`` or after those before; return False if they do not fit.

        They are dropped as a whole if the host's buffer has too little space.
        """
        start_ns = max(at_ns, self._free_ns)
        waiting = -((at_ns - start_ns) // self._byte_ns)
        if waiting + len(data) > self._host_bytes:
            self.host_dropped_bytes += len(data)
            return False
        if data:
            self._line.append((start_ns, data))
            self._free_ns = start_ns + len(data) * self._byte_ns
        return True

    def absorb(self, at_ns: int) -> None:
        """Move the bytes that have arrived until ``at_ns`` into `buffer`; those that do not fit are lost."""
        line, buffer = self._line, self.buffer
        while line:
            start_ns, data = line[0]
            count = (at_ns - start_ns) // self._byte_ns
            if count <= 0:
                break
            arrived = data[:count]
            if count < len(data):
                line[0] = start_ns + count * self._byte_ns, data[count:]
            else:
                line.popleft()
            space = RECEIVE_BUFFER_BYTES - 1 - len(buffer)
            buffer += arrived[:space]
            self.overflow_bytes += max(0, len(arrived) - space)

    def read(self, count: int) -> bytes:
        """Remove and return the first bytes of `buffer`."""
        data = bytes(self.buffer[:count])
        del self.buffer[:count]
        return data

    @property
    def free_percent(self) -> int:
        """Free space of the buffer as the firmware computes it, percent (``txbuf``)."""
        return 100 * ((RECEIVE_BUFFER_BYTES - len(self.buffer)) // 8) // (RECEIVE_BUFFER_BYTES // 8)


class SerialOutput:
    """Bytes to a host: the modem's transmit buffer and the line."""

    __slots__ = ("_byte_ns", "_free_ns", "overflow_bytes")

    def __init__(self, byte_ns: int) -> None:
        self._byte_ns = byte_ns
        self._free_ns = 0
        """Time at which the buffer is empty."""
        self.overflow_bytes = 0

    def space(self, at_ns: int) -> int:
        """Return the free space of the buffer in bytes."""
        return TRANSMIT_BUFFER_BYTES - max(0, -((at_ns - self._free_ns) // self._byte_ns))

    def write(self, data: bytes, at_ns: int) -> list[tuple[int, bytes]]:
        """Append bytes to the buffer at ``at_ns``; those that do not fit are lost.

        Returns the pieces, with the times at which their last bytes have arrived at the host.
        """
        space = max(0, self.space(at_ns))
        self.overflow_bytes += max(0, len(data) - space)
        return [(self.occupy(len(piece), at_ns), piece) for piece in whole_frames(data[:space])]

    def occupy(self, count: int, at_ns: int) -> int:
        """Append ``count`` bytes; return the time at which they have arrived."""
        self._free_ns = max(self._free_ns, at_ns) + count * self._byte_ns
        return self._free_ns
