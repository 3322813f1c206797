"""Streams of telemetry from the autopilot beside an application, requested by SET_MESSAGE_INTERVAL. No I/O.

A PX4 sends 400 messages a second to a companion, each of which costs both some 30 us: those that are not used
are requested to stop. An ArduPilot streams nothing on a link unless it is requested.
"""

from collections.abc import Mapping
from typing import Final

from pymavlink.dialects.v20 import common

from autopilot.mavlink.components import AUTOPILOT_COMPONENT

REQUEST_PERIOD_US = 1_000_000
"""Period at which a request is repeated until it has an effect. That of a request to stop a message doubles
each time, because some messages are no streams."""
_OFF = -1.0

AS_SENT = 0
"""In place of a period: the message is used at whatever rate it is sent."""
_NOT_STREAMED: Final = {
    common.MAVLINK_MSG_ID_HEARTBEAT: AS_SENT,
    common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: AS_SENT,
    common.MAVLINK_MSG_ID_PARAM_VALUE: AS_SENT,
    common.MAVLINK_MSG_ID_COMMAND_ACK: AS_SENT,
    common.MAVLINK_MSG_ID_COMMAND_LONG: AS_SENT,
    common.MAVLINK_MSG_ID_COMMAND_INT: AS_SENT,
    common.MAVLINK_MSG_ID_STATUSTEXT: AS_SENT,
}
PX4_STREAMS: Final[Mapping[int, int]] = _NOT_STREAMED | {
    common.MAVLINK_MSG_ID_SYS_STATUS: AS_SENT,
    common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: AS_SENT,
    common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: AS_SENT,
    common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: AS_SENT,
    common.MAVLINK_MSG_ID_ALTITUDE: AS_SENT,
    common.MAVLINK_MSG_ID_GPS_RAW_INT: AS_SENT,
    common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: AS_SENT,
}
"""Messages of a PX4 that application and log use, with their periods in us."""
ARDUPILOT_STREAMS: Final[Mapping[int, int]] = _NOT_STREAMED | {
    common.MAVLINK_MSG_ID_SYS_STATUS: 500_000,
    common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 500_000,
    common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20_000,
    common.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 20_000,
    common.MAVLINK_MSG_ID_SCALED_PRESSURE: 100_000,
    common.MAVLINK_MSG_ID_GPS_RAW_INT: 100_000,
    common.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 40_000,
}
"""Likewise of an ArduPilot."""


class Streams:
    """The streams of one autopilot.

    ``used`` are the messages that are used, with their periods in us; ``stops_others``: request that all
    others are not sent.
    """

    def __init__(self, used: Mapping[int, int], *, stops_others: bool, target_system: int) -> None:
        self._used = used
        self._stops_others = stops_others
        self._target_system = target_system
        self._stops: dict[int, tuple[int, int]] = {}
        """For each message that is not used: when its stop is requested again, and the period after that."""
        self._received_us = {kind: -REQUEST_PERIOD_US for kind, period_us in used.items() if period_us}
        """Time of the newest message of each requested stream."""
        self._checked_us = -REQUEST_PERIOD_US

    def is_used(self, kind: int) -> bool:
        """Whether a message is used."""
        return kind in self._used

    def on_message(self, kind: int, now_us: int) -> list[common.MAVLink_message]:
        """Process the arrival of a message; return the request to send it no more, if it is not used."""
        if kind in self._received_us:
            self._received_us[kind] = now_us
        if not self._stops_others or kind in self._used:
            return []
        due_us, period_us = self._stops.get(kind, (now_us, REQUEST_PERIOD_US))
        if now_us < due_us:
            return []
        self._stops[kind] = (now_us + period_us, 2 * period_us)
        return [self._request(kind, _OFF)]

    def on_timer(self, now_us: int) -> list[common.MAVLink_message]:
        """Return requests for the streams of which nothing has arrived for a while."""
        if now_us - self._checked_us < REQUEST_PERIOD_US:
            return []
        self._checked_us = now_us
        return [
            self._request(kind, float(self._used[kind]))
            for kind, received_us in self._received_us.items()
            if now_us - received_us >= REQUEST_PERIOD_US
        ]

    def _request(self, kind: int, period_us: float) -> common.MAVLink_message:
        return common.MAVLink_command_long_message(
            self._target_system, AUTOPILOT_COMPONENT, common.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
            float(kind), period_us, 0.0, 0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
