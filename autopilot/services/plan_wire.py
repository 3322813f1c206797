"""Conversion of plan items to and from MISSION_ITEM_INT, and MISSION_ITEM of old stations."""

import math

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.navigation.plan_store import NOT_GIVEN, PlanType, WireItem

_DEGREES_E7 = 1e7
_INT32_MAX = 2**31 - 1
_GLOBAL_FRAMES = frozenset(
    {
        common.MAV_FRAME_GLOBAL,
        common.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        common.MAV_FRAME_GLOBAL_INT,
        common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        common.MAV_FRAME_GLOBAL_TERRAIN_ALT,
        common.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
    }
)
"""Frames in which MISSION_ITEM uses degrees and MISSION_ITEM_INT 1e-7 degrees."""
_FRAME_OF_FLOATS = {
    common.MAV_FRAME_GLOBAL_INT: common.MAV_FRAME_GLOBAL,
    common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: common.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    common.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: common.MAV_FRAME_GLOBAL_TERRAIN_ALT,
}
"""Equivalent frames that a message with floats may use."""


def decode_item(message: Message) -> WireItem:
    """Decode MISSION_ITEM_INT or MISSION_ITEM; any content gives an item."""
    x, y = message.x, message.y
    if message.get_msgId() == common.MAVLINK_MSG_ID_MISSION_ITEM:
        per_unit = _DEGREES_E7 if message.frame in _GLOBAL_FRAMES else 1.0
        x, y = _to_integer(x * per_unit), _to_integer(y * per_unit)
    return WireItem(
        command=message.command,
        frame=message.frame,
        params=(message.param1, message.param2, message.param3, message.param4),
        x=x,
        y=y,
        z=message.z,
        autocontinue=message.autocontinue,
    )


def encode_item(
    item: WireItem, *, kind: PlanType, seq: int, current: bool, target: tuple[int, int], in_integers: bool
) -> Message:
    """Encode an item for ``target`` (system, component) as MISSION_ITEM_INT, or as MISSION_ITEM."""
    values = (item.command, int(current), item.autocontinue, *item.params)
    if in_integers:
        return common.MAVLink_mission_item_int_message(
            *target, seq, item.frame, *values, item.x, item.y, item.z, int(kind)
        )
    per_unit = _DEGREES_E7 if item.frame in _GLOBAL_FRAMES else 1.0
    x, y = (math.nan if value == NOT_GIVEN else value / per_unit for value in (item.x, item.y))
    frame = _FRAME_OF_FLOATS.get(item.frame, item.frame)
    return common.MAVLink_mission_item_message(*target, seq, frame, *values, x, y, item.z, int(kind))


def _to_integer(value: float) -> int:
    """Round to an int32; NaN becomes NOT_GIVEN, and values out of range stay invalid in every frame."""
    if math.isnan(value):
        return NOT_GIVEN
    return round(max(-_INT32_MAX, min(value, _INT32_MAX - 1)))
