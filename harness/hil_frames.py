"""MAVLink frames of one kind for all vehicles at once: what the physics server says in every step.

A kind of message is a row of a NumPy structure, its fields in the order of the wire. The columns are filled
for all vehicles together, and one kernel makes whole frames of the rows. `autopilot.mavlink.hil` says how a
frame is made of a payload; the codec of the vehicles, which reads these, is the other witness.
"""

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from autopilot.mavlink import dialect

SIMULATOR_SYSTEM_ID = 0
SIMULATOR_COMPONENT_ID = 1
_MAGIC = 0xFD
_HEADER_BYTES = 10
_CHECKSUM_BYTES = 2
_CRC_START = 0xFFFF


def _crc_table() -> NDArray[np.int64]:
    """CRC-16/MCRF4XX of each byte: x^16 + x^12 + x^5 + 1, bits reversed."""
    crc = np.arange(256, dtype=np.int64)
    for _ in range(8):
        crc = np.where(crc & 1, (crc >> 1) ^ 0x8408, crc >> 1)
    return crc


_CRC_TABLE = _crc_table()


class Kind:
    """One kind of message: how its rows look, and what its frames begin and end with."""

    def __init__(self, message_id: int, fields: list[tuple[Any, ...]]) -> None:
        self.dtype: Final = np.dtype(fields)
        """Packed, in the order of the wire."""
        self._crc_extra: Final = int(common.mavlink_map[message_id].crc_extra)
        source = bytes((SIMULATOR_SYSTEM_ID, SIMULATOR_COMPONENT_ID))
        header = bytes((_MAGIC, 0, 0, 0, 0)) + source + message_id.to_bytes(3, "little")
        self._header: Final = np.frombuffer(header, dtype=np.uint8)

    def frames(self, rows: NDArray[np.void], sequence: int) -> list[bytes]:
        """Whole frames of rows (n,) of ``dtype``, all with the same sequence number."""
        n, size = len(rows), self.dtype.itemsize
        longest = _HEADER_BYTES + size + _CHECKSUM_BYTES
        frames = np.empty((n, longest), dtype=np.uint8)
        lengths = np.empty(n, dtype=np.int64)
        payloads = rows.view(np.uint8).reshape(n, size)
        make_frames(self._header, sequence, self._crc_extra, payloads, frames, lengths)
        data = frames.tobytes()
        starts = range(0, n * longest, longest)
        return [data[start : start + length] for start, length in zip(starts, lengths.tolist(), strict=True)]


@njit(cache=True)
def make_frames(
    header: NDArray[np.uint8],
    sequence: int,
    crc_extra: int,
    payloads: NDArray[np.uint8],
    frames: NDArray[np.uint8],
    lengths: NDArray[np.int64],
) -> None:
    """Write frames (n, size + 12) of payloads (n, size), and their lengths (n,).

    ``header`` (10,) has all but the payload's length and the sequence number. Trailing zeros of a payload are
    cut off, but for its first byte.
    """
    for row in range(payloads.shape[0]):
        frame = frames[row]
        length = payloads.shape[1]
        while length > 1 and payloads[row, length - 1] == 0:
            length -= 1
        end = _HEADER_BYTES + length
        frame[:_HEADER_BYTES] = header
        frame[1] = length
        frame[4] = sequence
        frame[_HEADER_BYTES:end] = payloads[row, :length]
        crc = _CRC_START
        for at in range(1, end):  # all but the magic byte
            crc = (crc >> 8) ^ _CRC_TABLE[(crc ^ np.int64(frame[at])) & 0xFF]
        crc = (crc >> 8) ^ _CRC_TABLE[(crc ^ crc_extra) & 0xFF]
        frame[end] = crc & 0xFF
        frame[end + 1] = crc >> 8
        lengths[row] = end + _CHECKSUM_BYTES


HIL_SENSOR = Kind(
    common.MAVLINK_MSG_ID_HIL_SENSOR,
    [
        ("time_usec", "<u8"),
        ("acc", "<f4", 3),
        ("gyro", "<f4", 3),
        ("mag", "<f4", 3),
        ("abs_pressure", "<f4"),
        ("diff_pressure", "<f4"),
        ("pressure_alt", "<f4"),
        ("temperature", "<f4"),
        ("fields_updated", "<u4"),
        ("id", "u1"),
    ],
)
HIL_GPS = Kind(
    common.MAVLINK_MSG_ID_HIL_GPS,
    [
        ("time_usec", "<u8"),
        ("lat", "<i4"),
        ("lon", "<i4"),
        ("alt", "<i4"),
        ("eph", "<u2"),
        ("epv", "<u2"),
        ("vel", "<u2"),
        ("vel_ned", "<i2", 3),
        ("cog", "<u2"),
        ("fix_type", "u1"),
        ("satellites_visible", "u1"),
        ("id", "u1"),
        ("yaw", "<u2"),
    ],
)
HIL_STATE_QUATERNION = Kind(
    common.MAVLINK_MSG_ID_HIL_STATE_QUATERNION,
    [
        ("time_usec", "<u8"),
        ("attitude_quaternion", "<f4", 4),
        ("omega", "<f4", 3),
        ("lat", "<i4"),
        ("lon", "<i4"),
        ("alt", "<i4"),
        ("vel_ned", "<i2", 3),
        ("ind_airspeed", "<u2"),
        ("true_airspeed", "<u2"),
        ("acc", "<i2", 3),
    ],
)
ESC_STATUS = Kind(
    dialect.ESC_STATUS,
    [
        ("time_usec", "<u8"),
        ("rpm", "<i4", 4),
        ("voltage", "<f4", 4),
        ("current", "<f4", 4),
        ("index", "u1"),
    ],
)
RC_CHANNELS = Kind(
    common.MAVLINK_MSG_ID_RC_CHANNELS,
    [
        ("time_boot_ms", "<u4"),
        ("channels", "<u2", 18),
        ("chancount", "u1"),
        ("rssi", "u1"),
    ],
)
