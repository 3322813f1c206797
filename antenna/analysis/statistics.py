"""Statistics of many patterns: density of maximum gain, gain in one direction, pointing, mean, envelope."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antenna.analysis.patterns import FLOOR_DBI, Pattern, from_dbi, to_dbi
from antenna.model.geometry import Array

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
LEAST_SPREAD_DB = 1e-3
"""A series with a smaller range counts as constant and has no density."""
LEVELS_DBI = (-60.0, 40.0)
"""Range of gains that an envelope's quantiles resolve; gains outside are clipped to it."""
LEVEL_STEP_DB = 0.25
_BINS = round((LEVELS_DBI[1] - LEVELS_DBI[0]) / LEVEL_STEP_DB)
HISTOGRAM_BYTES = 4 * _BINS
"""Memory per direction of an envelope with quantiles."""
_AROUND = 8
"""Nodes along theta and along phi for interpolating a gain."""


@dataclass(frozen=True, slots=True)
class GainStatistics:
    """Statistics of K maximum gains. Means and deviations are of the decibels, as the article's densities."""

    samples: int
    mean_dbi: float
    std_db: float
    """Sample standard deviation, K - 1 in the denominator; 0 for a single gain."""
    min_dbi: float
    max_dbi: float
    quantiles_dbi: dict[float, float]
    """Quantiles of the decibels by `QUANTILES`: that of q is at index q (K - 1) of the sorted gains, from 0,
    with linear interpolation (R. J. Hyndman and Y. Fan, Sample quantiles, 1996, definition 7)."""


@dataclass(frozen=True, slots=True, eq=False)
class GainDensity:
    """Probability density of the maximum gain, as a histogram and as a smooth curve."""

    bin_edges_dbi: Array
    """(B + 1,) of the histogram (B,)."""
    histogram_per_db: Array
    gain_dbi: Array
    """(G,) gains of the smooth curve; empty when all gains are equal."""
    kernel_per_db: Array
    """(G,) density from Gaussian kernels of Scott's width."""


