"""When the formation sets off: an agreement without a leader, over beacons that may be lost.

Every beacon carries its sender's phase and the start time that the sender holds. Whoever is on station, hears
at least half of the formation but nobody who is still on the way, and holds no time, proposes one, ahead by a
lead that is long against the time that a beacon takes to get through. Proposals that cross are settled by the
latest (max-consensus), as long as it lies in the future. Whoever holds none, or one still to come, follows
those who have set off. Those who set off at different times, because a channel that was cut in the middle of
it kept them apart, go over to what most of them hold once they hear each other.
"""

from collections import Counter
from collections.abc import Mapping

from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation.model import CLOCK_TOLERANCE_US, SILENCE_US

LEAD_US = 2_000_000
"""Twenty beacons of each neighbour at 10 Hz: at 30 % loss a pair misses all with a chance of 3e-11."""
OLDEST_US = 3_600_000_000
"""No UAV flies for an hour; what is said to have begun before that is not true."""
SETTLED_US = 50_000
"""A time counts as begun at a neighbour whose beacon came so long after it: an older beacon may have been
overtaken by a later proposal."""
MOST_LEADS = 3
"""So many leads after the first proposal that it held a UAV sets off, whoever keeps proposing later times."""
STAYS_AWAY = frozenset({FlightPhase.YIELDED, FlightPhase.LANDED, FlightPhase.HELD})
"""Phases of a UAV that is not on its way to its place."""

Heard = tuple[FlightPhase, int | None, int]
"""Of a neighbour's newest beacon: phase, start time that it holds, when it was heard."""


class MotionStart:
    """One UAV's part in the agreement.

    Args:
        station: this UAV.
        stations: how many there are.
        lead_us: how far ahead a start is proposed.

    Attributes:
        start_us: the time held, a whole number of milliseconds; None before the first.

    """

    def __init__(self, station: int, stations: int, *, lead_us: int = LEAD_US) -> None:
        self.start_us: int | None = None
        self._others = frozenset(range(stations)) - {station}
        self._lead_us = lead_us
        self._first_us: int | None = None

    def update(self, now_us: int, *, on_station: bool, neighbours: Mapping[int, Heard]) -> int | None:
        """Return the start time held after what was heard by now; None while there is none.

        ``neighbours`` are those ever heard, by station; one silent for `SILENCE_US` neither counts nor
        blocks. Times that no honest UAV can hold are as none: farther ahead than a lead, before
        `OLDEST_US`, or begun by one who is not on station.
        """
        proposed_us: list[int] = []
        begun: Counter[int] = Counter()
        heard, ready = 0, on_station
        for station, (phase, start_us, heard_us) in neighbours.items():
            if station not in self._others or now_us - heard_us >= SILENCE_US:
                continue
            heard += 1
            ready = ready and (phase is FlightPhase.ON_STATION or phase in STAYS_AWAY)
            if start_us is None:
                continue
            if now_us < start_us <= now_us + self._lead_us + CLOCK_TOLERANCE_US:
                proposed_us.append(start_us)
            elif phase is FlightPhase.ON_STATION and self._can_have_begun(start_us, heard_us, now_us):
                begun[start_us] += 1
        if self.start_us is not None and self.start_us <= now_us:
            begun[self.start_us] += 1
        # One voice among several may be wrong.
        elif begun.total() < min(2, heard):
            begun.clear()
        if begun:
            # What most hold who have set off; of as many the latest, so that everybody chooses alike.
            self.start_us = max(begun, key=lambda start_us: (begun[start_us], start_us))
            return self.start_us
        enough = 2 * (heard + 1) >= len(self._others) + 1
        if self.start_us is None and not proposed_us and ready and enough:
            proposed_us.append((now_us + self._lead_us) // 1_000 * 1_000)
        for start_us in proposed_us:
            self._take(start_us)
        return self.start_us

    def _take(self, start_us: int) -> None:
        """Hold a proposal if it is later than what is held, and not by too much than the first."""
        if self._first_us is None:
            self._first_us = start_us
        if start_us <= self._first_us + MOST_LEADS * self._lead_us:
            self.start_us = start_us if self.start_us is None else max(self.start_us, start_us)

    @staticmethod
    def _can_have_begun(start_us: int, heard_us: int, now_us: int) -> bool:
        return max(now_us - OLDEST_US, 0) <= start_us <= heard_us - SETTLED_US
