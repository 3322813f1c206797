"""Features of patterns that the article discusses in figure 4: main lobe, symmetry, a region of low gain.

Directions are weighted by their solid angle. Gains are total, in dBi, on the pattern's grid.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from antenna.analysis.features import main_lobe
from antenna.analysis.gain_figures import GAIN_RANGE_DBI
from antenna.analysis.patterns import FLOOR_DBI, HALF_POWER_DB, Pattern, from_dbi, to_dbi
from foundation.types import Array

REGION_THETA_DEG, REGION_PHI_DEG = (0.0, 45.0), (180.0, 225.0)
"""Region in which the article finds less gain than ideal, bounds included"""
LEVEL_DBI = -10.0
"""Lower gains are set to this value, because the depth of nulls is irrelevant."""
COLOUR_FLOOR_DBI, COLOUR_TOP_DBI = GAIN_RANGE_DBI
_EDGE_DEG = 1e-6


class PatternReading(Struct, frozen=True, kw_only=True):
    """Features of one pattern, some relative to the ideal one."""

    max_gain_dbi: float
    lobe_sr: float
    """Solid angle of the main lobe above half of its own maximum."""
    effective_lobe_sr: float
    """Solid angle of the main lobe above half of the ideal maximum."""
    region_dbi: float
    """Mean gain of the article's region."""
    region_max_dbi: float
    region_colour_db: float
    """Mean of its gain in decibels, limited to the lowest colour of the article's figure."""
    region_lower_share: float
    """Part, 0 to 1, of the region with less than the ideal gain."""
    asymmetry_db: float
    """Rms difference from the mirror image in x, the broadside axis."""
    lower_share: float
    """Part, 0 to 1, of the directions with an ideal gain above `LEVEL_DBI` that have less gain."""
    difference_db: float
    """Rms difference from the ideal pattern."""
    mean_dbi: float
    """Mean gain over all directions: radiated over input power."""


def read_pattern(pattern: Pattern, ideal: Pattern) -> PatternReading:
    """Return the features of a pattern; raises ValueError if the grids differ."""
    if pattern.theta_gain_dbi.shape != ideal.theta_gain_dbi.shape:
        raise ValueError(f"a pattern of {pattern.theta_gain_dbi.shape} directions, ideal pattern of "
                         f"{ideal.theta_gain_dbi.shape}")  # fmt: skip
    weights = solid_angles_sr(pattern.theta_deg, pattern.phi_deg)
    gain_dbi, ideal_dbi = pattern.gain_dbi, ideal.gain_dbi
    region = in_region(pattern)
    counted = np.where(ideal_dbi > LEVEL_DBI, weights, 0.0)
    return PatternReading(
        max_gain_dbi=pattern.max_gain_dbi,
        lobe_sr=lobe_sr(pattern, pattern.max_gain_dbi - HALF_POWER_DB),
        effective_lobe_sr=lobe_sr(pattern, ideal.max_gain_dbi - HALF_POWER_DB),
        region_dbi=mean_gain_dbi(gain_dbi, np.where(region, weights, 0.0)),
        region_max_dbi=float(gain_dbi[region].max()),
        region_colour_db=float(
            np.average(np.maximum(gain_dbi, COLOUR_FLOOR_DBI)[region], weights=weights[region])
        ),
        region_lower_share=float(np.average((gain_dbi < ideal_dbi)[region], weights=weights[region])),
        asymmetry_db=difference_db(gain_dbi, mirrored(gain_dbi), weights),
        lower_share=float((counted * (gain_dbi < ideal_dbi)).sum() / counted.sum()),
        difference_db=difference_db(gain_dbi, ideal_dbi, weights),
        mean_dbi=mean_gain_dbi(gain_dbi, weights),
    )


def solid_angles_sr(theta_deg: Array, phi_deg: Array) -> Array:
    """Return the solid angle (T, P) of each direction of a pattern's grid; the sum is 4 pi."""
    step = np.radians(theta_deg[1] - theta_deg[0])
    theta = np.radians(theta_deg)
    upper, lower = np.maximum(theta - step / 2.0, 0.0), np.minimum(theta + step / 2.0, np.pi)
    bands = (np.cos(upper) - np.cos(lower)) * 2.0 * np.pi / len(phi_deg)
    return np.asarray(np.repeat(bands[:, None], len(phi_deg), axis=1))


def in_region(pattern: Pattern) -> NDArray[np.bool_]:
    """Return whether directions (T, P) are in the article's region."""
    theta, phi = (
        (angles >= low - _EDGE_DEG) & (angles <= high + _EDGE_DEG)
        for angles, (low, high) in (
            (pattern.theta_deg, REGION_THETA_DEG), (pattern.phi_deg, REGION_PHI_DEG),
        )
    )  # fmt: skip
    inside: NDArray[np.bool_] = theta[:, None] & phi[None, :]
    return inside


def mean_gain_dbi(gain_dbi: Array, weights: Array) -> float:
    """Return the mean of the linear gain in decibels."""
    return float(to_dbi(np.atleast_1d(np.average(from_dbi(gain_dbi), weights=weights)))[0])


def mirrored(gain_dbi: Array) -> Array:
    """Return the gains (T, P) with x inverted: phi becomes 180 degrees less phi."""
    columns = gain_dbi.shape[1]
    return np.asarray(gain_dbi[:, (columns // 2 - np.arange(columns)) % columns])


def difference_db(gain_dbi: Array, other_dbi: Array, weights: Array) -> float:
    """Return the rms difference of gains limited to `LEVEL_DBI`, where one is above it; 0 if none is."""
    one, other = np.maximum(gain_dbi, LEVEL_DBI), np.maximum(other_dbi, LEVEL_DBI)
    counted = np.where(np.maximum(one, other) > LEVEL_DBI, weights, 0.0)
    total = counted.sum()
    return float(np.sqrt((counted * (one - other) ** 2).sum() / total)) if total > 0.0 else 0.0


def lobe_sr(pattern: Pattern, level_dbi: float) -> float:
    """Return the solid angle above a level that is connected with the maximum."""
    inside = main_lobe(replace(pattern, max_gain_dbi=level_dbi + HALF_POWER_DB))
    return float(solid_angles_sr(pattern.theta_deg, pattern.phi_deg)[inside].sum())


def mean_pattern(patterns: Iterable[Pattern]) -> Pattern | None:
    """Return the pattern of the mean power density, without polarisation; None without patterns.

    The patterns are consumed one at a time. Raises ValueError if their grids differ.
    """
    total, count, first = np.empty((0, 0)), 0, None
    for pattern in patterns:
        if first is None:
            total, first = np.zeros(pattern.gain.shape), pattern
        elif pattern.gain.shape != total.shape:
            raise ValueError(f"a pattern of {pattern.gain.shape} directions among {total.shape}")
        total, count = total + pattern.gain, count + 1
    if first is None:
        return None
    mean_dbi = np.asarray(to_dbi(total / count))
    row, column = np.unravel_index(int(mean_dbi.argmax()), mean_dbi.shape)
    weights = solid_angles_sr(first.theta_deg, first.phi_deg)
    return replace(
        first, theta_gain_dbi=mean_dbi, phi_gain_dbi=np.full_like(mean_dbi, FLOOR_DBI),
        max_gain_dbi=float(mean_dbi[row, column]), max_theta_deg=float(first.theta_deg[row]),
        max_phi_deg=float(first.phi_deg[column]),
        average_gain=float((from_dbi(mean_dbi) * weights).sum() / weights.sum()),
    )  # fmt: skip
