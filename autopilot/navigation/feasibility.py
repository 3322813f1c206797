"""Feasibility of a mission: its positions against the geofence, and the distance to the first one.

As in PX4 (src/modules/navigator, MissionFeasibilityChecker and FeasibilityChecker): a mission with a position
outside the geofence is stored but not flown; one that begins far from home only causes a warning.
"""

import math

import numpy as np

from autopilot.commander.geofence import Geofence, Origin
from autopilot.navigation.flight_mode import HomePosition
from autopilot.navigation.mission import FLOWN, HeightFrame, Mission
from foundation.geometry.geodesy import geodetic_to_ned


def fence_violation(
    mission: Mission, fence: Geofence, *, home_ned_m: HomePosition, origin: Origin
) -> str | None:
    """Return the message for the first position that violates the geofence, or None.

    ``origin`` is the local frame's. Items are numbered from 1, as in PX4.
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
    """Return a warning if the first position is further than ``max_m`` from home; 0 or less: no limit."""
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
