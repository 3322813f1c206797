"""Log of an on-board application beside a PX4: the vehicle record, from PX4's messages and its own estimate.

The rows are those of `autopilot.logs.vehicle_record`, so that PX4 flights are analysed like any other. A row
holds the newest messages and the estimate at an instant of the log, when PX4's first attitude or position
after it arrives. The causes of failsafes, which PX4 does not report, are 0.
"""

import math

from pymavlink.dialects.v20 import common

from autopilot.logs.vehicle_record import ROW, pack_values, vehicle_record
from autopilot.mavlink.codec import Message
from autopilot.navigation.site_frame import LEAST_FIX_TYPE, UNKNOWN_NED_M, message_ned_m
from autopilot.onboard.application import NO_ESTIMATE
from autopilot.onboard.programs import Programs
from autopilot.parameters.config import VehicleConfig
from foundation.records.record_log import RecordLog
from foundation.types import Vector

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


class CompanionLog:
    """The log of one application; close it. Raises OSError if the file cannot be opened."""

    def __init__(self, config: VehicleConfig, path: str, app: Programs) -> None:
        self._site = config.site
        self._period_us = config.record_period_us
        self._app = app
        self._newest: dict[int, Message] = {}
        self._fix_ned_m = self._origin_ned_m = UNKNOWN_NED_M
        """Position of the newest fix, and offset of a local position, whose height is unchanged."""
        self._written_us = 0
        self._log = RecordLog(path, vehicle_record(app.layout.columns), block_rows=config.log_block_rows)

    def on_message(self, message: Message, now_us: int) -> None:
        """Store a message of the own PX4, before the application has it; write a row if one is due before it.

        Must not be called with messages of others.
        """
        kind = message.get_msgId()
        if kind not in _KEPT:
            return
        if kind in _TIMED:
            self._write(min(message.time_boot_ms * _US_PER_MS, now_us))
        self._newest[kind] = message
        if kind == _FIX:
            known = message.fix_type >= LEAST_FIX_TYPE
            self._fix_ned_m = (
                message_ned_m(self._site, message.lat, message.lon, message.alt) if known else UNKNOWN_NED_M
            )
        elif kind == _ORIGIN:
            north_m, east_m, _ = message_ned_m(self._site, message.latitude, message.longitude, 0)
            self._origin_ned_m = (north_m, east_m, 0.0)

    def _write(self, time_us: int) -> None:
        """Write a row if an instant of the log has passed since the last, and PX4 has sent a heartbeat."""
        at_us = time_us - time_us % self._period_us
        if at_us > self._written_us and _HEARTBEAT in self._newest:
            self._written_us = at_us
            self._log.append_packed(self._row(at_us))

    def close(self) -> None:
        """Flush and close; idempotent."""
        self._log.close()

    def _row(self, at_us: int) -> bytes:
        newest, app = self._newest, self._app
        beat, landed, status = newest[_HEARTBEAT], newest.get(_LANDED), newest.get(_STATUS)
        position, attitude, target = newest.get(_POSITION), newest.get(_ATTITUDE), newest.get(_TARGET)
        origin_ned_m = self._origin_ned_m
        armed = bool(beat.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED)
        pos_ned_m = vel_ned_m_s = target_ned_m = UNKNOWN_NED_M
        estimate = NO_ESTIMATE
        if position is not None:
            pos_ned_m = _sum(origin_ned_m, (position.x, position.y, position.z))
            vel_ned_m_s = (position.vx, position.vy, position.vz)
            if not math.isnan(origin_ned_m[0]):
                estimate = app.estimate(at_us)
        if target is not None:
            target_ned_m = _sum(origin_ned_m, _requested_ned_m(target))
        return ROW.pack(
            at_us,
            armed,
            beat.custom_mode,
            app.phase,
            landed is not None and landed.landed_state == common.MAV_LANDED_STATE_ON_GROUND,
            armed and beat.system_status >= common.MAV_STATE_CRITICAL,
            0,
            status.battery_remaining / 100
            if status is not None and status.battery_remaining >= 0
            else math.nan,
            *pos_ned_m,
            *vel_ned_m_s,
            *(_NO_ATTITUDE if attitude is None else (attitude.q1, attitude.q2, attitude.q3, attitude.q4)),
            *self._fix_ned_m,
            *estimate.pos_ned_m,
            *estimate.std_ned_m,
            *estimate.correction_ned_m,
            *estimate.odometry_offset_ned_m,
            *target_ned_m,
        ) + pack_values(app.values)


def _sum(first: Vector, second: Vector) -> Vector:
    return (first[0] + second[0], first[1] + second[1], first[2] + second[2])


def _requested_ned_m(target: Message) -> Vector:
    """Return the position of a POSITION_TARGET_LOCAL_NED; NaN in the axes that it does not contain."""
    mask = target.type_mask
    return (
        math.nan if mask & common.POSITION_TARGET_TYPEMASK_X_IGNORE else target.x,
        math.nan if mask & common.POSITION_TARGET_TYPEMASK_Y_IGNORE else target.y,
        math.nan if mask & common.POSITION_TARGET_TYPEMASK_Z_IGNORE else target.z,
    )
