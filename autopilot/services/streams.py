"""Message rates of each link: PX4's defaults, changed by SET_MESSAGE_INTERVAL.

A stream is a row of a table. Messages are built by `telemetry`, only when due and only with a listener.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.mavlink.dialect import by_id
from autopilot.services.service import NEVER_US

Builder = Callable[[], Message | list[Message] | None]
"""Builds a message from the current values, or one for each of several devices; None while there are none."""

_HEARTBEAT = common.MAVLINK_MSG_ID_HEARTBEAT
SECOND_US = 1_000_000
FRAME_OVERHEAD_BYTES = 12
"""Of an unsigned frame of MAVLink 2."""
STEP_US = 4_000
"""The vehicle's step, which is the shortest interval."""

GROUND_STATION_HZ: dict[int, float] = by_id(
    HEARTBEAT=1.0, ATTITUDE=50.0, ATTITUDE_QUATERNION=50.0, LOCAL_POSITION_NED=50.0,
    GLOBAL_POSITION_INT=50.0, POSITION_TARGET_LOCAL_NED=50.0, ATTITUDE_TARGET=50.0, SERVO_OUTPUT_RAW=50.0,
    GPS_RAW_INT=5.0, VFR_HUD=4.0, ALTITUDE=1.0, EXTENDED_SYS_STATE=1.0, SYS_STATUS=1.0, SCALED_PRESSURE=1.0,
    GPS_GLOBAL_ORIGIN=1.0, MISSION_CURRENT=1.0, BATTERY_STATUS=0.5, ESTIMATOR_STATUS=0.5, HOME_POSITION=0.5,
    CURRENT_MODE=0.5, DISTANCE_SENSOR=0.5, PING=0.1, VIBRATION=0.1,
)  # fmt: skip
"""PX4 v1.17's rates to port 14550."""

SERIAL_HZ: dict[int, float] = by_id(
    HEARTBEAT=1.0, ATTITUDE=15.0, ATTITUDE_QUATERNION=10.0, GLOBAL_POSITION_INT=5.0, GPS_RAW_INT=5.0,
    VFR_HUD=4.0, ATTITUDE_TARGET=2.0, POSITION_TARGET_LOCAL_NED=1.5, ALTITUDE=1.0, EXTENDED_SYS_STATE=1.0,
    GPS_GLOBAL_ORIGIN=1.0, LOCAL_POSITION_NED=1.0, MISSION_CURRENT=1.0, SCALED_PRESSURE=1.0,
    SERVO_OUTPUT_RAW=1.0, SYS_STATUS=1.0, BATTERY_STATUS=0.5, CURRENT_MODE=0.5, DISTANCE_SENSOR=0.5,
    ESTIMATOR_STATUS=0.5, HOME_POSITION=0.5, PING=0.1, VIBRATION=0.1,
)  # fmt: skip
"""PX4's rates at a telemetry port (MAV_0_MODE = 0, normal), before they are scaled to its data rate."""

COMPANION_HZ: dict[int, float] = by_id(
    HEARTBEAT=1.0, ATTITUDE=100.0, HIGHRES_IMU=50.0, ATTITUDE_QUATERNION=50.0, GLOBAL_POSITION_INT=50.0,
    LOCAL_POSITION_NED=30.0, ODOMETRY=30.0, TIMESYNC=10.0, ALTITUDE=10.0, SERVO_OUTPUT_RAW=10.0,
    GPS_RAW_INT=10.0, DISTANCE_SENSOR=10.0, ATTITUDE_TARGET=10.0, POSITION_TARGET_LOCAL_NED=10.0,
    VFR_HUD=10.0, EXTENDED_SYS_STATE=5.0, SYS_STATUS=5.0, ESTIMATOR_STATUS=1.0, SYSTEM_TIME=1.0,
    GPS_GLOBAL_ORIGIN=1.0, MISSION_CURRENT=1.0, BATTERY_STATUS=0.5, HOME_POSITION=0.5, CURRENT_MODE=0.5,
)  # fmt: skip
"""PX4 v1.17's rates to port 14540."""

APPLICATION_HZ: dict[int, float] = {
    common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 25.0,
    common.MAVLINK_MSG_ID_GPS_RAW_INT: COMPANION_HZ[common.MAVLINK_MSG_ID_GPS_RAW_INT],
    common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: COMPANION_HZ[common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN],
}
"""To the on-board application: the position at the rate of its setpoints, the rest as to a companion."""

APPLICATION_WITH_ATTITUDE_HZ = {
    **APPLICATION_HZ,
    common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: COMPANION_HZ[common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION],
}
"""The same and the attitude, from which the application estimates the wind."""

ON_NEW_DATA = frozenset({common.MAVLINK_MSG_ID_GPS_RAW_INT, common.MAVLINK_MSG_ID_DISTANCE_SENSOR})
"""Sent only with new data, at most at the stream's rate."""


@dataclass(slots=True)
class _Stream:
    interval_us: int
    due_us: int
    has_new_data: bool


