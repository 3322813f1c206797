"""Far-field patterns as data: the grid of directions, the average gain, and the maximum beyond the grid.

Nothing here knows a solver: a backend gives gains on the grid and, for the maximum, in single directions.
Angles have the article's convention: theta from +z, phi from +x towards +y.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from antenna.geometry import Array, Snapshot

GainAt = Callable[[float, float], float]
"""Gain in dBi in the direction (theta_deg, phi_deg); theta and phi may leave their ranges."""

PEAK_CANDIDATES = 16
"""Grid maxima that are refined at most: a lone dipole's equator is one long maximum."""
REFINED_TO_DEG = 0.1
"""Spacing at which the refinement ends."""
NEGLIGIBLE_DB = 1e-4
"""A gain that is higher by less is no reason to go there."""

_STENCIL = np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
_A, _B = _STENCIL.T
_QUADRATIC_FIT = np.linalg.pinv(np.stack([np.ones(9), _A, _B, _A * _A, _A * _B, _B * _B], axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Power gain of an array over the whole sphere."""

    theta_deg: Array
    """(T,) from 0 to 180, both included, evenly spaced."""
    phi_deg: Array
    """(P,) from 0, included, to 360, excluded, evenly spaced."""
    gain_dbi: Array
    """(T, P) total gain over input power; a solver's floor (NEC2: -999.99) where nothing is radiated."""
    max_gain_dbi: float
    """Over all directions, not only the grid's."""
    max_theta_deg: float
    """0 to 180."""
    max_phi_deg: float
    """0 to 360, excluded."""
    average_gain: float
    """Radiated over input power, linear: 1 for a lossless array in free space but for the solver's own error.
    Gain over this is directivity."""


def directions_deg(step_deg: float) -> tuple[Array, Array]:
    """Angles theta (T,) and phi (P,) of the coarsest grid with equal steps of at most ``step_deg``."""
    intervals = math.ceil(180.0 / step_deg - 1e-9)
    return np.linspace(0.0, 180.0, intervals + 1), np.linspace(0.0, 360.0, 2 * intervals, endpoint=False)


def make_pattern(gain_dbi: Array, gain_at: GainAt, snapshot: Snapshot, wavelength_m: float) -> Pattern:
    """Complete a backend's gains (T, P) on a grid of `directions_deg` to a pattern."""
    theta_deg, phi_deg = directions_deg(180.0 / (len(gain_dbi) - 1))
    margin_db = _grid_loss_db(float(theta_deg[1]), snapshot, wavelength_m)
    max_gain_dbi, max_theta_deg, max_phi_deg = find_maximum(gain_dbi, gain_at, margin_db)
    return Pattern(
        theta_deg=theta_deg,
        phi_deg=phi_deg,
        gain_dbi=gain_dbi,
        max_gain_dbi=max_gain_dbi,
        max_theta_deg=max_theta_deg,
        max_phi_deg=max_phi_deg,
        average_gain=sphere_average(10.0 ** (gain_dbi / 10.0)),
    )


def sphere_average(values: Array) -> float:
    """Mean over the sphere of (T, P) values on a grid of `directions_deg`.

    Clenshaw-Curtis quadrature in theta, whose nodes an even grid in theta has: exact up to degree T - 1
    in cos(theta) and order P - 1 in phi.
    """
    n = len(values) - 1
    j = np.arange(1, n // 2 + 1)
    factor = np.where(2 * j == n, 1.0, 2.0) / (4.0 * j * j - 1.0)
    weights = (2.0 - 2.0 * np.cos(2.0 * np.pi / n * np.outer(np.arange(n + 1), j)) @ factor) / n
    weights[[0, -1]] /= 2.0
    return float(weights @ values.mean(axis=1)) / 2.0


def find_maximum(gain_dbi: Array, gain_at: GainAt, margin_db: float) -> tuple[float, float, float]:
    """Maximum over the sphere (gain_dbi, theta_deg, phi_deg), from (T, P) gains on a `directions_deg` grid.

    Every local maximum of the grid within ``margin_db`` of the highest is climbed from, since the grid's
    highest need not belong to the highest lobe.
    """
    step_deg = 180.0 / (len(gain_dbi) - 1)
    peaks = gain_dbi == maximum_filter(gain_dbi, size=3, mode=("nearest", "wrap"))
    for pole, ring in ((0, 1), (-1, -2)):  # a pole is one direction, and all of its ring is beside it
        peaks[pole] = False
        peaks[pole, 0] = gain_dbi[pole, 0] >= gain_dbi[ring].max()
    peaks &= gain_dbi >= gain_dbi.max() - margin_db
    rows, columns = np.nonzero(peaks)
    highest_first = np.argsort(-gain_dbi[rows, columns], kind="stable")[:PEAK_CANDIDATES]
    climbs = (_climb(rows[i] * step_deg, columns[i] * step_deg, step_deg, gain_at) for i in highest_first)
    return max(climbs, key=lambda found: found[0])


def _grid_loss_db(step_deg: float, snapshot: Snapshot, wavelength_m: float) -> float:
    """How far the grid's value of a lobe may lie below the lobe's maximum, or a little further.

    At a maximum of |sum exp(j k r.p_i)|^2, relative to it, the curvature along a direction is -2 k^2 times
    the variance of the p_i along it; the 1 is the dipole's own sine. Half a cell's diagonal away the loss is
    therefore the expression below; elements that do not add up in phase bend a lobe more, hence the doubling.
    """
    offset_rad = math.radians(step_deg) / math.sqrt(2.0)
    centred_m = snapshot.centres_m - snapshot.centres_m.mean(axis=0)
    variance_m2 = np.linalg.eigvalsh(centred_m.T @ centred_m / len(centred_m))[-1]
    loss_nepers = offset_rad**2 * ((2.0 * math.pi / wavelength_m) ** 2 * float(variance_m2) + 1.0)
    return 2.0 * 10.0 / math.log(10.0) * loss_nepers


def _climb(theta_deg: float, phi_deg: float, step_deg: float, gain_at: GainAt) -> tuple[float, float, float]:
    """Nearest maximum to a direction, by quadratics through 3 x 3 directions in the tangent plane there.

    The value is a gain that was asked for, not the quadratic's: it never exceeds the true maximum.
    """
    best = (gain_at(theta_deg, phi_deg), theta_deg, phi_deg)
    spacing_deg = step_deg / 2.0
    for _ in range(24):  # four shrink a grid of 5 degrees; the others are for steps across it
        around = [_offset(theta_deg, phi_deg, *(spacing_deg * node)) for node in _STENCIL]
        gains = np.array([gain_at(*direction) for direction in around])
        top = int(np.argmax(gains))
        best = max(best, (float(gains[top]), *around[top]), key=lambda found: found[0])
        vertex = _vertex(gains)
        if vertex is None:
            if gains[top] - gains[len(gains) // 2] < NEGLIGIBLE_DB:
                spacing_deg /= 4.0
            theta_deg, phi_deg = around[top]
        else:
            theta_deg, phi_deg = _offset(theta_deg, phi_deg, *(spacing_deg * vertex))
            spacing_deg /= 4.0
        if spacing_deg < REFINED_TO_DEG:
            break
    return max(best, (gain_at(theta_deg, phi_deg), theta_deg, phi_deg), key=lambda found: found[0])


def _vertex(gains: Array) -> Array | None:
    """(2,) maximum of the quadratic through the stencil's gains, in spacings; None outside the stencil."""
    _, g_a, g_b, h_aa, h_ab, h_bb = _QUADRATIC_FIT @ gains
    hessian = np.array([[2.0 * h_aa, h_ab], [h_ab, 2.0 * h_bb]])
    if np.linalg.eigvalsh(hessian)[-1] >= -1e-12:
        return None
    vertex = -np.linalg.solve(hessian, np.array([g_a, g_b]))
    return vertex if np.abs(vertex).max() <= 1.0 else None


def _offset(theta_deg: float, phi_deg: float, south_deg: float, east_deg: float) -> tuple[float, float]:
    """Direction at these offsets in the plane tangent at (theta, phi): theta 0 to 180, phi 0 to 360."""
    theta, phi = math.radians(theta_deg), math.radians(phi_deg)
    a, b = math.radians(south_deg), math.radians(east_deg)
    outward = math.sin(theta) + a * math.cos(theta)
    x = outward * math.cos(phi) - b * math.sin(phi)
    y = outward * math.sin(phi) + b * math.cos(phi)
    z = math.cos(theta) - a * math.sin(theta)
    return math.degrees(math.atan2(math.hypot(x, y), z)), math.degrees(math.atan2(y, x)) % 360.0
