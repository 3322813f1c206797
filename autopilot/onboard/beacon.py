"""The beacon: what every UAV broadcasts to the formation, and its bytes.

A beacon carries the sender's newest GPS position, its odometry, and the newest distance that it measured to
each neighbour. Repeating the newest values in every beacon makes one that is lost cost latency alone: the
time stamps tell a receiver what it has already used.

Odometry is the integral of the autopilot's velocity since the sender started, so the difference of any two
beacons of a sender is its displacement between them, however many were lost in between. Its down component
is the autopilot's barometric height.

Layout, little-endian, `HEADER_BYTES` + `RANGE_BYTES` per distance (51 + 11 n: 128 bytes in a formation of
eight):

    u8 version   u8 station   u8 number of distances
    u64 time_us   3 f32 odometry_ned_m   3 f32 vel_ned_m_s
    u32 fix_ms (2^32 - 1: none)   3 f32 fix_ned_m
    then each: u8 peer   u32 measured_ms   f32 distance_m   u16 std_mm

Times are on the clock that the formation shares. Positions are NED from the site's origin.
"""

import struct

from msgspec import Struct

VERSION = 2
_HEADER = struct.Struct("<BBBQ3f3fI3f")
_RANGE = struct.Struct("<BIfH")
HEADER_BYTES = _HEADER.size
RANGE_BYTES = _RANGE.size
MAX_RANGES = 127
"""Keeps a beacon within one Ethernet frame."""
_NO_FIX = 2**32 - 1
_FAR_M = 1e6
"""No honest sender is farther from the site, or faster in m/s."""

Vector = tuple[float, float, float]


class Fix(Struct, frozen=True):
    """A GPS position of the antenna at ``time_ms``, the receiver's delay already taken off."""

    time_ms: int
    pos_ned_m: Vector


class Distance(Struct, frozen=True):
    """A distance that the sender measured to ``peer``."""

    peer: int
    time_ms: int
    distance_m: float
    std_m: float
    """Of ``distance_m``, 0..65.535."""


class Beacon(Struct, frozen=True):
    """One beacon; ``time_us`` is that of the odometry and the velocity."""

    station: int
    time_us: int
    odometry_ned_m: Vector
    vel_ned_m_s: Vector
    fix: Fix | None
    distances: tuple[Distance, ...]


def encode(beacon: Beacon) -> bytes:
    """Bytes of a beacon.

    Raises struct.error for a number that its field cannot hold, ValueError for more than `MAX_RANGES`
    distances.
    """
    if len(beacon.distances) > MAX_RANGES:
        raise ValueError(f"{len(beacon.distances)} distances do not fit a beacon")
    fix = beacon.fix or Fix(_NO_FIX, (0.0, 0.0, 0.0))
    parts = [
        _HEADER.pack(
            VERSION, beacon.station, len(beacon.distances),
            beacon.time_us, *beacon.odometry_ned_m, *beacon.vel_ned_m_s, fix.time_ms, *fix.pos_ned_m,
        )
    ]  # fmt: skip
    parts += [
        _RANGE.pack(item.peer, item.time_ms, item.distance_m, min(round(item.std_m * 1e3), 0xFFFF))
        for item in beacon.distances
    ]
    return b"".join(parts)


def decode(buffer: bytes) -> Beacon | None:
    """Beacon in these bytes; None for another version or length, or a number that cannot be."""
    if (
        len(buffer) < HEADER_BYTES
        or buffer[0] != VERSION
        or len(buffer) != HEADER_BYTES + buffer[2] * RANGE_BYTES
    ):
        return None
    _, station, _, time_us, *numbers = _HEADER.unpack_from(buffer)
    odo_n, odo_e, odo_d, vel_n, vel_e, vel_d, fix_ms, fix_n, fix_e, fix_d = numbers
    size = sum(map(abs, (odo_n, odo_e, odo_d, vel_n, vel_e, vel_d, fix_n, fix_e, fix_d)))
    if time_us >= 2**63 or not size < _FAR_M:  # NaN is not below anything
        return None
    fix = None if fix_ms == _NO_FIX else Fix(fix_ms, (fix_n, fix_e, fix_d))
    distances = []
    for peer, time_ms, distance_m, std_mm in _RANGE.iter_unpack(buffer[HEADER_BYTES:]):
        if not abs(distance_m) < _FAR_M:
            return None
        distances.append(Distance(peer, time_ms, distance_m, std_mm * 1e-3))
    return Beacon(station, time_us, (odo_n, odo_e, odo_d), (vel_n, vel_e, vel_d), fix, tuple(distances))
