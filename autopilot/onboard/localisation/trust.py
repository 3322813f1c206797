"""Fault detection from misfitting distances: separates a wrong position estimate from wrong measurements.

If a UAV's position estimate is wrong, all distances with this UAV as an end misfit, whichever end measured
them. If a UAV measures wrongly, its own distances misfit, while those that others measured to it fit.

A filter can also settle in a state where only some distances misfit, such as a mirror image. It is detected
by a share of misfits that stays high.
"""

from collections.abc import Iterable

from numba import njit

from autopilot.onboard.localisation.members import Members

MEMORY = 30
"""Number of a UAV's distances, as either end, over which the share of misfits is averaged."""
SIDE_MEMORY = 8
"""The same for the distances that it measured, and for those that others measured to it. A UAV that begins to
measure wrongly is detected after ten distances."""
ELSEWHERE_LIMIT = 0.7
"""Above this share of misfits, as either end, a UAV's position estimate is wrong. A faulty initiator
spoils half of the distances with itself as an end, and in a formation of eight 1 / 7 of another UAV's."""
DISTRUST_LIMIT, FIT_LIMIT = 0.7, 0.35
"""A UAV is distrusted if more than the first share of its own distances and less than the second share of
those measured to it misfit."""
TRUST_LIMIT = 0.2
"""Its distances are fused again when the share of misfits is at most this."""
LASTING_LIMIT, LASTING_US = 0.25, 30_000_000
"""A UAV is suspected to have a wrong position estimate if its share of misfits exceeds that of the best UAV
by this for so long; blocked lines of sight spoil a share of all distances."""


@njit(cache=True)
def distrust(members: Members, row: int) -> None:
    """Exclude the distances that a UAV measures until they fit again."""
    member = members[row]
    member["distrusted"] = 1
    member["measured"] = 1.0
    member["as_end"] = member["of_it"]


@njit(cache=True)
def note(members: Members, initiator: int, responder: int, badly: bool) -> None:  # noqa: FBT001
    """Update the shares of misfits by a distance that was compared with the estimate."""
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
    """UAVs whose share of misfitting distances stays high."""

    def __init__(self, members: Members) -> None:
        self._members = members
        self._since_us: list[int | None] = [None] * len(members)

    def suspects(self, now_us: int, members: Iterable[int]) -> set[int]:
        """Return the members that misfit relative to the best one, once one of them has for `LASTING_US`.

        Returns an empty set before that. Returning members restarts the timers.
        """
        shares = {station: self._members["as_end"].item(station) for station in members}
        limit = min(shares.values(), default=0.0) + LASTING_LIMIT
        found = {station for station, share in shares.items() if share > limit}
        since_us = [now_us if since is None else since for since in self._since_us]
        lasting = any(now_us - since_us[station] >= LASTING_US for station in found)
        self._since_us = [
            since if station in found and not lasting else None for station, since in enumerate(since_us)
        ]
        return found if lasting else set()

    def forget(self, row: int) -> None:
        """Reset the statistics of a UAV."""
        for name in ("as_end", "measured", "of_it", "distrusted"):
            self._members[name][row] = 0
        self._since_us[row] = None
