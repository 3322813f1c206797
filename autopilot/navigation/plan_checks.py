"""Common checks of plan items: frames, positions, limits of numbers, and rejection."""

import math

from pymavlink.dialects.v20 import common

from autopilot.navigation.mission import HeightFrame
from autopilot.navigation.plan_store import Refused, WireItem

INVALID = common.MAV_MISSION_INVALID
UNSUPPORTED = common.MAV_MISSION_UNSUPPORTED
UNSUPPORTED_FRAME = common.MAV_MISSION_UNSUPPORTED_FRAME
INVALID_PARAM = (
    common.MAV_MISSION_INVALID_PARAM1,
    common.MAV_MISSION_INVALID_PARAM2,
    common.MAV_MISSION_INVALID_PARAM3,
    common.MAV_MISSION_INVALID_PARAM4,
    common.MAV_MISSION_INVALID_PARAM5_X,
    common.MAV_MISSION_INVALID_PARAM6_Y,
    common.MAV_MISSION_INVALID_PARAM7,
)
"""By the parameter's index, from 0."""
_FIELDS = ("param1", "param2", "param3", "param4", "latitude", "longitude", "altitude")

HEIGHT_FRAMES = {
    common.MAV_FRAME_GLOBAL: HeightFrame.AMSL,
    common.MAV_FRAME_GLOBAL_INT: HeightFrame.AMSL,
    common.MAV_FRAME_GLOBAL_RELATIVE_ALT: HeightFrame.ABOVE_HOME,
    common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: HeightFrame.ABOVE_HOME,
}
NO_FRAME = common.MAV_FRAME_MISSION
PER_DEGREE = 10_000_000
_HEIGHT_MAX_M = 1e5


class RefusalError(ValueError):
    """An item that is rejected."""

    def __init__(self, result: int, seq: int, text: str) -> None:
        super().__init__(text)
        self.refused = Refused(result, seq, text)


def require_finite(seq: int, item: WireItem) -> None:
    """Reject infinite parameters."""
    for i, value in enumerate((*item.params, 0.0, 0.0, item.z)):
        if math.isinf(value):
            raise wrong(seq, item, i, f"{_FIELDS[i]} is not finite")


def require_place(seq: int, item: WireItem) -> tuple[float, float]:
    """Return latitude and longitude, degrees."""
    if item.frame not in HEIGHT_FRAMES:
        raise RefusalError(
            UNSUPPORTED_FRAME, seq, f"Item {seq}: {name_of(item)} in {frame_of(item)} is not supported"
        )
    lat_deg, lon_deg = item.x / PER_DEGREE, item.y / PER_DEGREE
    for i, value, most in ((4, lat_deg, 90.0), (5, lon_deg, 180.0)):
        if abs(value) > most:
            raise wrong(seq, item, i, f"{_FIELDS[i]} {value:g} is beyond {most:g}")
    return lat_deg, lon_deg


def height_m(seq: int, item: WireItem) -> float:
    """Return the height, relative to the reference of the frame."""
    if not abs(item.z) <= _HEIGHT_MAX_M:  # also rejects not-a-number
        raise wrong(seq, item, 6, f"altitude {item.z:g} is outside {-_HEIGHT_MAX_M:g} .. {_HEIGHT_MAX_M:g}")
    return item.z


def number(
    seq: int, item: WireItem, i: int, *, high: float, low: float = 0.0, nothing: float | None = 0.0
) -> float:
    """Return parameter ``i``, from 0, within limits; ``nothing`` replaces a missing one, None forbids it."""
    value = item.params[i]
    if math.isnan(value) and nothing is not None:
        return nothing
    if not low <= value <= high:
        raise wrong(seq, item, i, f"{_FIELDS[i]} {value:g} is outside {low:g} .. {high:g}")
    return value


def wrong(seq: int, item: WireItem, i: int, text: str) -> RefusalError:
    """Return the rejection of a parameter, numbered from 0."""
    return RefusalError(INVALID_PARAM[i], seq, f"Item {seq} ({name_of(item)}): {text}")


def name_of(item: WireItem) -> str:
    """Return a command's name without its prefix."""
    entry = common.enums["MAV_CMD"].get(item.command)
    return f"command {item.command}" if entry is None else str(entry.name).removeprefix("MAV_CMD_")


def frame_of(item: WireItem) -> str:
    """Return a frame's number and name."""
    entry = common.enums["MAV_FRAME"].get(item.frame)
    return f"frame {item.frame}" + (
        "" if entry is None else f", {str(entry.name).removeprefix('MAV_FRAME_')},"
    )
