"""Table of the newest beacon of every station, and the kernels that update it.

Beacons are the most frequent input of an application, and in a large formation most of them come from
stations that it does not localise. The table is therefore one array with a row per station, and compiled code
reads beacons directly from their bytes. `localisation` uses the remaining content, of neighbours only.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.client.own_state import Fix
from autopilot.onboard.formation.motion import NeighbourReport
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation.model import CLOCK_TOLERANCE_US, SILENCE_US
from autopilot.onboard.radio.beacon import (
    HAS_FIX,
    HAS_GPS_ERROR,
    HAS_START,
    SEQ_MODULUS,
    BeaconBuffer,
    GpsError,
    PageRows,
    is_credible,
)
from autopilot.onboard.radio.neighbourhood import Neighbourhood

WAIT_US = 1_000_000
"""Longest delay of a beacon's reception after its due time, which follows from its sequence number."""
SHIFTS = 2
"""Further tolerance of sequence numbers: the random shifts of two beacons, and a fraction of a period."""

STATION = np.dtype(
    [
        ("heard_us", "i8"),  # reception of the last beacon; -1 before the first
        ("seq", "i8"),  # of the newest beacon, and the time that it states
        ("told_us", "i8"),
        ("start_us", "i8"),  # start of the formation's motion that it holds, or -1
        ("held_us", "i8"),  # reception of its last GPS error, which it reports only with support by distances
        # its newest fix and its error, horizontally, and the variance that its receiver states
        ("located_us", "i8"),  # reception of that report; -1 before the first
        ("fix_us", "i8"),
        ("fix_ne_m", "f8", 2),
        ("error_ne_m", "f8", 2),
        ("variance_m2", "f8"),
        ("phase", "u1"),
    ],
    align=True,
)
"""Record of a station."""
Stations = NDArray[np.void]
"""(N,) array of `STATION`."""
LISTENER = np.dtype(
    [
        ("station", "i8"),
        ("period_us", "i8"),  # beacon period of the formation
        ("periods_off", "f8"),  # tolerance of sequence numbers
        ("gps_var_m2", "f8"),  # least variance of GPS errors
        ("bad", "i8"),
        ("missed", "i8"),
        ("at", "i8"),  # page being processed
        ("is_open", "i8"),  # that page has been received, but its content has not been used completely
    ],
    align=True,
)
"""Record of the receiving station."""
Listener = NDArray[np.void]
"""(1,) array of `LISTENER`."""
Rows = NDArray[np.int64]
"""(N,) row of every station in the neighbourhood's arrays, -1: not a member."""
REFUSED, RECEIVED, RESTARTED = 0, 1, 2
"""Outcomes of `receive_beacon`."""
MOST_PAGES = 32
"""Pages per processing run; of 64 UAVs with five beacons per second, 13 beacons arrive in a loop of 40 ms."""


@njit(cache=True, inline="always")
def row_of(page: np.void, rows: Rows) -> int:
    """Return the row of the sender of a page, or -1."""
    source = page["source"]
    return rows[source] if source < rows.size else -1


@njit(cache=True)
def receive_beacon(page: np.void, now_us: int, listener: Listener, stations: Stations, rows: Rows) -> int:
    """Update the table by a page, if it is a valid beacon of its sender; otherwise returns REFUSED.

    Returns RESTARTED if the sender, and thus its odometry, has restarted since its last beacon: the sequence
    number does not match the number of periods in between. Distances are checked only for senders with a row.
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
    outcome, newest = RECEIVED, True
    if sender["heard_us"] >= 0:
        gap = (seq - sender["seq"]) % SEQ_MODULUS
        # The sender has numbered a beacon per period, lost or not: the formation has one beacon period.
        periods = (now_us - sender["heard_us"]) / me["period_us"]
        if abs(gap - periods) <= me["periods_off"]:
            if gap > 1:
                me["missed"] += gap - 1
        elif time_us > sender["told_us"]:
            outcome = RESTARTED
        else:  # overtaken by a later beacon, which has counted it as missed
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
    return outcome


@njit(cache=True)
def receive_beacons(
    count: int, now_us: int, pages: PageRows, listener: Listener, stations: Stations, rows: Rows
) -> None:
    """Update the table by ``count`` pages."""
    for k in range(count):
        receive_beacon(pages[k], now_us, listener, stations, rows)


@njit(cache=True)
def all_held(stations: Stations, chosen: NDArray[np.int64], since_us: int) -> bool:
    """Return whether all ``chosen`` stations that fly have reported support by distances since a time."""
    for station in chosen:
        other = stations[station]
        flies = FlightPhase.TAKE_OFF <= other["phase"] < FlightPhase.LANDED
        if flies and other["held_us"] <= since_us:
            return False
    return True


class NeighbourTable:
    """Newest beacons of all N stations, as received by one station.

    All have the beacon period ``period_us``. ``gps_std_m`` is the least standard deviation of GPS errors, per
    horizontal axis. Distances are used that are reported by UAVs of ``near``; None: by all stations.
    """

    def __init__(
        self, *, station: int, stations: int, period_us: int, gps_std_m: float,
        near: Neighbourhood | None = None,
    ) -> None:  # fmt: skip
        self.pages = BeaconBuffer(MOST_PAGES)
        """Received beacons that have not been processed."""
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
        """Process all pages without localisation."""
        pages = self.pages
        receive_beacons(pages.count, now_us, pages.rows, self.listener, self.stations, self.rows)
        pages.count = 0

    @property
    def sender_row(self) -> int:
        """Row of the sender of the page being processed."""
        source = self.pages.rows["source"][self.listener["at"].item()]
        return int(self.rows[source])

    def note_fix(self, station: int, fix: Fix, error: GpsError, now_us: int) -> None:
        """Store the newest fix of a station, which may be the own one, and its reported error."""
        row, std_m = self.stations[station], fix.std_h_m or 0.0
        row["located_us"], row["fix_us"] = now_us, fix.time_ms * 1_000
        row["fix_ne_m"], row["error_ne_m"] = fix.pos_ned_m[:2], error.ned_m[:2]
        row["variance_m2"] = max(std_m * std_m, self.listener["gps_var_m2"].item())

    def reaches(self, station: int, now_us: int) -> bool:
        """Return whether a beacon of a station has been received within `SILENCE_US`."""
        heard_us = self.stations["heard_us"].item(station)
        return bool(heard_us >= 0 and now_us - heard_us < SILENCE_US)

    def neighbours(self) -> dict[int, NeighbourReport]:
        """Return the newest report of each station received so far, for the agreement on the start."""
        columns = (self.stations[name].tolist() for name in ("phase", "start_us", "heard_us"))
        return {
            station: (FlightPhase(phase), None if start_us < 0 else start_us, heard_us)
            for station, (phase, start_us, heard_us) in enumerate(zip(*columns, strict=True))
            if heard_us >= 0
        }

    def all_held(self, chosen: NDArray[np.int64], since_us: int) -> bool:
        """Return whether all ``chosen`` stations that fly have reported support since a time."""
        return bool(all_held(self.stations, chosen, since_us))

    @property
    def bad_beacons(self) -> int:
        """Number of datagrams that were not a valid beacon."""
        return int(self.listener["bad"].item())

    @property
    def beacons_missed(self) -> int:
        """Number of beacons missing in the sequence numbers of the received ones."""
        return int(self.listener["missed"].item())
