"""The beacon that every UAV broadcasts to the formation: its content and its encoding.

A beacon carries the sender's newest GPS position with the accuracy that the receiver states, the estimated
error of that receiver, the sender's odometry, and the newest distance that it measured to each neighbour. The
newest values are repeated in every beacon, so that a lost beacon costs latency only: receivers skip values
that they have already used by their time stamps. Odometry is the integral of the autopilot's velocity since
the sender started; its down component is the height above the ground (`height`).

The layout is `HEADER`, then `RANGE` for each distance: 79 + 11 n bytes. Start, fix and GPS error have flags
(`HAS_START`); without its flag a field is unknown and contains zeros. Standard deviations saturate at 65.535
m. With distances to all others a beacon has 156 bytes in a formation of eight and 244 in one of sixteen. If
each pair is measured by one of its ends only, it has at most 123 or 167 bytes. Times are on the clock that
the formation shares. Positions are NED from the site's origin.
"""

import struct
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.formation.phases import FlightPhase
from foundation.types import Vector

VERSION = 3
HEADER = np.dtype(
    [
        ("version", "u1"), ("station", "u1"), ("phase", "u1"), ("flags", "u1"), ("count", "u1"),
        ("seq", "<u4"), ("time_us", "<u8"),
        ("odometry_n_m", "<f4"), ("odometry_e_m", "<f4"), ("odometry_d_m", "<f4"),
        ("vel_n_m_s", "<f4"), ("vel_e_m_s", "<f4"), ("vel_d_m_s", "<f4"),
        ("motion_start_ms", "<u4"),
        ("fix_ms", "<u4"), ("fix_n_m", "<f4"), ("fix_e_m", "<f4"), ("fix_d_m", "<f4"),
        ("fix_std_h_mm", "<u2"), ("fix_std_v_mm", "<u2"),
        ("error_n_m", "<f4"), ("error_e_m", "<f4"), ("error_d_m", "<f4"), ("error_std_mm", "<u2"),
    ]
)  # fmt: skip
"""Layout of a beacon's header for compiled code, without padding."""
RANGE = np.dtype([("peer", "u1"), ("time_ms", "<u4"), ("distance_m", "<f4"), ("std_mm", "<u2")])
"""Layout of each distance in a beacon."""
_HEADER = struct.Struct("<BBBBBIQ3f3fII3fHH3fH")
_RANGE = struct.Struct("<BIfH")
HEADER_BYTES = HEADER.itemsize
RANGE_BYTES = RANGE.itemsize
MAX_RANGES = 126
"""Keeps a beacon within the 1472 bytes of UDP payload that fit one Ethernet frame."""
SEQ_MODULUS = 2**32
HAS_START, HAS_FIX, HAS_GPS_ERROR = 1, 2, 4
_FLAGS = HAS_START | HAS_FIX | HAS_GPS_ERROR
_FAR_M = 1e6
_FAR2_M2 = _FAR_M**2
"""Square of the largest valid distance from the site's origin."""
_FAST2_M2_S2 = 30.0**2
"""Square of the largest valid speed, 30 m/s."""
_NO_TIME_US = 2**63
MOST_MM = 65_535
"""Accuracies of this or more are sent as this."""
_STD_MAX_M = MOST_MM / 1e3
_LAST_PHASE = max(int(phase) for phase in FlightPhase)
_CAPACITY = HEADER_BYTES + MAX_RANGES * RANGE_BYTES
PAGE = np.dtype([("source", "<i8"), ("size", "<i8"), ("header", HEADER), ("ranges", RANGE, MAX_RANGES)])
"""A datagram: its source station, its size in bytes, and the bytes. The rest of the page is undefined."""
PageRows = NDArray[np.void]
"""(P,) array of `PAGE`."""
_PAGE_BYTES = PAGE.itemsize


class GpsError(Struct, frozen=True):
    """Estimated error of a UAV's GPS receiver: the fix minus the true position.

    It is sent only while distances support the sender's position: near a UAV that stops sending it, UAVs move
    to their height layers (`height_layers`). Its values are used in a formation of several neighbourhoods
    only, where they give the sender's estimated position and the horizontal error is that of the newest fix
    itself (`common_frame`). In a single neighbourhood using them would count the same distances twice.
    """

    ned_m: Vector
    std_m: float
    """Standard deviation of the error, horizontal, per axis, 0..65.535."""


class Distance(Struct, frozen=True):
    """A distance that the sender measured to ``peer``."""

    peer: int
    time_ms: int
    distance_m: float
    std_m: float
    """Standard deviation of ``distance_m``, 0..65.535."""


_NO_FIX = Fix(0, (0.0, 0.0, 0.0))
_NO_ERROR = GpsError((0.0, 0.0, 0.0), 0.0)


