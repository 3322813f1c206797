"""MAVLink 2 frames: header, checksum and validation, in compiled code.

For code that packs or parses the same kind of frame at a high rate; `whole_frame` packs a single one. Buffers
of compiled code have spare bytes before the frame, so that the payload is aligned. `hil_schema` has the
payloads.
"""

from struct import Struct

import numpy as np
from fastcrc import crc16
from numba import njit
from numpy.typing import NDArray

Octets = NDArray[np.uint8]
MAGIC = 0xFD
HEADER = np.dtype(
    [
        ("magic", "u1"),
        ("length", "u1"),  # of the payload
        ("incompatible", "u1"),
        ("compatible", "u1"),
        ("sequence", "u1"),
        ("system", "u1"),
        ("component", "u1"),
        ("message_id", "<u2"),
        ("message_id_high", "u1"),
    ]
)
HEADER_BYTES, CHECKSUM_BYTES = HEADER.itemsize, 2
FIRST = 6
"""Offset of the frame in its buffer."""
PAYLOAD = FIRST + HEADER_BYTES
NO_FRAME = -1
_START = 0xFFFF


def _table() -> NDArray[np.int64]:
    """Checksums of all bytes, for the polynomial x^16 + x^12 + x^5 + 1, bits reversed."""
    crc = np.arange(256, dtype=np.int64)
    for _ in range(8):
        crc = np.where(crc & 1, (crc >> 1) ^ 0x8408, crc >> 1)
    return crc


_TABLE = _table()
_CODES = {"u1": "B", "u2": "H", "u4": "I", "u8": "Q", "i2": "h", "i4": "i", "f4": "f"}


def struct_format(layout: np.dtype[np.void]) -> str:
    """Return the format for `struct` of a packed record of little-endian numbers and arrays of them."""
    codes = ["<"]
    for name in layout.names or ():
        kind = layout[name]
        count = kind.itemsize // kind.base.itemsize
        codes.append(("" if count == 1 else f"{count}") + _CODES[kind.base.str[1:]])
    return "".join(codes)


HEADER_STRUCT = Struct(struct_format(HEADER))


def whole_frame(
    payload: bytes, *, message_id: int, crc_extra: bytes, sequence: int, system: int, component: int
) -> bytes:
    """Return the frame of a payload, whose trailing zeros are cut off. ``crc_extra`` is one byte."""
    if not payload[-1]:
        payload = payload.rstrip(b"\0") or b"\0"
    frame = HEADER_STRUCT.pack(
        MAGIC, len(payload), 0, 0, sequence, system, component, message_id & 0xFFFF, message_id >> 16
    ) + payload  # fmt: skip
    crc: int = crc16.mcrf4xx(frame[1:] + crc_extra)
    return frame + crc.to_bytes(CHECKSUM_BYTES, "little")


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

    NO_FRAME otherwise. Message ids must be below 65,536.
    """
    header = octets[FIRST:PAYLOAD].view(HEADER)[0]
    length = int(header["length"])
    if size != HEADER_BYTES + length + CHECKSUM_BYTES or header["magic"] != MAGIC:
        return NO_FRAME
    if header["incompatible"] != 0 or header["message_id"] != kind or header["message_id_high"] != 0:
        return NO_FRAME
    end = PAYLOAD + length
    if np.int64(octets[end]) | np.int64(octets[end + 1]) << 8 != checksum(octets, FIRST + 1, end, extra):
        return NO_FRAME
    return length


@njit(cache=True)
def seal(octets: Octets, sequence: int, extra: int) -> None:
    """Write sequence number and checksum of a frame that begins at `FIRST`."""
    header = octets[FIRST:PAYLOAD].view(HEADER)[0]
    header["sequence"] = sequence
    end = PAYLOAD + int(header["length"])
    crc = checksum(octets, FIRST + 1, end, extra)
    octets[end], octets[end + 1] = crc & 0xFF, crc >> 8
