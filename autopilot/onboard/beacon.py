"""The beacon: what every UAV broadcasts to the formation, and its bytes.

A beacon carries the sender's newest GPS position with the receiver's stated accuracy, what the sender
believes its receiver's error to be, its odometry, and the newest distance that it measured to each neighbour.
Repeating the newest values in every beacon makes one that is lost cost latency alone: the time stamps tell a
receiver what it has already used.

Odometry is the integral of the autopilot's velocity since the sender started, so the difference of any two
beacons of a sender is its displacement between them, however many were lost in between. Its down component
is the autopilot's barometric height.

Layout, little-endian, `HEADER_BYTES` + `RANGE_BYTES` per distance (79 + 11 n):

    u8 version   u8 station   u8 phase   u8 flags   u8 number of distances
    u32 seq   u64 time_us   3 f32 odometry_ned_m   3 f32 vel_ned_m_s
    u32 motion_start_ms   (flag 1)
    u32 fix_ms   3 f32 fix_ned_m   u16 fix_std_h_mm   u16 fix_std_v_mm   (flag 2)
    3 f32 gps_error_ned_m   u16 gps_error_std_mm   (flag 4)
    then each: u8 peer   u32 measured_ms   f32 distance_m   u16 std_mm

What has no flag is not known, and zeros stand in its place. Standard deviations saturate at 65.535 m. With
distances to all others a beacon has 156 bytes in a formation of eight and 244 in one of sixteen; where each
pair is measured by one of its ends, it has 123 or 167 at most.

Times are on the clock that the formation shares. Positions are NED from the site's origin.
"""

import struct

from msgspec import Struct

from autopilot.onboard.phases import Phase

VERSION = 3
_HEADER = struct.Struct("<BBBBBIQ3f3fII3fHH3fH")
_RANGE = struct.Struct("<BIfH")
HEADER_BYTES = _HEADER.size
RANGE_BYTES = _RANGE.size
MAX_RANGES = 126
"""Keeps a beacon within the 1472 bytes of UDP payload that fit one Ethernet frame."""
SEQ_MODULUS = 2**32
_HAS_START, _HAS_FIX, _HAS_GPS_ERROR = 1, 2, 4
_FLAGS = _HAS_START | _HAS_FIX | _HAS_GPS_ERROR
_FAR_M = 1e6
_FAR2_M2 = _FAR_M**2
"""No honest sender is farther from the site."""
_FAST2_M2_S2 = 30.0**2
"""No honest sender is faster."""
_NO_TIME_US = 2**63
_STD_MAX_M = 65.535
_PHASES = {int(phase): phase for phase in Phase}

Vector = tuple[float, float, float]


class Fix(Struct, frozen=True):
    """A GPS position of the antenna at ``time_ms``, the receiver's delay already taken off.

    ``std_h_m`` and ``std_v_m`` are the accuracy that the receiver states; None: it states none.
    """

    time_ms: int
    pos_ned_m: Vector
    std_h_m: float | None = None
    std_v_m: float | None = None


class GpsError(Struct, frozen=True):
    """What a UAV believes of its GPS receiver now: the fix less the true position.

    Said only while distances hold the sender's position, and that is what the formation goes by: a UAV of
    whom it is not heard may drift, and who has a height layer beside it goes there (`layers`). The numbers
    are for whoever else listens, to whom they make the sender's fixes right: where each estimates everybody's
    receivers itself, what another made of the same distances would be counted twice. Where each estimates
    those of its neighbourhood alone, they tell the others where the sender believes itself to be, and are
    horizontally of the newest fix itself (`common_frame`).
    """

    ned_m: Vector
    std_m: float
    """Of the error, horizontal, per axis, 0..65.535."""


class Distance(Struct, frozen=True):
    """A distance that the sender measured to ``peer``."""

    peer: int
    time_ms: int
    distance_m: float
    std_m: float
    """Of ``distance_m``, 0..65.535."""


class Beacon(Struct, frozen=True, kw_only=True):
    """One beacon; ``time_us`` is that of the odometry and the velocity."""

    station: int
    seq: int
    """Rises by one with each beacon of the sender, modulo `SEQ_MODULUS`."""
    time_us: int
    phase: Phase
    odometry_ned_m: Vector
    vel_ned_m_s: Vector
    motion_start_ms: int | None = None
    """When the formation begins to move, as far as the sender knows."""
    fix: Fix | None = None
    gps_error: GpsError | None = None
    """None: no distances hold the sender's position."""
    distances: tuple[Distance, ...] = ()


_NO_FIX = Fix(0, (0.0, 0.0, 0.0))
_NO_ERROR = GpsError((0.0, 0.0, 0.0), 0.0)


