"""Geodetic positions in the NED frames of one vehicle: that of its estimator, and that of the site."""

import math

from autopilot.mavlink.codec import Message
from autopilot.parameters.config import Site
from foundation.geometry.geodesy import geodetic_to_ned, ned_to_geodetic, place_ned_m
from foundation.types import Array, EstimatorState, Vector

LEAST_FIX_TYPE = 3
"""GPS_FIX_TYPE_3D_FIX"""
UNKNOWN_NED_M: Vector = (math.nan, math.nan, math.nan)


def horizontal_ned_m(lat_deg: float, lon_deg: float, state: EstimatorState) -> Array:
    """(2,) north and east of the estimator's origin in metres, in its tangent plane."""
    ned_m = geodetic_to_ned(
        lat_deg,
        lon_deg,
        state.origin_alt_m,
        origin_lat_deg=state.origin_lat_deg,
        origin_lon_deg=state.origin_lon_deg,
        origin_alt_m=state.origin_alt_m,
    )
    return ned_m[:2]


def geodetic(pos_ned_m: Array, state: EstimatorState) -> tuple[float, float, float]:
    """Latitude and longitude in degrees and altitude of a position (3,) from the estimator's origin."""
    lat_deg, lon_deg, alt_m = ned_to_geodetic(
        pos_ned_m,
        origin_lat_deg=state.origin_lat_deg,
        origin_lon_deg=state.origin_lon_deg,
        origin_alt_m=state.origin_alt_m,
    )
    return float(lat_deg), float(lon_deg), float(alt_m)


def site_ned_m(site: Site, lat_deg: float, lon_deg: float, alt_m: float) -> Vector:
    """Return a position, with its altitude above mean sea level, in the site's NED frame."""
    place: Vector = place_ned_m(
        lat_deg, lon_deg, alt_m, site.latitude_deg, site.longitude_deg, site.altitude_m
    )
    return place


def message_ned_m(site: Site, lat_deg_e7: int, lon_deg_e7: int, alt_mm: int) -> Vector:
    """Return the same of a position in the integers of MAVLink."""
    return site_ned_m(site, lat_deg_e7 * 1e-7, lon_deg_e7 * 1e-7, alt_mm * 1e-3)


class SiteFrame:
    """Converts to the site's NED frame; caches results, because origin and fixes change rarely."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._origin_deg = (math.nan, math.nan)
        self._origin_ned_m = UNKNOWN_NED_M
        self._fix: Message | None = None
        self._fix_ned_m = UNKNOWN_NED_M

    def origin_ned_m(self, state: EstimatorState) -> Vector:
        """Return the position of the estimator's origin, to be added to positions from it; height 0."""
        origin_deg = (state.origin_lat_deg, state.origin_lon_deg)
        if origin_deg != self._origin_deg:
            self._origin_deg = origin_deg
            north_m, east_m, _ = site_ned_m(self._site, *origin_deg, self._site.altitude_m)
            self._origin_ned_m = (north_m, east_m, 0.0)
        return self._origin_ned_m

    def fix_ned_m(self, gps: Message | None) -> Vector:
        """Return the position of a HIL_GPS; NaN without a message or a 3D fix."""
        if gps is not None and gps is not self._fix:
            self._fix = gps
            if gps.fix_type < LEAST_FIX_TYPE:
                self._fix_ned_m = UNKNOWN_NED_M
            else:
                self._fix_ned_m = message_ned_m(self._site, gps.lat, gps.lon, gps.alt)
        return self._fix_ned_m
