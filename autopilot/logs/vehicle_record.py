"""The record of one vehicle: a row of fixed layout per period, later compared with the true state."""

import math
from collections.abc import Sequence
from functools import cache
from struct import Struct
from typing import Any

import numpy as np

from autopilot.navigation.site_frame import UNKNOWN_NED_M
from autopilot.vehicle.vehicle import Vehicle

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
"""Positions are in the site's frame and NaN while unknown. ``mode`` is PX4's custom mode, ``phase`` the
on-board application's (255 without one), ``causes`` the bits of `autopilot.commander.failsafe.Cause`. The
heights of estimator and setpoint are above the ground of the start, from the barometer: the origin's GPS
altitude is left out. ``gps_pos_ned_m`` is the last fix, which describes an earlier position.
``correction_ned_m`` is what the application subtracts from the estimator's position to get its own estimate.
``odometry_offset_ned_m`` is the part of it that comes from ranging and all vehicles' GPS, and is constant
while no radio data arrive."""


def vehicle_record(columns: Sequence[str]) -> np.dtype[Any]:
    """Return `VEHICLE_RECORD` followed by the numbers of the application's status; `Layout.columns`."""
    fixed = [(name, VEHICLE_RECORD[name]) for name in VEHICLE_RECORD.names or ()]
    return np.dtype(fixed + [(name, np.dtype("f8")) for name in columns])


ROW = Struct("<q?IB??If" + "3d3f4f" + "3d3d" + "3f3f3f" + "3d")
"""The same row for `struct`: a tenth of numpy's time to build one from a tuple with arrays."""
_SINGLE_MAX = 3.402823e38
"""Limit beyond which `struct` raises for a float32; diverged estimates are clamped and recorded."""

NO_PHASE = 255


@cache
def _numbers(count: int) -> Struct:
    return Struct(f"<{count}d")


def pack_values(values: Sequence[float]) -> bytes:
    """Return the last fields of a row, the numbers of the application's status."""
    return _numbers(len(values)).pack(*values) if values else b""


def record(vehicle: Vehicle) -> bytes:
    """Return the row of `vehicle_record` for the vehicle's state after its last step."""
    flight, app = vehicle.flight, vehicle.app
    state, commander = flight.state, flight.commander
    north_m, east_m, down_m = state.pos_ned_m.tolist()
    vel_ned_m_s, q_ned_frd = state.vel_ned_m_s.tolist(), state.q_ned_frd.tolist()
    origin_n_m, origin_e_m, origin_d_m = UNKNOWN_NED_M
    believed_ned_m = std_ned_m = correction_ned_m = odometry_offset_ned_m = UNKNOWN_NED_M
    if flight.origin_known:
        origin_n_m, origin_e_m, origin_d_m = vehicle.site.origin_ned_m(state)
        if app is not None:
            believed_ned_m, std_ned_m, correction_ned_m, odometry_offset_ned_m = app.estimate(flight.now_us)
    setpoint_n_m, setpoint_e_m, setpoint_d_m = UNKNOWN_NED_M
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
    return ROW.pack(
        flight.now_us, commander.armed, commander.mode.custom_mode,
        int(app.phase) if app is not None else NO_PHASE,
        commander.landed, commander.failsafe, flight.causes, flight.battery.remaining,
        north_m + origin_n_m, east_m + origin_e_m, down_m + origin_d_m, *singles,
        *vehicle.site.fix_ned_m(flight.gps), *believed_ned_m,
        *std_ned_m, *correction_ned_m, *odometry_offset_ned_m,
        setpoint_n_m + origin_n_m, setpoint_e_m + origin_e_m, setpoint_d_m + origin_d_m,
    ) + (pack_values(app.values) if app is not None else b"")  # fmt: skip
