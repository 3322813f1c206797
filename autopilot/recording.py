"""What one vehicle records of itself: a row of fixed layout per period, later laid beside the truth."""

from typing import TYPE_CHECKING, Any

import numpy as np

from autopilot.config import Site
from autopilot.mavlink.codec import Message
from autopilot.navigation.geodesy import geodetic_to_ned
from autopilot.types import Array, EstimatorState

if TYPE_CHECKING:
    from autopilot.vehicle import Vehicle

VEHICLE_RECORD = np.dtype(
    [
        ("time_us", "i8"),
        ("armed", "?"),
        ("mode", "u4"),
        ("phase", "u1"),
        ("landed", "?"),
        ("failsafe", "?"),
        ("causes", "u4"),
        ("battery_remaining", "f4"),
        ("estimator_pos_ned_m", "f8", 3),
        ("estimator_vel_ned_m_s", "f4", 3),
        ("estimator_q_ned_frd", "f4", 4),
        ("gps_pos_ned_m", "f8", 3),
        ("onboard_pos_ned_m", "f8", 3),
        ("onboard_pos_std_m", "f4", 3),
        ("correction_ned_m", "f4", 3),
        ("odometry_offset_ned_m", "f4", 3),
        ("setpoint_pos_ned_m", "f8", 3),
    ]
)
"""Positions are in the site's frame and NaN while not known. ``mode`` is PX4's custom mode, ``phase`` the
on-board application's (255 without one), ``causes`` the bits of `autopilot.commander.failsafe.Cause`. The
estimator's and the setpoint's height is over the ground of the start, as the barometer gives it: the origin's
GPS altitude is left out. ``gps_pos_ned_m`` is the last fix, of 0.12 s before it came. ``correction_ned_m`` is
what the application takes off the estimator's position to get its own; ``odometry_offset_ned_m`` is the part
of that which ranging and everybody's GPS make, and stands still while nothing comes over the radio."""

NO_PHASE = 255
LEAST_FIX_TYPE = 3
"""GPS_FIX_TYPE_3D_FIX"""
_UNKNOWN = np.full(3, np.nan)


class SiteFrame:
    """The site's NED frame as one vehicle needs it; keeps results, since origin and fixes change rarely."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._origin_deg = (np.nan, np.nan)
        self._origin_ned_m = _UNKNOWN
        self._fix: Message | None = None
        self._fix_ned_m = _UNKNOWN

    def origin_ned_m(self, state: EstimatorState) -> Array:
        """(3,) what to add to a position from the estimator's origin; its height stays as it is."""
        origin_deg = (state.origin_lat_deg, state.origin_lon_deg)
        if origin_deg != self._origin_deg:
            self._origin_deg = origin_deg
            self._origin_ned_m = self._ned_m(*origin_deg, self._site.altitude_m)
            self._origin_ned_m[2] = 0.0
        return self._origin_ned_m

    def fix_ned_m(self, gps: Message | None) -> Array:
        """(3,) where a HIL_GPS puts the vehicle; NaN without one, or if it has no fix in three dimensions."""
        if gps is not None and gps is not self._fix:
            self._fix = gps
            if gps.fix_type < LEAST_FIX_TYPE:
                self._fix_ned_m = _UNKNOWN
            else:
                self._fix_ned_m = self._ned_m(gps.lat * 1e-7, gps.lon * 1e-7, gps.alt * 1e-3)
        return self._fix_ned_m

    def _ned_m(self, lat_deg: float, lon_deg: float, alt_m: float) -> Array:
        return geodetic_to_ned(
            lat_deg,
            lon_deg,
            alt_m,
            origin_lat_deg=self._site.latitude_deg,
            origin_lon_deg=self._site.longitude_deg,
            origin_alt_m=self._site.altitude_m,
        )


def record(vehicle: "Vehicle") -> tuple[Any, ...]:
    """Row of `VEHICLE_RECORD` of the vehicle as it is after its last step."""
    flight, app = vehicle.flight, vehicle.app
    state = flight.state
    origin_ned_m = vehicle.site.origin_ned_m(state) if flight.origin_known else _UNKNOWN
    setpoint_ned_m = _UNKNOWN
    setpoint = flight.setpoint
    if setpoint is not None and setpoint.pos_ned_m is not None:
        setpoint_ned_m = setpoint.pos_ned_m + origin_ned_m
        if not all(setpoint.pos_axes):
            setpoint_ned_m[[not axis for axis in setpoint.pos_axes]] = np.nan
    estimate = app.estimate if app is not None and flight.origin_known else None
    return (
        flight.now_us,
        flight.commander.armed,
        flight.commander.mode.custom_mode,
        int(app.phase) if app is not None else NO_PHASE,
        flight.commander.landed,
        flight.commander.failsafe,
        flight.causes,
        flight.battery.remaining,
        state.pos_ned_m + origin_ned_m,
        state.vel_ned_m_s.copy(),
        state.q_ned_frd.copy(),
        vehicle.site.fix_ned_m(flight.gps),
        estimate.pos_ned_m if estimate is not None else _UNKNOWN,
        estimate.std_ned_m if estimate is not None else _UNKNOWN,
        estimate.correction_ned_m if estimate is not None else _UNKNOWN,
        estimate.odometry_offset_ned_m if estimate is not None else _UNKNOWN,
        setpoint_ned_m,
    )
