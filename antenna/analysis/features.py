"""Features of a pattern: half-power widths of the main lobe, side lobes, back lobe, null, ambiguity."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import label, maximum_filter
from scipy.optimize import brentq

from antenna.analysis.patterns import HALF_POWER_DB, Pattern, from_dbi
from antenna.model.geometry import Array

_BEYOND = 3
"""Rows beyond a pole by which a grid is continued on its other side."""
LEAST_STEPS = 2.0
"""Least width of a lobe, in steps of the grid, that splines resolve; the error is 1 % from here on."""
ALIKE_DB = 1e-4
"""Gains that differ by less are equal: the difference is below a solver's error."""
BROADEST_DEG = 20.0
"""Largest angle between directions of equal gain that belong to one maximum: along the axis of two elements
in end-fire the gain falls with the fourth power of the angle and reaches `ALIKE_DB` at 6 degrees."""


@dataclass(frozen=True, slots=True)
class Features:
    """Features of one pattern; None where not defined."""

    azimuth_width_deg: float | None
    """Angle between the half-power directions at the maximum's theta; None at a pole, if all gains are above
    half power, or if it has less than `LEAST_STEPS` steps of the grid."""
    elevation_width_deg: float | None
    """Likewise on the great circle through the poles and the maximum."""
    side_lobe_dbi: float | None
    """Highest maximum of the grid outside the main lobe; None without one, or if that is not resolved."""
    back_dbi: float
    """Gain opposite to the maximum; over a ground at the same elevation."""
    null_dbi: float
    """Least gain at the horizon, on the grid."""


