"""Conversion between the plan items of ground stations and the plans used in flight.

`make` converts a list of items, or returns the reason for which it is rejected. In the other direction,
`mission_items` and `fence_items` convert the plans of a scenario, so that stations can read them.
"""

import math
from collections.abc import Sequence

import numpy as np
from pymavlink.dialects.v20 import common

from autopilot.commander.geofence import FenceCircle, FencePolygon, FenceShape
from autopilot.navigation.mission import HeightFrame, Mission, MissionCommand, MissionItem
from autopilot.navigation.mission_items import mission
from autopilot.navigation.plan_checks import (
    HEIGHT_FRAMES,
    INVALID,
    NO_FRAME,
    PER_DEGREE,
    UNSUPPORTED,
    RefusalError,
    height_m,
    name_of,
    number,
    require_finite,
    require_place,
    wrong,
)
from autopilot.navigation.plan_store import Made, PlanType, RallyPoint, Refused, WireItem

# ---- from items


def make(kind: PlanType, items: Sequence[WireItem]) -> Made | Refused:
    """Convert a list of items, or return the reason for rejection with its first invalid item.

    An empty list is valid.
    """
    try:
        if kind is PlanType.MISSION:
            return Made(mission=mission(items))
        if kind is PlanType.FENCE:
            return Made(fence_shapes=tuple(fence_shapes(items)))
        return Made(rally_points=rally_points(items))
    except RefusalError as error:
        return error.refused


def fence_shapes(items: Sequence[WireItem]) -> list[FenceShape]:
    """Return a fence's shapes. Raises ValueError for items that `make` rejects.

    A return point is accepted and ignored, as in PX4.
    """
    shapes: list[FenceShape] = []
    seq = 0
    while seq < len(items):
        item = items[seq]
        require_finite(seq, item)
        lat_deg, lon_deg = require_place(seq, item)
        count = 1
        if item.command in CIRCLES:
            radius_m, inclusion = item.params[0], CIRCLES[item.command]
            try:
                shapes.append(
                    FenceCircle(lat_deg=lat_deg, lon_deg=lon_deg, radius_m=radius_m, inclusion=inclusion)
                )
            except ValueError as error:
                raise wrong(seq, item, 0, str(error)) from None
        elif item.command in _VERTICES:
            count = _vertex_count(seq, items)
            vertices = tuple(require_place(i, items[i]) for i in range(seq, seq + count))
            try:
                shapes.append(FencePolygon(vertices=vertices, inclusion=_VERTICES[item.command]))
            except ValueError as error:
                raise RefusalError(INVALID, seq, f"Items {seq} to {seq + count - 1}: {error}") from None
        elif item.command != common.MAV_CMD_NAV_FENCE_RETURN_POINT:
            raise RefusalError(UNSUPPORTED, seq, f"Item {seq}: {name_of(item)} is not a fence item")
        seq += count
    return shapes


def rally_points(items: Sequence[WireItem]) -> tuple[RallyPoint, ...]:
    """Return rally points. Raises ValueError for items that `make` rejects."""
    points = []
    for seq, item in enumerate(items):
        if item.command != common.MAV_CMD_NAV_RALLY_POINT:
            raise RefusalError(UNSUPPORTED, seq, f"Item {seq}: {name_of(item)} is not a rally point")
        require_finite(seq, item)
        lat_deg, lon_deg = require_place(seq, item)
        points.append(RallyPoint(lat_deg, lon_deg, height_m(seq, item), HEIGHT_FRAMES[item.frame]))
    return tuple(points)


