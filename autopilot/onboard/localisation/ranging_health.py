"""Whether distances hold a UAV's position, and those of the UAVs to whom it would have to give way."""

from collections.abc import Sequence

import numpy as np

from autopilot.onboard.formation.avoidance import FRESH_US
from autopilot.onboard.localisation.localisation import CooperativeLocalisation
from autopilot.onboard.radio.neighbour_table import NeighbourTable

MISSED_BEACONS = 5
"""So many without word of a position that is held, and it counts as held no longer."""


class Support:
    """That of one UAV.

    Args:
        localisation: the UAV's; None: it goes by something else, and no distances are asked for.
        hearing: what others say of theirs.
        watched: stations to whom it would have to give way, were they not held.
        range_silence_us: distances older than this hold nothing.
        beacon_period_us: of everybody.

    Attributes:
        holds: distances hold the own position, which is more than its GPS says of it.

    """

    def __init__(
        self,
        localisation: CooperativeLocalisation | None,
        hearing: NeighbourTable,
        *,
        watched: Sequence[int],
        range_silence_us: int,
        beacon_period_us: int,
    ) -> None:
        self.holds = False
        self._localisation = localisation
        self._hearing = hearing
        self._watched = np.array(watched, np.int64)
        self._range_silence_us = range_silence_us
        self._beacon_silence_us = max(FRESH_US, MISSED_BEACONS * beacon_period_us)

    def update(self, now_us: int) -> bool:
        """Judge by what the localisation knows now; gives whether that is otherwise than before."""
        before, localisation = self.holds, self._localisation
        if localisation is not None:
            range_us = localisation.own_range_us
            located = bool(localisation.located[localisation.own])
            self.holds = located and range_us >= 0 and now_us - range_us < self._range_silence_us
        return self.holds is not before

    def holds_all(self, now_us: int) -> bool:
        """Whether this UAV is held, and those watched who are in the air; true where nobody asks."""
        if self._localisation is None:
            return True
        if not self.holds or not self._watched.size:
            return self.holds
        return self._hearing.all_held(self._watched, now_us - self._beacon_silence_us)
