"""Log of an on-board application beside a PX4: the vehicle record, from PX4's messages and its own estimate.

The rows are those of `autopilot.logs.vehicle_record`, so that PX4 flights are analysed like any other. A row
holds the newest messages and the estimate at an instant of the log, when PX4's first attitude or position
after it arrives. The causes of failsafes, which PX4 does not report, are 0.
"""

import math
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.logs.vehicle_record import VEHICLE_RECORD
from autopilot.mavlink.codec import Message
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.navigation.site_frame import LEAST_FIX_TYPE
from autopilot.onboard.application import Application
from autopilot.parameters.config import VehicleConfig
from foundation.geometry.geodesy import geodetic_to_ned
from foundation.records.record_log import RecordLog
from foundation.types import Array

_UNKNOWN = np.full(3, np.nan)
_NO_ATTITUDE = (math.nan, math.nan, math.nan, math.nan)
_HEARTBEAT = common.MAVLINK_MSG_ID_HEARTBEAT
_LANDED = common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
_STATUS = common.MAVLINK_MSG_ID_SYS_STATUS
_POSITION = common.MAVLINK_MSG_ID_LOCAL_POSITION_NED
_ATTITUDE = common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
_FIX = common.MAVLINK_MSG_ID_GPS_RAW_INT
_ORIGIN = common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN
_TARGET = common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED
_KEPT = frozenset({_HEARTBEAT, _LANDED, _STATUS, _POSITION, _ATTITUDE, _FIX, _ORIGIN, _TARGET})
_TIMED = frozenset({_POSITION, _ATTITUDE})
"""Messages with PX4's time of their content."""
_US_PER_MS = 1_000
_NO_AXIS = (
    common.POSITION_TARGET_TYPEMASK_X_IGNORE,
    common.POSITION_TARGET_TYPEMASK_Y_IGNORE,
    common.POSITION_TARGET_TYPEMASK_Z_IGNORE,
)


class CompanionLog:
    """The log of one application; close it. Raises OSError if the file cannot be opened."""

    def __init__(self, config: VehicleConfig, path: str, app: Application) -> None:
        self._site = config.site
        self._system = config.instance + 1
        self._period_us = config.record_period_us
        self._app = app
        self._newest: dict[int, Message] = {}
        self._fix_ned_m = self._origin_ned_m = _UNKNOWN
        """(3,) of the newest fix, and (3,) to add to a local position, whose height is unchanged."""
        self._written_us = 0
        self._log = RecordLog(path, VEHICLE_RECORD)

    def on_message(self, message: Message, now_us: int) -> None:
        """Store a message from PX4, before the application has it; write a row if one is due before it."""
        kind = message.get_msgId()
        is_px4s = (
            message.get_srcSystem() == self._system and message.get_srcComponent() == AUTOPILOT_COMPONENT
        )
        if is_px4s and kind in _KEPT:
            if kind in _TIMED:
                self._write(min(message.time_boot_ms * _US_PER_MS, now_us))
            self._newest[kind] = message
            if kind == _FIX:
                known = message.fix_type >= LEAST_FIX_TYPE
                self._fix_ned_m = self._ned_m(message.lat, message.lon, message.alt) if known else _UNKNOWN
            elif kind == _ORIGIN:
                self._origin_ned_m = self._ned_m(message.latitude, message.longitude, 0)
                self._origin_ned_m[2] = 0.0

    def _write(self, time_us: int) -> None:
        """Write a row if an instant of the log has passed since the last, and PX4 has sent a heartbeat."""
        at_us = time_us - time_us % self._period_us
        if at_us > self._written_us and _HEARTBEAT in self._newest:
            self._written_us = at_us
            self._log.append([self._row(at_us)])

    def close(self) -> None:
        """Flush and close; idempotent."""
        self._log.close()

    def _row(self, at_us: int) -> tuple[Any, ...]:
        newest = self._newest
        beat, landed, status = newest[_HEARTBEAT], newest.get(_LANDED), newest.get(_STATUS)
        position, attitude = newest.get(_POSITION), newest.get(_ATTITUDE)
        origin_ned_m = self._origin_ned_m
        armed = bool(beat.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED)
        known = position is not None and not math.isnan(origin_ned_m[0])
        estimate = self._app.estimate(at_us) if known else None
        return (
            at_us,
            armed,
            beat.custom_mode,
            int(self._app.phase),
            landed is not None and landed.landed_state == common.MAV_LANDED_STATE_ON_GROUND,
            armed and beat.system_status >= common.MAV_STATE_CRITICAL,
            0,
            status.battery_remaining / 100
            if status is not None and status.battery_remaining >= 0
            else math.nan,
            _UNKNOWN if position is None else np.array((position.x, position.y, position.z)) + origin_ned_m,
            _UNKNOWN if position is None else (position.vx, position.vy, position.vz),
            _NO_ATTITUDE if attitude is None else (attitude.q1, attitude.q2, attitude.q3, attitude.q4),
            self._fix_ned_m,
            _UNKNOWN if estimate is None else estimate.pos_ned_m,
            _UNKNOWN if estimate is None else estimate.std_ned_m,
            _UNKNOWN if estimate is None else estimate.correction_ned_m,
            _UNKNOWN if estimate is None else estimate.odometry_offset_ned_m,
            self._target_ned_m(origin_ned_m),
        )

    def _target_ned_m(self, origin_ned_m: Array) -> Array:
        target = self._newest.get(_TARGET)
        if target is None:
            return _UNKNOWN
        target_ned_m = np.array((target.x, target.y, target.z)) + origin_ned_m
        target_ned_m[[bool(target.type_mask & bit) for bit in _NO_AXIS]] = np.nan
        return target_ned_m

    def _ned_m(self, lat_deg_e7: int, lon_deg_e7: int, alt_mm: int) -> Array:
        return geodetic_to_ned(
            lat_deg_e7 * 1e-7,
            lon_deg_e7 * 1e-7,
            alt_mm * 1e-3,
            origin_lat_deg=self._site.latitude_deg,
            origin_lon_deg=self._site.longitude_deg,
            origin_alt_m=self._site.altitude_m,
        )
