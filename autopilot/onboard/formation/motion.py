"""Leaderless agreement on the start time of the formation's motion, over beacons that may be lost.

Every beacon carries its sender's phase and the start time that the sender holds. A UAV proposes a start time
if it holds none, is on station, and receives beacons from at least half of the formation and from no UAV that
is still on its way. The proposal lies ahead by a lead that is long against the delay of a beacon. Of
concurrent proposals the latest wins (max-consensus), if it lies in the future. A UAV that holds no start
time, or a future one, adopts that of UAVs that have started. If a channel failure made UAVs start at
different times, they adopt the majority's time once they receive each other's beacons.
"""

from collections import Counter
from collections.abc import Mapping

from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation.model import CLOCK_TOLERANCE_US, SILENCE_US

LEAD_US = 2_000_000
"""Twenty beacons of each neighbour at 10 Hz: at 30 % loss a pair misses all with a chance of 3e-11."""
OLDEST_US = 3_600_000_000
"""Start times longer ago than this are rejected: no UAV flies for an hour."""
SETTLED_US = 50_000
"""A neighbour counts as started if its beacon was received this long after the start time."""
MOST_LEADS = 3
"""A UAV starts at most this many leads after the first proposal that it held, regardless of later ones."""
STAYS_AWAY = frozenset({FlightPhase.YIELDED, FlightPhase.LANDED, FlightPhase.HELD})
"""Phases of a UAV that is not on its way to its place."""

NeighbourReport = tuple[FlightPhase, int | None, int]
"""Content of a neighbour's newest beacon: phase, start time that it holds, time of reception."""


class MotionStart:
    """One UAV's part in the agreement among ``stations`` UAVs."""

    def __init__(self, station: int, stations: int) -> None:
        self.start_us: int | None = None
        """The start time held, a whole number of milliseconds; None before the first."""
        self._others = frozenset(range(stations)) - {station}
        self._first_us: int | None = None

    def update(
        self, now_us: int, *, on_station: bool, neighbours: Mapping[int, NeighbourReport]
    ) -> int | None:
        """Return the start time held after an update by the reports of all stations received so far.

        One silent for `SILENCE_US` neither counts nor blocks. Impossible start times are ignored: farther
        ahead than a lead, longer ago than `OLDEST_US`, or in the past and reported by a UAV that is not on
        station.
        """
        proposed_us: list[int] = []
        begun: Counter[int] = Counter()
        present, ready = 0, on_station
        for station, (phase, start_us, heard_us) in neighbours.items():
            if station not in self._others or now_us - heard_us >= SILENCE_US:
                continue
            present += 1
            ready = ready and (phase is FlightPhase.ON_STATION or phase in STAYS_AWAY)
            if start_us is None:
                continue
            if now_us < start_us <= now_us + LEAD_US + CLOCK_TOLERANCE_US:
                proposed_us.append(start_us)
            elif phase is FlightPhase.ON_STATION and self._can_have_begun(start_us, heard_us, now_us):
                begun[start_us] += 1
        if self.start_us is not None and self.start_us <= now_us:
            begun[self.start_us] += 1
        # A single report among several may be wrong.
        elif begun.total() < min(2, present):
            begun.clear()
        if begun:
            # The majority's time; the latest of equal counts, so that all UAVs choose the same.
            self.start_us = max(begun, key=lambda start_us: (begun[start_us], start_us))
            return self.start_us
        enough = 2 * (present + 1) >= len(self._others) + 1
        if self.start_us is None and not proposed_us and ready and enough:
            proposed_us.append((now_us + LEAD_US) // 1_000 * 1_000)
        for start_us in proposed_us:
            self._take(start_us)
        return self.start_us

    def _take(self, start_us: int) -> None:
        """Adopt a proposal if it is later than the time held, and not too long after the first one."""
        if self._first_us is None:
            self._first_us = start_us
        if start_us <= self._first_us + MOST_LEADS * LEAD_US:
            self.start_us = start_us if self.start_us is None else max(self.start_us, start_us)

    @staticmethod
    def _can_have_begun(start_us: int, heard_us: int, now_us: int) -> bool:
        return max(now_us - OLDEST_US, 0) <= start_us <= heard_us - SETTLED_US
