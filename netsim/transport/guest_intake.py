"""Limit of what guests send between two intervals, and its counters; for several threads.

A guest that sends without waiting for replies would otherwise fill the emulator's memory.
"""

import logging
from collections.abc import Mapping

from netsim.wire.messages import MAX_PAYLOAD_BYTES, MOST_GUEST_ITEMS, Station

logger = logging.getLogger(__name__)
LONGEST_GUEST_BATCH_BYTES = MOST_GUEST_ITEMS * (MAX_PAYLOAD_BYTES + 64)
"""Longest batch of a guest: `MOST_GUEST_ITEMS` items of greatest length."""


class GuestIntake:
    """Accepts a guest's batches up to `MOST_GUEST_ITEMS` items an interval."""

    def __init__(self, names: Mapping[Station, str]) -> None:
        self.names = names
        """What the guests are called in counters, by station."""
        self._taken: dict[Station, int] = {}
        self.dropped: dict[str, int] = {}
        """Batches that exceeded the limit, by the guest."""

    def accept(self, station: Station, items: int) -> bool:
        """Return whether a batch is within the limit, and count it."""
        taken = self._taken.get(station, 0) + items
        if taken <= MOST_GUEST_ITEMS:
            self._taken[station] = taken
            return True
        self.refuse(station)
        return False

    def is_full(self, station: Station) -> bool:
        """Whether the guest has used up the interval's items, so that its batches need no decoding."""
        return self._taken.get(station, 0) >= MOST_GUEST_ITEMS

    def refuse(self, station: Station) -> None:
        """Count a batch that is dropped; the first one of a guest is logged."""
        name = self.names[station]
        count = self.dropped.get(name, 0)
        if count == 0:
            logger.warning(
                "%s has sent more than %d transmissions since the last interval of simulated time: "
                "the others are dropped and counted", name, MOST_GUEST_ITEMS,
            )  # fmt: skip
        self.dropped[name] = count + 1

    def begin_interval(self) -> None:
        """Allow every guest `MOST_GUEST_ITEMS` items again."""
        self._taken = {}
