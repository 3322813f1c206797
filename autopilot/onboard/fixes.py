"""Means of GPS fixes: what is slow in their errors makes single ones worth no more than their mean."""

from collections.abc import Sequence
from dataclasses import dataclass

GROUP_US = 800_000
"""Fixes of this time make a mean. Within it GPS bias moves by more than what is white in it."""


@dataclass(frozen=True, slots=True)
class FixMean:
    """Mean of some fixes of one UAV, each less the odometry of its time."""

    less_odometry_ned_m: tuple[float, float, float]
    time_us: int
    """Mean of theirs."""
    count: int
    span_us: int
    """From the first to the last."""


class FixGroup:
    """The fixes of one UAV of which there is no mean yet."""

    __slots__ = ("_count", "_down_m", "_east_m", "_first_us", "_late_us", "_north_m")

    def __init__(self) -> None:
        self._clear(0)

    def _clear(self, first_us: int) -> None:
        self._first_us = first_us
        self._count = self._late_us = 0
        self._north_m = self._east_m = self._down_m = 0.0

    def add(
        self, time_us: int, pos_ned_m: Sequence[float], odometry_ned_m: Sequence[float], *, at_once: bool
    ) -> FixMean | None:
        """Take a fix; gives the mean when they span `GROUP_US`, or ``at_once``."""
        if self._count == 0:
            self._clear(time_us)
        self._count += 1
        self._late_us += time_us - self._first_us
        self._north_m += pos_ned_m[0] - odometry_ned_m[0]
        self._east_m += pos_ned_m[1] - odometry_ned_m[1]
        self._down_m += pos_ned_m[2] - odometry_ned_m[2]
        count, span_us = self._count, time_us - self._first_us
        if not at_once and span_us < GROUP_US:
            return None
        mean_m = (self._north_m / count, self._east_m / count, self._down_m / count)
        mean = FixMean(mean_m, self._first_us + self._late_us // count, count, span_us)
        self._count = 0
        return mean
