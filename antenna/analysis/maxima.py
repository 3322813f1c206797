"""Maximum gain of a pattern between grid directions, for solvers that return only gains.

The search starts at every local maximum of the grid that may belong to the highest lobe, and uses quadratics
through 3 x 3 directions in the tangent plane. The result is a computed gain, not the value of a quadratic, so
it never exceeds the true maximum.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from antenna.model.geometry import Array

Index = NDArray[np.int64]
Gains = NDArray[np.floating]
"""Gains of a solver, in its precision."""
GainAt = Callable[[Array, Array], Array]
"""Function that returns gains in dBi in directions theta_deg and phi_deg, all of one shape."""

PEAK_CANDIDATES = 16
"""Most grid maxima that are refined: the whole equator of a single dipole is maximal."""
REFINED_TO_DEG = 0.1
"""Spacing at which the refinement ends."""
NEGLIGIBLE_DB = 1e-4
"""Gain improvements below this are ignored."""
STEPS = 24
"""Most iterations: four shrink a grid of 5 degrees, the others move across it."""

_STENCIL = np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
_A, _B = _STENCIL.T
_QUADRATIC_FIT = np.linalg.pinv(np.stack([np.ones(9), _A, _B, _A * _A, _A * _B, _B * _B], axis=1))
_MIDDLE = 4


class Maximum(NamedTuple):
    """The highest gain of a pattern."""

    gain_dbi: float
    theta_deg: float
    """0 to 180."""
    phi_deg: float
    """0 to 360, excluded."""


def find_maximum(gain_dbi: Array, gain_at: GainAt, margin_db: float) -> Maximum:
    """Return the maximum of a pattern (T, P) on a grid of `directions_deg`.

    The search starts at the grid's local maxima within ``margin_db`` of the highest, since that one may not
    belong to the highest lobe. Raises ValueError without a finite gain.
    """
    highest = float(np.nanmax(gain_dbi, initial=-np.inf))
    if not math.isfinite(highest):
        raise ValueError("a pattern without a finite gain has no maximum")
    step_deg = 180.0 / (len(gain_dbi) - 1)
    row, column = np.empty((2, PEAK_CANDIDATES), np.int64)
    count = peaks(np.ascontiguousarray(gain_dbi, float), highest - margin_db, row, column)
    gain, theta_deg, phi_deg = _climb(
        np.asarray(row[:count] * step_deg), np.asarray(column[:count] * step_deg), step_deg, gain_at
    )
    best = int(gain.argmax())
    return Maximum(float(gain[best]), float(theta_deg[best]), float(phi_deg[best]))


@njit(cache=True, nogil=True, error_model="numpy")
def peaks(gain: Gains, least: float, row: Index, column: Index) -> int:
    """Write the indices of a grid's (T, P) highest local maxima of at least ``least``; return their number.

    Gains are linear or in decibels. ``row`` and ``column`` have `PEAK_CANDIDATES` entries, highest first.
    """
    rows, columns = gain.shape
    count = 0
    for t in range(rows):
        pole = t in (0, rows - 1)
        for p in range(1 if pole else columns):  # a pole is one direction, with a ring of neighbours
            value = gain[t, p]
            if not value >= least:
                continue
            peak = True
            if pole:
                ring = 1 if t == 0 else rows - 2
                for q in range(columns):
                    peak = peak and value >= gain[ring, q]
            else:
                for dt in (-1, 0, 1):
                    for dp in (-1, 0, 1):
                        peak = peak and value >= gain[t + dt, (p + dp) % columns]
            if not peak:
                continue
            place = count
            while place > 0 and gain[row[place - 1], column[place - 1]] < value:
                place -= 1
            if place >= PEAK_CANDIDATES:
                continue
            count = min(count + 1, PEAK_CANDIDATES)
            for k in range(count - 1, place, -1):
                row[k], column[k] = row[k - 1], column[k - 1]
            row[place], column[place] = t, p
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def grid_loss_db(step_rad: float, centres_m: Array, wavelength_m: float) -> float:
    """Return an upper bound of the difference between a lobe's maximum and its highest grid value.

    At a maximum of |sum exp(j k r.p_i)|^2, relative to it, the curvature along a direction is -2 k^2 times
    the variance of the p_i along it, which is at most their mean square distance from their centre; the 1 is
    the dipole's own sine. Half a cell's diagonal away the loss is therefore the expression below; elements
    that do not add up in phase bend a lobe more, hence the doubling.
    """
    n = len(centres_m)
    square_m2 = 0.0
    for x in range(3):
        mean_m = 0.0
        for i in range(n):
            mean_m += centres_m[i, x] / n
        for i in range(n):
            square_m2 += (centres_m[i, x] - mean_m) ** 2 / n
    loss_nepers = 0.5 * step_rad**2 * ((2.0 * math.pi / wavelength_m) ** 2 * square_m2 + 1.0)
    return 2.0 * 10.0 / math.log(10.0) * loss_nepers


def _climb(theta_deg: Array, phi_deg: Array, step_deg: float, gain_at: GainAt) -> tuple[Array, Array, Array]:
    """Return gain_dbi, theta_deg and phi_deg of the nearest maxima to C directions."""
    best = np.stack([np.full(len(theta_deg), -np.inf), theta_deg, phi_deg])
    at = np.stack([theta_deg, phi_deg]).astype(float)
    spacing_deg = np.full(len(theta_deg), step_deg / 2.0)
    active = np.arange(len(theta_deg))
    for _ in range(STEPS):
        if len(active) == 0:
            break
        offsets_deg = spacing_deg[active, None, None] * _STENCIL
        theta, phi = offset(
            at[0, active, None], at[1, active, None], offsets_deg[..., 0], offsets_deg[..., 1]
        )
        gains = gain_at(theta, phi)
        top = gains.argmax(axis=1)
        rows = np.arange(len(active))
        highest = np.stack([gains[rows, top], theta[rows, top], phi[rows, top]])
        better = highest[0] > best[0, active]
        best[:, active[better]] = highest[:, better]
        inside, vertex = _vertices(gains)
        steps_deg = spacing_deg[active, None] * vertex
        new_theta, new_phi = offset(at[0, active], at[1, active], steps_deg[:, 0], steps_deg[:, 1])
        shrink = inside | (gains[rows, top] - gains[:, _MIDDLE] < NEGLIGIBLE_DB)
        at[0, active] = np.where(inside, new_theta, highest[1])
        at[1, active] = np.where(inside, new_phi, highest[2])
        spacing_deg[active[shrink]] /= 4.0
        active = active[spacing_deg[active] >= REFINED_TO_DEG]
    last = gain_at(at[0], at[1])
    better = last > best[0]
    best[:, better] = np.stack([last, at[0], at[1]])[:, better]
    return best[0], best[1], best[2] % 360.0


def _vertices(gains: Array) -> tuple[NDArray[np.bool_], Array]:
    """Return whether quadratics through gains (C, 9) have a maximum inside, and where (C, 2), in spacings."""
    fit = gains @ _QUADRATIC_FIT.T
    g_a, g_b, h_aa, h_ab, h_bb = fit[:, 1], fit[:, 2], 2.0 * fit[:, 3], fit[:, 4], 2.0 * fit[:, 5]
    determinant = h_aa * h_bb - h_ab * h_ab
    domed = (h_aa + h_bb < -1e-12) & (determinant > 1e-24)
    safe = np.where(domed, determinant, 1.0)
    vertex = np.stack([(h_ab * g_b - h_bb * g_a) / safe, (h_ab * g_a - h_aa * g_b) / safe], axis=1)
    inside = domed & (np.abs(vertex).max(axis=1) <= 1.0)
    return inside, np.where(inside[:, None], vertex, 0.0)


def offset(theta_deg: Array, phi_deg: Array, south_deg: Array, east_deg: Array) -> tuple[Array, Array]:
    """Return directions at offsets in the planes tangent at (theta, phi): theta 0 to 180, phi 0 to 360."""
    theta, phi, a, b = (np.radians(angle) for angle in (theta_deg, phi_deg, south_deg, east_deg))
    outward = np.sin(theta) + a * np.cos(theta)
    x, y = outward * np.cos(phi) - b * np.sin(phi), outward * np.sin(phi) + b * np.cos(phi)
    z = np.cos(theta) - a * np.sin(theta)
    return np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x)) % 360.0
