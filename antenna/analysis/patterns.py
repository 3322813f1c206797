"""Far-field patterns: gains on a grid of directions, with a refined maximum and the average gain.

A solver supplies partial gains on the grid and, for the maximum, gains in single directions. Angles follow
the article's convention: theta from +z, phi from +x towards +y.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from antenna.analysis.maxima import GainAt, Gains, find_maximum, grid_loss_db
from antenna.model.geometry import Array, Snapshot

FLOOR_DBI = -999.99
"""Value for zero gain, as in NEC2's tables."""
RESOLVED_BEYOND = 12.0
"""Additional degree beyond 2 k R: Bessel functions decay from there, as do the elements' patterns."""
FINEST_TIMES = 8
"""Largest refinement of a grid; the cost of a pattern grows with its square."""
DECIBEL = math.log(10.0) / 10.0
"""One decibel of power, in nepers."""
NOTHING = 2e-38
"""Linear gains below this count as 0; below normal numbers in single precision, above `FLOOR_DBI`."""
HALF_POWER_DB = 10.0 * math.log10(2.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Pattern:
    """Power gain of an array over the whole sphere."""

    theta_deg: Array
    """(T,) from 0 to 180, both included, evenly spaced."""
    phi_deg: Array
    """(P,) from 0, included, to 360, excluded, evenly spaced."""
    theta_gain_dbi: Array
    """(T, P) gain over input power in the theta polarisation (vertical at the horizon); `FLOOR_DBI` where
    nothing is radiated."""
    phi_gain_dbi: Array
    """(T, P) gain over input power in the phi polarisation (horizontal)."""
    max_gain_dbi: float
    """Maximum of the total gain over all directions, not only those of the grid."""
    max_theta_deg: float
    """0 to 180."""
    max_phi_deg: float
    """0 to 360, excluded."""
    average_gain: float
    """Radiated over input power, linear: 1 for a lossless array in free space, except for the solver's error.
    Directivity is gain over this value. Integrated on a grid that resolves the array, see `times_finer`."""
    backend: str
    """Name of the solver."""

    @property
    def gain(self) -> Array:
        """(T, P) total gain, linear."""
        return from_dbi(self.theta_gain_dbi) + from_dbi(self.phi_gain_dbi)

    @property
    def gain_dbi(self) -> Array:
        """(T, P) total gain."""
        return to_dbi(self.gain)


def from_dbi(gain_dbi: Array) -> Array:
    """Return linear gains; `FLOOR_DBI` becomes 0."""
    gain = np.asarray(np.exp(gain_dbi * DECIBEL))
    gain[gain < NOTHING] = 0.0
    return gain


def to_dbi(gain: Gains, out: Gains | None = None) -> Array:
    """Return gains in dBi, at least `FLOOR_DBI`, in ``out`` if given."""
    with np.errstate(divide="ignore"):
        gain_dbi = np.asarray(np.log10(gain, out=out))
    gain_dbi *= 10.0
    return np.asarray(np.maximum(gain_dbi, FLOOR_DBI, out=gain_dbi))


def directions_deg(step_deg: float) -> tuple[Array, Array]:
    """Return theta (T,) and phi (P,) of the coarsest grid with equal steps of at most ``step_deg``.

    The grid includes the horizon.
    """
    intervals = 2 * math.ceil(90.0 / step_deg - 1e-9)
    return np.linspace(0.0, 180.0, intervals + 1), np.linspace(0.0, 360.0, 2 * intervals, endpoint=False)


def make_pattern(
    gain_theta: Gains, gain_phi: Gains, gain_at: GainAt, snapshot: Snapshot, wavelength_m: float,
    backend: str, *, grounded: bool = False,
) -> Pattern:  # fmt: skip
    """Return the pattern of linear partial gains (T, P) on a grid of `directions_deg`.

    With ``grounded`` the gain below the horizon is 0; ``gain_at`` then returns the mirror image there, so
    that a maximum at the horizon has two sides.
    """
    theta_deg, phi_deg = directions_deg(180.0 / (len(gain_theta) - 1))
    total = gain_theta + gain_phi
    margin_db = grid_loss_db(math.radians(theta_deg[1]), snapshot.centres_m, wavelength_m)
    maximum = find_maximum(to_dbi(total), gain_at, margin_db)
    max_theta_deg = min(maximum.theta_deg, 180.0 - maximum.theta_deg) if grounded else maximum.theta_deg
    return Pattern(
        theta_deg=theta_deg, phi_deg=phi_deg,
        theta_gain_dbi=to_dbi(gain_theta), phi_gain_dbi=to_dbi(gain_phi),
        max_gain_dbi=maximum.gain_dbi, max_theta_deg=max_theta_deg, max_phi_deg=maximum.phi_deg,
        average_gain=float(total.mean(axis=1) @ row_weights(len(total), grounded=grounded)),
        backend=backend,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def times_finer(
    centres_m: Array, reach_m: float, wavelength_m: float, step_deg: float,
    grounded: bool,  # noqa: FBT001  # numba has no keyword-only arguments
) -> int:  # fmt: skip
    """Return the factor by which a grid must be finer than ``step_deg`` to resolve an array (n, 3).

    The intensity of an array within a radius R is about of degree 2 k R in the direction; images count.
    ``reach_m`` is the reach of an element from its centre. The factor is at most `FINEST_TIMES`: for a wider
    array, such as one with a lost vehicle, the highest lobe may be missed, and the average is approximate.
    """
    n, middle_m, radius_m2 = len(centres_m), np.zeros(3), 0.0
    for x in range(2 if grounded else 3):
        for i in range(n):
            middle_m[x] += centres_m[i, x] / n
    for i in range(n):
        apart_m2 = 0.0
        for x in range(3):
            apart_m2 += (centres_m[i, x] - middle_m[x]) ** 2
        radius_m2 = max(radius_m2, apart_m2)
    degree = 4.0 * math.pi * (math.sqrt(radius_m2) + reach_m) / wavelength_m + RESOLVED_BEYOND
    return int(min(max(math.ceil(degree * step_deg / 180.0), 1.0), FINEST_TIMES))


def decimated(pattern: Pattern, times: int) -> Pattern:
    """Return the pattern with every ``times``-th direction of its grid, along theta and phi."""
    if times == 1:
        return pattern
    return replace(
        pattern, theta_deg=pattern.theta_deg[::times], phi_deg=pattern.phi_deg[::times],
        theta_gain_dbi=pattern.theta_gain_dbi[::times, ::times].copy(),
        phi_gain_dbi=pattern.phi_gain_dbi[::times, ::times].copy(),
    )  # fmt: skip


def row_weights(rows: int, *, grounded: bool) -> Array:
    """Return the weights (T,) of the rows of a grid of `directions_deg` in the mean over the sphere.

    Clenshaw-Curtis quadrature in theta, exact up to degree T - 1 in cos(theta) and, with the mean over phi,
    order P - 1 in phi. With ``grounded`` the weights of the lower half are 0, and the upper half has those of
    a pattern that is continued smoothly by its mirror image.
    """
    n, half = rows - 1, rows // 2
    j = np.arange(1, half + 1)
    factor = np.where(2 * j == n, 1.0, 2.0) / (4.0 * j * j - 1.0)
    weights = (2.0 - 2.0 * np.cos(2.0 * np.pi / n * np.outer(np.arange(rows), j)) @ factor) / n
    weights[[0, -1]] /= 2.0
    if grounded:
        weights[half] *= 0.5
        weights[half + 1 :] = 0.0
    return np.asarray(weights / 2.0)
