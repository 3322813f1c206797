"""Plans as ground stations know them: the items of mission, geofence and rally points, bit for bit.

What is flown and kept to is made of them by `plan_items` and kept beside them; what is read back over MAVLink
is what was written.
"""

import struct
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.commander.geofence import FenceShape
from autopilot.mavlink.crc import crc32
from autopilot.navigation.mission import HeightFrame, Mission


class PlanType(IntEnum):
    """Kinds of plan: MAV_MISSION_TYPE numbers."""

    MISSION = common.MAV_MISSION_TYPE_MISSION
    FENCE = common.MAV_MISSION_TYPE_FENCE
    RALLY = common.MAV_MISSION_TYPE_RALLY


CAPACITY = {PlanType.MISSION: 10_000, PlanType.FENCE: 500, PlanType.RALLY: 80}
"""Most items of each, as PX4's simulation has it."""


NOT_GIVEN = 2**31 - 1
"""MAVLink's mark of an integer coordinate that is not given, as not-a-number is that of a float."""


class WireItem(NamedTuple):
    """An item as MISSION_ITEM_INT carries it; not-a-number is MAVLink's mark of what is not given."""

    command: int
    """MAV_CMD"""
    frame: int
    """MAV_FRAME"""
    params: tuple[float, float, float, float]
    """Values that a float32 holds."""
    x: int
    """Latitude in 1e-7 degrees in frames that have one, else the fifth parameter; or NOT_GIVEN."""
    y: int
    """Longitude in 1e-7 degrees, else the sixth parameter; or NOT_GIVEN."""
    z: float
    """Metres; what it counts from is the frame's."""
    autocontinue: int = 1


class RallyPoint(NamedTuple):
    """A place to return to instead of home."""

    lat_deg: float
    lon_deg: float
    height_m: float
    frame: HeightFrame


class Made(NamedTuple):
    """What items are made into: of one type of plan, so the others are empty."""

    mission: Mission | None = None
    fence_shapes: tuple[FenceShape, ...] = ()
    rally_points: tuple[RallyPoint, ...] = ()


NOTHING = Made()


class Plan(NamedTuple):
    """Items of one type."""

    items: tuple[WireItem, ...] = ()
    opaque_id: int = 0
    """Of the items' contents; 0 without any. Stations know by it whether what they have is what is here."""
    start: int = 0
    """Of a mission: the item to begin with, which its writer marked as current."""
    made: Made = NOTHING
    """What is flown and kept to."""


class Refused(NamedTuple):
    """Why a plan is not taken."""

    result: int
    """MAV_MISSION_RESULT"""
    seq: int
    """The item's number in its plan."""
    text: str
    """One line for the user that names item and field."""


class PlanStore:
    """The plans of one vehicle."""

    def __init__(self) -> None:
        self._plans = dict.fromkeys(PlanType, Plan())
        self.version = dict.fromkeys(PlanType, 0)
        """Rises when a plan has become another."""

    def __getitem__(self, kind: PlanType) -> Plan:
        return self._plans[kind]

    def put(self, kind: PlanType, items: Iterable[WireItem], *, start: int = 0, made: Made = NOTHING) -> bool:
        """Take other items, and what was made of them, in place of all of a type; tells whether they differ.

        Where they are the same nothing changes, so that a mission that is written again is flown on (PX4).
        """
        plan = make_plan(items, start=start, made=made)
        if plan.opaque_id == self._plans[kind].opaque_id:
            return False
        self._plans[kind] = plan
        self.version[kind] += 1
        return True


_CONTENT = struct.Struct("<BHB4fiif")


def make_plan(items: Iterable[WireItem], *, start: int = 0, made: Made = NOTHING) -> Plan:
    """Give items their opaque id."""
    kept = tuple(items)
    return Plan(kept, opaque_id(kept), start, made)


def opaque_id(items: Sequence[WireItem]) -> int:
    """Checksum over what the items say; 0 for none, and never 0 otherwise."""
    checksum = 0
    for item in items:
        content = (item.frame, item.command, item.autocontinue, *item.params, item.x, item.y, item.z)
        checksum = crc32(_CONTENT.pack(*content), checksum)
    return checksum or len(items)
