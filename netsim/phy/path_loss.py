"""What distance takes: power laws, and the two-ray model of a smooth ground under both antennas.

All gains are against what isotropic antennas in free space lose over 1 m, and nearer than 1 m as at 1 m. The
ground is the plane NED z = 0. It is smooth and endless: relief, vegetation and the Earth's curvature are left
out.
"""

from math import log10, pi

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

SPEED_OF_LIGHT_M_S = 299_792_458.0
REFERENCE_DISTANCE_M = 1.0
LEAST_HEIGHT_M = 0.1
"""Of an antenna over the ground: on its legs a vehicle's stands about so high, wherever its centre is."""

Vector = tuple[float, float, float]
Doubles = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def friis_loss_db(distance_m: float, frequency_mhz: float) -> float:
    """Free-space path loss between isotropic antennas."""
    return 20.0 * log10(4.0 * pi * distance_m * frequency_mhz * 1e6 / SPEED_OF_LIGHT_M_S)


def ground_permittivity(frequency_mhz: float) -> complex:
    """Complex relative permittivity of medium dry ground, fitted to 1 to 10 GHz (ITU-R P.2040-3, table 3).

    Real part 15 f^-0.1, conductivity 0.035 f^1.63 S/m with f in GHz; imaginary part 17.98 sigma / f.
    """
    f_ghz = frequency_mhz * 1e-3
    return complex(15.0 * f_ghz**-0.1, -17.98 * 0.035 * f_ghz**1.63 / f_ghz)


class GroundRay(Struct, frozen=True, kw_only=True):
    """Geometry of the rays that the ground reflects, from m places to n places."""

    across_ned: Doubles
    """(m, n, 2) horizontal unit vectors from the one place to the other, north and east."""
    distance_m: Doubles
    """(m, n) along the ray."""
    detour_m: Doubles
    """(m, n) longer than the direct ray."""
    sine: Doubles
    """(m, n) of the angle between ray and ground."""
    cosine: Doubles
    """(m, n) of the same."""


def ground_ray(from_ned_m: Doubles, to_ned_m: Doubles, direct_m: Doubles) -> GroundRay:
    """Reflect at z = 0: rays seem to come from the images of ``from_ned_m`` (m, 3) under the ground."""
    across_m = to_ned_m[:, :2] - from_ned_m[:, None, :2]
    horizontal_m = np.sqrt(np.einsum("ijk,ijk->ij", across_m, across_m))
    from_m = np.maximum(-from_ned_m[:, 2:], LEAST_HEIGHT_M)
    to_m = np.maximum(-to_ned_m[:, 2], LEAST_HEIGHT_M)
    sum_m = from_m + to_m
    distance_m = np.hypot(horizontal_m, sum_m)
    across_m[horizontal_m == 0.0] = (1.0, 0.0)  # straight below each other any direction will do
    return GroundRay(
        across_ned=across_m / np.where(horizontal_m == 0.0, 1.0, horizontal_m)[..., None],
        distance_m=distance_m,
        # the difference of the squares is 4 h1 h2, exactly
        detour_m=4.0 * from_m * to_m / (distance_m + np.maximum(direct_m, REFERENCE_DISTANCE_M)),
        sine=sum_m / distance_m,
        cosine=horizontal_m / distance_m,
    )


def reflection(permittivity: complex, ray: GroundRay) -> tuple[Complexes, Complexes]:
    """Fresnel's coefficients of the electric field, vertical and horizontal polarisation.

    Vertical fields count as positive upwards before and after, so that a perfect conductor has +1 and -1.
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
    """Power of both rays' fields together, averaged over the channel.

    ``direct_field`` and ``reflected_field`` say what antennas and ground make of each ray's field, 1 if
    nothing. Over a channel of width B the product of the fields turns with the detour D, so that its mean is
    the one at the centre times sin(x) / x, x = pi B D / c: an 80 MHz channel has no deep notches any more
    where the rays are 3.7 m apart.
    """
    direct = direct_field / np.maximum(direct_m, REFERENCE_DISTANCE_M)
    reflected = reflected_field / np.maximum(ray.distance_m, REFERENCE_DISTANCE_M)
    turns = ray.detour_m * (1e6 / SPEED_OF_LIGHT_M_S)
    product = np.real(reflected * np.exp(-2j * pi * frequency_mhz * turns))
    x = np.maximum(pi * bandwidth_mhz * turns, 1e-9)
    return np.asarray(
        direct * direct + np.abs(reflected) ** 2 + 2.0 * direct * product * (np.sin(x) / x), dtype=np.float64
    )
