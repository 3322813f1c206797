"""Path loss: Friis, and the two-ray model with a smooth ground.

All gains are relative to isotropic antennas in free space at 1 m; below 1 m the gain is that of 1 m. The
ground is the plane NED z = 0, smooth and infinite: relief, vegetation and the Earth's curvature are not
modelled.
"""

from math import log10, pi

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

SPEED_OF_LIGHT_M_S = 299_792_458.0
REFERENCE_DISTANCE_M = 1.0
LEAST_HEIGHT_M = 0.1
"""Least height of an antenna above ground, about that of a vehicle on its landing gear."""

Doubles = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def friis_loss_db(distance_m: float, frequency_mhz: float) -> float:
    """Return the free-space path loss between isotropic antennas, dB."""
    return 20.0 * log10(4.0 * pi * distance_m * frequency_mhz * 1e6 / SPEED_OF_LIGHT_M_S)


def ground_permittivity(frequency_mhz: float) -> complex:
    """Return the complex permittivity of medium dry ground, fitted to 1 to 10 GHz (ITU-R P.2040-3, table 3).

    Real part 15 f^-0.1, conductivity 0.035 f^1.63 S/m with f in GHz; imaginary part 17.98 sigma / f.
    """
    f_ghz = frequency_mhz * 1e-3
    return complex(15.0 * f_ghz**-0.1, -17.98 * 0.035 * f_ghz**1.63 / f_ghz)


class PowerLaw(Struct, frozen=True):
    """Path loss of Friis at 1 m, from where the power falls with the distance to the power of -``exponent``.

    `netsim.phy.propagation` computes it in a kernel if nothing else shapes the gains.
    """

    exponent: float


class TwoRay(Struct, frozen=True, kw_only=True):
    """Path loss of the direct and the ground-reflected ray, which antennas weight separately."""

    frequency_mhz: float
    bandwidth_mhz: float

    @property
    def permittivity(self) -> complex:
        """Complex permittivity of the ground."""
        return ground_permittivity(self.frequency_mhz)


class GroundRay(Struct, frozen=True, kw_only=True):
    """Geometry of the ground-reflected rays from m positions to n positions."""

    across_ned: Doubles
    """(m, n, 2) horizontal unit vectors from source to receiver, north and east."""
    distance_m: Doubles
    """(m, n) length of the ray."""
    detour_m: Doubles
    """(m, n) length minus that of the direct ray."""
    sine: Doubles
    """(m, n) sine of the angle between ray and ground."""
    cosine: Doubles
    """(m, n) cosine of that angle."""


def ground_ray(from_ned_m: Doubles, to_ned_m: Doubles, direct_m: Doubles) -> GroundRay:
    """Return the rays reflected at z = 0, from the mirror images of ``from_ned_m`` (m, 3)."""
    across_m = to_ned_m[:, :2] - from_ned_m[:, None, :2]
    horizontal_m = np.sqrt(np.einsum("ijk,ijk->ij", across_m, across_m))
    from_m = np.maximum(-from_ned_m[:, 2:], LEAST_HEIGHT_M)
    to_m = np.maximum(-to_ned_m[:, 2], LEAST_HEIGHT_M)
    sum_m = from_m + to_m
    distance_m = np.hypot(horizontal_m, sum_m)
    across_m[horizontal_m == 0.0] = (1.0, 0.0)  # arbitrary direction for vertical rays
    return GroundRay(
        across_ned=across_m / np.where(horizontal_m == 0.0, 1.0, horizontal_m)[..., None],
        distance_m=distance_m,
        # the difference of the squares is 4 h1 h2, exactly
        detour_m=4.0 * from_m * to_m / (distance_m + np.maximum(direct_m, REFERENCE_DISTANCE_M)),
        sine=sum_m / distance_m,
        cosine=horizontal_m / distance_m,
    )


def reflection(permittivity: complex, ray: GroundRay) -> tuple[Complexes, Complexes]:
    """Return the Fresnel coefficients of the electric field for vertical and horizontal polarisation.

    Vertical fields are positive upwards before and after: a perfect conductor has +1 and -1.
    """
    root = np.sqrt(permittivity - ray.cosine * ray.cosine)
    vertical = (permittivity * ray.sine - root) / (permittivity * ray.sine + root)
    return vertical, (ray.sine - root) / (ray.sine + root)


def two_ray_gain(
    direct_m: Doubles,
    ray: GroundRay,
    direct_field: Doubles | float,
    reflected_field: Complexes,
    frequency_mhz: float,
    bandwidth_mhz: float,
) -> Doubles:
    """Return the total power gain of both rays, averaged over the channel.

    ``direct_field`` and ``reflected_field`` are the field gains by antennas and ground, 1 for none. Over a
    channel of width B the phase of the product of the fields rotates with the detour D, so its mean is the
    value at the centre times sin(x) / x, x = pi B D / c. An 80 MHz channel has no deep notches for a detour
    of 3.7 m or more.
    """
    direct = direct_field / np.maximum(direct_m, REFERENCE_DISTANCE_M)
    reflected = reflected_field / np.maximum(ray.distance_m, REFERENCE_DISTANCE_M)
    turns = ray.detour_m * (1e6 / SPEED_OF_LIGHT_M_S)
    product = np.real(reflected * np.exp(-2j * pi * frequency_mhz * turns))
    x = np.maximum(pi * bandwidth_mhz * turns, 1e-9)
    return np.asarray(
        direct * direct + np.abs(reflected) ** 2 + 2.0 * direct * product * (np.sin(x) / x), dtype=np.float64
    )
