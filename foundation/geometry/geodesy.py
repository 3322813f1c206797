"""Conversion between geodetic coordinates (WGS 84) and a local north-east-down frame.

The NED frame is the tangent plane at its origin (no map projection): distances in it are Euclidean distances,
and the two conversions are inverses. Altitude is used as height above the ellipsoid, since the geoid
undulation is constant over a flight and cancels. Pure functions; points may be arrays of any common shape.
"""

import math
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SEMI_MAJOR_AXIS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257_223_563
_ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
_SEMI_MINOR_AXIS_M = SEMI_MAJOR_AXIS_M * (1.0 - FLATTENING)
_SECOND_ECCENTRICITY_SQUARED = _ECCENTRICITY_SQUARED / (1.0 - _ECCENTRICITY_SQUARED)


@njit(cache=True)
def place_ned_m(
    lat_deg: float, lon_deg: float, alt_m: float,
    origin_lat_deg: float, origin_lon_deg: float, origin_alt_m: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the NED position in metres, from the origin, of one geodetic point of finite numbers.

    The result equals that of `geodetic_to_ned` except for rounding, in a twentieth of its time; for single
    points such as GPS fixes.
    """
    x_m, y_m, z_m = _ecef_m(math.radians(lat_deg), math.radians(lon_deg), alt_m)
    lat_rad, lon_rad = math.radians(origin_lat_deg), math.radians(origin_lon_deg)
    from_x_m, from_y_m, from_z_m = _ecef_m(lat_rad, lon_rad, origin_alt_m)
    x_m, y_m, z_m = x_m - from_x_m, y_m - from_y_m, z_m - from_z_m
    sin_lat, cos_lat = math.sin(lat_rad), math.cos(lat_rad)
    sin_lon, cos_lon = math.sin(lon_rad), math.cos(lon_rad)
    outwards_m = cos_lon * x_m + sin_lon * y_m
    return (
        cos_lat * z_m - sin_lat * outwards_m,
        cos_lon * y_m - sin_lon * x_m,
        -cos_lat * outwards_m - sin_lat * z_m,
    )


@njit(cache=True, inline="always")
def _ecef_m(lat_rad: float, lon_rad: float, alt_m: float) -> tuple[float, float, float]:
    sin_lat, cos_lat = math.sin(lat_rad), math.cos(lat_rad)
    prime_vertical_m = SEMI_MAJOR_AXIS_M / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * sin_lat * sin_lat)
    from_axis_m = (prime_vertical_m + alt_m) * cos_lat
    z_m = (prime_vertical_m * (1.0 - _ECCENTRICITY_SQUARED) + alt_m) * sin_lat
    return from_axis_m * math.cos(lon_rad), from_axis_m * math.sin(lon_rad), z_m


def geodetic_to_ned(
    lat_deg: ArrayLike,
    lon_deg: ArrayLike,
    alt_m: ArrayLike,
    *,
    origin_lat_deg: float,
    origin_lon_deg: float,
    origin_alt_m: float,
) -> Array:
    """Return NED positions (..., 3) in metres, from the origin, of geodetic points of common shape (...)."""
    origin_ecef_m, dcm_ned_ecef = _origin(origin_lat_deg, origin_lon_deg, origin_alt_m)
    offset_ecef_m = (
        _geodetic_to_ecef(np.radians(lat_deg), np.radians(lon_deg), np.asarray(alt_m, float)) - origin_ecef_m
    )
    return offset_ecef_m @ dcm_ned_ecef.T


def ned_to_geodetic(
    pos_ned_m: ArrayLike, *, origin_lat_deg: float, origin_lon_deg: float, origin_alt_m: float
) -> tuple[Array, Array, Array]:
    """Return latitude, longitude (degrees) and altitude (metres), each (...), of NED positions (..., 3).

    One step of Bowring's formula ("Transformation from spatial to geographical coordinates", 1976); the
    round-trip error is below a micrometre up to 1 km from the origin.
    """
    origin_ecef_m, dcm_ned_ecef = _origin(origin_lat_deg, origin_lon_deg, origin_alt_m)
    ecef_m = np.asarray(pos_ned_m, float) @ dcm_ned_ecef + origin_ecef_m
    x_m, y_m, z_m = ecef_m[..., 0], ecef_m[..., 1], ecef_m[..., 2]
    from_axis_m = np.hypot(x_m, y_m)
    parametric_rad = np.arctan2(z_m * SEMI_MAJOR_AXIS_M, from_axis_m * _SEMI_MINOR_AXIS_M)
    lat_rad = np.arctan2(
        z_m + _SECOND_ECCENTRICITY_SQUARED * _SEMI_MINOR_AXIS_M * np.sin(parametric_rad) ** 3,
        from_axis_m - _ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS_M * np.cos(parametric_rad) ** 3,
    )
    sin_lat, cos_lat = np.sin(lat_rad), np.cos(lat_rad)
    # projection on the local vertical: unlike p / cos(lat) - N, it is well-conditioned at the poles
    alt_m = (
        from_axis_m * cos_lat
        + z_m * sin_lat
        - SEMI_MAJOR_AXIS_M * np.sqrt(1.0 - _ECCENTRICITY_SQUARED * sin_lat**2)
    )
    return np.degrees(lat_rad), np.degrees(np.arctan2(y_m, x_m)), alt_m


@lru_cache(maxsize=8)
def _origin(lat_deg: float, lon_deg: float, alt_m: float) -> tuple[Array, Array]:
    """Return the origin (3,) in metres and the axes (3, 3) of a NED frame in ECEF; cached."""
    ecef_m = _geodetic_to_ecef(np.radians(lat_deg), np.radians(lon_deg), np.float64(alt_m))
    dcm_ned_ecef = _dcm_ned_ecef(lat_deg, lon_deg)
    for array in (ecef_m, dcm_ned_ecef):
        array.setflags(write=False)
    return ecef_m, dcm_ned_ecef


def _geodetic_to_ecef(
    lat_rad: Array | np.float64, lon_rad: Array | np.float64, alt_m: Array | np.float64
) -> Array:
    sin_lat, cos_lat = np.sin(lat_rad), np.cos(lat_rad)
    prime_vertical_m = SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - _ECCENTRICITY_SQUARED * sin_lat**2)
    from_axis_m = (prime_vertical_m + alt_m) * cos_lat
    z_m = (prime_vertical_m * (1.0 - _ECCENTRICITY_SQUARED) + alt_m) * sin_lat
    ecef_m = np.empty((*np.broadcast(lat_rad, lon_rad, alt_m).shape, 3))
    ecef_m[..., 0], ecef_m[..., 1], ecef_m[..., 2] = (
        from_axis_m * np.cos(lon_rad),
        from_axis_m * np.sin(lon_rad),
        z_m,
    )
    return ecef_m


def _dcm_ned_ecef(lat_deg: float, lon_deg: float) -> Array:
    """Return the matrix (3, 3) whose rows are north, east and down at a point, in ECEF axes."""
    sin_lat, cos_lat = np.sin(np.radians(lat_deg)), np.cos(np.radians(lat_deg))
    sin_lon, cos_lon = np.sin(np.radians(lon_deg)), np.cos(np.radians(lon_deg))
    return np.array(
        [
            [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            [-sin_lon, cos_lon, 0.0],
            [-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat],
        ]
    )
