"""Whether a mission can be flown from here: its places and the geofence, the way to its first place.

As PX4 does (src/modules/navigator, MissionFeasibilityChecker and FeasibilityChecker): a mission with a place
beyond the geofence is kept, but not flown; one that begins far from home is only warned of.
"""

import math

import numpy as np

from autopilot.commander.geofence import Geofence, Origin
from autopilot.navigation.guide import HomePosition
from autopilot.navigation.mission import FLOWN, HeightFrame, Mission
from foundation.geometry.geodesy import geodetic_to_ned


def fence_trouble(
    mission: Mission, fence: Geofence, *, home_ned_m: HomePosition, origin: Origin
) -> str | None:
    """Say which of its places the mission must not go to; None: it may go to all.

    ``origin`` is the local frame's. Items are counted from 1, as PX4 counts them there.
    """
    placed = [
        (number, item.lat_deg, item.lon_deg, item.height_m, item.frame)
        for number, item in enumerate(mission.items, start=1)
        if item.command in FLOWN and item.lat_deg is not None and item.lon_deg is not None
    ]
    if not placed or not fence.has_limits:
        return None
    above_m = {HeightFrame.ABOVE_HOME: home_ned_m[2], HeightFrame.AMSL: origin.alt_m}
    down_m = np.array([above_m[frame] - height_m for _, _, _, height_m, frame in placed])
    places = [(lat_deg, lon_deg) for _, lat_deg, lon_deg, _, _ in placed]
    breached = fence.first_beyond(places, down_m, home_ned_m, origin)
    return None if breached is None else f"Geofence violation for waypoint {placed[breached][0]}"


def distance_warning(
    mission: Mission, *, home_lat_deg: float, home_lon_deg: float, max_m: float
) -> str | None:
    """Say that the first place is further from home than MIS_DIST_1WP, or None; 0 or less is any distance."""
    first = mission.first_place()
    if first is None or first.lat_deg is None or first.lon_deg is None or max_m <= 0.0:
        return None
    north_m, east_m, _ = geodetic_to_ned(
        first.lat_deg,
        first.lon_deg,
        0.0,
        origin_lat_deg=home_lat_deg,
        origin_lon_deg=home_lon_deg,
        origin_alt_m=0.0,
    )
    distance_m = math.hypot(north_m, east_m)
    if distance_m <= max_m:
        return None
    return f"First waypoint far away from home: {distance_m:.0f} m. Correct mission loaded?"
