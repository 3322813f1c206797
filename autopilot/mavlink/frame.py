"""MAVLink 2 frames in compiled code: field offsets, checksum and validation.

For code that packs or parses the same kind of frame at a high rate. Buffers have spare bytes before the
frame, so that the payload is aligned.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Octets = NDArray[np.uint8]
MAGIC = 0xFD
HEADER_BYTES, CHECKSUM_BYTES = 10, 2
FIRST = 6
"""Offset of the frame in its buffer."""
PAYLOAD = FIRST + HEADER_BYTES
LENGTH, INCOMPATIBLE, SEQUENCE, KIND = FIRST + 1, FIRST + 2, FIRST + 4, FIRST + 7
"""Offsets of payload length, incompatibility flags, sequence number, and message id (three bytes)."""
NO_FRAME = -1
_START = 0xFFFF


def _table() -> NDArray[np.int64]:
    """Checksums of all bytes, for the polynomial x^16 + x^12 + x^5 + 1, bits reversed."""
    crc = np.arange(256, dtype=np.int64)
    for _ in range(8):
        crc = np.where(crc & 1, (crc >> 1) ^ 0x8408, crc >> 1)
    return crc


_TABLE = _table()


@njit(cache=True)
def checksum(octets: Octets, first: int, end: int, extra: int) -> int:
    """CRC-16/MCRF4XX of ``octets[first:end]`` and of the message's CRC_EXTRA byte."""
    crc = _START
    for at in range(first, end):
        crc = (crc >> 8) ^ _TABLE[(crc ^ np.int64(octets[at])) & 0xFF]
    return int((crc >> 8) ^ _TABLE[(crc ^ extra) & 0xFF])


@njit(cache=True)
def payload_bytes(octets: Octets, size: int, kind: int, extra: int) -> int:
    """Payload length, if ``size`` bytes from `FIRST` on are one valid, unsigned frame of this message id.

    NO_FRAME otherwise. Message ids must be below 256.
    """
    length = int(octets[LENGTH])
    if size != HEADER_BYTES + length + CHECKSUM_BYTES or octets[FIRST] != MAGIC:
        return NO_FRAME
    if octets[INCOMPATIBLE] != 0 or octets[KIND] != kind or octets[KIND + 1] != 0 or octets[KIND + 2] != 0:
        return NO_FRAME
    end = PAYLOAD + length
    if np.int64(octets[end]) | np.int64(octets[end + 1]) << 8 != checksum(octets, FIRST + 1, end, extra):
        return NO_FRAME
    return length


@njit(cache=True)
def seal(octets: Octets, sequence: int, extra: int) -> None:
    """Write sequence number and checksum of a frame that begins at `FIRST`."""
    octets[SEQUENCE] = sequence
    end = PAYLOAD + int(octets[LENGTH])
    crc = checksum(octets, FIRST + 1, end, extra)
    octets[end], octets[end + 1] = crc & 0xFF, crc >> 8
