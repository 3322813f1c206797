"""What a mission is: its items, and what makes one wrong. Data; `mission_runner` goes through it.

An item stands for one of MAVLink's MISSION_ITEM_INT and has its number in the list; `plan_items` makes one of
the other (None stands where MAVLink has not-a-number or does not care).
"""

import math
from collections.abc import Iterable, Sequence
from enum import Enum, IntEnum

from msgspec import Struct
from pymavlink.dialects.v20 import common


class MissionError(ValueError):
    """A mission that cannot be flown; the text is one line."""


class MissionCommand(IntEnum):
    """What an item asks for: MAV_CMD numbers, but for ACT."""

    ACT = 0
    """Of a camera, a gimbal or another load that may be aboard or not: told, and passed."""
    WAYPOINT = common.MAV_CMD_NAV_WAYPOINT
    LOITER_UNLIMITED = common.MAV_CMD_NAV_LOITER_UNLIM
    LOITER_TIME = common.MAV_CMD_NAV_LOITER_TIME
    RETURN = common.MAV_CMD_NAV_RETURN_TO_LAUNCH
    LAND = common.MAV_CMD_NAV_LAND
    TAKEOFF = common.MAV_CMD_NAV_TAKEOFF
    LOITER_TO_ALT = common.MAV_CMD_NAV_LOITER_TO_ALT
    DELAY = common.MAV_CMD_NAV_DELAY
    TURN = common.MAV_CMD_CONDITION_YAW
    JUMP = common.MAV_CMD_DO_JUMP
    CHANGE_SPEED = common.MAV_CMD_DO_CHANGE_SPEED
    LOOK_AT = common.MAV_CMD_DO_SET_ROI_LOCATION
    LOOK_AHEAD = common.MAV_CMD_DO_SET_ROI_NONE


class HeightFrame(Enum):
    """What an item's height counts from."""

    ABOVE_HOME = "above home"
    """MAV_FRAME_GLOBAL_RELATIVE_ALT(_INT)"""
    AMSL = "above mean sea level"
    """MAV_FRAME_GLOBAL(_INT)"""


FLOWN = frozenset(MissionCommand) - {
    MissionCommand.ACT,
    MissionCommand.JUMP,
    MissionCommand.CHANGE_SPEED,
    MissionCommand.LOOK_AT,
    MissionCommand.LOOK_AHEAD,
}
"""Commands that take time; the others act on the way."""
_NEEDS_PLACE = {
    MissionCommand.WAYPOINT,
    MissionCommand.LOITER_UNLIMITED,
    MissionCommand.LOITER_TIME,
    MissionCommand.LOITER_TO_ALT,
    MissionCommand.LOOK_AT,
}


