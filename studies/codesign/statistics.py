"""Means of few flights and ratios of means of paired flights, with confidence intervals."""

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from scipy.stats import bootstrap, t

CONFIDENCE = 0.95
RESAMPLES = 9_999
_SEED = 20_24
_ALIKE = 1e-12


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
    half = float(t.ppf(0.5 + CONFIDENCE / 2.0, len(known) - 1) * known.std(ddof=1) / math.sqrt(len(known)))
    return Interval(mean, mean - half, mean + half, len(known))


def ratio_interval(above: Sequence[float | None], below: Sequence[float | None]) -> Interval:
    """Return the ratio of means, mean(above) / mean(below), with a bias-corrected bootstrap over the pairs.

    Both sequences are in the order of the seeds; an incomplete pair is skipped.
    """
    pairs = np.array(
        [(a, b) for a, b in zip(above, below, strict=True) if a is not None and b is not None]
    ).reshape(-1, 2)
    if len(pairs) == 0 or not pairs[:, 1].mean() > 0.0:
        return Interval(math.nan, math.nan, math.nan, 0)
    ratio = float(_ratio(pairs[:, 0], pairs[:, 1]))
    if len(pairs) == 1:
        return Interval(ratio, math.nan, math.nan, 1)
    if np.ptp(pairs[:, 0] - ratio * pairs[:, 1]) < _ALIKE:  # every resample has this ratio
        return Interval(ratio, ratio, ratio, len(pairs))
    found = bootstrap(
        (pairs[:, 0], pairs[:, 1]), _ratio, paired=True, vectorized=True, n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE, method="BCa", rng=np.random.default_rng(_SEED),
    ).confidence_interval  # fmt: skip
    return Interval(ratio, float(found.low), float(found.high), len(pairs))


def _ratio(
    above: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    below: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    axis: int = -1,
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.asarray(above.mean(axis=axis) / below.mean(axis=axis))
