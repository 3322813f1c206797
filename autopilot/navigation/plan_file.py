"""Plan files of QGroundControl (.plan): mission, geofence and rally points in JSON, version 1.

The format is that of QGroundControl's developer guide, "Plan File Format". Surveys and corridor scans are
read as the items that were generated from them; without such items they are rejected. `loads` returns the
items as QGroundControl would upload them to a PX4, and `dumps` writes them so that `loads` returns the same.
Both are pure; `load` reads a file.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.navigation import plan_items
from autopilot.navigation.plan_checks import NO_FRAME, PER_DEGREE
from autopilot.navigation.plan_items import float32
from autopilot.navigation.plan_store import CAPACITY, PlanType, Refused, WireItem
from foundation.text_file import TextFileError, read_text

_JUMP = common.MAV_CMD_DO_JUMP
_INT_MAX = 2**31 - 1
_VERSIONS = {"mission": 2, "geoFence": 2, "rallyPoints": 2}
_HOME_ITEMS = 1
"""QGroundControl counts the planned home as the item before the first, also in jump targets."""


class PlanFileError(ValueError):
    """A plan that cannot be read or flown; the text is one line with the location."""


class HomePlace(NamedTuple):
    """Planned home position."""

    lat_deg: float
    lon_deg: float
    alt_m: float
    """Above mean sea level."""


class Plans(NamedTuple):
    """Contents of a file."""

    mission: tuple[WireItem, ...] = ()
    fence: tuple[WireItem, ...] = ()
    rally: tuple[WireItem, ...] = ()
    home: HomePlace | None = None

    def of(self, kind: PlanType) -> tuple[WireItem, ...]:
        """Return the items of one type."""
        return {PlanType.MISSION: self.mission, PlanType.FENCE: self.fence, PlanType.RALLY: self.rally}[kind]


def load(path: Path) -> str:
    """Return a file's text. Raises PlanFileError, also if `loads` rejects it."""
    try:
        text = read_text(path)
    except TextFileError as error:
        raise PlanFileError(str(error)) from None
    try:
        loads(text)
    except PlanFileError as error:
        raise PlanFileError(f"{path}: {error}") from None
    return text


def loads(text: str) -> Plans:
    """Return the plans, checked for whether they can be flown. Raises PlanFileError."""
    try:
        file = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"not JSON: {error}") from None
    table = _Table(file, "plan")
    if table.get("fileType") != "Plan" or table.get("version") != 1:
        raise PlanFileError('not a plan: "fileType" must be "Plan" and "version" 1')
    mission = table.table("mission")
    plans = Plans(
        mission=_mission(mission) if mission else (),
        fence=_fence(table.table("geoFence")),
        rally=_rally(table.table("rallyPoints")),
        home=_home(mission),
    )
    for kind in PlanType:
        items = plans.of(kind)
        if len(items) > CAPACITY[kind]:
            raise PlanFileError(f"{kind.name.lower()}: {len(items)} items, {CAPACITY[kind]} at most")
        made = plan_items.make(kind, items)
        if isinstance(made, Refused):
            raise PlanFileError(f"{kind.name.lower()}: {made.text}")
    return plans


def dumps(plans: Plans) -> str:
    """Return the text of plans. Raises ValueError for infinity, which JSON does not represent.

    Frames and flags of fence and rally points are not in the format: reading sets QGroundControl's.
    """
    mission: dict[str, Any] = {
        "cruiseSpeed": 15, "firmwareType": common.MAV_AUTOPILOT_PX4, "globalPlanAltitudeMode": 1,
        "hoverSpeed": 5, "items": [_simple_item(seq, item) for seq, item in enumerate(plans.mission)],
        "plannedHomePosition": list(plans.home or _first_place(plans)),
        "vehicleType": common.MAV_TYPE_QUADROTOR, "version": _VERSIONS["mission"],
    }  # fmt: skip
    file = {
        "fileType": "Plan", "geoFence": _fence_table(plans.fence), "groundStation": "coflight",
        "mission": mission,
        "rallyPoints": {
            "points": [[*_lat_lon(item), item.z] for item in plans.rally],
            "version": _VERSIONS["rallyPoints"],
        },
        "version": 1,
    }  # fmt: skip
    return json.dumps(file, indent=4, sort_keys=True, allow_nan=False) + "\n"


