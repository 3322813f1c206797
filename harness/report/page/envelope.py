"""Reduction of long series for figures that keeps the extremes: least and greatest value of each bin."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_BINS = 1_000
"""Bins of a line of a figure, two points each; about a dot of a wide figure"""
MOST_POINTS = 40_000
"""Points of all lines of a figure together"""


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """Values of N series at P points; of a long series two points for each bin."""

    rows: NDArray[np.int64]
    """(P,) instants to which the points belong, by their numbers"""
    values: NDArray[np.float32]
    """(P, N)"""
    bin_rows: int
    """Instants of the largest bin; 1: every instant is there"""


def most_bins(series: int) -> int:
    """Return the number of bins for each of some series in one figure."""
    return max(50, min(MOST_BINS, MOST_POINTS // (2 * max(series, 1))))


def bin_starts(count: int, bins: int) -> NDArray[np.int64]:
    """Return the first instants of at most ``bins`` bins of ``count`` instants, all of about one size."""
    bins = min(count, bins)
    return (np.arange(bins, dtype=np.int64) * count) // max(bins, 1)


def envelope(values: NDArray[Any], *, bins: int | None = None) -> Envelope:
    """Return the envelope of values (T, N), NaN where there is none.

    A series of at most two instants per bin is returned whole. Otherwise each bin gives its least and its
    greatest value, in the order that its first and its last value suggest; a bin with NaN only gives NaN.
    """
    bins = most_bins(values.shape[1]) if bins is None else bins
    count = len(values)
    if count <= 2 * bins:
        return Envelope(np.arange(count), values.astype(np.float32), 1)
    starts = bin_starts(count, bins)
    ends = np.append(starts[1:], count)
    least = np.fmin.reduceat(values, starts, axis=0)
    greatest = np.fmax.reduceat(values, starts, axis=0)
    falls = values[starts] > values[ends - 1]
    points = np.empty((2 * len(starts), values.shape[1]), np.float32)
    points[0::2] = np.where(falls, greatest, least)
    points[1::2] = np.where(falls, least, greatest)
    rows = np.empty(2 * len(starts), np.int64)
    rows[0::2], rows[1::2] = starts, (starts + ends) // 2
    return Envelope(rows, points, int(np.diff(np.append(starts, count)).max()))
