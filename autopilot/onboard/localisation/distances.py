"""Queue of measured distances, each identified by (initiator, responder, time) and used once."""

from collections.abc import Set as AbstractSet

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.batch_initialisation import Range
from autopilot.onboard.localisation.members import Filter
from autopilot.onboard.localisation.model import CLOCK_TOLERANCE_US
from autopilot.onboard.radio.beacon import MAX_RANGES

PAIR = np.dtype(
    [
        ("newest_us", "i8"),  # measurement time of the newest; -1 before the first
        # the newest one used, kept for solving again if it does not fit: measurement time or -1
        ("fused_us", "i8"),
        ("distance_m", "f8"),
        ("variance_m2", "f8"),
        ("between_ned_m", "f8", 3),
    ]
)
"""Record of the distances that one UAV has measured to another."""
Pairs = NDArray[np.void]
"""(N, N) array of `PAIR`, by initiator and responder."""
PENDING = np.dtype(
    [("initiator", "i8"), ("responder", "i8"), ("time_us", "i8"), ("distance_m", "f8"), ("variance_m2", "f8")]
)
"""A distance that waits for the odometry of its ends."""
Pending = NDArray[np.void]
"""(P,) array of `PENDING`."""


@njit(cache=True)
def add_distance(
    pairs: Pairs, pending: Pending, filter_row: Filter, initiator: int, responder: int, time_us: int,
    distance_m: float, variance_m2: float, now_us: int,
) -> bool:  # fmt: skip
    """Append a distance to ``pending``, which must have room; returns whether it was appended.

    It is ignored if it is not newer than the last one of the pair or if both ends are the same UAV, and if
    its time is in the future, because it would suppress the valid ones that follow.
    """
    own, pair = filter_row[0], pairs[initiator, responder]
    if initiator == responder or not pair["newest_us"] < time_us <= now_us + CLOCK_TOLERANCE_US:
        return False
    pair["newest_us"] = time_us
    item = pending[own["pending"]]
    own["pending"] += 1
    item["initiator"], item["responder"], item["time_us"] = initiator, responder, time_us
    item["distance_m"], item["variance_m2"] = distance_m, variance_m2
    return True


class Distances:
    """Distances between N UAVs: those that compiled code uses, and those held for a batch initialisation."""

    def __init__(self, count: int, filter_row: Filter) -> None:
        self.pairs: Pairs = np.zeros((count, count), PAIR)
        self.pairs["newest_us"] = self.pairs["fused_us"] = -1
        self.pending: Pending = np.zeros(4 * MAX_RANGES, PENDING)
        self._filter = filter_row
        self.held: dict[tuple[int, int], Range] = {}
        """Newest distance of each pair with an end that is not located; the first since ``held_since_us``."""
        self.held_since_us = 0

    def make_room(self) -> None:
        """Ensure room for all the distances of another beacon."""
        if self._filter["pending"].item() + MAX_RANGES > len(self.pending):
            self.pending = np.concatenate((self.pending, np.zeros_like(self.pending)))

    def last_pending(self, between_ned_m: NDArray[np.float64]) -> Range:
        """Return the pending distance processed last, with the odometry (3,) between its ends."""
        item = self.pending[self._filter["done"].item() - 1]
        initiator, responder, time_us, distance_m, variance_m2 = item.tolist()
        return Range(initiator, responder, time_us, distance_m, variance_m2, between_ned_m)

    def hold(self, item: Range, now_us: int) -> None:
        """Keep a distance until its ends can be solved for."""
        if not self.held:
            self.held_since_us = now_us
        self.held[item.initiator, item.responder] = item

    def release(self) -> list[Range]:
        """Return the held distances, sorted by pair, and clear them."""
        held = [item for _, item in sorted(self.held.items())]
        self.held.clear()
        return held

    def fused_of(self, stations: AbstractSet[int], now_us: int, *, within_us: float) -> list[Range]:
        """Return the distances used within the last ``within_us`` with an end in ``stations``, by pair."""
        found = []
        for i, j in np.argwhere(self.pairs["fused_us"] >= 0).tolist():
            _, time_us, distance_m, variance_m2, between_ned_m = self.pairs[i, j].tolist()
            if not stations.isdisjoint((i, j)) and now_us - time_us < within_us:
                found.append(Range(i, j, time_us, distance_m, variance_m2, np.array(between_ned_m)))
        return found

    def drop(self, station: int) -> None:
        """Drop the stored distances of a UAV, whose odometry has jumped."""
        for pair in [pair for pair in self.held if station in pair]:
            del self.held[pair]
        self.pairs["fused_us"][station, :] = self.pairs["fused_us"][:, station] = -1
