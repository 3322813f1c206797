"""What one vehicle records of itself: a row of fixed layout per period, later laid beside the truth."""

import math
from struct import Struct
from typing import TYPE_CHECKING

import numpy as np

from autopilot.config import Site
from autopilot.mavlink.codec import Message
from foundation.geometry.geodesy import place_ned_m
from foundation.types import EstimatorState, Vector

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

_ROW = Struct("<q?IB??If" + "3d3f4f" + "3d3d" + "3f3f3f" + "3d")
"""The same row for `struct`: a tenth of what numpy takes to make one of a tuple with arrays in it."""
_SINGLE_MAX = 3.402823e38
"""What is beyond that `struct` does not take for a float32: an estimate gone wild is still written down."""

NO_PHASE = 255
LEAST_FIX_TYPE = 3
"""GPS_FIX_TYPE_3D_FIX"""
_UNKNOWN: Vector = (math.nan, math.nan, math.nan)


class SiteFrame:
    """The site's NED frame as one vehicle needs it; keeps results, since origin and fixes change rarely."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._origin_deg = (math.nan, math.nan)
        self._origin_ned_m = _UNKNOWN
        self._fix: Message | None = None
        self._fix_ned_m = _UNKNOWN

    def origin_ned_m(self, state: EstimatorState) -> Vector:
        """What to add to a position from the estimator's origin; its height stays as it is."""
        origin_deg = (state.origin_lat_deg, state.origin_lon_deg)
        if origin_deg != self._origin_deg:
            self._origin_deg = origin_deg
            north_m, east_m, _ = self._ned_m(*origin_deg, self._site.altitude_m)
            self._origin_ned_m = (north_m, east_m, 0.0)
        return self._origin_ned_m

    def fix_ned_m(self, gps: Message | None) -> Vector:
        """Where a HIL_GPS puts the vehicle; NaN without one, or if it has no fix in three dimensions."""
        if gps is not None and gps is not self._fix:
            self._fix = gps
            if gps.fix_type < LEAST_FIX_TYPE:
                self._fix_ned_m = _UNKNOWN
            else:
                self._fix_ned_m = self._ned_m(gps.lat * 1e-7, gps.lon * 1e-7, gps.alt * 1e-3)
        return self._fix_ned_m

    def _ned_m(self, lat_deg: float, lon_deg: float, alt_m: float) -> Vector:
        site = self._site
        place: Vector = place_ned_m(
            lat_deg, lon_deg, alt_m, site.latitude_deg, site.longitude_deg, site.altitude_m
        )
        return place


def record(vehicle: "Vehicle") -> bytes:
    """Row of `VEHICLE_RECORD` of the vehicle as it is after its last step."""
    flight, app = vehicle.flight, vehicle.app
    state, commander = flight.state, flight.commander
    north_m, east_m, down_m = state.pos_ned_m.tolist()
    vel_ned_m_s, q_ned_frd = state.vel_ned_m_s.tolist(), state.q_ned_frd.tolist()
    origin_n_m, origin_e_m, origin_d_m = _UNKNOWN
    believed_ned_m = std_ned_m = correction_ned_m = odometry_offset_ned_m = _UNKNOWN
    if flight.origin_known:
        origin_n_m, origin_e_m, origin_d_m = vehicle.site.origin_ned_m(state)
        if app is not None:
            believed_ned_m, std_ned_m, correction_ned_m, odometry_offset_ned_m = app.estimate(flight.now_us)
    setpoint_n_m, setpoint_e_m, setpoint_d_m = _UNKNOWN
    setpoint = flight.setpoint
    if setpoint is not None and setpoint.pos_ned_m is not None:
        holds_n, holds_e, holds_d = setpoint.pos_axes
        n_m, e_m, d_m = setpoint.pos_ned_m
        setpoint_n_m = n_m if holds_n else math.nan
        setpoint_e_m = e_m if holds_e else math.nan
        setpoint_d_m = d_m if holds_d else math.nan
    singles = [*vel_ned_m_s, *q_ned_frd]
    if not (min(singles) >= -_SINGLE_MAX and max(singles) <= _SINGLE_MAX):
        singles = [min(max(value, -_SINGLE_MAX), _SINGLE_MAX) for value in singles]
    return _ROW.pack(
        flight.now_us, commander.armed, commander.mode.custom_mode,
        int(app.phase) if app is not None else NO_PHASE,
        commander.landed, commander.failsafe, flight.causes, flight.battery.remaining,
        north_m + origin_n_m, east_m + origin_e_m, down_m + origin_d_m, *singles,
        *vehicle.site.fix_ned_m(flight.gps), *believed_ned_m,
        *std_ned_m, *correction_ned_m, *odometry_offset_ned_m,
        setpoint_n_m + origin_n_m, setpoint_e_m + origin_e_m, setpoint_d_m + origin_d_m,
    )  # fmt: skip