def encode_with(
    distances: Sequence[bytes], station: int, seq: int, time_us: int, phase: FlightPhase,
    odometry_ned_m: Vector, vel_ned_m_s: Vector,
    motion_start_ms: int | None, fix: Fix | None, gps_error: GpsError | None,
) -> bytes:  # fmt: skip
    """Return the bytes of a beacon, from encoded distances, which a sender reuses in many beacons.

    Raises struct.error for a number that its field cannot hold, ValueError for a standard deviation that is
    NaN and for more than `MAX_RANGES` distances.
    """
    if len(distances) > MAX_RANGES:
        raise ValueError(f"{len(distances)} distances do not fit a beacon")
    flags, start_ms = 0, 0
    if motion_start_ms is not None:
        flags, start_ms = HAS_START, motion_start_ms
    if fix is None:
        fix = _NO_FIX
    else:
        flags |= HAS_FIX
    if gps_error is None:
        gps_error = _NO_ERROR
    else:
        flags |= HAS_GPS_ERROR
    header = _HEADER.pack(
        VERSION, station, phase, flags, len(distances), seq, time_us, *odometry_ned_m, *vel_ned_m_s, start_ms,
        fix.time_ms, *fix.pos_ned_m, _stated_mm(fix.std_h_m), _stated_mm(fix.std_v_m),
        *gps_error.ned_m, _mm(gps_error.std_m),
    )  # fmt: skip
    return header + b"".join(distances)


def encode_distance(distance: Distance) -> bytes:
    """Return the bytes of a distance in a beacon; raises as `encode_with`."""
    return _RANGE.pack(distance.peer, distance.time_ms, distance.distance_m, _mm(distance.std_m))


class BeaconBuffer:
    """Buffer of received datagrams that compiled code reads in place: the first ``count`` of ``rows``."""

    def __init__(self, most: int) -> None:
        self.rows: PageRows = np.zeros(most, PAGE)
        self._most = most
        self.count = 0
        self._octets = self.rows.view(np.uint8).data
        self._layouts: dict[int, struct.Struct] = {}
        """Packing format of a page for each datagram size received so far: source, size, bytes."""

    def put(self, source: int, payload: bytes) -> bool:
        """Copy a station's datagram to the next page; of a datagram that is too long, only its size.

        Returns whether the buffer is full.
        """
        size = len(payload)
        layout = self._layouts.get(size)
        if layout is None:
            layout = struct.Struct(f"<qq{size if size <= _CAPACITY else 0}s")
            self._layouts[size] = layout
        layout.pack_into(self._octets, self.count * _PAGE_BYTES, source, size, payload)
        self.count += 1
        return self.count == self._most


@njit(cache=True)
def is_credible(page: np.void, with_ranges: bool) -> bool:  # noqa: FBT001
    """Return whether the bytes on a page are a valid beacon, with defined fields and possible numbers.

    The distances are checked if ``with_ranges``: one to the sender itself and two to the same peer are
    invalid.
    """
    size, header, ranges = page["size"], page["header"], page["ranges"]
    if size < HEADER_BYTES or header["version"] != VERSION:
        return False
    count = np.int64(header["count"])
    if count > MAX_RANGES or size != HEADER_BYTES + count * RANGE_BYTES:
        return False
    if header["phase"] > _LAST_PHASE or header["flags"] > _FLAGS or header["time_us"] >= _NO_TIME_US:
        return False
    odo_n, odo_e = np.float64(header["odometry_n_m"]), np.float64(header["odometry_e_m"])
    odo_d, fix_d = np.float64(header["odometry_d_m"]), np.float64(header["fix_d_m"])
    fix_n, fix_e = np.float64(header["fix_n_m"]), np.float64(header["fix_e_m"])
    err_n, err_e = np.float64(header["error_n_m"]), np.float64(header["error_e_m"])
    err_d, vel_d = np.float64(header["error_d_m"]), np.float64(header["vel_d_m_s"])
    vel_n, vel_e = np.float64(header["vel_n_m_s"]), np.float64(header["vel_e_m_s"])
    size2 = (
        odo_n * odo_n + odo_e * odo_e + odo_d * odo_d + fix_n * fix_n + fix_e * fix_e + fix_d * fix_d
        + err_n * err_n + err_e * err_e + err_d * err_d
    )  # fmt: skip
    speed2 = vel_n * vel_n + vel_e * vel_e + vel_d * vel_d
    if not (size2 < _FAR2_M2 and speed2 <= _FAST2_M2_S2):  # false for NaN
        return False
    if not with_ranges:
        return True
    for k in range(count):
        peer = ranges[k]["peer"]
        if not -_FAR_M < ranges[k]["distance_m"] < _FAR_M or peer == header["station"]:
            return False
        for before in range(k):
            if ranges[before]["peer"] == peer:
                return False
    return True


def _mm(std_m: float) -> int:
    return MOST_MM if std_m > _STD_MAX_M else round(std_m * 1e3)


def _stated_mm(std_m: float | None) -> int:
    """Return a stated accuracy in mm, at least 1; 0 means that none is stated."""
    return 0 if std_m is None else max(_mm(std_m), 1)
