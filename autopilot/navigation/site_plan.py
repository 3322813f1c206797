"""Conversion of a scenario's geofence, mission and rally points for the autopilot.

Each of the three is given either in metres of the site or in a plan file.
"""

from collections.abc import Sequence

from autopilot.commander.geofence import FenceCircle, FencePolygon, FenceShape, Origin
from autopilot.navigation import plan_file, plan_items
from autopilot.navigation.mission import Mission, MissionCommand, MissionError, MissionItem, make_mission
from autopilot.navigation.plan_store import Plan, PlanType, Refused, WireItem, make_plan
from autopilot.parameters.config import (
    AutopilotConfig,
    CircleConfig,
    MissionItemConfig,
    PolygonConfig,
    RallyPointConfig,
    Site,
)
from foundation.geometry.geodesy import ned_to_geodetic


class PlanError(ValueError):
    """A fence or a mission that cannot be flown; the text is one line."""


def plans(config: AutopilotConfig, site: Site) -> dict[PlanType, Plan]:
    """Return the plans of a scenario, as if uploaded by a station. Raises PlanError."""
    try:
        file = plan_file.loads(config.plan) if config.plan is not None else plan_file.Plans()
    except plan_file.PlanFileError as error:
        raise PlanError(f"plan: {error}") from None
    for name, in_file, in_scenario in (
        ("mission", file.mission, config.mission),
        ("fence", file.fence, config.fence),
        ("rally", file.rally, config.rally),
    ):
        if in_file and in_scenario:
            raise PlanError(f"{name}: also defined in the plan file; define it in only one of the two")
    flown = mission(config.mission, site)
    items = {
        PlanType.MISSION: file.mission or (() if flown is None else plan_items.mission_items(flown)),
        PlanType.FENCE: file.fence or plan_items.fence_items(fence_shapes(config.fence, site)),
        PlanType.RALLY: file.rally or tuple(_rally_item(point, site) for point in config.rally),
    }
    return {kind: _made_plan(kind, of_kind) for kind, of_kind in items.items()}


def fence_shapes(config: Sequence[CircleConfig | PolygonConfig], site: Site) -> list[FenceShape]:
    """Return the shapes in latitude and longitude. Raises PlanError with the shape's index from 0."""
    origin = Origin(site.latitude_deg, site.longitude_deg, site.altitude_m)
    shapes: list[FenceShape] = []
    for index, shape in enumerate(config):
        try:
            if isinstance(shape, CircleConfig):
                shapes.append(
                    FenceCircle.of_site(
                        shape.north_m, shape.east_m, shape.radius_m, inclusion=shape.inclusion, site=origin
                    )
                )
            else:
                shapes.append(FencePolygon.of_site(shape.vertices_m, inclusion=shape.inclusion, site=origin))
        except ValueError as error:
            raise PlanError(f"fence {index}: {error}") from None
    return shapes


def mission(config: Sequence[MissionItemConfig], site: Site) -> Mission | None:
    """Return the mission in latitude and longitude; None without items. Raises PlanError."""
    try:
        return make_mission(_item(item, site) for item in config) if config else None
    except MissionError as error:
        raise PlanError(f"mission: {error}") from None


def _item(item: MissionItemConfig, site: Site) -> MissionItem:
    lat_deg = lon_deg = None
    if item.north_m is not None and item.east_m is not None:
        lat_deg, lon_deg = _lat_lon_deg(item.north_m, item.east_m, site)
    return MissionItem(
        command=MissionCommand[item.command.upper()],
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        height_m=item.height_m,
        acceptance_m=item.acceptance_m,
        hold_s=item.hold_s,
        yaw_deg=item.yaw_deg,
        speed_m_s=item.speed_m_s,
        jump_to=item.jump_to,
        jump_count=item.jump_count,
    )


def _made_plan(kind: PlanType, items: Sequence[WireItem]) -> Plan:
    made = plan_items.make(kind, items)
    if isinstance(made, Refused):
        raise PlanError(f"{kind.name.lower()}: {made.text}")
    return make_plan(items, made=made)


def _rally_item(point: RallyPointConfig, site: Site) -> WireItem:
    return plan_items.rally_item(*_lat_lon_deg(point.north_m, point.east_m, site), point.height_m)


def _lat_lon_deg(north_m: float, east_m: float, site: Site) -> tuple[float, float]:
    """Return latitude and longitude, degrees, of a place in metres from the site's origin."""
    lat, lon, _ = ned_to_geodetic(
        [north_m, east_m, 0.0],
        origin_lat_deg=site.latitude_deg,
        origin_lon_deg=site.longitude_deg,
        origin_alt_m=site.altitude_m,
    )
    return float(lat), float(lon)
