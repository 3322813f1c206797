"""What was last heard of every station, and how a beacon that comes gets there.

Beacons are what an application gets most of, most of them in a large formation from stations that it does not
localise. So what is kept of all stations are rows of one array, and a beacon is read by compiled code from
where its bytes lie. What else is in it is for `localisation`, which is told of neighbours alone.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.formation.motion import Heard
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation.model import CLOCK_TOLERANCE_US, SILENCE_US
from autopilot.onboard.radio.beacon import (
    HAS_FIX,
    HAS_GPS_ERROR,
    HAS_START,
    SEQ_MODULUS,
    BeaconBuffer,
    Fix,
    GpsError,
    PageRows,
    is_credible,
)
from autopilot.onboard.radio.neighbourhood import Neighbourhood

WAIT_US = 1_000_000
"""A beacon is received within this after it was due; its number tells when that was."""
SHIFTS = 2
"""Beacons by which numbers may be off besides: both ends' random shifts, and a period that is not whole."""

STATION = np.dtype(
    [
        ("heard_us", "i8"),  # the last beacon; -1 before the first
        ("seq", "i8"),  # of the newest, with the time in it
        ("told_us", "i8"),
        ("start_us", "i8"),  # of the formation's motion as it holds it, or -1
        ("held_us", "i8"),  # when it last knew its GPS error, which takes distances that hold its position
        # its newest fix and the error of that, horizontally, and the variance that its receiver states
        ("located_us", "i8"),  # when it said so; -1 before the first time
        ("fix_us", "i8"),
        ("fix_ne_m", "f8", 2),
        ("error_ne_m", "f8", 2),
        ("variance_m2", "f8"),
        ("phase", "u1"),
    ],
    align=True,
)
"""What is kept of a station."""
Stations = NDArray[np.void]
"""(N,) of `STATION`"""
LISTENER = np.dtype(
    [
        ("station", "i8"),
        ("period_us", "i8"),
        ("periods_off", "f8"),
        ("gps_var_m2", "f8"),
        ("bad", "i8"),
        ("heard", "i8"),
        ("missed", "i8"),
        ("at", "i8"),
        ("is_open", "i8"),
    ],
    align=True,
)
"""Who listens: its number, the formation's beacon period, by how many periods numbers may be off, what errors
of GPS are taken to be at least, and counts; of the pages to be gone through, which one it is at, and whether
that has been heard, but not all of it been made use of."""
Listener = NDArray[np.void]
"""(1,) of `LISTENER`"""
Rows = NDArray[np.int64]
"""(N,) rows of all stations among those whose distances are looked at, -1 of those that have none"""
REFUSED, HEARD, BEGUN_ANEW = 0, 1, 2
MOST_PAGES = 32
"""Of one reading; of 64 UAVs whose beacons come five times a second, 13 are heard in a loop of 40 ms."""


@njit(cache=True)
def row_of(page: np.void, rows: Rows) -> int:
    """Row of who has sent what is on a page, or -1."""
    source = page["source"]
    return rows[source] if source < rows.size else -1


@njit(cache=True)
def receive_beacon(page: np.void, now_us: int, listener: Listener, stations: Stations, rows: Rows) -> int:
    """Take what is on a page, if it is a beacon of who has sent it.

    Gives REFUSED if it is not, BEGUN_ANEW if the sender has begun anew since the beacon before, and its
    odometry with it: it has not numbered as many as there were periods in between. Else HEARD. The distances
    are looked at of those alone who have a row.
    """
    me, header, source = listener[0], page["header"], page["source"]
    if source >= stations.size or source == me["station"]:
        me["bad"] += 1
        return REFUSED
    sender = stations[source]
    if not is_credible(page, with_ranges=rows[source] >= 0) or header["station"] != source:
        me["bad"] += 1
        return REFUSED
    time_us, seq = np.int64(header["time_us"]), np.int64(header["seq"])
    if time_us > now_us + CLOCK_TOLERANCE_US:
        me["bad"] += 1
        return REFUSED
    me["heard"] += 1
    found, newest = HEARD, True
    if sender["heard_us"] >= 0:
        gap = (seq - sender["seq"]) % SEQ_MODULUS
        # As many as there were periods, however many were lost: the formation has one beacon period.
        periods = (now_us - sender["heard_us"]) / me["period_us"]
        if abs(gap - periods) <= me["periods_off"]:
            if gap > 1:
                me["missed"] += gap - 1
        elif time_us > sender["told_us"]:
            found = BEGUN_ANEW
        else:  # overtaken by a later one, which has counted it as missed
            newest = False
    sender["heard_us"] = now_us
    if newest:
        sender["seq"], sender["told_us"] = seq, time_us
    flags = header["flags"]
    sender["phase"] = header["phase"]
    sender["start_us"] = np.int64(header["motion_start_ms"]) * 1_000 if flags & HAS_START else -1
    if flags & HAS_GPS_ERROR:
        sender["held_us"] = now_us
        if flags & HAS_FIX:
            sender["located_us"], sender["fix_us"] = now_us, np.int64(header["fix_ms"]) * 1_000
            fix_ne_m, error_ne_m = sender["fix_ne_m"], sender["error_ne_m"]
            fix_ne_m[0], fix_ne_m[1] = header["fix_n_m"], header["fix_e_m"]
            error_ne_m[0], error_ne_m[1] = header["error_n_m"], header["error_e_m"]
            std_m = np.int64(header["fix_std_h_mm"]) * 1e-3
            sender["variance_m2"] = max(std_m * std_m, me["gps_var_m2"])
    return found