def features(pattern: Pattern) -> Features:
    """Return the features of a pattern by cubic splines of the linear gain; over a ground lobes end there."""
    gain = from_dbi(pattern.gain_dbi)
    grounded = not gain[len(gain) // 2 + 1 :].any()
    at = _above_ground(pattern, gain) if grounded else _interpolated(pattern, gain)
    theta, phi = pattern.max_theta_deg, pattern.max_phi_deg
    half = 10.0 ** ((pattern.max_gain_dbi - HALF_POWER_DB) / 10.0)
    step_deg = float(pattern.theta_deg[1])
    lobe = main_lobe(pattern)
    tops = _tops(gain) & ~lobe
    resolved = bool(lobe.any())
    at_a_pole = min(theta, 180.0 - theta) < 1e-3
    horizon = gain[len(gain) // 2]
    azimuth_deg = elevation_deg = side_lobe_dbi = None
    if resolved and not at_a_pole:
        azimuth_deg = _width_deg(lambda off: at(theta, phi + off) - half, step_deg)
    if resolved:
        elevation_deg = _width_deg(lambda off: at(theta + off, phi) - half, step_deg)
        side_lobe_dbi = _dbi(float(gain[tops].max())) if tops.any() else None
    back_dbi = _dbi(at(theta if grounded else 180.0 - theta, phi + 180.0))
    return Features(azimuth_deg, elevation_deg, side_lobe_dbi, back_dbi, _dbi(float(horizon.min())))


def main_lobe(pattern: Pattern) -> NDArray[np.bool_]:
    """Return (T, P) which grid directions are within half power of the maximum and connected with it.

    There are none if the grid is so coarse that the direction nearest to the maximum is below half power.
    """
    high = pattern.gain_dbi >= pattern.max_gain_dbi - HALF_POWER_DB
    lobes, _ = label(
        np.tile(high, (1, 3))
    )  # a lobe across phi = 0 is complete in the middle one of three turns
    turn = len(pattern.phi_deg)
    row = int(np.argmin(np.abs(pattern.theta_deg - pattern.max_theta_deg)))
    column = turn + int(np.argmin(np.abs(pattern.phi_deg - pattern.max_phi_deg)))
    inside = lobes == (lobes[row, column] or -1)
    lobe: NDArray[np.bool_] = inside.reshape(len(lobes), 3, turn).any(axis=1)
    return lobe


def has_one_maximum(pattern: Pattern) -> bool:
    """Whether all grid directions of maximum gain, within `ALIKE_DB`, are close to each other.

    If not, the direction of the maximum is ambiguous, as for a ring or two mirror images.
    """
    gain_dbi = pattern.gain_dbi
    row, column = np.nonzero(gain_dbi >= gain_dbi.max() - ALIKE_DB)
    theta, phi = np.radians(pattern.theta_deg[row]), np.radians(pattern.phi_deg[column])
    towards = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    apart_deg = np.degrees(np.arccos(np.minimum(towards[:, 0] @ towards, 1.0)))
    across_cell_deg = 1.5 * float(pattern.theta_deg[1])  # the corners of a cell around a maximum may be equal
    return bool(apart_deg.max() <= max(BROADEST_DEG, across_cell_deg))


def _tops(gain: Array) -> NDArray[np.bool_]:
    """Return (T, P) which directions are local maxima; the neighbours of a pole are a whole ring."""
    tops: NDArray[np.bool_] = (gain > 0.0) & (gain == maximum_filter(gain, size=3, mode=("nearest", "wrap")))
    for pole, ring in ((0, 1), (-1, -2)):
        tops[pole] = gain[pole].max() > 0.0 and gain[pole].max() >= gain[ring].max()
    return tops


def _above_ground(pattern: Pattern, gain: Array) -> Callable[[float, float], float]:
    """Return the gain at any theta and phi, 0 below the horizon.

    The grid is continued below by its mirror image, since a spline would oscillate at the jump.
    """
    half_rows = len(gain) // 2
    mirrored = _interpolated(pattern, np.concatenate([gain[: half_rows + 1], gain[:half_rows][::-1]]))
    return lambda theta, phi: mirrored(theta, phi) if abs((theta + 180.0) % 360.0 - 180.0) <= 90.0 else 0.0


def _interpolated(pattern: Pattern, gain: Array) -> Callable[[float, float], float]:
    """Return the gain at any theta and phi, continued over the poles and periodic in phi."""
    rows, columns = gain.shape
    opposite = np.roll(gain, columns // 2, axis=1)
    upper, lower = opposite[1 : _BEYOND + 1][::-1], opposite[-_BEYOND - 1 : -1][::-1]
    tall = np.concatenate([upper, gain, lower])
    wide = np.concatenate([tall[:, -_BEYOND:], tall, tall[:, : _BEYOND + 1]], axis=1)
    step_deg = float(pattern.theta_deg[1])
    theta_deg = step_deg * np.arange(-_BEYOND, rows + _BEYOND)
    phi_deg = step_deg * np.arange(-_BEYOND, columns + _BEYOND + 1)
    spline = RectBivariateSpline(theta_deg, phi_deg, wide, kx=3, ky=3)

    def at(theta: float, phi: float) -> float:
        theta %= 360.0
        if theta > 180.0:
            theta, phi = 360.0 - theta, phi + 180.0
        return float(spline(theta, phi % 360.0)[0, 0])

    return at


def _width_deg(excess: Callable[[float], float], step_deg: float) -> float | None:
    """Return the angle between the first zeros on either side of 0; None without zeros within half a turn.

    Also None if they are less than `LEAST_STEPS` apart.
    """
    found = []
    for sign in (1.0, -1.0):
        for k in range(int(180.0 / step_deg)):
            if excess(sign * (k + 1) * step_deg) < 0.0 <= excess(sign * k * step_deg):
                found.append(abs(brentq(excess, sign * k * step_deg, sign * (k + 1) * step_deg)))
                break
    width_deg = sum(found)
    return width_deg if len(found) == 2 and width_deg >= LEAST_STEPS * step_deg else None


def _dbi(gain: float) -> float:
    """Return a gain in dBi, at least -120: splines may be negative between the grid's directions."""
    return float(10.0 * np.log10(max(gain, 1e-12)))
