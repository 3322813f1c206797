"""Monitors whether distances support the position of a UAV, and of the UAVs that it must avoid."""

from collections.abc import Sequence

import numpy as np

from autopilot.onboard.formation.avoidance import FRESH_US
from autopilot.onboard.localisation.localisation import CooperativeLocalisation
from autopilot.onboard.radio.neighbour_table import NeighbourTable

MISSED_BEACONS = 5
"""A position counts as unsupported after this many beacon periods without a report of support."""


class Support:
    """Support of one UAV's position by distances; without localisation it does not use any.

    ``watched`` are the stations that this UAV must avoid by its height layer if they lose support. Distances
    older than ``range_silence_us`` give no support.
    """

    def __init__(
        self, localisation: CooperativeLocalisation | None, table: NeighbourTable, *,
        watched: Sequence[int], range_silence_us: int, beacon_period_us: int,
    ) -> None:  # fmt: skip
        self.holds = False
        """Distances support the own position, which is then better than GPS alone."""
        self._localisation = localisation
        self._table = table
        self._watched = np.array(watched, np.int64)
        self._range_silence_us = range_silence_us
        self._beacon_silence_us = max(FRESH_US, MISSED_BEACONS * beacon_period_us)

    def update(self, now_us: int) -> bool:
        """Update `holds` from the localisation; returns whether it has changed."""
        before, localisation = self.holds, self._localisation
        if localisation is not None:
            range_us = localisation.own_range_us
            located = bool(localisation.located[localisation.own])
            self.holds = located and range_us >= 0 and now_us - range_us < self._range_silence_us
        return self.holds is not before

    def holds_all(self, now_us: int) -> bool:
        """Return whether this UAV and the watched UAVs in the air have support; True without localisation."""
        if self._localisation is None:
            return True
        if not self.holds or not self._watched.size:
            return self.holds
        return self._table.all_held(self._watched, now_us - self._beacon_silence_us)
