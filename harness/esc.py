"""What the vehicles' motor controllers report: ESC_STATUS, packed for all vehicles at once."""

from collections.abc import Iterator
from struct import Struct
from typing import NamedTuple

import numpy as np
from fastcrc import crc16

from autopilot.mavlink.dialect import ESC_STATUS, EscStatus
from autopilot.types import Array

PERIOD_US = 50_000
"""20 Hz"""
HOVER_CURRENT_A = 4.0
HOVER_SPEED_RAD_S = 806.7
"""Of the Iris: 3.8 N per rotor."""
RPM_PER_RAD_S = 60.0 / (2.0 * np.pi)

_HEADER = Struct("<BBBBBBBHB")
"""Magic, payload's length, incompatible and compatible flags, sequence, system, component, kind (24 bit)."""
_CHECKSUM = Struct("<H")
_MAGIC = 0xFD
_FIRST_CHECKED = 1
_NO_VOLTAGE = (0.0, 0.0, 0.0, 0.0)


class EscReadings(NamedTuple):
    """Of the four motors of each of n vehicles."""

    speed_rpm: Array
    """(n, 4), positive whichever way a rotor is meant to turn"""
    current_a: Array
    """(n, 4)"""


def readings(
    rotor_speed_rad_s: Array, effectiveness: Array | None = None, density_ratio: Array | None = None
) -> EscReadings:
    """Read motors that turn at (n, 4); of rotors (n, 4) that are not whole, None for whole ones.

    ``density_ratio`` (n,) is that of the air over sea level's, None for 1. A rotor's torque goes with the
    square of its speed, with its effectiveness and the density, and so its power, of which the current at the
    battery's voltage is made, with the cube.
    """
    current_a = HOVER_CURRENT_A * (rotor_speed_rad_s / HOVER_SPEED_RAD_S) ** 3
    if density_ratio is not None:
        current_a *= density_ratio[:, None]
    if effectiveness is not None:
        current_a *= effectiveness
    return EscReadings(rotor_speed_rad_s * RPM_PER_RAD_S, current_a)


def pack_escs(
    time_us: int, escs: EscReadings, *, sequence: int, system: int, component: int
) -> Iterator[bytes]:
    """Give a whole ESC_STATUS frame for one vehicle after the other; the voltage is 0, not known."""
    speeds_rpm: list[list[int]] = np.rint(escs.speed_rpm).astype(np.int64).tolist()
    currents_a: list[list[float]] = escs.current_a.tolist()
    crc_extra = bytes([EscStatus.crc_extra])
    for speed_rpm, current_a in zip(speeds_rpm, currents_a, strict=True):
        payload = (
            EscStatus.unpacker.pack(time_us, *speed_rpm, *_NO_VOLTAGE, *current_a, 0).rstrip(b"\0") or b"\0"
        )
        header = _HEADER.pack(_MAGIC, len(payload), 0, 0, sequence, system, component, ESC_STATUS, 0)
        frame = header + payload
        yield frame + _CHECKSUM.pack(crc16.mcrf4xx(frame[_FIRST_CHECKED:] + crc_extra))