@njit(cache=True)
def receive_beacons(
    count: int, now_us: int, pages: PageRows, listener: Listener, stations: Stations, rows: Rows
) -> None:
    """Take what is on ``count`` pages."""
    for k in range(count):
        receive_beacon(pages[k], now_us, listener, stations, rows)


@njit(cache=True)
def all_held(stations: Stations, whose: NDArray[np.int64], since_us: int) -> bool:
    """Whether distances have held the positions, since a time, of those of ``whose`` who fly."""
    for station in whose:
        other = stations[station]
        flies = FlightPhase.TAKE_OFF <= other["phase"] < FlightPhase.LANDED
        if flies and other["held_us"] <= since_us:
            return False
    return True


class NeighbourTable:
    """What one station hears.

    Args:
        station: this station.
        stations: how many there are.
        period_us: of everybody's beacons.
        gps_std_m: what errors of GPS are taken to be at least, per horizontal axis.
        near: of whose beacons it looks at the distances; None: everybody's.

    Attributes:
        pages: what has come and has not been read.
        stations: (N,) of `STATION`.
        listener: (1,) of `LISTENER`.
        rows: (N,) of all stations in the neighbourhood, -1 of those that are not in it.

    """

    def __init__(
        self,
        *,
        station: int,
        stations: int,
        period_us: int,
        gps_std_m: float,
        near: Neighbourhood | None = None,
    ) -> None:
        self.pages = BeaconBuffer(MOST_PAGES)
        self.stations: Stations = np.zeros(stations, STATION)
        for name in ("heard_us", "start_us", "located_us"):
            self.stations[name] = -1
        self.rows: Rows = np.arange(stations) if near is None else near.row_numbers
        self.listener: Listener = np.zeros(1, LISTENER)
        listener = self.listener[0]
        listener["station"], listener["period_us"] = station, period_us
        listener["periods_off"] = WAIT_US / period_us + SHIFTS
        listener["gps_var_m2"] = gps_std_m * gps_std_m

    def read(self, now_us: int) -> None:
        """Read all pages, for whoever localises nobody by them."""
        pages = self.pages
        receive_beacons(pages.count, now_us, pages.rows, self.listener, self.stations, self.rows)
        pages.count = 0

    @property
    def sender_row(self) -> int:
        """Row of the sender of the page that is open."""
        source = self.pages.rows["source"][self.listener["at"].item()]
        return int(self.rows[source])

    def note_fix(self, station: int, fix: Fix, error: GpsError, now_us: int) -> None:
        """Note of a station, the own one too, what it says of its newest fix."""
        row, std_m = self.stations[station], fix.std_h_m or 0.0
        row["located_us"], row["fix_us"] = now_us, fix.time_ms * 1_000
        row["fix_ne_m"], row["error_ne_m"] = fix.pos_ned_m[:2], error.ned_m[:2]
        row["variance_m2"] = max(std_m * std_m, self.listener["gps_var_m2"].item())

    def reaches(self, station: int, now_us: int) -> bool:
        """Whether a station has been heard of lately."""
        heard_us = self.stations["heard_us"].item(station)
        return bool(heard_us >= 0 and now_us - heard_us < SILENCE_US)

    def neighbours(self) -> dict[int, Heard]:
        """Those ever heard, by station, for the agreement on when the motion starts."""
        columns = (self.stations[name].tolist() for name in ("phase", "start_us", "heard_us"))
        return {
            station: (FlightPhase(phase), None if start_us < 0 else start_us, heard_us)
            for station, (phase, start_us, heard_us) in enumerate(zip(*columns, strict=True))
            if heard_us >= 0
        }

    def all_held(self, whose: NDArray[np.int64], since_us: int) -> bool:
        """Whether distances have held, since a time, those of ``whose`` (stations) who fly."""
        return bool(all_held(self.stations, whose, since_us))

    @property
    def bad_beacons(self) -> int:
        """Datagrams that were no beacon, or one that contradicts itself."""
        return int(self.listener["bad"].item())

    @property
    def beacons_heard(self) -> int:
        """Beacons so far."""
        return int(self.listener["heard"].item())

    @property
    def beacons_missed(self) -> int:
        """Of those that stations heard so far have numbered."""
        return int(self.listener["missed"].item())
