"""Whose distances fit: tells a UAV that is not where it is thought to be from one that measures wrongly.

One that stands elsewhere misfits in all distances that it is an end of, whoever measured them. One that
measures wrongly misfits in those that it measured itself, while what the others measured to it fits.

A filter can also settle where only a part of them misfits, such as a mirror image: that shows in time.
"""

from collections.abc import Iterable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.members import Members

MEMORY = 30
"""Distances of a UAV, as either end, over which the share of badly fitting ones is averaged."""
SIDE_MEMORY = 8
"""The same of those that it measured, and of those that others measured to it. One that begins to measure
wrongly is found out after ten distances: three seconds in a formation of eight at one per pair and second."""
ELSEWHERE_LIMIT = 0.7
"""Above this share of either end a UAV is not where the filter has it. A UAV that itself measures wrongly
spoils half of the distances that it is an end of, and a seventh of another's in a formation of eight."""
DISTRUST_LIMIT, FIT_LIMIT = 0.7, 0.35
"""More than this of its own fits badly, less than this of the others'."""
TRUST_LIMIT = 0.2
"""So few of its own fit badly when its distances are used again."""
LASTING_LIMIT, LASTING_US = 0.25, 30_000_000
"""A UAV of which this share more misfits than of the best one, for so long, is suspected to be elsewhere.
Blocked lines of sight spoil a share of everybody's."""


@njit(cache=True)
def distrust(members: Members, row: int) -> None:
    """Leave out what a UAV measures until it fits again."""
    member = members[row]
    member["distrusted"] = 1
    member["measured"] = 1.0
    member["as_end"] = member["of_it"]


@njit(cache=True)
def note(members: Members, initiator: int, responder: int, badly: bool) -> None:  # noqa: FBT001
    """Count a distance that has been compared with the estimate."""
    found = 1.0 if badly else 0.0
    measurer, measured = members[initiator], members[responder]
    measurer["measured"] += (found - measurer["measured"]) / SIDE_MEMORY
    if measurer["distrusted"]:
        measurer["distrusted"] = measurer["measured"] > TRUST_LIMIT
        return
    measured["of_it"] += (found - measured["of_it"]) / SIDE_MEMORY
    for member in (measurer, measured):
        member["as_end"] += (found - member["as_end"]) / MEMORY
    if measurer["measured"] > DISTRUST_LIMIT and measurer["of_it"] < FIT_LIMIT:
        distrust(members, initiator)


class Trust:
    """Running shares of badly fitting distances, per UAV.

    Attributes:
        distrusted: (N,) bool, whether the distances that a UAV measures are to be left out.

    """

    def __init__(self, members: Members) -> None:
        self.distrusted: NDArray[np.bool_] = members["distrusted"].view(bool)
        self._members = members
        self._as_end = members["as_end"]
        self._since_us: list[int | None] = [None] * len(members)

    def note(self, initiator: int, responder: int, *, badly: bool) -> None:
        """Count a distance that has been compared with the estimate."""
        note(self._members, initiator, responder, badly)

    def distrust(self, row: int) -> None:
        """Leave out what this UAV measures until it fits again."""
        distrust(self._members, row)

    def elsewhere(self, row: int) -> bool:
        """Whether a UAV cannot be where it is thought to be."""
        return bool(self._as_end[row] > ELSEWHERE_LIMIT)

    def suspects(self, now_us: int, members: Iterable[int]) -> set[int]:
        """Who of these misfits beside the others, once one of them has done so for `LASTING_US`, anew."""
        shares = {station: self._as_end.item(station) for station in members}
        limit = min(shares.values(), default=0.0) + LASTING_LIMIT
        found = {station for station, share in shares.items() if share > limit}
        since_us = [now_us if since is None else since for since in self._since_us]
        lasting = any(now_us - since_us[station] >= LASTING_US for station in found)
        self._since_us = [
            since if station in found and not lasting else None for station, since in enumerate(since_us)
        ]
        return found if lasting else set()

    def forget(self, row: int) -> None:
        """Begin a UAV afresh."""
        for name in ("as_end", "measured", "of_it", "distrusted"):
            self._members[name][row] = 0
        self._since_us[row] = None
