"""Encodes MAVLink messages of one kind for all vehicles at once.

A message is a row of a NumPy structured array, its fields in the order of the wire. The columns are filled
for all vehicles together, and one kernel packs the rows into frames. `autopilot.mavlink.hil` specifies the
framing of a payload; the vehicles' codec, which decodes these frames, is an independent implementation.
"""

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common

from autopilot.mavlink import dialect
from autopilot.mavlink.frame import (
    CHECKSUM_BYTES,
    FIRST,
    HEADER_BYTES,
    MAGIC,
    PAYLOAD,
    Octets,
    checksum,
    seal,
)
from foundation.types import Array

SIMULATOR_SYSTEM_ID = 0
SIMULATOR_COMPONENT_ID = 1


class FrameLayout:
    """Layout of one kind of message: its rows' dtype, and the header and CRC_EXTRA of its frames."""

    def __init__(self, message_id: int, fields: list[tuple[Any, ...]]) -> None:
        self.dtype: Final = np.dtype(fields)
        """Packed, with the fields in the order of the wire."""
        self._crc_extra: Final = int(common.mavlink_map[message_id].crc_extra)
        source = bytes((SIMULATOR_SYSTEM_ID, SIMULATOR_COMPONENT_ID))
        header = bytes((MAGIC, 0, 0, 0, 0)) + source + message_id.to_bytes(3, "little")
        self._header: Final = np.frombuffer(header, dtype=np.uint8)

    def frames(self, rows: NDArray[np.void], sequence: int) -> list[bytes]:
        """Return the frames of rows (n,) of ``dtype``, all with the same sequence number."""
        n, size = len(rows), self.dtype.itemsize
        longest = HEADER_BYTES + size + CHECKSUM_BYTES
        frames = np.empty((n, longest), dtype=np.uint8)
        lengths = np.empty(n, dtype=np.int64)
        payloads = rows.view(np.uint8).reshape(n, size)
        make_frames(self._header, sequence, self._crc_extra, payloads, frames, lengths)
        data = frames.tobytes()
        starts = range(0, n * longest, longest)
        return [data[start : start + length] for start, length in zip(starts, lengths.tolist(), strict=True)]


@njit(cache=True)
def make_frames(
    header: Octets,
    sequence: int,
    crc_extra: int,
    payloads: Octets,
    frames: Octets,
    lengths: NDArray[np.int64],
) -> None:
    """Write the frames (n, size + 12) of payloads (n, size), and their lengths (n,).

    ``header`` (10,) is complete except for the payload's length and the sequence number. Trailing zeros of a
    payload are truncated; its first byte is kept.
    """
    for row in range(payloads.shape[0]):
        frame = frames[row]
        length = payloads.shape[1]
        while length > 1 and payloads[row, length - 1] == 0:
            length -= 1
        end = HEADER_BYTES + length
        frame[:HEADER_BYTES] = header
        frame[1] = length
        frame[4] = sequence
        frame[HEADER_BYTES:end] = payloads[row, :length]
        crc = checksum(frame, 1, end, crc_extra)  # all but the magic byte
        frame[end] = crc & 0xFF
        frame[end + 1] = crc >> 8
        lengths[row] = end + CHECKSUM_BYTES


HIL_SENSOR = FrameLayout(
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
HIL_GPS = FrameLayout(
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
HIL_STATE_QUATERNION = FrameLayout(
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
ESC_STATUS = FrameLayout(
    dialect.ESC_STATUS,
    [
        ("time_usec", "<u8"),
        ("rpm", "<i4", 4),
        ("voltage", "<f4", 4),
        ("current", "<f4", 4),
        ("index", "u1"),
    ],
)
RC_CHANNELS = FrameLayout(
    common.MAVLINK_MSG_ID_RC_CHANNELS,
    [
        ("time_boot_ms", "<u4"),
        ("channels", "<u2", 18),
        ("chancount", "u1"),
        ("rssi", "u1"),
    ],
)

_SAMPLES, _REST, _UPDATED = PAYLOAD + 8, PAYLOAD + 32, PAYLOAD + 60
_END = _UPDATED + 1
"""End of HIL_SENSOR's payload if ``fields_updated`` is below 256: all later bytes are zero."""
_ROW_BYTES = 80
_SENSOR = common.MAVLINK_MSG_ID_HIL_SENSOR
_SENSOR_EXTRA = int(common.mavlink_map[_SENSOR].crc_extra)


class InertialFrames:
    """HIL_SENSOR for n vehicles with accelerations and angular rates only, as in most steps.

    The frames use the same memory in every step, so nothing is allocated or copied.
    """

    def __init__(self, vehicles: int, fields_updated: int) -> None:
        self.vehicles: Final = vehicles
        self._rows = np.zeros((vehicles, _ROW_BYTES), dtype=np.uint8)
        source = (SIMULATOR_SYSTEM_ID, SIMULATOR_COMPONENT_ID)
        self._rows[:, FIRST:PAYLOAD] = (MAGIC, _END - PAYLOAD, 0, 0, 0, *source, _SENSOR, 0, 0)
        self._rows[:, _UPDATED] = fields_updated
        data, length = memoryview(self._rows.reshape(-1)), _END + CHECKSUM_BYTES - FIRST  # type: ignore[arg-type]
        starts = range(FIRST, vehicles * _ROW_BYTES, _ROW_BYTES)
        self._frames: Final = [data[start : start + length].toreadonly() for start in starts]

    def at(
        self, time_us: int, accel_frd_m_s2: Array, gyro_frd_rad_s: Array, sequence: int
    ) -> list[memoryview]:
        """Return the frames of samples (n, 3) and (n, 3), all with the same time and sequence number.

        They are valid until the next call.
        """
        write_inertial(self._rows, time_us, sequence, accel_frd_m_s2, gyro_frd_rad_s)
        return self._frames


@njit(cache=True)
def write_inertial(
    rows: Octets, time_us: int, sequence: int, accel_frd_m_s2: Array, gyro_frd_rad_s: Array
) -> None:
    """Update frames of HIL_SENSOR, which begin at `frame.FIRST`: time, samples, sequence and checksum."""
    for i in range(len(rows)):
        row = rows[i]
        row[PAYLOAD:_SAMPLES].view(np.int64)[0] = time_us
        samples = row[_SAMPLES:_REST].view(np.float32)
        for axis in range(3):
            samples[axis] = accel_frd_m_s2[i, axis]
            samples[3 + axis] = gyro_frd_rad_s[i, axis]
        seal(row, sequence, _SENSOR_EXTRA)
