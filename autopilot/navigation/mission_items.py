"""Conversion of missions from a station's items, item for item.

Supported items and the meaning of their parameters are PX4's (src/modules/mavlink/mavlink_mission.cpp,
parse_mavlink_mission_item), with these differences: items without a position may have any frame,
CONDITION_YAW is supported, DO_SET_HOME and CONDITION_DISTANCE are not.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial

from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.navigation.mission import (
    HeightFrame,
    Mission,
    MissionCommand,
    MissionError,
    MissionItem,
    make_mission,
)
from autopilot.navigation.plan_checks import (
    HEIGHT_FRAMES,
    INVALID,
    NO_FRAME,
    PER_DEGREE,
    UNSUPPORTED,
    UNSUPPORTED_FRAME,
    RefusalError,
    frame_of,
    height_m,
    name_of,
    number,
    require_finite,
    require_place,
    wrong,
)
from autopilot.navigation.plan_store import WireItem


def mission(items: Sequence[WireItem]) -> Mission | None:
    """Return the mission, or None without items. Raises ValueError for items that `refusal` rejects."""
    if not items:
        return None
    made = [_mission_item(seq, item) for seq, item in enumerate(items)]
    count = len(made)
    for seq, item in enumerate(made):
        if item.command is MissionCommand.JUMP and not item.jump_to < count:
            raise wrong(seq, items[seq], 0, f"jumps to item {item.jump_to} of {count}")
    try:
        return make_mission(made)
    except MissionError as error:
        raise RefusalError(INVALID, 0, f"Mission: {error}") from None


# ---- items of a mission


def _mission_item(seq: int, item: WireItem) -> MissionItem:
    require_finite(seq, item)
    maker = _MAKERS.get(item.command)
    if maker is None:
        raise RefusalError(UNSUPPORTED, seq, f"Item {seq}: {name_of(item)} is not supported")
    if item.frame != NO_FRAME and item.frame not in HEIGHT_FRAMES:
        raise RefusalError(UNSUPPORTED_FRAME, seq, f"Item {seq}: {frame_of(item)} is not supported")
    return maker(seq, item)


def _place_or_here(seq: int, item: WireItem) -> tuple[float | None, float | None]:
    """Return latitude and longitude; None (the vehicle's position) without frame, at 0/0 or if invalid."""
    beyond = abs(item.x) > 90 * PER_DEGREE or abs(item.y) > 180 * PER_DEGREE
    if item.frame == NO_FRAME or (item.x, item.y) == (0, 0) or beyond:
        return None, None
    return require_place(seq, item)


def _yaw_deg(seq: int, item: WireItem) -> float | None:
    yaw_deg = number(seq, item, 3, low=-1e6, high=1e6, nothing=math.nan)
    return None if math.isnan(yaw_deg) else math.fmod(yaw_deg, 360.0)


def _placed(seq: int, item: WireItem, command: MissionCommand, *, has_yaw: bool = True) -> MissionItem:
    """Return the item of a command with a height and a position, which a take-off may lack."""
    height = height_m(seq, item)
    place = _place_or_here if command is MissionCommand.TAKEOFF else require_place
    lat_deg, lon_deg = place(seq, item)
    return MissionItem(
        command=command, lat_deg=lat_deg, lon_deg=lon_deg, height_m=height,
        frame=HEIGHT_FRAMES.get(item.frame, HeightFrame.ABOVE_HOME),
        yaw_deg=_yaw_deg(seq, item) if has_yaw else None,
    )  # fmt: skip


def _waypoint(seq: int, item: WireItem) -> MissionItem:
    placed = _placed(seq, item, MissionCommand.WAYPOINT)
    hold_s = number(seq, item, 0, high=1e6)
    return replace(placed, hold_s=hold_s, acceptance_m=number(seq, item, 1, high=1e4))


def _loiter_time(seq: int, item: WireItem) -> MissionItem:
    placed = _placed(seq, item, MissionCommand.LOITER_TIME)
    return replace(placed, hold_s=number(seq, item, 0, high=1e6))


def _land(seq: int, item: WireItem) -> MissionItem:
    lat_deg, lon_deg = _place_or_here(seq, item)
    return MissionItem(
        command=MissionCommand.LAND, lat_deg=lat_deg, lon_deg=lon_deg, yaw_deg=_yaw_deg(seq, item)
    )


def _delay(seq: int, item: WireItem) -> MissionItem:
    return MissionItem(command=MissionCommand.DELAY, hold_s=number(seq, item, 0, high=1e6))


def _turn(seq: int, item: WireItem) -> MissionItem:
    relative = number(seq, item, 3, low=0.0, high=1.0) == 1.0
    yaw_deg = number(seq, item, 0, low=-360.0, high=360.0)
    counterclockwise = number(seq, item, 2, low=-1.0, high=1.0) < 0.0
    return MissionItem(
        command=MissionCommand.TURN, yaw_relative=relative,
        yaw_deg=-yaw_deg if relative and counterclockwise else yaw_deg,
    )  # fmt: skip


def _jump(seq: int, item: WireItem) -> MissionItem:
    return MissionItem(
        command=MissionCommand.JUMP,
        jump_to=int(number(seq, item, 0, high=65_535.0, nothing=None)),
        jump_count=int(number(seq, item, 1, low=-1.0, high=65_535.0, nothing=None)),
    )


def _change_speed(seq: int, item: WireItem) -> MissionItem:
    """Speed over ground; airspeed is equivalent for a multicopter, and vertical speeds are parameters."""
    number(seq, item, 0, low=0.0, high=1.0)
    speed_m_s = number(seq, item, 1, low=-2.0, high=1e3)
    return MissionItem(command=MissionCommand.CHANGE_SPEED, speed_m_s=speed_m_s if speed_m_s > 0.0 else None)


def _look_at(seq: int, item: WireItem) -> MissionItem:
    return _placed(seq, item, MissionCommand.LOOK_AT, has_yaw=False)


def _look_ahead(_seq: int, _item: WireItem) -> MissionItem:
    return MissionItem(command=MissionCommand.LOOK_AHEAD)


def _roi(seq: int, item: WireItem) -> MissionItem:
    """MAV_CMD_DO_SET_ROI and MAV_CMD_NAV_ROI, whose first parameter is the kind of region."""
    what = number(seq, item, 0, high=4.0)
    if what == common.MAV_ROI_LOCATION:
        return _look_at(seq, item)
    if what == common.MAV_ROI_NONE:
        return _look_ahead(seq, item)
    if what == common.MAV_ROI_WPNEXT:
        return _act(seq, item)
    raise wrong(seq, item, 0, f"region of interest of kind {what:g} is not supported")


def _act(_seq: int, item: WireItem) -> MissionItem:
    return MissionItem(command=MissionCommand.ACT, act=item.command)


ACTS: dict[int, str] = {
    common.MAV_CMD_DO_LAND_START: "",
    common.MAV_CMD_DO_SET_ROI: "look at the next place",
    common.MAV_CMD_NAV_ROI: "look at the next place",
    common.MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET: "look at the next place",
    common.MAV_CMD_DO_SET_ACTUATOR: "set actuators",
    common.MAV_CMD_DO_CONTROL_VIDEO: "control video",
    common.MAV_CMD_DO_DIGICAM_CONTROL: "take photo",
    common.MAV_CMD_DO_MOUNT_CONFIGURE: "configure mount",
    common.MAV_CMD_DO_MOUNT_CONTROL: "turn mount",
    common.MAV_CMD_DO_SET_CAM_TRIGG_DIST: "photos by distance",
    common.MAV_CMD_DO_GRIPPER: "move gripper",
    common.MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL: "photos by time",
    common.MAV_CMD_OBLIQUE_SURVEY: "oblique survey",
    common.MAV_CMD_SET_CAMERA_MODE: "set camera mode",
    common.MAV_CMD_SET_CAMERA_ZOOM: "zoom camera",
    common.MAV_CMD_SET_CAMERA_FOCUS: "focus camera",
    common.MAV_CMD_SET_CAMERA_SOURCE: "set camera source",
    common.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: "turn gimbal",
    common.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: "configure gimbal",
    common.MAV_CMD_IMAGE_START_CAPTURE: "take photo",
    common.MAV_CMD_IMAGE_STOP_CAPTURE: "stop photos",
    common.MAV_CMD_DO_TRIGGER_CONTROL: "control trigger",
    common.MAV_CMD_VIDEO_START_CAPTURE: "start video",
    common.MAV_CMD_VIDEO_STOP_CAPTURE: "stop video",
    common.MAV_CMD_DO_WINCH: "move winch",
}
"""Payload items and the message when the vehicle passes them; a marker has none."""

_MAKERS: dict[int, Callable[[int, WireItem], MissionItem]] = dict.fromkeys(ACTS, _act) | {
    common.MAV_CMD_NAV_WAYPOINT: _waypoint,
    common.MAV_CMD_NAV_LOITER_UNLIM: partial(_placed, command=MissionCommand.LOITER_UNLIMITED),
    common.MAV_CMD_NAV_LOITER_TIME: _loiter_time,
    common.MAV_CMD_NAV_LOITER_TO_ALT: partial(_placed, command=MissionCommand.LOITER_TO_ALT, has_yaw=False),
    common.MAV_CMD_NAV_TAKEOFF: partial(_placed, command=MissionCommand.TAKEOFF),
    common.MAV_CMD_NAV_LAND: _land,
    common.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _seq, _item: MissionItem(command=MissionCommand.RETURN),
    common.MAV_CMD_NAV_DELAY: _delay,
    common.MAV_CMD_CONDITION_DELAY: _delay,
    common.MAV_CMD_CONDITION_YAW: _turn,
    common.MAV_CMD_DO_JUMP: _jump,
    common.MAV_CMD_DO_CHANGE_SPEED: _change_speed,
    common.MAV_CMD_DO_SET_ROI_LOCATION: _look_at,
    common.MAV_CMD_DO_SET_ROI_NONE: _look_ahead,
    common.MAV_CMD_DO_SET_ROI: _roi,
    common.MAV_CMD_NAV_ROI: _roi,
}
