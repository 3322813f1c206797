"""Gain and polarisation between half-wave dipoles that tilt with their vehicles.

A dipole's far field in direction u is F(c) (z - c u), where z is its axis, c = z . u and F(c) = cos(pi c / 2)
/ (1 - c^2) (Balanis, Antenna Theory, 4.6). The field that one dipole receives from another is the scalar
product of both vectors, which includes pattern and polarisation.

Real antennas do not have the infinitely deep nulls of that formula. Currents on feed line and airframe also
radiate in all directions and polarisations, about 20 dB below the peak; data sheets of small antennas state
this as cross-polar isolation, and measured patterns show it in the nulls. So each dipole has in addition an
unpolarised field with `UNPOLARISED` times the peak power in every direction, of which a polarised antenna
receives half. Compared to two upright dipoles side by side, the loss is 20 dB for two crossed ones, 23 dB if
one points at the other, and 43 dB if both point at each other.
"""

from math import pi

import numpy as np

from netsim.phy.interfaces import AntennaPattern
from netsim.phy.path_loss import Doubles, GroundRay

UNPOLARISED = 0.01
_PEAK = 1.0 + UNPOLARISED + 0.5 * UNPOLARISED**2
"""Power between two dipoles in their peak directions; all results are divided by it."""


class Dipole:
    """Selects half-wave dipoles along the bodies' z axes, which couple as in this module."""


def rotations_ned_frd(q_ned_frd: Doubles) -> Doubles:
    """Return the rotations (n, 3, 3) from FRD to NED of quaternions (n, 4), wxyz.

    The third column is the body's z axis in NED. Quaternions are normalised.
    """
    lengths = np.sqrt(np.einsum("ij,ij->i", q_ned_frd, q_ned_frd))
    w, x, y, z = (q_ned_frd / np.maximum(lengths, 1e-12)[:, None]).T
    columns = (
        (w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), w * w - x * x - y * y + z * z),
    )
    return np.array(columns).transpose(2, 1, 0)


def pattern_gain_db(pattern: AntennaPattern, directions_ned: Doubles, rotations: Doubles) -> Doubles:
    """Return the gains (m, n) in dB of m antennas with a pattern in directions (m, n, 3) in NED.

    ``rotations`` (m, 3, 3) are those of `rotations_ned_frd`.
    """
    return pattern.gain_db(np.einsum("ijk,ikl->ijl", directions_ned, rotations))


def _strength(cosine: Doubles) -> Doubles:
    """Return F(c) of the module docstring; it multiplies a vector of length sqrt(1 - c^2)."""
    return np.asarray(np.cos(0.5 * pi * cosine) / np.maximum(1.0 - cosine * cosine, 1e-12))


def _unpolarised(strength_a: Doubles, cosine_a: Doubles, strength_b: Doubles, cosine_b: Doubles) -> Doubles:
    """Return the power by the unpolarised part of either end: half of e (g_a + g_b + e)."""
    gain_a = strength_a * strength_a * (1.0 - cosine_a * cosine_a)
    gain_b = strength_b * strength_b * (1.0 - cosine_b * cosine_b)
    return 0.5 * UNPOLARISED * (gain_a + gain_b + UNPOLARISED) / _PEAK


def direct_coupling(direction_ned: Doubles, from_axes: Doubles, to_axes: Doubles) -> tuple[Doubles, Doubles]:
    """Return the polarised field (m, n) from m dipoles to n, and the unpolarised power, both at most 1.

    ``direction_ned`` (m, n, 3) are unit vectors from those with axes (m, 3) in NED to those with axes (n, 3).
    """
    cosine_a = np.einsum("ijk,ik->ij", direction_ned, from_axes)
    cosine_b = np.einsum("ijk,jk->ij", direction_ned, to_axes)
    strength_a, strength_b = _strength(cosine_a), _strength(cosine_b)
    field = strength_a * strength_b * (from_axes @ to_axes.T - cosine_a * cosine_b) / _PEAK**0.5
    return field, _unpolarised(strength_a, cosine_a, strength_b, cosine_b)


def reflected_coupling(
    ray: GroundRay, from_axes: Doubles, to_axes: Doubles
) -> tuple[Doubles, Doubles, Doubles]:
    """Return the ground-reflected fields of vertical and horizontal polarisation, and the unpolarised power.

    All are (m, n), from m dipoles to n, as in `direct_coupling`. With n the horizontal direction, the ray
    leaves along (cos n, -sin up) and arrives along (cos n, sin up). Its vertical unit vectors are
    (sin n, cos up) before and (-sin n, cos up) after the reflection.
    """
    north, east = ray.across_ned[..., 0], ray.across_ned[..., 1]
    (north_a, east_a, down_a), (north_b, east_b, down_b) = from_axes.T[..., None], to_axes.T
    ahead_a, side_a, up_a = north * north_a + east * east_a, north * east_a - east * north_a, -down_a
    ahead_b, side_b, up_b = north * north_b + east * east_b, north * east_b - east * north_b, -down_b
    cosine_a = ray.cosine * ahead_a - ray.sine * up_a
    cosine_b = ray.cosine * ahead_b + ray.sine * up_b
    strength_a, strength_b = _strength(cosine_a), _strength(cosine_b)
    both = strength_a * strength_b / _PEAK**0.5
    vertical = (ray.sine * ahead_a + ray.cosine * up_a) * (ray.cosine * up_b - ray.sine * ahead_b)
    return (both * vertical, both * side_a * side_b, _unpolarised(strength_a, cosine_a, strength_b, cosine_b))


def unpolarised_source_coupling(direction_ned: Doubles, to_axes: Doubles) -> Doubles:
    """Return the power (m, n) that dipoles receive from sources of unknown polarisation: half their gain."""
    cosine = np.einsum("ijk,jk->ij", direction_ned, to_axes)
    strength = _strength(cosine)
    gain = strength * strength * (1.0 - cosine * cosine)
    return np.asarray(0.5 * (gain + UNPOLARISED) / _PEAK)
