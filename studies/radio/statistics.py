"""Means of few runs with their standard errors; crossing of a curve with a value."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct


class Mean(Struct, frozen=True):
    """Mean of some runs with its standard error; None for a single run."""

    value: float
    error: float | None

    def text(self, digits: int) -> str:
        """Format as ``mean ± error``."""
        error = "" if self.error is None else f" ± {self.error:.{digits}f}"
        return f"{self.value:.{digits}f}{error}"


class Mesh(Struct, frozen=True, kw_only=True):
    """Means over the seeds of one number of stations and one period."""

    stations: int
    requested: float
    """Air time of all sessions in sequence over the elapsed time"""
    completed: Mean
    round_trips: Mean
    """Share of the requested ones"""
    delay_ms: Mean
    busy: Mean


def mean_of(values: Sequence[float | None]) -> Mean:
    """Return mean and standard error of independent values; None is skipped, the mean of no value is NaN."""
    known = [value for value in values if value is not None]
    error = float(np.std(known, ddof=1)) / math.sqrt(len(known)) if len(known) > 1 else None
    return Mean(float(np.mean(known)) if known else math.nan, error)


def difference_error(first: Mean, second: Mean) -> float:
    """Return the standard error of the difference of two means; an unknown error counts as 0."""
    return math.hypot(first.error or 0.0, second.error or 0.0)


def crossing_db(snr_db: Sequence[float], per: Sequence[float], target: float = 0.1) -> float:
    """Return the ratio at which a falling error rate reaches ``target``.

    The logarithm of the rate is interpolated linearly. NaN if the points do not enclose the target.
    """
    for k in range(len(per) - 1):
        if per[k] > target >= per[k + 1]:
            if per[k + 1] <= 0.0:
                return snr_db[k + 1]
            share = math.log(per[k] / target) / math.log(per[k] / per[k + 1])
            return snr_db[k] + share * (snr_db[k + 1] - snr_db[k])
    return math.nan
