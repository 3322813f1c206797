"""Encodes MAVLink messages of one kind for all vehicles at once.

A message is a row of a NumPy structured array (`autopilot.mavlink.hil_schema`). The columns are filled for
all vehicles together, and one kernel packs the rows into frames. `autopilot.mavlink.hil` specifies the
framing of a payload; the vehicles' codec, which decodes these frames, is an independent implementation.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.mavlink.frame import (
    CHECKSUM_BYTES,
    FIRST,
    HEADER,
    HEADER_BYTES,
    HEADER_STRUCT,
    MAGIC,
    PAYLOAD,
    Octets,
    checksum,
    seal,
)
from autopilot.mavlink.hil_schema import HIL_SENSOR, MessageSchema
from foundation.kernels.inner import constant
from foundation.types import Array

SIMULATOR_SYSTEM_ID = 0
SIMULATOR_COMPONENT_ID = 1


def encode_rows(schema: MessageSchema, rows: NDArray[np.void], sequence: int) -> list[bytes]:
    """Return the frames of rows (n,) of ``schema.dtype``, all with the same sequence number."""
    header = HEADER_STRUCT.pack(
        MAGIC, 0, 0, 0, sequence, SIMULATOR_SYSTEM_ID, SIMULATOR_COMPONENT_ID, schema.message_id, 0
    )
    n, size, longest = len(rows), schema.payload_bytes, schema.frame_bytes
    frames = np.empty((n, longest), dtype=np.uint8)
    lengths = np.empty(n, dtype=np.int64)
    payloads = rows.view(np.uint8).reshape(n, size)
    make_frames(np.frombuffer(header, dtype=np.uint8), schema.crc_extra, payloads, frames, lengths)
    data = frames.tobytes()
    starts = range(0, n * longest, longest)
    return [data[start : start + length] for start, length in zip(starts, lengths.tolist(), strict=True)]


_AFTER_MAGIC = constant(1)


@njit(cache=True)
def make_frames(
    header: Octets, crc_extra: int, payloads: Octets, frames: Octets, lengths: NDArray[np.int64]
) -> None:
    """Write the frames (n, size + 12) of payloads (n, size), and their lengths (n,).

    ``header`` (10,) is complete except for the payload's length. Trailing zeros of a payload are truncated;
    its first byte is kept.
    """
    for row in range(payloads.shape[0]):
        frame = frames[row]
        length = payloads.shape[1]
        while length > 1 and payloads[row, length - 1] == 0:
            length -= 1
        end = HEADER_BYTES + length
        for at in range(HEADER_BYTES):
            frame[at] = header[at]
        frame[:HEADER_BYTES].view(HEADER)[0]["length"] = length
        for at in range(length):
            frame[HEADER_BYTES + at] = payloads[row, at]
        crc = checksum(frame, _AFTER_MAGIC, end, crc_extra)
        frame[end] = crc & 0xFF
        frame[end + 1] = crc >> 8
        lengths[row] = end + CHECKSUM_BYTES


_SENSOR, _SENSOR_EXTRA = HIL_SENSOR.dtype, constant(HIL_SENSOR.crc_extra)
_SENSOR_END = PAYLOAD + HIL_SENSOR.payload_bytes
_END = PAYLOAD + HIL_SENSOR.offset("fields_updated") + 1
"""End of HIL_SENSOR's payload if ``fields_updated`` is below 256: all later bytes are zero."""
_ROW_BYTES = 88
"""Multiple of 8, so that all payloads are aligned"""


class InertialFrames:
    """HIL_SENSOR for n vehicles with accelerations and angular rates only, as in most steps.

    The frames use the same memory in every step, so nothing is allocated or copied.
    """

    def __init__(self, vehicles: int, fields_updated: int) -> None:
        self.vehicles: Final = vehicles
        self._rows = np.zeros((vehicles, _ROW_BYTES), dtype=np.uint8)
        header = self._rows[:, FIRST:PAYLOAD].view(HEADER)
        header["magic"], header["length"] = MAGIC, _END - PAYLOAD
        header["system"], header["component"] = SIMULATOR_SYSTEM_ID, SIMULATOR_COMPONENT_ID
        header["message_id"] = HIL_SENSOR.message_id
        self._rows[:, PAYLOAD:_SENSOR_END].view(_SENSOR)["fields_updated"] = fields_updated
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
def write_samples(sensor: NDArray[np.void], accel_frd_m_s2: Array, gyro_frd_rad_s: Array) -> None:
    """Write acceleration and body rates (3,) each into a record of HIL_SENSOR."""
    sensor["xacc"], sensor["yacc"], sensor["zacc"] = accel_frd_m_s2[0], accel_frd_m_s2[1], accel_frd_m_s2[2]
    sensor["xgyro"], sensor["ygyro"], sensor["zgyro"] = (
        gyro_frd_rad_s[0],
        gyro_frd_rad_s[1],
        gyro_frd_rad_s[2],
    )


@njit(cache=True)
def write_inertial(
    rows: Octets, time_us: int, sequence: int, accel_frd_m_s2: Array, gyro_frd_rad_s: Array
) -> None:
    """Update frames of HIL_SENSOR, which begin at `frame.FIRST`: time, samples, sequence and checksum."""
    for i in range(len(rows)):
        row = rows[i]
        sensor = row[PAYLOAD:_SENSOR_END].view(_SENSOR)[0]
        sensor["time_usec"] = time_us
        write_samples(sensor, accel_frd_m_s2[i], gyro_frd_rad_s[i])
        seal(row, sequence, _SENSOR_EXTRA)