@dataclass(frozen=True, slots=True)
class PointingStatistics:
    """Statistics of the angles between the directions of K maxima and the nominal one."""

    samples: int
    mean_deg: float
    rms_deg: float
    max_deg: float
    quantiles_deg: dict[float, float]
    """Quantiles by `QUANTILES`."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Envelope:
    """Statistics of the total gain of K patterns for every direction of their grid."""

    samples: int
    theta_deg: Array
    """(T,) and phi (P,)."""
    phi_deg: Array
    mean_dbi: Array
    """(T, P) mean of the linear gains, in dBi; likewise the extremes."""
    min_dbi: Array
    max_dbi: Array
    quantiles_dbi: dict[float, Array]
    """(T, P) by `QUANTILES`, defined as in `GainStatistics`, with resolution `LEVEL_STEP_DB`; empty unless
    requested."""


def gain_statistics(max_gain_dbi: Array) -> GainStatistics:
    """Return the statistics of (K,) gains; raises ValueError without any."""
    if len(max_gain_dbi) == 0:
        raise ValueError("statistics need at least one gain")
    return GainStatistics(
        samples=len(max_gain_dbi), mean_dbi=float(np.mean(max_gain_dbi)),
        std_db=float(np.std(max_gain_dbi, ddof=1)) if len(max_gain_dbi) > 1 else 0.0,
        min_dbi=float(np.min(max_gain_dbi)), max_dbi=float(np.max(max_gain_dbi)),
        quantiles_dbi=dict(zip(QUANTILES, np.quantile(max_gain_dbi, QUANTILES).tolist(), strict=True)),
    )  # fmt: skip


def gain_density(max_gain_dbi: Array, *, points: int = 201) -> GainDensity:
    """Return the density of (K,) gains, K >= 1; the curve extends four kernel widths beyond them."""
    low_dbi, high_dbi = float(np.min(max_gain_dbi)), float(np.max(max_gain_dbi))
    if high_dbi - low_dbi < LEAST_SPREAD_DB:
        edges_dbi = (low_dbi + high_dbi) / 2 + np.array([-0.5, 0.5]) * LEAST_SPREAD_DB
        return GainDensity(edges_dbi, np.array([1.0 / LEAST_SPREAD_DB]), np.empty(0), np.empty(0))
    histogram_per_db, edges_dbi = np.histogram(max_gain_dbi, bins="auto", density=True)
    width_db = float(np.std(max_gain_dbi, ddof=1)) * len(max_gain_dbi) ** (-1.0 / 5.0)
    reach_db = 4.0 * width_db
    at_dbi = np.linspace(low_dbi - reach_db, high_dbi + reach_db, points)
    return GainDensity(edges_dbi, histogram_per_db, at_dbi, _kernel_density(max_gain_dbi, width_db, at_dbi))


def _kernel_density(samples: Array, width: float, at: Array) -> Array:
    """Return the mean (G,) of the normal densities of standard deviation ``width`` around (K,) samples.

    `scipy.stats.gaussian_kde` returns the same, and takes 34 MB in every process that imports it.
    """
    total = np.zeros(len(at))
    for sample in samples / width:
        total += np.exp(-0.5 * (sample - at / width) ** 2)
    return np.asarray(total / (len(samples) * width * math.sqrt(2.0 * math.pi)), float)


class RunningEnvelope:
    """Accumulates the `Envelope` of patterns on one grid; quantiles need `HISTOGRAM_BYTES` per direction."""

    def __init__(self, *, quantiles: bool = True) -> None:
        self._with_quantiles = quantiles
        self._samples = 0
        self._angles_deg = np.empty(0), np.empty(0)
        self._sum = self._min = self._max = np.empty((0, 0))
        self._counts = np.empty((0, 0, 0), np.uint32)

    def add(self, pattern: Pattern) -> None:
        """Add a pattern; raises ValueError if its grid differs from that of the first."""
        if self._samples == 0:
            shape = pattern.theta_gain_dbi.shape
            self._angles_deg = pattern.theta_deg, pattern.phi_deg
            self._sum, self._min, self._max = np.zeros(shape), np.full(shape, np.inf), np.zeros(shape)
            if self._with_quantiles:
                self._counts = np.zeros((*shape, _BINS), np.uint32)
        elif pattern.theta_gain_dbi.shape != self._sum.shape:
            raise ValueError(
                f"a pattern of {pattern.theta_gain_dbi.shape} directions among {self._sum.shape}"
            )
        gain = pattern.gain
        self._samples += 1
        self._sum += gain
        np.minimum(self._min, gain, out=self._min)
        np.maximum(self._max, gain, out=self._max)
        if self._with_quantiles:
            levels = np.floor((np.asarray(to_dbi(gain), float) - LEVELS_DBI[0]) / LEVEL_STEP_DB)
            bins = np.clip(levels, 0.0, _BINS - 1.0).astype(np.int64)
            by_direction = self._counts.reshape(-1, _BINS)
            by_direction[np.arange(bins.size), bins.ravel()] += 1

    def result(self) -> Envelope:
        """Return the envelope of the patterns so far; raises ValueError without any."""
        if self._samples == 0:
            raise ValueError("an envelope needs at least one pattern")
        theta_deg, phi_deg = self._angles_deg
        min_dbi, max_dbi = to_dbi(self._min), to_dbi(self._max)
        levels_dbi = self._quantile_levels_dbi() if self._with_quantiles else {}
        return Envelope(
            samples=self._samples, theta_deg=theta_deg, phi_deg=phi_deg,
            mean_dbi=to_dbi(self._sum / self._samples), min_dbi=min_dbi, max_dbi=max_dbi,
            quantiles_dbi={q: np.clip(level, min_dbi, max_dbi) for q, level in levels_dbi.items()},
        )  # fmt: skip

    def _quantile_levels_dbi(self) -> dict[float, Array]:
        """Return quantiles (T, P) by `QUANTILES`; computed row by row to save memory."""
        levels_dbi = {q: np.empty(self._counts.shape[:2]) for q in QUANTILES}
        for t, counts in enumerate(self._counts):
            up_to = np.cumsum(counts, axis=-1, dtype=np.uint32)
            for q in QUANTILES:
                rank, part = divmod(q * (self._samples - 1), 1.0)
                below, above = (
                    _sorted_gain_dbi(counts, up_to, min(int(rank) + more, self._samples - 1))
                    for more in (0, 1)
                )
                levels_dbi[q][t] = (1.0 - part) * below + part * above
        return levels_dbi


def _sorted_gain_dbi(counts: NDArray[np.uint32], up_to: NDArray[np.uint32], rank: int) -> Array:
    """Return (P,) the gain of index ``rank`` of the sorted gains; gains are evenly spread within a bin."""
    bins = (up_to <= rank).sum(axis=-1)[:, None]
    inside = np.take_along_axis(counts, bins, axis=-1)[:, 0].astype(float)
    before = np.take_along_axis(up_to, bins, axis=-1)[:, 0] - inside
    return np.asarray(LEVELS_DBI[0] + LEVEL_STEP_DB * (bins[:, 0] + (rank - before + 0.5) / inside), float)


def gain_towards_dbi(patterns: Sequence[Pattern], theta_deg: float, phi_deg: float) -> Array:
    """Return the total gains (K,) in one direction, of patterns on one grid.

    Between directions of the grid they are interpolated by polynomials of the linear gain through the eight
    nearest ones along theta and along phi, continued over the poles. Patterns without gain below the horizon
    are continued there by their mirror image.
    """
    if not patterns:
        return np.empty(0)
    grounded = _ends_at_horizon(patterns[0])
    if grounded and theta_deg > 90.0:
        return np.full(len(patterns), FLOOR_DBI)
    step_deg = float(patterns[0].theta_deg[1])
    intervals, turn = len(patterns[0].theta_deg) - 1, len(patterns[0].phi_deg)
    rows, row_weights = _lagrange(theta_deg / step_deg)
    columns, column_weights = _lagrange(phi_deg / step_deg)
    over = (rows < 0) | (rows > intervals)
    rows = np.where(over, np.where(rows < 0, -rows, 2 * intervals - rows), rows)
    column_of = (columns[None, :] + np.where(over, turn // 2, 0)[:, None]) % turn
    rows = np.minimum(rows, intervals - rows) if grounded else rows
    weights = row_weights[:, None] * column_weights
    near = [p.theta_gain_dbi[rows[:, None], column_of] for p in patterns]
    near_phi = [p.phi_gain_dbi[rows[:, None], column_of] for p in patterns]
    gains = from_dbi(np.array(near, float)) + from_dbi(np.array(near_phi, float))
    return np.asarray(to_dbi(np.maximum((gains * weights).sum(axis=(1, 2)), 0.0)), float)


def refined_gain_dbi(pattern: Pattern, step_deg: float) -> tuple[Array, Array, Array]:
    """Return theta (T',), phi (P',) from 0 to 360, both included, and the total gain (T', P') between them.

    The directions are at most ``step_deg`` apart; interpolated and continued as in `gain_towards_dbi`, and
    at most the pattern's maximum.
    """
    times = math.ceil(float(pattern.theta_deg[1]) / step_deg - 1e-9)
    gain, grounded, half = pattern.gain, _ends_at_horizon(pattern), _AROUND // 2
    intervals, turn = len(gain) - 1, gain.shape[1]
    if grounded:
        rows = np.arange(intervals + 1)
        gain = gain[np.minimum(rows, intervals - rows)]
    over = np.roll(gain, turn // 2, axis=1)  # across a pole
    gain = np.concatenate([over[half:0:-1], gain, over[-2 : -half - 2 : -1]])
    gain = np.take(gain, np.arange(-half, turn + half + 1), axis=1, mode="wrap")
    gain = _between(_between(gain, times).T, times).T
    theta_deg = np.linspace(0.0, 180.0, intervals * times + 1)
    gain_dbi = np.minimum(to_dbi(np.maximum(gain, 0.0)), pattern.max_gain_dbi)
    if grounded:
        gain_dbi[theta_deg > 90.0] = FLOOR_DBI
    return theta_deg, np.linspace(0.0, 360.0, turn * times + 1), gain_dbi


def _between(rows: Array, times: int) -> Array:
    """Return rows at ``times`` points per interval, without the half of `_AROUND` nodes at each end."""
    intervals = len(rows) - 1 - _AROUND
    fine = np.empty((intervals * times + 1, rows.shape[1]))
    for part in range(times):
        nodes, weights = _lagrange(_AROUND // 2 + part / times)
        part_of_fine = fine[part::times]
        part_of_fine[:] = 0.0
        for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
            part_of_fine += weight * rows[node : node + len(part_of_fine)]
    return fine


def _ends_at_horizon(pattern: Pattern) -> bool:
    below = len(pattern.theta_deg) // 2 + 1
    grids = (pattern.theta_gain_dbi, pattern.phi_gain_dbi)
    return all(bool((grid[below:] <= FLOOR_DBI).all()) for grid in grids)


def _lagrange(at: float) -> tuple[NDArray[np.int64], Array]:
    """Return the nodes around a position and their Lagrange interpolation weights."""
    nodes = int(np.floor(at)) - _AROUND // 2 + 1 + np.arange(_AROUND)
    weights = np.ones(_AROUND)
    for i in range(_AROUND):
        for j in range(_AROUND):
            if i != j:
                weights[i] *= (at - nodes[j]) / (nodes[i] - nodes[j])
    return nodes, weights


def pointing_errors_deg(patterns: Sequence[Pattern], theta_deg: float, phi_deg: float) -> Array:
    """Return the angles (K,), 0 to 180, between the direction of each maximum and the nominal one."""
    at = np.radians([(pattern.max_theta_deg, pattern.max_phi_deg) for pattern in patterns]).reshape(-1, 2)
    theta, phi = np.radians(theta_deg), np.radians(phi_deg)
    # half angles, since an arc cosine is inaccurate for small angles
    square = (
        np.sin((at[:, 0] - theta) / 2.0) ** 2
        + np.sin(at[:, 0]) * np.sin(theta) * np.sin((at[:, 1] - phi) / 2.0) ** 2
    )
    return np.asarray(np.degrees(2.0 * np.arcsin(np.sqrt(np.minimum(square, 1.0)))))


def pointing_statistics(errors_deg: Array) -> PointingStatistics:
    """Return the statistics of (K,) angles; raises ValueError without any."""
    if len(errors_deg) == 0:
        raise ValueError("statistics need at least one direction")
    return PointingStatistics(
        samples=len(errors_deg), mean_deg=float(np.mean(errors_deg)),
        rms_deg=float(np.sqrt(np.mean(errors_deg**2))), max_deg=float(np.max(errors_deg)),
        quantiles_deg=dict(zip(QUANTILES, np.quantile(errors_deg, QUANTILES).tolist(), strict=True)),
    )  # fmt: skip
