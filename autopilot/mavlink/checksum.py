"""CRC-16/MCRF4XX of MAVLink's frames, in compiled code: of whoever makes or takes frames there."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Octets = NDArray[np.uint8]
_START = 0xFFFF


def _table() -> NDArray[np.int64]:
    """Of each byte: x^16 + x^12 + x^5 + 1, bits reversed."""
    crc = np.arange(256, dtype=np.int64)
    for _ in range(8):
        crc = np.where(crc & 1, (crc >> 1) ^ 0x8408, crc >> 1)
    return crc


_TABLE = _table()


@njit(cache=True)
def checksum(octets: Octets, first: int, end: int, extra: int) -> int:
    """Checksum of ``octets[first:end]`` and of the byte ``extra`` that is peculiar to the kind of message."""
    crc = _START
    for at in range(first, end):
        crc = (crc >> 8) ^ _TABLE[(crc ^ np.int64(octets[at])) & 0xFF]
    return int((crc >> 8) ^ _TABLE[(crc ^ extra) & 0xFF])
