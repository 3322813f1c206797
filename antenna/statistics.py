"""Maximum gain over time as statistics: moments, quantiles and its probability density."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import gaussian_kde

from antenna.geometry import Array

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
LEAST_SPREAD_DB = 1e-3
"""Below this a series is constant for all purposes, and has no density."""


@dataclass(frozen=True, slots=True)
class GainStatistics:
    """Of K maximum gains. Means and deviations are those of the decibels, as the article's densities are."""

    samples: int
    mean_dbi: float
    std_db: float
    """Of the sample, K - 1 in the denominator; 0 for a single one."""
    min_dbi: float
    max_dbi: float
    quantiles_dbi: dict[float, float]
    """By `QUANTILES`."""


@dataclass(frozen=True, slots=True, eq=False)
class GainDensity:
    """Probability density of the maximum gain, as a histogram and as a smooth curve."""

    bin_edges_dbi: Array
    """(B + 1,)"""
    histogram_per_db: Array
    """(B,)"""
    gain_dbi: Array
    """(G,) where the smooth curve is known; empty when the gains do not differ."""
    kernel_per_db: Array
    """(G,) Gaussian kernels of Scott's width."""


def gain_statistics(max_gain_dbi: Array) -> GainStatistics:
    """Summarise (K,) gains; raises ValueError when there are none."""
    if len(max_gain_dbi) == 0:
        raise ValueError("statistics need at least one gain")
    quantiles = np.quantile(max_gain_dbi, QUANTILES)
    return GainStatistics(
        samples=len(max_gain_dbi),
        mean_dbi=float(np.mean(max_gain_dbi)),
        std_db=float(np.std(max_gain_dbi, ddof=1)) if len(max_gain_dbi) > 1 else 0.0,
        min_dbi=float(np.min(max_gain_dbi)),
        max_dbi=float(np.max(max_gain_dbi)),
        quantiles_dbi=dict(zip(QUANTILES, quantiles.tolist(), strict=True)),
    )


def gain_density(max_gain_dbi: Array, *, points: int = 201) -> GainDensity:
    """Density of (K,) gains, K >= 1; the curve reaches four kernel widths beyond them."""
    low_dbi, high_dbi = float(np.min(max_gain_dbi)), float(np.max(max_gain_dbi))
    if high_dbi - low_dbi < LEAST_SPREAD_DB:
        edges_dbi = (low_dbi + high_dbi) / 2 + np.array([-0.5, 0.5]) * LEAST_SPREAD_DB
        return GainDensity(edges_dbi, np.array([1.0 / LEAST_SPREAD_DB]), np.empty(0), np.empty(0))
    histogram_per_db, edges_dbi = np.histogram(max_gain_dbi, bins="auto", density=True)
    kernel = gaussian_kde(max_gain_dbi)
    reach_db = 4.0 * float(np.sqrt(kernel.covariance[0, 0]))
    at_dbi = np.linspace(low_dbi - reach_db, high_dbi + reach_db, points)
    return GainDensity(edges_dbi, histogram_per_db, at_dbi, kernel(at_dbi))
