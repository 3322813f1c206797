"""Expected gain of the array for a position error, from a table in studies/reference; see its README."""

import math
from functools import cache
from typing import Any

import numpy as np
from msgspec import Struct
from scipy.interpolate import PchipInterpolator

from studies.antenna.sensitivity import reference_rows

IDEAL_DBI = 13.26
"""Gain of the ideal array with short dipoles by NEC2, at any wavelength"""


class Expected(Struct, frozen=True):
    """Maximum gain for independent Gaussian position errors."""

    mean_dbi: float
    std_db: float


@cache
def _curves() -> tuple[Any, Any, float]:
    rows = {row.sigma_m / row.wavelength_m: (row.mean_max_gain_dbi, row.std_db) for row in reference_rows()}
    sigmas, values = zip((0.0, (IDEAL_DBI, 0.0)), *sorted(rows.items()), strict=True)
    means, stds = np.array(values).T
    return PchipInterpolator(sigmas, means), PchipInterpolator(sigmas, stds), sigmas[-1]


def expected_gain(sigma_m: float, wavelength_m: float) -> Expected:
    """Return the maximum gain of the 4 x 2 array with errors of ``sigma_m`` on each axis of its elements.

    It depends on sigma over lambda only. Mean and deviation are interpolated by monotone cubics between the
    ratios of the table, and constant beyond the last one.
    """
    if not math.isfinite(sigma_m) or sigma_m < 0.0 or not wavelength_m > 0.0:
        raise ValueError(
            f"sigma_m {sigma_m}, wavelength_m {wavelength_m}: expected a length and a wavelength"
        )
    mean, std, last = _curves()
    ratio = min(sigma_m / wavelength_m, last)
    return Expected(float(mean(ratio)), float(std(ratio)))


def per_axis_sigma_m(shape_rms_m: float, vehicles: int) -> float:
    """Return the standard deviation per horizontal axis of independent errors with this rms after alignment.

    The alignment removes 3 of the 2 N degrees of freedom (a translation and a turn), so the mean square of a
    vehicle's remaining horizontal distance is 2 sigma^2 (1 - 3 / (2 N)).
    """
    if vehicles < 2:
        raise ValueError(f"{vehicles} vehicles: the alignment requires at least two")
    return shape_rms_m / math.sqrt(2.0 - 3.0 / vehicles)


def vertical_sigma_m(vertical_rms_m: float, vehicles: int) -> float:
    """Return the same for heights about their mean, which removes one of N degrees of freedom."""
    if vehicles < 2:
        raise ValueError(f"{vehicles} vehicles: the alignment requires at least two")
    return vertical_rms_m / math.sqrt(1.0 - 1.0 / vehicles)
