"""Plans as exchanged with ground stations: the items of mission, geofence and rally points, bit for bit.

`plan_items` converts them for flight, and the result is stored with them; reading a plan over MAVLink returns
the items that were written.
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
    """Types of plan: MAV_MISSION_TYPE numbers."""

    MISSION = common.MAV_MISSION_TYPE_MISSION
    FENCE = common.MAV_MISSION_TYPE_FENCE
    RALLY = common.MAV_MISSION_TYPE_RALLY


CAPACITY = {PlanType.MISSION: 10_000, PlanType.FENCE: 500, PlanType.RALLY: 80}
"""Greatest number of items of each type, as in PX4's simulation."""


NOT_GIVEN = 2**31 - 1
"""MAVLink's value of an integer coordinate that is not given, the equivalent of a float's not-a-number."""


class WireItem(NamedTuple):
    """An item of MISSION_ITEM_INT; not-a-number is MAVLink's value of a parameter that is not given."""

    command: int
    """MAV_CMD"""
    frame: int
    """MAV_FRAME"""
    params: tuple[float, float, float, float]
    """Values that are exact in float32."""
    x: int
    """Latitude in 1e-7 degrees in global frames, else the fifth parameter; or NOT_GIVEN."""
    y: int
    """Longitude in 1e-7 degrees, else the sixth parameter; or NOT_GIVEN."""
    z: float
    """Metres, relative to the reference of the frame."""
    autocontinue: int = 1


class RallyPoint(NamedTuple):
    """An alternative position to return to."""

    lat_deg: float
    lon_deg: float
    height_m: float
    frame: HeightFrame


class Made(NamedTuple):
    """Plan converted for flight: of one type, so the other fields are empty."""

    mission: Mission | None = None
    fence_shapes: tuple[FenceShape, ...] = ()
    rally_points: tuple[RallyPoint, ...] = ()


NOTHING = Made()


class Plan(NamedTuple):
    """Items of one type of plan."""

    items: tuple[WireItem, ...] = ()
    opaque_id: int = 0
    """Checksum of the items' contents, 0 without items; stations use it to detect a changed plan."""
    start: int = 0
    """Of a mission: the first item to fly, which the station marked as current."""
    made: Made = NOTHING
    """The plan converted for flight."""


class Refused(NamedTuple):
    """Reason for which a plan is rejected."""

    result: int
    """MAV_MISSION_RESULT"""
    seq: int
    """The item's number in its plan."""
    text: str
    """One line for the user, with item and field."""


class PlanStore:
    """Plans of one vehicle."""

    def __init__(self) -> None:
        self._plans = dict.fromkeys(PlanType, Plan())
        self.version = dict.fromkeys(PlanType, 0)
        """Incremented when a plan changes."""

    def __getitem__(self, kind: PlanType) -> Plan:
        return self._plans[kind]

    def put(self, kind: PlanType, items: Iterable[WireItem], *, start: int = 0, made: Made = NOTHING) -> bool:
        """Replace the plan of a type; return whether the items differ.

        The same items change nothing, so a mission that is uploaded again continues (PX4).
        """
        plan = make_plan(items, start=start, made=made)
        if plan.opaque_id == self._plans[kind].opaque_id:
            return False
        self._plans[kind] = plan
        self.version[kind] += 1
        return True


_CONTENT = struct.Struct("<BHB4fiif")


def make_plan(items: Iterable[WireItem], *, start: int = 0, made: Made = NOTHING) -> Plan:
    """Return a plan of items, with its opaque id."""
    kept = tuple(items)
    return Plan(kept, opaque_id(kept), start, made)


def opaque_id(items: Sequence[WireItem]) -> int:
    """Return the checksum of the items' contents; 0 only without items."""
    checksum = 0
    for item in items:
        content = (item.frame, item.command, item.autocontinue, *item.params, item.x, item.y, item.z)
        checksum = crc32(_CONTENT.pack(*content), checksum)
    return checksum or len(items)
