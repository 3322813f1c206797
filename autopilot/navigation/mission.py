"""Missions: their items, and validation. Data; `mission_runner` executes it.

An item corresponds to one MISSION_ITEM_INT of MAVLink with the same index; `plan_items` converts between them
(None corresponds to MAVLink's not-a-number or an ignored field).
"""

import math
from collections.abc import Iterable, Sequence
from enum import Enum, IntEnum

from msgspec import Struct
from pymavlink.dialects.v20 import common


class MissionError(ValueError):
    """A mission that cannot be flown; the text is one line."""


class MissionCommand(IntEnum):
    """Command of an item: the MAV_CMD number, except for ACT."""

    ACT = 0
    """For a camera, a gimbal or another payload that may not be present: reported and skipped."""
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
    """Reference of an item's height."""

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
"""Commands that take time to fly; the others take effect immediately."""
_NEEDS_PLACE = {
    MissionCommand.WAYPOINT,
    MissionCommand.LOITER_UNLIMITED,
    MissionCommand.LOITER_TIME,
    MissionCommand.LOITER_TO_ALT,
    MissionCommand.LOOK_AT,
}


class MissionItem(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One item of a mission."""

    command: MissionCommand
    lat_deg: float | None = None
    """None with ``lon_deg``: the vehicle's position, for TAKEOFF and LAND"""
    lon_deg: float | None = None
    height_m: float = 0.0
    """Of WAYPOINT, LOITER and TAKEOFF; LAND descends to the ground at any height"""
    frame: HeightFrame = HeightFrame.ABOVE_HOME
    acceptance_m: float = 0.0
    """Horizontal distance at which the position is reached; 0: NAV_ACC_RAD"""
    hold_s: float = 0.0
    """Duration of WAYPOINT, LOITER_TIME and DELAY"""
    yaw_deg: float | None = None
    """Heading at the position, clockwise from north; None: by MPC_YAW_MODE. Final heading of TURN"""
    yaw_relative: bool = False
    """Of TURN: ``yaw_deg`` is relative to the present heading"""
    speed_m_s: float | None = None
    """Of CHANGE_SPEED, over ground; None: back to MPC_XY_CRUISE"""
    jump_to: int = 0
    """Of JUMP: index of the next item"""
    jump_count: int = 1
    """Of JUMP: number of repetitions, after which the mission continues behind it; -1: unlimited"""
    act: int = 0
    """Of ACT: the MAV_CMD number"""

    @property
    def has_place(self) -> bool:
        """Whether it has a horizontal position."""
        return self.lat_deg is not None and self.lon_deg is not None


class Mission(Struct, frozen=True):
    """Validated items in their order. Creation raises MissionError with the first fault."""

    items: tuple[MissionItem, ...]

    def __post_init__(self) -> None:
        """Reject a mission that cannot be flown."""
        fault = _fault(self.items)
        if fault is not None:
            raise MissionError(fault)

    def first_place(self) -> MissionItem | None:
        """Return the first item with a position to fly to, in the order of the list."""
        return next((item for item in self.items if item.has_place and item.command in FLOWN), None)


def make_mission(items: Iterable[MissionItem]) -> Mission:
    """Return a validated mission. Raises MissionError."""
    return Mission(tuple(items))


# ---- validation


def _fault(items: Sequence[MissionItem]) -> str | None:
    if not items:
        return "the mission is empty"
    for index, item in enumerate(items):
        fault = _item_fault(item, len(items))
        if fault is not None:
            return f"item {index} ({item.command.name}): {fault}"
    if not any(item.command in FLOWN for item in items):
        return "the mission has nothing to fly"
    index_in_loop = _jump_loop(items)
    if index_in_loop is not None:
        return f"item {index_in_loop} (JUMP): loops without anything to fly"
    return None


def _item_fault(item: MissionItem, count: int) -> str | None:
    if (item.lat_deg is None) is not (item.lon_deg is None):
        return "latitude and longitude must be given together"
    if item.command in _NEEDS_PLACE and not item.has_place:
        return "it has no position"
    checks = (
        (item.lat_deg, -90.0, 90.0, "latitude"),
        (item.lon_deg, -180.0, 180.0, "longitude"),
        (item.height_m, -1e5, 1e5, "height"),
        (item.acceptance_m, 0.0, 1e4, "acceptance radius"),
        (item.hold_s, 0.0, 1e6, "hold time"),
        (item.yaw_deg, -360.0, 360.0, "heading"),
    )
    for value, low, high, name in checks:
        if value is not None and not low <= value <= high:  # also rejects not-a-number
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


def _jump_loop(items: Sequence[MissionItem]) -> int | None:
    """Return the index of a jump in a loop that contains nothing to fly, or None.

    Repeatedly removes items without successors or without predecessors; the remaining ones form loops.
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
    """Return the indices that may follow an item that takes no time."""
    item = items[index]
    if item.command is not MissionCommand.JUMP or item.jump_count == 0:
        return [index + 1]
    return [item.jump_to, index + 1] if item.jump_count > 0 else [item.jump_to]
