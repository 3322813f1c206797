"""Neighbourhood of a UAV: the UAVs that it localises, ranges to and avoids, by default all of them.

With all UAVs as neighbours, arithmetic and memory of each UAV and the number of distances on the channel grow
with N^2. In a large formation the distances to the nearest places determine the shape as well: neighbourhoods
overlap, and `common_frame` aligns them. They depend on the places only, so all UAVs compute the same ones
without communication.
"""

import numpy as np

from autopilot.onboard.predicted_shape import linked
from foundation.types import Array


class Neighbourhood:
    """One UAV and its neighbours by `linked`.

    Attributes:
        members: (M,) the UAV and its neighbours in the order of their numbers: the rows of all arrays of the
            neighbourhood.
        rows: row of every station; None: not a member.
        row_numbers: (N,) the same for compiled code; -1: not a member.
        own: row of the UAV itself.
        whole: all UAVs are members.

    """

    def __init__(self, station: int, places_ned_m: Array, nearest: int) -> None:
        self.linked = linked(places_ned_m, nearest)
        taken = self.linked[station].copy()
        taken[station] = True
        self.members = np.flatnonzero(taken)
        self.rows: list[int | None] = [None] * len(places_ned_m)
        for row, member in enumerate(self.members.tolist()):
            self.rows[member] = row
        self.row_numbers = np.array([-1 if row is None else row for row in self.rows], np.int64)
        self.own = int(np.searchsorted(self.members, station))
        self.whole = len(self.members) == len(places_ned_m)