class MissionItem(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One step of a mission."""

    command: MissionCommand
    lat_deg: float | None = None
    """None with ``lon_deg``: where the vehicle is, for TAKEOFF and LAND"""
    lon_deg: float | None = None
    height_m: float = 0.0
    """Of WAYPOINT, LOITER and TAKEOFF; LAND goes down to the ground, wherever that is"""
    frame: HeightFrame = HeightFrame.ABOVE_HOME
    acceptance_m: float = 0.0
    """Horizontal distance at which the place is reached; 0: NAV_ACC_RAD"""
    hold_s: float = 0.0
    """Stay of WAYPOINT, LOITER_TIME and DELAY"""
    yaw_deg: float | None = None
    """Heading at the place, clockwise from north; None: as MPC_YAW_MODE says. TURN turns there"""
    yaw_relative: bool = False
    """Of TURN: ``yaw_deg`` counts from the present heading"""
    speed_m_s: float | None = None
    """Of CHANGE_SPEED, over ground; None: MPC_XY_CRUISE again"""
    jump_to: int = 0
    """Of JUMP: index of the item to go on with"""
    jump_count: int = 1
    """Of JUMP: how often; after that the mission goes on behind it. -1: always"""
    act: int = 0
    """Of ACT: the MAV_CMD"""

    @property
    def has_place(self) -> bool:
        """Whether it says where."""
        return self.lat_deg is not None and self.lon_deg is not None


class Mission(Struct, frozen=True):
    """Items in their order, checked: making one raises MissionError with the first reason against it."""

    items: tuple[MissionItem, ...]

    def __post_init__(self) -> None:
        """Refuse what cannot be flown."""
        trouble = _trouble(self.items)
        if trouble is not None:
            raise MissionError(trouble)

    def first_place(self) -> MissionItem | None:
        """Give the first item with a place to fly to, in the order of the list."""
        return next((item for item in self.items if item.has_place and item.command in FLOWN), None)


def make_mission(items: Iterable[MissionItem]) -> Mission:
    """Make a checked mission. Raises MissionError."""
    return Mission(tuple(items))


# ---- what is wrong with a mission


def _trouble(items: Sequence[MissionItem]) -> str | None:
    if not items:
        return "the mission is empty"
    for index, item in enumerate(items):
        trouble = _item_trouble(item, len(items))
        if trouble is not None:
            return f"item {index} ({item.command.name}): {trouble}"
    if not any(item.command in FLOWN for item in items):
        return "the mission has nothing to fly"
    index_in_circle = _circle(items)
    if index_in_circle is not None:
        return f"item {index_in_circle} (JUMP): goes round in a circle without flying anything"
    return None


def _item_trouble(item: MissionItem, count: int) -> str | None:
    if (item.lat_deg is None) is not (item.lon_deg is None):
        return "latitude and longitude come together"
    if item.command in _NEEDS_PLACE and not item.has_place:
        return "it has no place"
    checks = (
        (item.lat_deg, -90.0, 90.0, "latitude"),
        (item.lon_deg, -180.0, 180.0, "longitude"),
        (item.height_m, -1e5, 1e5, "height"),
        (item.acceptance_m, 0.0, 1e4, "acceptance radius"),
        (item.hold_s, 0.0, 1e6, "hold time"),
        (item.yaw_deg, -360.0, 360.0, "heading"),
    )
    for value, low, high, name in checks:
        if value is not None and not low <= value <= high:  # also refuses not-a-number
            return f"{name} {value:g} is outside {low:g} .. {high:g}"
    if item.command is MissionCommand.TURN and item.yaw_deg is None:
        return "it has no heading"
    if item.speed_m_s is not None and not 0.0 < item.speed_m_s < math.inf:
        return f"speed {item.speed_m_s:g} m/s is not positive"
    if item.command is MissionCommand.JUMP:
        if not 0 <= item.jump_to < count:
            return f"it jumps to {item.jump_to}, but the items are 0 .. {count - 1}"
        if item.jump_count < -1:
            return f"jump count {item.jump_count} is below -1"
    return None


def _circle(items: Sequence[MissionItem]) -> int | None:
    """Index of a jump from which jumps lead round past nothing that is flown, or None.

    Takes away, again and again, what leads nowhere and what nothing leads to: what is left goes round.
    """
    after = {i: set(_follow(items, i)) for i, item in enumerate(items) if item.command not in FLOWN}
    for index in after:
        after[index] &= after.keys()
    before: dict[int, set[int]] = {index: set() for index in after}
    for index, following in after.items():
        for other in following:
            before[other].add(index)
    for ahead, behind in ((after, before), (before, after)):
        idle = [index for index, following in ahead.items() if not following]
        while idle:
            index = idle.pop()
            for other in behind.pop(index):
                ahead[other].discard(index)
                if not ahead[other]:
                    idle.append(other)
            del ahead[index]
    jumps = (index for index in after if items[index].command is MissionCommand.JUMP)
    return min(jumps, default=None)


def _follow(items: Sequence[MissionItem], index: int) -> list[int]:
    """Indices that may come after an item that is not flown."""
    item = items[index]
    if item.command is not MissionCommand.JUMP or item.jump_count == 0:
        return [index + 1]
    return [item.jump_to, index + 1] if item.jump_count > 0 else [item.jump_to]
