"""Which message goes to a link how often: PX4's default rates, changed by SET_MESSAGE_INTERVAL.

A stream is a table row. The messages are formed by `telemetry`, only when due, and only if somebody listens.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.protocol.service import NEVER_US

Builder = Callable[[], Message | None]
"""Forms a message of the present values; None while there is nothing to say."""

_HEARTBEAT = common.MAVLINK_MSG_ID_HEARTBEAT
SECOND_US = 1_000_000

GROUND_STATION_HZ: dict[int, float] = {
    _HEARTBEAT: 1.0,
    common.MAVLINK_MSG_ID_ATTITUDE: 50.0,
    common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50.0,
    common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 50.0,
    common.MAVLINK_MSG_ID_ATTITUDE_TARGET: 50.0,
    common.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 50.0,
    common.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    common.MAVLINK_MSG_ID_VFR_HUD: 4.0,
    common.MAVLINK_MSG_ID_ALTITUDE: 1.0,
    common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    common.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    common.MAVLINK_MSG_ID_SCALED_PRESSURE: 1.0,
    common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
    common.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    common.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.5,
    common.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
}
"""As PX4 v1.17 streams to 14550, less what has no source here yet (vibration)."""

COMPANION_HZ: dict[int, float] = {
    _HEARTBEAT: 1.0,
    common.MAVLINK_MSG_ID_ATTITUDE: 100.0,
    common.MAVLINK_MSG_ID_HIGHRES_IMU: 50.0,
    common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50.0,
    common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    common.MAVLINK_MSG_ID_ODOMETRY: 30.0,
    common.MAVLINK_MSG_ID_ALTITUDE: 10.0,
    common.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10.0,
    common.MAVLINK_MSG_ID_GPS_RAW_INT: 10.0,
    common.MAVLINK_MSG_ID_ATTITUDE_TARGET: 10.0,
    common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 10.0,
    common.MAVLINK_MSG_ID_VFR_HUD: 10.0,
    common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    common.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    common.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    common.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
    common.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    common.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
}
"""As PX4 v1.17 streams to 14540."""

APPLICATION_HZ: dict[int, float] = {
    message_id: COMPANION_HZ[message_id]
    for message_id in (
        common.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        common.MAVLINK_MSG_ID_GPS_RAW_INT,
        common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    )
}
"""What the on-board application in this process listens to, at a companion's rates, beside the heartbeat."""

APPLICATION_WITH_ATTITUDE_HZ = {
    **APPLICATION_HZ,
    common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: COMPANION_HZ[common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION],
}
"""With what it needs to learn the wind."""

ON_NEW_DATA = frozenset({common.MAVLINK_MSG_ID_GPS_RAW_INT})
"""Sent when there is something new, at most at the stream's rate."""


@dataclass(slots=True)
class _Stream:
    build: Builder
    interval_us: int
    due_us: int
    has_new_data: bool

    def postpone(self, now_us: int) -> None:
        """Set the next time: on the grid, unless that has fallen behind."""
        self.due_us += self.interval_us
        if self.due_us <= now_us:
            self.due_us = now_us + self.interval_us


class Streams:
    """The periodic messages of one link. While nobody listens only the heartbeat is formed."""

    def __init__(self, builders: Mapping[int, Builder], rates_hz: Mapping[int, float]) -> None:
        self._active = True
        self._builders = builders
        self._default_us = {
            message_id: round(SECOND_US / rate_hz) for message_id, rate_hz in rates_hz.items()
        }
        self._streams = {
            message_id: _Stream(builders[message_id], interval_us, 0, message_id not in ON_NEW_DATA)
            for message_id, interval_us in self._default_us.items()
        }
        self._deadline_us = 0

    @property
    def active(self) -> bool:
        """Somebody listens."""
        return self._active

    @active.setter
    def active(self, active: bool) -> None:
        if active is not self._active:
            self._active = active
            self._deadline_us = 0

    def on_timer(self, now_us: int) -> Sequence[Message]:
        """Messages that are due."""
        if now_us < self._deadline_us:
            return ()
        if not self._active:
            return self._heartbeat_alone(now_us)
        messages = []
        deadline_us = NEVER_US
        for message_id, stream in self._streams.items():
            if stream.has_new_data:
                if now_us >= stream.due_us:
                    stream.postpone(now_us)
                    if message_id in ON_NEW_DATA:
                        stream.has_new_data = False
                    if (message := stream.build()) is not None:
                        messages.append(message)
                if stream.has_new_data:
                    deadline_us = min(deadline_us, stream.due_us)
        self._deadline_us = deadline_us
        return messages

    def _heartbeat_alone(self, now_us: int) -> Sequence[Message]:
        stream = self._streams.get(_HEARTBEAT)
        if stream is None:
            self._deadline_us = NEVER_US
            return ()
        message = None
        if now_us >= stream.due_us:
            stream.postpone(now_us)
            message = stream.build()
        self._deadline_us = stream.due_us
        return () if message is None else [message]

    def next_deadline_us(self) -> int:
        """When the next stream is due."""
        return self._deadline_us

    def on_new_data(self, message_id: int) -> None:
        """Note that a message of `ON_NEW_DATA` has something new to say."""
        stream = self._streams.get(message_id)
        if stream is not None and not stream.has_new_data:
            stream.has_new_data = True
            self._deadline_us = min(self._deadline_us, stream.due_us)

    def knows(self, message_id: int) -> bool:
        """Whether the message can be formed at all."""
        return message_id in self._builders

    def form(self, message_id: int) -> Message | None:
        """Form a message out of turn; None while there is nothing to say."""
        return self._builders[message_id]()

    def set_interval(self, message_id: int, interval_us: int, now_us: int) -> bool:
        """Do as MAV_CMD_SET_MESSAGE_INTERVAL says: -1 stops, 0 is the default. False: unknown message."""
        if not self.knows(message_id):
            return False
        if interval_us == 0:
            interval_us = self._default_us.get(message_id, -1)
        if interval_us < 0:
            self._streams.pop(message_id, None)
        else:
            self._streams[message_id] = _Stream(
                self._builders[message_id], interval_us, now_us, message_id not in ON_NEW_DATA
            )
            self._deadline_us = min(self._deadline_us, now_us)
        return True
