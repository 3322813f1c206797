"""Beacons as records: what the application packs and reads field by field."""

from msgspec import Struct

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.radio import beacon as wire
from foundation.types import Vector


class Beacon(Struct, frozen=True, kw_only=True):
    """One beacon; ``time_us`` is that of the odometry and the velocity."""

    station: int
    seq: int
    """Sequence number: increases by one per beacon of the sender, modulo `beacon.SEQ_MODULUS`."""
    time_us: int
    phase: FlightPhase
    odometry_ned_m: Vector
    vel_ned_m_s: Vector
    motion_start_ms: int | None = None
    """Start of the formation's motion that the sender holds; None: none yet."""
    fix: Fix | None = None
    gps_error: wire.GpsError | None = None
    """None: no distances support the sender's position."""
    distances: tuple[wire.Distance, ...] = ()


def encode(beacon: Beacon) -> bytes:
    """Return the bytes of a beacon.

    Raises struct.error for a number that its field cannot hold, ValueError for a standard deviation that is
    NaN and for more than `MAX_RANGES` distances.
    """
    return wire.encode_with(
        [wire.encode_distance(item) for item in beacon.distances],
        beacon.station, beacon.seq, beacon.time_us, beacon.phase, beacon.odometry_ned_m, beacon.vel_ned_m_s,
        beacon.motion_start_ms, beacon.fix, beacon.gps_error,
    )  # fmt: skip


def decode(buffer: bytes) -> Beacon | None:
    """Return the beacon in these bytes; None if they are not valid (`is_credible`)."""
    pages = wire.BeaconBuffer(1)
    pages.put(0, buffer)
    page = pages.rows[0]
    if not wire.is_credible(page, with_ranges=True):
        return None
    (
        _, station, phase, flags, count, seq, time_us,
        odo_n, odo_e, odo_d, vel_n, vel_e, vel_d, start_ms,
        fix_ms, fix_n, fix_e, fix_d, std_h_mm, std_v_mm, err_n, err_e, err_d, err_mm,
    ) = page["header"].tolist()  # fmt: skip
    fix = None
    if flags & wire.HAS_FIX:
        fix = Fix(fix_ms, (fix_n, fix_e, fix_d), std_h_mm * 1e-3 or None, std_v_mm * 1e-3 or None)
    return Beacon(
        station=station, seq=seq, time_us=time_us, phase=FlightPhase(phase),
        odometry_ned_m=(odo_n, odo_e, odo_d), vel_ned_m_s=(vel_n, vel_e, vel_d),
        motion_start_ms=start_ms if flags & wire.HAS_START else None,
        fix=fix,
        gps_error=wire.GpsError((err_n, err_e, err_d), err_mm * 1e-3) if flags & wire.HAS_GPS_ERROR else None,
        distances=tuple(
            wire.Distance(peer, time_ms, distance_m, std_mm * 1e-3)
            for peer, time_ms, distance_m, std_mm in page["ranges"][:count].tolist()
        ),
    )  # fmt: skip
