"""STATUSTEXT and HEARTBEAT: the vehicle's status as text and as flags, and its landed state."""

from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.commander import Commander
from autopilot.mavlink.codec import Message
from foundation.types import Course

TEXT_BYTES = 50
"""Capacity of a STATUSTEXT."""
_CHUNKS_MAX = 255
"""``chunk_seq`` is a byte."""


def status_text(severity: int, text: str) -> Message:
    """STATUSTEXT of any length; `Chunks` splits one that exceeds TEXT_BYTES."""
    return common.MAVLink_statustext_message(severity, text.encode("ascii", "replace"))


class Chunks:
    """Splits texts into messages that fit; those of one text share an id."""

    def __init__(self) -> None:
        self._id = 0

    def split(self, message: Message) -> Sequence[Message]:
        """Return a message unchanged, or a long STATUSTEXT in chunks, the last of which is not full."""
        if message.get_msgId() != common.MAVLINK_MSG_ID_STATUSTEXT or len(message.text) <= TEXT_BYTES:
            return (message,)
        self._id = self._id % 0xFFFF + 1
        text = message.text[: TEXT_BYTES * _CHUNKS_MAX]
        return [
            common.MAVLink_statustext_message(
                message.severity,
                text[begin : begin + TEXT_BYTES].encode("ascii", "replace"),
                self._id,
                begin // TEXT_BYTES,
            )
            for begin in range(0, len(text) + 1, TEXT_BYTES)
        ]


def heartbeat(commander: Commander, conditions: int, mav_type: int) -> Message:
    """HEARTBEAT of a PX4 multicopter."""
    if commander.armed:
        system_status = common.MAV_STATE_CRITICAL if commander.failsafe else common.MAV_STATE_ACTIVE
    else:
        system_status = common.MAV_STATE_STANDBY if conditions & _ATTITUDE else common.MAV_STATE_UNINIT
    armed = common.MAV_MODE_FLAG_SAFETY_ARMED if commander.armed else 0
    return common.MAVLink_heartbeat_message(
        mav_type,
        common.MAV_AUTOPILOT_PX4,
        commander.mode.base_mode | armed,
        commander.mode.custom_mode,
        system_status,
        3,
    )


def landed_state(course: Course, *, landed: bool) -> int:
    """MAV_LANDED_STATE: ground, take-off, air, landing; also those within missions and returns, as in PX4."""
    return common.MAV_LANDED_STATE_ON_GROUND if landed else _LANDED_STATE_OF_COURSE[course]


_ATTITUDE = int(Condition.ATTITUDE)
_LANDED_STATE_OF_COURSE: dict[Course, int] = {
    Course.TAKE_OFF: common.MAV_LANDED_STATE_TAKEOFF,
    Course.LANDING: common.MAV_LANDED_STATE_LANDING,
    Course.OTHER: common.MAV_LANDED_STATE_IN_AIR,
}
