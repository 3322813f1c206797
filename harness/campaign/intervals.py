"""Means over flights with confidence intervals."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from scipy.special import stdtrit

CONFIDENCE = 0.95


class Interval(Struct, frozen=True):
    """A value with its 95 % confidence interval, which is NaN for fewer than two flights."""

    value: float
    low: float
    high: float
    count: int
    """Number of flights"""

    def text(self, digits: int = 3, *, factor: float = 1.0) -> str:
        """Format as ``mean (low to high)``, or a dash without a value."""
        if not self.count:
            return "–"
        value = f"{factor * self.value:.{digits}f}"
        if math.isnan(self.low):
            return value
        return f"{value} ({factor * self.low:.{digits}f} to {factor * self.high:.{digits}f})"


def mean_interval(values: Sequence[float | None]) -> Interval:
    """Return the mean with Student's interval, mean ± t(0.975, n - 1) s / sqrt(n); None is skipped."""
    known = np.array([value for value in values if value is not None])
    if len(known) == 0:
        return Interval(math.nan, math.nan, math.nan, 0)
    mean = float(known.mean())
    if len(known) == 1:
        return Interval(mean, math.nan, math.nan, 1)
    half = float(stdtrit(len(known) - 1, 0.5 + CONFIDENCE / 2.0) * known.std(ddof=1) / math.sqrt(len(known)))
    return Interval(mean, mean - half, mean + half, len(known))