CIRCLES = {common.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True, common.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False}
_VERTICES = {
    common.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    common.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
"""Whether the shape is an inclusion."""


def _vertex_count(seq: int, items: Sequence[WireItem]) -> int:
    """Return the number of vertices of the polygon that begins at an item; all its items must agree."""
    first = items[seq]
    count = number(seq, first, 0, low=3.0, high=65_535.0, nothing=None)
    last = seq + int(count)
    if count != int(count) or last > len(items):
        raise wrong(seq, first, 0, f"polygon of {count:g} vertices, but {len(items) - seq} items remain")
    for i in range(seq, last):
        require_finite(i, items[i])
        if items[i].command != first.command or items[i].params[0] != first.params[0]:
            raise wrong(
                i, items[i], 0, f"does not belong to the polygon of {count:g} that begins with item {seq}"
            )
    return int(count)


# ---- to items


def mission_items(made: Mission) -> tuple[WireItem, ...]:
    """Return the items of a mission, as they would be received over MAVLink."""
    return tuple(_wire_item(item) for item in made.items)


def circle_item(lat_deg: float, lon_deg: float, radius_m: float, *, inclusion: bool) -> WireItem:
    """Return the item of a fence's circle, as sent by QGroundControl."""
    command = next(command for command, inside in CIRCLES.items() if inside is inclusion)
    return _place_item(command, lat_deg, lon_deg, param1=radius_m)


def polygon_items(vertices: Sequence[tuple[float, float]], *, inclusion: bool) -> tuple[WireItem, ...]:
    """Return the items of a polygon of latitudes and longitudes, degrees, as sent by QGroundControl."""
    command = next(command for command, inside in _VERTICES.items() if inside is inclusion)
    return tuple(_place_item(command, lat, lon, param1=float(len(vertices))) for lat, lon in vertices)


def return_point_item(lat_deg: float, lon_deg: float, height_m: float) -> WireItem:
    """Return the item of a fence's return point, height above home."""
    return _point_item(common.MAV_CMD_NAV_FENCE_RETURN_POINT, lat_deg, lon_deg, height_m)


def rally_item(lat_deg: float, lon_deg: float, height_m: float) -> WireItem:
    """Return the item of a rally point, height above home."""
    return _point_item(common.MAV_CMD_NAV_RALLY_POINT, lat_deg, lon_deg, height_m)


def fence_items(shapes: Sequence[FenceShape]) -> tuple[WireItem, ...]:
    """Return the items of a fence's shapes."""
    items: list[WireItem] = []
    for shape in shapes:
        if isinstance(shape, FenceCircle):
            items.append(circle_item(shape.lat_deg, shape.lon_deg, shape.radius_m, inclusion=shape.inclusion))
        else:
            items += polygon_items(shape.vertices, inclusion=shape.inclusion)
    return tuple(items)


def float32(value: float) -> float:
    """Return a number rounded to MAVLink's float."""
    return float(np.float32(value))


def _place_item(command: int, lat_deg: float, lon_deg: float, *, param1: float) -> WireItem:
    frame, params = common.MAV_FRAME_GLOBAL, (float32(param1), 0.0, 0.0, 0.0)
    x, y = round(lat_deg * PER_DEGREE), round(lon_deg * PER_DEGREE)
    return WireItem(command, frame, params, x, y, z=0.0, autocontinue=0)


def _point_item(command: int, lat_deg: float, lon_deg: float, height_m: float) -> WireItem:
    item = _place_item(command, lat_deg, lon_deg, param1=0.0)
    return item._replace(frame=common.MAV_FRAME_GLOBAL_RELATIVE_ALT, z=float32(height_m))


def _wire_item(item: MissionItem) -> WireItem:
    command, nan = item.command, math.nan
    yaw_deg = nan if item.yaw_deg is None else item.yaw_deg
    params = (0.0, 0.0, 0.0, yaw_deg)
    if command is MissionCommand.WAYPOINT:
        params = (item.hold_s, item.acceptance_m, 0.0, yaw_deg)
    elif command is MissionCommand.LOITER_TIME:
        params = (item.hold_s, 0.0, 0.0, yaw_deg)
    elif command is MissionCommand.DELAY:
        params = (item.hold_s, 0.0, 0.0, 0.0)
    elif command is MissionCommand.TURN:
        params = (abs(yaw_deg), 0.0, math.copysign(1.0, yaw_deg), float(item.yaw_relative))
        if not item.yaw_relative:
            params = (yaw_deg, 0.0, 0.0, 0.0)
    elif command is MissionCommand.JUMP:
        params = (float(item.jump_to), float(item.jump_count), 0.0, 0.0)
    elif command is MissionCommand.CHANGE_SPEED:
        params = (1.0, -2.0 if item.speed_m_s is None else item.speed_m_s, -1.0, 0.0)
    one, two, three, four = map(float32, params)
    frame = _NUMBER_OF[item.frame] if item.has_place or command in _ANYWHERE else NO_FRAME
    return WireItem(
        command=item.act if command is MissionCommand.ACT else int(command),
        frame=frame,
        params=(one, two, three, four),
        x=round((item.lat_deg or 0.0) * PER_DEGREE),
        y=round((item.lon_deg or 0.0) * PER_DEGREE),
        z=float32(item.height_m),
    )


_ANYWHERE = {MissionCommand.TAKEOFF, MissionCommand.LAND}
_NUMBER_OF = {
    HeightFrame.ABOVE_HOME: common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    HeightFrame.AMSL: common.MAV_FRAME_GLOBAL_INT,
}
