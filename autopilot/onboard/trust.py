"""Whose distances fit: tells a UAV that is not where it is thought to be from one that measures wrongly.

One that stands elsewhere misfits in all distances that it is an end of, whoever measured them. One that
measures wrongly misfits in those that it measured itself, while what the others measured to it fits.

A filter can also settle where only a part of them misfits, such as a mirror image: that shows in time.
"""

from collections.abc import Iterable

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


class Trust:
    """Running shares of badly fitting distances, per UAV.

    Attributes:
        distrusted: whether the distances that a UAV measures are to be left out.

    """

    def __init__(self, count: int) -> None:
        self.distrusted = [False] * count
        self._as_end = [0.0] * count
        self._measured = [0.0] * count
        self._of_it = [0.0] * count
        self._since_us: list[int | None] = [None] * count

    def note(self, initiator: int, responder: int, *, badly: bool) -> None:
        """Count a distance that has been compared with the estimate."""
        self._measured[initiator] += (badly - self._measured[initiator]) / SIDE_MEMORY
        if self.distrusted[initiator]:
            self.distrusted[initiator] = self._measured[initiator] > TRUST_LIMIT
            return
        self._of_it[responder] += (badly - self._of_it[responder]) / SIDE_MEMORY
        for station in (initiator, responder):
            self._as_end[station] += (badly - self._as_end[station]) / MEMORY
        if self._measured[initiator] > DISTRUST_LIMIT and self._of_it[initiator] < FIT_LIMIT:
            self.distrust(initiator)

    def distrust(self, station: int) -> None:
        """Leave out what this UAV measures until it fits again."""
        self.distrusted[station] = True
        self._measured[station] = 1.0
        self._as_end[station] = self._of_it[station]

    def elsewhere(self, station: int) -> bool:
        """Whether a UAV cannot be where it is thought to be."""
        return self._as_end[station] > ELSEWHERE_LIMIT

    def suspects(self, now_us: int, members: Iterable[int]) -> set[int]:
        """Who of these misfits beside the others, once one of them has done so for `LASTING_US`, anew."""
        shares = {station: self._as_end[station] for station in members}
        limit = min(shares.values(), default=0.0) + LASTING_LIMIT
        found = {station for station, share in shares.items() if share > limit}
        since_us = [now_us if since is None else since for since in self._since_us]
        lasting = any(now_us - since_us[station] >= LASTING_US for station in found)
        self._since_us = [
            since if station in found and not lasting else None for station, since in enumerate(since_us)
        ]
        return found if lasting else set()

    def forget(self, station: int) -> None:
        """Begin a UAV afresh."""
        self._as_end[station] = self._measured[station] = self._of_it[station] = 0.0
        self.distrusted[station] = False
        self._since_us[station] = None