# ---- reading


class _Table:
    """A JSON object and its path, for error messages."""

    def __init__(self, value: object, path: str) -> None:
        if not isinstance(value, dict):
            raise PlanFileError(f"{path}: expected an object")
        self.values: Mapping[str, Any] = value
        self.path = path

    def __bool__(self) -> bool:
        return bool(self.values)

    def get(self, key: str) -> Any:  # noqa: ANN401  # any JSON value
        return self.values.get(key)

    def table(self, key: str) -> "_Table":
        """Return a nested object, empty if missing. Raises PlanFileError for an unknown version."""
        table = _Table(self.values.get(key, {}), key if self.path == "plan" else f"{self.path}.{key}")
        version = _VERSIONS.get(key)
        if table and version is not None and table.get("version") != version:
            raise PlanFileError(f"{table.path}: version {table.get('version')}, expected {version}")
        return table

    def entries(self, key: str) -> list[tuple[str, Any]]:
        """Return paths and values of a nested list, empty if missing."""
        values = self.values.get(key, [])
        if not isinstance(values, list):
            raise PlanFileError(f"{self.path}.{key}: expected a list")
        return [(f"{self.path}.{key}[{i}]", value) for i, value in enumerate(values)]

    def tables(self, key: str) -> list["_Table"]:
        """Return the objects of a nested list."""
        return [_Table(value, path) for path, value in self.entries(key)]

    def whole(self, key: str, *, high: int) -> int:
        """Return an integer from 0 to ``high``."""
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= high:
            raise PlanFileError(f"{self.path}.{key}: expected a whole number from 0 to {high}")
        return value

    def flag(self, key: str) -> bool:
        """Return a boolean."""
        value = self.values.get(key)
        if not isinstance(value, bool):
            raise PlanFileError(f"{self.path}.{key}: expected true or false")
        return value


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number in JSON")


def _numbers(value: object, path: str, count: int) -> list[float]:
    """Return the numbers of a list; null is not-a-number."""
    if not isinstance(value, list) or len(value) < count:
        raise PlanFileError(f"{path}: expected {count} numbers")
    return [math.nan if number is None else _finite(number, path) for number in value[:count]]


