"""Transmissions of all pairs in the band, and the interference that they are to other pairs.

A signal occupies the bandwidth of Carson's rule with a flat spectrum, and the receiver's filter has the same
width: of a signal at another frequency it passes the share by which both overlap. Interference has the effect
of noise. Other users of the band, such as 802.11ah or LoRa, are not modelled.
"""

from collections import deque
from typing import NamedTuple


class AirTransmission(NamedTuple):
    """Occupation of the air by one packet."""

    start_ns: int
    end_ns: int
    end: int
    """Number of the sending modem."""
    frequency_hz: int


class Air:
    """Recent transmissions."""

    def __init__(self, bandwidth_hz: float, kept_ns: int) -> None:
        self._bandwidth_hz = bandwidth_hz
        self._kept_ns = kept_ns
        """Time for which transmissions are kept after their end: that of the longest packet."""
        self._cells: dict[int, deque[AirTransmission]] = {}
        """By frequency in units of the bandwidth, rounded down; a signal reaches into adjacent cells."""

    def add(self, transmission: AirTransmission, at_ns: int) -> None:
        """Register a transmission that has been decided at ``at_ns``."""
        recent = self._cells.setdefault(int(transmission.frequency_hz // self._bandwidth_hz), deque())
        while recent and recent[0].end_ns + self._kept_ns < at_ns:
            recent.popleft()
        recent.append(transmission)

    def overlapping(
        self, pair: int, frequency_hz: int, start_ns: int, end_ns: int
    ) -> list[tuple[AirTransmission, float]]:
        """Return the transmissions of other pairs in an interval, and the share that a filter passes."""
        found = []
        cell = int(frequency_hz // self._bandwidth_hz)
        for near in (cell - 1, cell, cell + 1):
            for other in self._cells.get(near, ()):
                if other.start_ns < end_ns and other.end_ns > start_ns and other.end // 2 != pair:
                    passed = 1.0 - abs(other.frequency_hz - frequency_hz) / self._bandwidth_hz
                    if passed > 0.0:
                        found.append((other, passed))
        return found
