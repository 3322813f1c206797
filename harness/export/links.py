"""Which pairs of stations carried frames, and the worst that happened to them: what the scene draws."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.export import colours

NONE, DELIVERED, RANGING, PARTLY, NOISE, COLLIDED = range(6)
SEVERITIES = (
    None, colours.DELIVERED, colours.RANGING, colours.PARTLY, colours.NOISE, colours.COLLIDED,
)  # fmt: skip
"""Colours by severity; a pair has that of its worst frame."""
_RANGING_KINDS = (b"ftm", b"ftm_request")


class LinkTable:
    """Frames that are not drawn yet, as pairs of stations with a severity.

    Of a frame to a group, the table of frames has only the numbers of receivers with each outcome. If some
    lost it, all its pairs are `PARTLY`. With receptions, each pair has its own outcome.
    """

    def __init__(self, stations: int) -> None:
        self._stations = stations
        self._times_ns = np.empty(0, np.int64)
        self._pairs = np.empty((0, 2), np.int64)
        self._severity = np.empty(0, np.int8)

    def add_frames(self, frames: NDArray[Any]) -> None:
        """Add frames (n,), in the order of their ends."""
        ranging = np.isin(frames["kind"], _RANGING_KINDS)
        lost = frames["collided"] + frames["lost_to_noise"]
        severity = np.select(
            [
                (frames["delivered"] > 0) & (lost > 0),
                frames["collided"] > 0,
                frames["lost_to_noise"] > 0,
                (frames["delivered"] > 0) & ranging,
                frames["delivered"] > 0,
            ],
            [PARTLY, COLLIDED, NOISE, RANGING, DELIVERED],
            NONE,
        ).astype(np.int8)
        to_group = frames["destination"] < 0
        copies = np.where(to_group, self._stations, 1)
        rows = np.repeat(np.arange(len(frames)), copies)
        within = np.arange(len(rows)) - np.repeat(np.cumsum(copies) - copies, copies)
        source = frames["source"][rows]
        receiver = np.where(to_group[rows], within, frames["destination"][rows])
        self._add(frames["end_ns"][rows], source, receiver, severity[rows])

    def add_receptions(
        self, receptions: NDArray[Any], ends_ns: NDArray[np.int64], kinds: NDArray[np.bytes_]
    ) -> None:
        """Add receptions (n,) of frames that end at (n,) and are of kinds (n,), in that order."""
        outcome = receptions["outcome"]
        delivered = np.where(np.isin(kinds, _RANGING_KINDS), RANGING, DELIVERED)
        severity = np.select(
            [outcome == b"collided", outcome == b"lost_to_noise", outcome == b"delivered"],
            [np.full(len(receptions), COLLIDED), np.full(len(receptions), NOISE), delivered],
            NONE,
        ).astype(np.int8)
        self._add(ends_ns, receptions["source"], receptions["receiver"], severity)

    def _add(
        self,
        times_ns: NDArray[np.int64],
        first: NDArray[np.int32],
        second: NDArray[np.int32],
        severity: NDArray[np.int8],
    ) -> None:
        known = (severity != NONE) & (first != second) & (first >= 0) & (second >= 0)
        known &= (first < self._stations) & (second < self._stations)
        pairs = np.sort(np.column_stack([first, second])[known], axis=1)
        self._times_ns = np.concatenate([self._times_ns, times_ns[known]])
        self._pairs = np.concatenate([self._pairs, pairs])
        self._severity = np.concatenate([self._severity, severity[known]])

    def take(self, until_ns: int) -> NDArray[np.int8]:
        """Return and remove the severities (stations, stations) up to a time; 0 below the diagonal."""
        count = int(np.searchsorted(self._times_ns, until_ns, side="right"))
        found = np.zeros((self._stations, self._stations), np.int8)
        np.maximum.at(found, (self._pairs[:count, 0], self._pairs[:count, 1]), self._severity[:count])
        self._times_ns, self._pairs = self._times_ns[count:], self._pairs[count:]
        self._severity = self._severity[count:]
        return found