def _finite(value: object, path: str) -> float:
    """Return a number that fits into MAVLink's float."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 3.4e38:
        raise PlanFileError(f"{path}: expected a number")
    return float(value)


def _place(value: object, path: str) -> tuple[float, float]:
    lat_deg, lon_deg = _numbers(value, path, 2)
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        raise PlanFileError(f"{path}: {lat_deg:g}, {lon_deg:g} is not a valid latitude and longitude")
    return lat_deg, lon_deg


def _home(mission: _Table) -> HomePlace | None:
    """Return the planned home; None if it is null or contains nulls."""
    value = mission.get("plannedHomePosition")
    path = f"{mission.path}.plannedHomePosition"
    if value is None or all(math.isnan(number) for number in _numbers(value, path, 2)):
        return None
    lat_deg, lon_deg = _place(value, path)
    alt_m = _numbers(value, path, 3)[2] if len(value) > 2 else 0.0
    return HomePlace(lat_deg, lon_deg, 0.0 if math.isnan(alt_m) else alt_m)


def _mission(mission: _Table) -> tuple[WireItem, ...]:
    tables: list[_Table] = []
    for table in mission.tables("items"):
        tables += [table] if table.get("type") == "SimpleItem" else _made_items(table)
    items = [_wire_item(table) for table in tables]
    numbers = (table.get("doJumpId") for table in tables)
    index_of = {float(number): i for i, number in enumerate(numbers) if isinstance(number, int)}
    for i, item in enumerate(items):
        if item.command == _JUMP:
            target = index_of.get(item.params[0])
            if target is None:
                raise PlanFileError(
                    f"{tables[i].path}: jumps to item {item.params[0]:g}, which does not exist"
                )
            items[i] = item._replace(params=(float(target), *item.params[1:]))
    return tuple(items)


def _made_items(item: _Table) -> list[_Table]:
    """Return the items that QGroundControl generated from a survey or a corridor scan."""
    kind = item.get("complexItemType")
    made = item.table("TransectStyleComplexItem").tables("Items")
    if not made:
        raise PlanFileError(
            f"{item.path}: {kind or item.get('type')!r} without items to fly is not supported"
        )
    return made


def _wire_item(table: _Table) -> WireItem:
    path = f"{table.path}.params"
    *params, x, y, z = _numbers(table.get("params"), path, 7)
    frame = table.whole("frame", high=255)
    scale = 1.0 if frame == NO_FRAME else PER_DEGREE
    in_x, in_y = (0 if math.isnan(value) else round(value * scale) for value in (x, y))
    if max(abs(in_x), abs(in_y)) > _INT_MAX:
        raise PlanFileError(f"{path}: {x:g}, {y:g} is not a valid latitude and longitude")
    one, two, three, four = map(float32, params)
    return WireItem(
        command=table.whole("command", high=65_535),
        frame=frame,
        params=(one, two, three, four),
        x=in_x,
        y=in_y,
        z=float32(z),
        autocontinue=int(table.flag("autoContinue")),
    )


def _fence(fence: _Table) -> tuple[WireItem, ...]:
    items: list[WireItem] = []
    for table in fence.tables("polygons"):
        vertices = [_place(value, path) for path, value in table.entries("polygon")]
        items += plan_items.polygon_items(vertices, inclusion=table.flag("inclusion"))
    for table in fence.tables("circles"):
        circle = table.table("circle")
        lat_deg, lon_deg = _place(circle.get("center"), f"{circle.path}.center")
        radius_m = _finite(circle.get("radius"), f"{circle.path}.radius")
        inclusion = table.flag("inclusion")
        items.append(plan_items.circle_item(lat_deg, lon_deg, radius_m, inclusion=inclusion))
    if (point := fence.get("breachReturn")) is not None:
        path = f"{fence.path}.breachReturn"
        items.append(plan_items.return_point_item(*_place(point, path), _numbers(point, path, 3)[2]))
    return tuple(items)


def _rally(rally: _Table) -> tuple[WireItem, ...]:
    return tuple(
        plan_items.rally_item(*_place(value, path), _numbers(value, path, 3)[2])
        for path, value in rally.entries("points")
    )


# ---- writing


def _lat_lon(item: WireItem) -> list[float]:
    return [item.x / PER_DEGREE, item.y / PER_DEGREE]


def _first_place(plans: Plans) -> Sequence[float]:
    placed = (item for item in plans.mission if item.frame != NO_FRAME and (item.x, item.y) != (0, 0))
    first = next(placed, None)
    return [0.0, 0.0, 0.0] if first is None else [*_lat_lon(first), 0.0]


def _simple_item(seq: int, item: WireItem) -> dict[str, Any]:
    place: list[float] = [float(item.x), float(item.y)] if item.frame == NO_FRAME else _lat_lon(item)
    params = [*item.params, *place, item.z]
    if item.command == _JUMP:
        params[0] += _HOME_ITEMS
    return {
        "autoContinue": bool(item.autocontinue), "command": item.command, "doJumpId": seq + _HOME_ITEMS,
        "frame": item.frame, "params": [None if math.isnan(value) else value for value in params],
        "type": "SimpleItem",
    }  # fmt: skip


def _fence_table(items: Sequence[WireItem]) -> dict[str, Any]:
    polygons: list[dict[str, Any]] = []
    circles: list[dict[str, Any]] = []
    table: dict[str, Any] = {"circles": circles, "polygons": polygons, "version": _VERSIONS["geoFence"]}
    left = list(items)
    while left:
        item = left[0]
        count = 1
        if item.command == common.MAV_CMD_NAV_FENCE_RETURN_POINT:
            table["breachReturn"] = [*_lat_lon(item), item.z]
        elif item.command in plan_items.CIRCLES:
            circle = {"center": _lat_lon(item), "radius": item.params[0]}
            circles.append({"circle": circle, "inclusion": plan_items.CIRCLES[item.command], "version": 1})
        else:
            count = max(int(item.params[0]), 1)
            corners = [_lat_lon(corner) for corner in left[:count]]
            inclusion = item.command == common.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
            polygons.append({"inclusion": inclusion, "polygon": corners, "version": 1})
        del left[:count]
    return table
