"""Means of few runs and how sure they are; where a curve comes down to a value."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct


class Mean(Struct, frozen=True):
    """Mean of some runs with its standard error, which one run alone does not have."""

    value: float
    error: float | None

    def text(self, digits: int) -> str:
        """As ``mean ± error``."""
        error = "" if self.error is None else f" ± {self.error:.{digits}f}"
        return f"{self.value:.{digits}f}{error}"


class Mesh(Struct, frozen=True, kw_only=True):
    """Means over the seeds of one number of stations and one period."""

    stations: int
    wanted: float
    """Share of the time that the sessions would take one after the other"""
    completed: Mean
    round_trips: Mean
    """Of those asked for"""
    delay_ms: Mean
    busy: Mean


def mean_of(values: Sequence[float | None]) -> Mean:
    """Mean and standard error of independent values; None is left out, and the mean of nothing is NaN."""
    known = [value for value in values if value is not None]
    error = float(np.std(known, ddof=1)) / math.sqrt(len(known)) if len(known) > 1 else None
    return Mean(float(np.mean(known)) if known else math.nan, error)


def difference_error(first: Mean, second: Mean) -> float:
    """Standard error of the difference of two means, as far as theirs are known."""
    return math.hypot(first.error or 0.0, second.error or 0.0)


def crossing_db(snr_db: Sequence[float], per: Sequence[float], target: float = 0.1) -> float:
    """Give the ratio at which a falling error rate comes down to ``target``.

    Between two points the logarithm of the rate is taken for a straight line. NaN if the points do not
    enclose the target.
    """
    for k in range(len(per) - 1):
        if per[k] > target >= per[k + 1]:
            if per[k + 1] <= 0.0:
                return snr_db[k + 1]
            share = math.log(per[k] / target) / math.log(per[k] / per[k + 1])
            return snr_db[k] + share * (snr_db[k + 1] - snr_db[k])
    return math.nan
