"""Whom a UAV localises, ranges to and keeps clear of: everybody, or those whose places are near its own.

Everybody with everybody costs each UAV N^2 of arithmetic and memory, and the channel N^2 distances. Of many
UAVs the distances to the nearest hold the shape as well: neighbourhoods overlap, and `common_frame` lays them
onto each other. They follow from the places, so that all find the same without a word.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_ROUND_M = 3
"""Digits to which distances of places are compared: equal ones of a grid are equal, and numbers decide."""


def linked(places_ned_m: Array, nearest: int) -> Flags:
    """(N, N) symmetric: who are neighbours, nobody of itself.

    Those of whom either is among the ``nearest`` of the other, by places_ned_m (N, 3); 0: all.
    """
    count = len(places_ned_m)
    if nearest == 0 or nearest >= count - 1:
        return ~np.eye(count, dtype=bool)
    found = np.zeros((count, count), bool)
    for station in range(count):
        way_m = places_ned_m - places_ned_m[station]
        apart_m = np.sqrt((way_m**2).sum(axis=1)).round(_ROUND_M)
        apart_m[station] = -1.0
        found[station, np.argsort(apart_m, kind="stable")[1 : nearest + 1]] = True
    return found | found.T


class Neighbourhood:
    """One UAV and its neighbours.

    Args:
        station: this UAV.
        places_ned_m: (N, 3) the formation's places.
        nearest: see `linked`.

    Attributes:
        stations: how many there are in all.
        members: (M,) the UAV and its neighbours in the order of their numbers: whom the rows of all arrays
            that are kept of the neighbourhood belong to.
        rows: row of every station; None: it is no member.
        row_numbers: (N,) the same for compiled code; -1: it is no member.
        own: row of the UAV itself.
        whole: everybody is a member.
        linked: (N, N) as of `linked`.

    """

    def __init__(self, station: int, places_ned_m: Array, nearest: int) -> None:
        self.stations = len(places_ned_m)
        self.linked = linked(places_ned_m, nearest)
        taken = self.linked[station].copy()
        taken[station] = True
        self.members = np.flatnonzero(taken)
        self.rows: list[int | None] = [None] * self.stations
        for row, member in enumerate(self.members.tolist()):
            self.rows[member] = row
        self.row_numbers = np.array([-1 if row is None else row for row in self.rows], np.int64)
        self.own = int(np.searchsorted(self.members, station))
        self.whole = len(self.members) == self.stations
