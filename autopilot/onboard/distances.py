"""Distances on their way into the localisation, each told by (initiator, responder, time) and used once."""

from collections.abc import Set as AbstractSet

import numpy as np

from autopilot.onboard.joining import Range


class Distances:
    """Distances between N UAVs.

    Attributes:
        newest_us: by initiator and responder, when the newest was measured; -1 before the first.
        pending: those whose ends' odometry has not been looked up yet.
        held: the newest of each pair of which an end is not located, since ``held_since_us``.
        fused: the newest of each pair, to solve again should it not fit.

    """

    def __init__(self, count: int) -> None:
        self.newest_us = [[-1] * count for _ in range(count)]
        self.pending: list[Range] = []
        self.held: dict[tuple[int, int], Range] = {}
        self.held_since_us = 0
        self.fused: dict[tuple[int, int], Range] = {}

    def add(
        self, initiator: int, responder: int, time_us: int, distance_m: float, variance_m2: float
    ) -> None:
        """Take one that is newer than what is known of the two."""
        self.newest_us[initiator][responder] = time_us
        self.pending.append(Range(initiator, responder, time_us, distance_m, variance_m2, np.empty(3)))

    def hold(self, item: Range, now_us: int) -> None:
        """Keep one until those who do not take part yet can be solved for."""
        if not self.held:
            self.held_since_us = now_us
        self.held[item.initiator, item.responder] = item

    def release(self) -> list[Range]:
        """Give those held, by pair, and hold them no longer."""
        held = [item for _, item in sorted(self.held.items())]
        self.held.clear()
        return held

    def fused_of(self, stations: AbstractSet[int], now_us: int, *, within_us: float) -> list[Range]:
        """Those of the last ``within_us``, by pair, of which one of ``stations`` is an end."""
        return [
            item
            for pair, item in sorted(self.fused.items())
            if not stations.isdisjoint(pair) and now_us - item.time_us < within_us
        ]

    def drop(self, station: int) -> None:
        """Forget what is kept of a UAV's distances, whose odometry is that of before."""
        for kept in (self.held, self.fused):
            for pair in [pair for pair in kept if station in pair]:
                del kept[pair]