class MessageStreams:
    """The periodic messages of one link. Without a listener only the heartbeat is built.

    A builder is looked up when its message is due, so ``builders`` may be extended after construction.
    """

    def __init__(self, builders: Mapping[int, Builder], rates_hz: Mapping[int, float]) -> None:
        self._active = True
        self._builders = builders
        self._default_us = {
            message_id: round(SECOND_US / rate_hz) for message_id, rate_hz in rates_hz.items()
        }
        self._streams = {
            message_id: _Stream(interval_us, 0, message_id not in ON_NEW_DATA)
            for message_id, interval_us in self._default_us.items()
        }
        self.deadline_us = 0
        """Time of the next stream that is due."""
        self.rate_factor = 1.0
        """Factor of all rates but the heartbeat's, 0.05 to 1."""
        self._needs_bytes_s: tuple[float, float] | None = None

    @property
    def active(self) -> bool:
        """Whether there is a listener."""
        return self._active

    @active.setter
    def active(self, active: bool) -> None:
        if active is not self._active:
            self._active = active
            self.deadline_us = 0

    def on_timer(self, now_us: int) -> Sequence[Message]:
        """Build the messages that are due."""
        if now_us < self.deadline_us:
            return ()
        streams = self._streams
        if not self._active:
            streams = {_HEARTBEAT: streams[_HEARTBEAT]} if _HEARTBEAT in streams else {}
        messages: list[Message] = []
        deadline_us = NEVER_US
        for message_id, stream in streams.items():
            if not stream.has_new_data:
                continue
            due_us = stream.due_us
            if now_us >= due_us:
                interval_us = stream.interval_us
                if self.rate_factor != 1.0 and message_id != _HEARTBEAT:
                    interval_us = round(interval_us / self.rate_factor)
                due_us += interval_us
                if due_us <= now_us:  # the schedule has fallen behind
                    due_us = now_us + interval_us
                stream.due_us = due_us
                stream.has_new_data = message_id not in ON_NEW_DATA
                messages += self.form(message_id)
            if stream.has_new_data and due_us < deadline_us:
                deadline_us = due_us
        self.deadline_us = deadline_us
        return messages

    @property
    def needs_bytes_s(self) -> tuple[float, float]:
        """Bytes/s of the heartbeat and of all other streams at a factor of 1, in frames of full length."""
        if self._needs_bytes_s is None:
            needs = {
                message_id: (common.mavlink_map[message_id].unpacker.size + FRAME_OVERHEAD_BYTES)
                * SECOND_US
                / stream.interval_us
                for message_id, stream in self._streams.items()
                if self.is_supported(message_id)
            }
            heartbeat = needs.pop(_HEARTBEAT, 0.0)
            self._needs_bytes_s = heartbeat, sum(needs.values())
        return self._needs_bytes_s

    def on_new_data(self, message_id: int) -> None:
        """Mark a message of `ON_NEW_DATA` as having new data."""
        stream = self._streams.get(message_id)
        if stream is not None and not stream.has_new_data:
            stream.has_new_data = True
            self.deadline_us = min(self.deadline_us, stream.due_us)

    def is_supported(self, message_id: int) -> bool:
        """Whether there is a builder for the message."""
        return message_id in self._builders

    def form(self, message_id: int) -> Sequence[Message]:
        """Build a message, of several devices one for each; none while there is no data."""
        build = self._builders.get(message_id)
        built = None if build is None else build()
        if built is None:
            return ()
        return built if isinstance(built, list) else (built,)

    def hasten(self, message_id: int, now_us: int) -> None:
        """Send a stream's message with the next step, because its content has changed."""
        stream = self._streams.get(message_id)
        if stream is not None and self._active:
            stream.due_us = now_us
            self.deadline_us = min(self.deadline_us, now_us)

    def interval_us(self, message_id: int) -> int:
        """Interval as in MESSAGE_INTERVAL: -1 if the message is not sent, 0 if it is not supported."""
        if not self.is_supported(message_id):
            return 0
        stream = self._streams.get(message_id)
        return -1 if stream is None else stream.interval_us

    def set_interval(self, message_id: int, interval_us: int, now_us: int) -> bool:
        """Execute MAV_CMD_SET_MESSAGE_INTERVAL: -1 stops, 0 restores the default. False: unknown message.

        Intervals are at least one step; the heartbeat's is at most one second.
        """
        if not self.is_supported(message_id):
            return False
        if interval_us == 0:
            interval_us = self._default_us.get(message_id, -1)
        if message_id == _HEARTBEAT:
            interval_us = interval_us if 0 < interval_us < SECOND_US else SECOND_US
        self._needs_bytes_s = None
        if interval_us < 0:
            self._streams.pop(message_id, None)
        else:
            self._streams[message_id] = _Stream(
                max(interval_us, STEP_US), now_us, message_id not in ON_NEW_DATA
            )
            self.deadline_us = min(self.deadline_us, now_us)
        return True
