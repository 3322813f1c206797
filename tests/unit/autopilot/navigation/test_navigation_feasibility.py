"""Feasibility of a mission: every position against every limit, and the distance to the first."""

import math

import numpy as np
import pytest
from navigation_fixtures import ORIGIN, at, lat_lon

from autopilot.commander.geofence import (
    FenceCircle,
    FencePolygon,
    Geofence,
    GeofenceParams,
    Origin,
)
from autopilot.navigation.feasibility import distance_warning, fence_violation
from autopilot.navigation.mission import HeightFrame, MissionCommand, MissionItem, make_mission

LOCAL = Origin(*ORIGIN.values())
HOME = (0.0, 0.0, 2.0)
"""Two metres below the origin of the local frame."""


def circle(north_m, east_m, radius_m, *, inclusion=True):
    return FenceCircle(**lat_lon(north_m, east_m), radius_m=radius_m, inclusion=inclusion)


def polygon(*corners, inclusion=True):
    return FencePolygon(
        vertices=tuple(tuple(lat_lon(*corner).values()) for corner in corners), inclusion=inclusion
    )


def violation(items, *shapes, home_ned_m=HOME, **params):
    fence = Geofence(GeofenceParams(**params), shapes)
    return fence_violation(make_mission(items), fence, home_ned_m=home_ned_m, origin=LOCAL)


SPEED = MissionItem(command=MissionCommand.CHANGE_SPEED, speed_m_s=3.0)
NEAR, FAR = at(10.0, 0.0, 5.0), at(60.0, 0.0, 5.0)


@pytest.mark.parametrize(
    ("shapes", "params"),
    [
        ([circle(0.0, 0.0, 30.0)], {}),
        ([circle(60.0, 5.0, 8.0, inclusion=False)], {}),
        ([polygon((-20.0, -20.0), (-20.0, 20.0), (40.0, 0.0))], {}),
        ([circle(0.0, 0.0, 90.0), polygon((50.0, -9.0), (50.0, 9.0), (70.0, 0.0), inclusion=False)], {}),
        ([], {"max_horizontal_m": 50.0}),
    ],
)
def test_the_first_position_outside_the_fence_is_reported_numbered_from_1(shapes, params):
    assert violation([SPEED, NEAR, NEAR], *shapes, **params) is None
    # a region of interest is not flown to
    look = MissionItem(command=MissionCommand.LOOK_AT, lat_deg=FAR.lat_deg, lon_deg=FAR.lon_deg)
    assert violation([look, NEAR], *shapes, **params) is None
    assert violation([SPEED, NEAR, FAR, FAR], *shapes, **params) == "Geofence violation for waypoint 3"


def test_heights_are_above_home_or_sea_level_and_the_limit_above_home():
    limit = {"max_vertical_m": 30.0}
    sea = {"frame": HeightFrame.AMSL}
    assert violation([at(1.0, 0.0, 29.9)], **limit) is None
    assert violation([at(1.0, 0.0, 30.1)], **limit) is not None
    assert violation([at(1.0, 0.0, 488.0 - 2.0 + 29.9, **sea)], **limit) is None
    assert violation([at(1.0, 0.0, 488.0 - 2.0 + 30.1, **sea)], **limit) is not None
    assert violation([at(1.0, 0.0, 0.0, MissionCommand.LAND)], **limit) is None


def test_without_positions_or_limits_there_is_no_violation():
    assert violation([FAR]) is None
    assert violation([MissionItem(command=MissionCommand.RETURN)], circle(500.0, 0.0, 1.0)) is None


def test_positions_are_checked_like_the_vehicles_own():
    rng = np.random.default_rng(5)
    star = [(math.cos(a) * r, math.sin(a) * r) for a, r in
            zip(np.linspace(0.0, 6.0, 24), rng.uniform(20.0, 90.0, 24), strict=True)]  # fmt: skip
    shapes = (polygon(*star), circle(10.0, -5.0, 25.0, inclusion=False))
    fence = Geofence(GeofenceParams(max_vertical_m=40.0, max_horizontal_m=70.0), shapes)
    for north_m, east_m, height_m in rng.uniform((-90.0, -90.0, 0.0), (90.0, 90.0, 50.0), (300, 3)).tolist():
        beyond = fence.check((north_m, east_m, HOME[2] - height_m), HOME, LOCAL) is not None
        message = fence_violation(
            make_mission([at(north_m, east_m, height_m)]), fence, home_ned_m=HOME, origin=LOCAL
        )
        assert (message is not None) is beyond


def test_the_antipodes_are_not_inside():
    other_side = MissionItem(command=MissionCommand.WAYPOINT, lat_deg=-47.0, lon_deg=-172.0, height_m=5.0)
    assert violation([other_side], circle(0.0, 0.0, 1000.0)) is not None
    assert violation([other_side], max_horizontal_m=10_000.0) is not None


def test_a_first_position_far_from_home_causes_a_warning():
    mission = make_mission([SPEED, at(600.0, 700.0, 5.0)])  # 922 m
    home = {"home_lat_deg": ORIGIN["origin_lat_deg"], "home_lon_deg": ORIGIN["origin_lon_deg"]}
    assert distance_warning(mission, **home, max_m=923.0) is None
    assert distance_warning(mission, **home, max_m=0.0) is None
    assert distance_warning(mission, **home, max_m=900.0) == (
        "First waypoint far away from home: 922 m. Correct mission loaded?"
    )
    here = make_mission([MissionItem(command=MissionCommand.LAND)])
    assert distance_warning(here, **home, max_m=1.0) is None
