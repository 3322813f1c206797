"""Ratios of means of paired flights, with confidence intervals."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import bootstrap

from harness.campaign.intervals import CONFIDENCE, Interval

RESAMPLES = 9_999
_SEED = 20_24
_ALIKE = 1e-12


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
