"""Geofence and mission of a scenario, stated in metres of the site, as the autopilot takes them."""

from collections.abc import Sequence

from autopilot.commander.geofence import FenceCircle, FencePolygon, FenceShape, Origin
from autopilot.config import CircleConfig, MissionItemConfig, PolygonConfig, Site
from autopilot.navigation.geodesy import ned_to_geodetic
from autopilot.navigation.mission import Mission, MissionCommand, MissionError, MissionItem, make_mission


class PlanError(ValueError):
    """A fence or a mission that cannot be flown; the text is one line."""


def fence_shapes(config: Sequence[CircleConfig | PolygonConfig], site: Site) -> list[FenceShape]:
    """Shapes by latitude and longitude. Raises PlanError, which numbers the shape from 0."""
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
    """Mission by latitude and longitude; None without items. Raises PlanError."""
    try:
        return make_mission(_item(item, site) for item in config) if config else None
    except MissionError as error:
        raise PlanError(f"mission: {error}") from None


def _item(item: MissionItemConfig, site: Site) -> MissionItem:
    lat_deg = lon_deg = None
    if item.north_m is not None and item.east_m is not None:
        lat, lon, _ = ned_to_geodetic(
            [item.north_m, item.east_m, 0.0],
            origin_lat_deg=site.latitude_deg,
            origin_lon_deg=site.longitude_deg,
            origin_alt_m=site.altitude_m,
        )
        lat_deg, lon_deg = float(lat), float(lon)
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
