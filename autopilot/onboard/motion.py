"""When the formation sets off: an agreement without a leader, over beacons that may be lost.

Every beacon carries its sender's phase and the start time that the sender holds. Whoever is on station, hears
nobody who is still on the way and holds no time proposes one, ahead by a lead that is long against the time
that a beacon takes to get through. Proposals that cross are settled by the latest (max-consensus), as long as
it lies in the future. A time that has come is never changed, and whoever holds none, or one still to come,
follows those who have set off. So UAVs agree unless one of them hears of the latest proposal from nobody,
directly or through others, for the rest of its lead.
"""

from collections import Counter
from collections.abc import Mapping

from autopilot.onboard.localisation import CLOCK_TOLERANCE_US
from autopilot.onboard.phases import Phase
from autopilot.onboard.traffic import SILENCE_US

LEAD_US = 2_000_000
"""Twenty beacons of each neighbour at 10 Hz: at 30 % loss a pair misses all with a chance of 3e-11."""
OLDEST_US = 3_600_000_000
"""No UAV flies for an hour; what is said to have begun before that is not true."""
SETTLED_US = 50_000
"""A time counts as begun at a neighbour whose beacon came so long after it: an older beacon may have been
overtaken by a later proposal."""
STAYS_AWAY = frozenset({Phase.YIELDED, Phase.LANDED})
"""Phases of a UAV that is not on its way to its place."""

Heard = tuple[Phase, int | None, int]
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

    def begun(self, now_us: int) -> bool:
        """Whether the time has come; from then on it stays."""
        return self.start_us is not None and self.start_us <= now_us

    def update(self, now_us: int, *, on_station: bool, neighbours: Mapping[int, Heard]) -> int | None:
        """Return the start time held after what was heard by now; None while there is none.

        ``neighbours`` are those ever heard, by station; one silent for `SILENCE_US` neither counts nor
        blocks. Times that no honest UAV can hold are as none: farther ahead than a lead, or before
        `OLDEST_US`.
        """
        if self.begun(now_us):
            return self.start_us
        latest_us = self.start_us
        begun: Counter[int] = Counter()
        ready = on_station
        for station, (phase, start_us, heard_us) in neighbours.items():
            if station not in self._others or now_us - heard_us >= SILENCE_US:
                continue
            ready = ready and (phase is Phase.ON_STATION or phase in STAYS_AWAY)
            if start_us is None:
                continue
            if now_us < start_us <= now_us + self._lead_us + CLOCK_TOLERANCE_US:
                latest_us = start_us if latest_us is None else max(latest_us, start_us)
            elif max(now_us - OLDEST_US, 0) <= start_us <= heard_us - SETTLED_US:
                begun[start_us] += 1
        if begun:
            # Most of those who have set off; of as many the latest, so that everybody chooses alike.
            self.start_us = max(begun, key=lambda start_us: (begun[start_us], start_us))
        elif latest_us is not None or not ready:
            self.start_us = latest_us
        else:
            self.start_us = (now_us + self._lead_us) // 1_000 * 1_000
        return self.start_us