def encode(beacon: Beacon) -> bytes:
    """Bytes of a beacon.

    Raises struct.error for a number that its field cannot hold, ValueError for a standard deviation that is
    not a number and for more than `MAX_RANGES` distances.
    """
    if len(beacon.distances) > MAX_RANGES:
        raise ValueError(f"{len(beacon.distances)} distances do not fit a beacon")
    flags, start_ms, fix, error = 0, 0, _NO_FIX, _NO_ERROR
    if beacon.motion_start_ms is not None:
        flags, start_ms = flags | _HAS_START, beacon.motion_start_ms
    if beacon.fix is not None:
        flags, fix = flags | _HAS_FIX, beacon.fix
    if beacon.gps_error is not None:
        flags, error = flags | _HAS_GPS_ERROR, beacon.gps_error
    parts = [
        _HEADER.pack(
            VERSION, beacon.station, beacon.phase, flags, len(beacon.distances),
            beacon.seq, beacon.time_us, *beacon.odometry_ned_m, *beacon.vel_ned_m_s, start_ms,
            fix.time_ms, *fix.pos_ned_m, _stated_mm(fix.std_h_m), _stated_mm(fix.std_v_m),
            *error.ned_m, _mm(error.std_m),
        )
    ]  # fmt: skip
    parts += [
        _RANGE.pack(item.peer, item.time_ms, item.distance_m, _mm(item.std_m)) for item in beacon.distances
    ]
    return b"".join(parts)


def decode(buffer: bytes, *, distances: bool = True) -> Beacon | None:
    """Beacon in these bytes; None for another version or length, or what no sender would say.

    That is a number that cannot be, a phase or flag that does not exist, a distance to itself, and two to the
    same peer. Without ``distances`` those are not looked at, and none are given.
    """
    if (
        len(buffer) < HEADER_BYTES
        or buffer[0] != VERSION
        or len(buffer) != HEADER_BYTES + buffer[4] * RANGE_BYTES
    ):
        return None
    (
        _, station, phase_value, flags, _, seq, time_us,
        odo_n, odo_e, odo_d, vel_n, vel_e, vel_d, start_ms,
        fix_ms, fix_n, fix_e, fix_d, std_h_mm, std_v_mm, err_n, err_e, err_d, err_mm,
    ) = _HEADER.unpack_from(buffer)  # fmt: skip
    phase = _PHASES.get(phase_value)
    size2 = (
        odo_n * odo_n + odo_e * odo_e + odo_d * odo_d + fix_n * fix_n + fix_e * fix_e + fix_d * fix_d
        + err_n * err_n + err_e * err_e + err_d * err_d
    )  # fmt: skip
    speed2 = vel_n * vel_n + vel_e * vel_e + vel_d * vel_d
    if (
        phase is None
        or flags > _FLAGS
        or time_us >= _NO_TIME_US
        or not (size2 < _FAR2_M2 and speed2 <= _FAST2_M2_S2)  # NaN is below nothing
    ):
        return None
    measured = _distances(buffer, station) if distances else ()
    if measured is None:
        return None
    fix = None
    if flags & _HAS_FIX:
        fix = Fix(fix_ms, (fix_n, fix_e, fix_d), std_h_mm * 1e-3 or None, std_v_mm * 1e-3 or None)
    return Beacon(
        station=station, seq=seq, time_us=time_us, phase=phase,
        odometry_ned_m=(odo_n, odo_e, odo_d), vel_ned_m_s=(vel_n, vel_e, vel_d),
        motion_start_ms=start_ms if flags & _HAS_START else None,
        fix=fix,
        gps_error=GpsError((err_n, err_e, err_d), err_mm * 1e-3) if flags & _HAS_GPS_ERROR else None,
        distances=measured,
    )  # fmt: skip


def _distances(buffer: bytes, station: int) -> tuple[Distance, ...] | None:
    """Distances after the header of a beacon of ``station``; None for what no sender would say."""
    found = []
    seen = 1 << station
    for peer, time_ms, distance_m, std_mm in _RANGE.iter_unpack(buffer[HEADER_BYTES:]):
        if not -_FAR_M < distance_m < _FAR_M or seen >> peer & 1:
            return None
        seen |= 1 << peer
        found.append(Distance(peer, time_ms, distance_m, std_mm * 1e-3))
    return tuple(found)


def _mm(std_m: float) -> int:
    return round(min(std_m, _STD_MAX_M) * 1e3)


def _stated_mm(std_m: float | None) -> int:
    """Zero says that nothing is stated, so what is stated is 1 mm at the least."""
    return 0 if std_m is None else max(_mm(std_m), 1)
