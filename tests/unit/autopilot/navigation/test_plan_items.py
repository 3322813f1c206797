"""Conversion of plan items from stations and back, and rejected items. Costs 3 s."""

import math
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigation_fixtures import at, refusal
from pymavlink.dialects.v20 import common

from autopilot.commander.geofence import FenceCircle, FencePolygon
from autopilot.navigation.mission import HeightFrame, MissionCommand, MissionItem, make_mission
from autopilot.navigation.mission_items import ACTS, mission
from autopilot.navigation.plan_items import (
    fence_items,
    fence_shapes,
    float32,
    mission_items,
    rally_item,
    rally_points,
)
from autopilot.navigation.plan_store import NOT_GIVEN, PlanType, Refused, WireItem

NAN, INF = math.nan, math.inf
LAT_E7, LON_E7 = 473_977_420, 85_455_940
RELATIVE, AMSL = common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, common.MAV_FRAME_GLOBAL
MISSION, FENCE, RALLY = PlanType
VERTEX = common.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
CIRCLE = common.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION


def item(command, *params, frame=RELATIVE, x=LAT_E7, y=LON_E7, z=10.0):
    given = (*params, 0.0, 0.0, 0.0, 0.0)[:4]
    return WireItem(command=command, frame=frame, params=given, x=x, y=y, z=z)


WAYPOINT = item(common.MAV_CMD_NAV_WAYPOINT, 0.0, 0.0, 0.0, NAN)


def vertex(x, y, count=4.0, command=VERTEX):
    return item(command, count, frame=AMSL, x=LAT_E7 + x, y=LON_E7 + y)


SQUARE = (vertex(0, 0), vertex(0, 9000), vertex(9000, 9000), vertex(9000, 0))


# ---- conversion


def test_items_are_converted_with_their_parameters():
    items = [
        item(common.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, NAN, x=0, y=0, z=7.5),
        item(common.MAV_CMD_NAV_WAYPOINT, 3.0, 1.5, 0.0, 450.0, frame=AMSL, z=500.0),
        item(common.MAV_CMD_DO_CHANGE_SPEED, 1.0, 2.5, -1.0, frame=common.MAV_FRAME_MISSION, x=0, y=0),
        item(common.MAV_CMD_DO_CHANGE_SPEED, 0.0, -1.0, -1.0, frame=common.MAV_FRAME_MISSION, x=0, y=0),
        item(common.MAV_CMD_NAV_LOITER_TIME, 12.0, 0.0, 50.0, NAN),
        item(common.MAV_CMD_CONDITION_YAW, 30.0, 0.0, -1.0, 1.0, frame=common.MAV_FRAME_MISSION),
        item(common.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 2.0, 1.0, 1.0, frame=common.MAV_FRAME_MISSION),
        item(common.MAV_CMD_DO_JUMP, 1.0, -1.0, frame=common.MAV_FRAME_MISSION, x=0, y=0, z=0.0),
        item(common.MAV_CMD_NAV_LAND, 0.0, 0.0, 0.0, NAN, x=NOT_GIVEN, y=NOT_GIVEN, z=NAN),
    ]
    assert refusal(MISSION, items) is None
    take_off, waypoint, slow, fast, loiter, turn, photo, jump, land = mission(items).items
    assert (take_off.command, take_off.has_place, take_off.height_m) == (MissionCommand.TAKEOFF, False, 7.5)
    assert (waypoint.lat_deg, waypoint.lon_deg) == (LAT_E7 / 1e7, LON_E7 / 1e7)
    assert (waypoint.hold_s, waypoint.acceptance_m, waypoint.yaw_deg) == (3.0, 1.5, 90.0)
    assert (waypoint.frame, waypoint.height_m) == (HeightFrame.AMSL, 500.0)
    assert (slow.speed_m_s, fast.speed_m_s) == (2.5, None)
    assert (loiter.hold_s, loiter.yaw_deg, loiter.frame) == (12.0, None, HeightFrame.ABOVE_HOME)
    assert (turn.yaw_deg, turn.yaw_relative) == (-30.0, True)
    assert (photo.command, photo.act) == (MissionCommand.ACT, common.MAV_CMD_IMAGE_START_CAPTURE)
    assert (jump.jump_to, jump.jump_count) == (1, -1)
    assert (land.command, land.has_place) == (MissionCommand.LAND, False)


def test_an_empty_list_is_accepted_and_gives_no_plan():
    assert [refusal(kind, ()) for kind in PlanType] == [None, None, None]
    assert (mission(()), fence_shapes(()), rally_points(())) == (None, [], ())


def test_a_fence_is_its_shapes_in_order_without_its_return_point():
    circle = item(CIRCLE, 25.0, frame=common.MAV_FRAME_GLOBAL_INT)
    point = item(common.MAV_CMD_NAV_FENCE_RETURN_POINT, frame=common.MAV_FRAME_GLOBAL_RELATIVE_ALT)
    items = (circle, point, *SQUARE)
    assert refusal(FENCE, items) is None
    exclusion, inclusion = fence_shapes(items)
    assert (exclusion.radius_m, exclusion.inclusion) == (25.0, False)
    assert (len(inclusion.vertices), inclusion.inclusion) == (4, True)
    assert inclusion.vertices[2] == ((LAT_E7 + 9000) / 1e7, (LON_E7 + 9000) / 1e7)


def test_a_rally_point_keeps_its_height_frame():
    points = rally_points([rally_item(47.0, 8.0, 30.0), item(common.MAV_CMD_NAV_RALLY_POINT, frame=AMSL)])
    assert [(point.height_m, point.frame) for point in points] == [
        (30.0, HeightFrame.ABOVE_HOME), (10.0, HeightFrame.AMSL),
    ]  # fmt: skip


# ---- rejection


@pytest.mark.parametrize(
    ("kind", "items", "result", "seq", "words"),
    [
        (MISSION, (item(16, frame=common.MAV_FRAME_GLOBAL_TERRAIN_ALT),),
         common.MAV_MISSION_UNSUPPORTED_FRAME, 0, "frame 10, GLOBAL_TERRAIN_ALT, is not supported"),
        (MISSION, (WAYPOINT, item(16, frame=common.MAV_FRAME_MISSION)),
         common.MAV_MISSION_UNSUPPORTED_FRAME, 1, "NAV_WAYPOINT in frame 2"),
        (MISSION, (WAYPOINT, item(common.MAV_CMD_NAV_VTOL_TAKEOFF)),
         common.MAV_MISSION_UNSUPPORTED, 1, "Item 1: NAV_VTOL_TAKEOFF"),
        (MISSION, (item(65_000),), common.MAV_MISSION_UNSUPPORTED, 0, "command 65000"),
        (MISSION, (item(16, -1.0),), common.MAV_MISSION_INVALID_PARAM1, 0, "param1 -1 is outside"),
        (MISSION, (item(16, 0.0, INF),), common.MAV_MISSION_INVALID_PARAM2, 0, "param2 is not finite"),
        (MISSION, (item(16, x=900_000_001),), common.MAV_MISSION_INVALID_PARAM5_X, 0, "latitude 90"),
        (MISSION, (item(16, y=NOT_GIVEN),), common.MAV_MISSION_INVALID_PARAM6_Y, 0, "longitude 214.748"),
        (MISSION, (item(16, z=NAN),), common.MAV_MISSION_INVALID_PARAM7, 0, "altitude nan"),
        (MISSION, (WAYPOINT, item(177, 2.0, 1.0)), common.MAV_MISSION_INVALID_PARAM1, 1, "item 2 of 2"),
        (MISSION, (WAYPOINT, item(177, NAN, 1.0)), common.MAV_MISSION_INVALID_PARAM1, 1, "param1 nan"),
        (MISSION, (WAYPOINT, item(177, 0.0, -2.0)), common.MAV_MISSION_INVALID_PARAM2, 1, "param2 -2"),
        (MISSION, (WAYPOINT, item(178, 2.0, 3.0)), common.MAV_MISSION_INVALID_PARAM1, 1, "param1 2"),
        (MISSION, (WAYPOINT, item(177, 1.0, -1.0)), common.MAV_MISSION_INVALID, 0, "1 (JUMP): loops without"),
        (MISSION, (item(2000),), common.MAV_MISSION_INVALID, 0, "nothing to fly"),
        (FENCE, (WAYPOINT,), common.MAV_MISSION_UNSUPPORTED, 0, "NAV_WAYPOINT is not a fence item"),
        (FENCE, (item(CIRCLE, 0.0),), common.MAV_MISSION_INVALID_PARAM1, 0, "radius"),
        (FENCE, (item(CIRCLE, 5.0, frame=1),), common.MAV_MISSION_UNSUPPORTED_FRAME, 0, "frame 1"),
        (FENCE, SQUARE[:3], common.MAV_MISSION_INVALID_PARAM1, 0, "polygon of 4 vertices, but 3 items"),
        (FENCE, SQUARE[:1], common.MAV_MISSION_INVALID_PARAM1, 0, "polygon of 4 vertices, but 1 items"),
        (FENCE, (vertex(0, 0, 2.0), vertex(0, 9, 2.0)), common.MAV_MISSION_INVALID_PARAM1, 0, "param1 2"),
        (FENCE, (*SQUARE[:3], vertex(9000, 0, 5.0)), common.MAV_MISSION_INVALID_PARAM1, 3, "does not belong"),
        (FENCE, (SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]), common.MAV_MISSION_INVALID, 0, "crosses"),
        (RALLY, (rally_item(47.0, 8.0, 1.0), WAYPOINT), common.MAV_MISSION_UNSUPPORTED, 1,
         "not a rally point"),
        (RALLY, (item(5100, z=1e9),), common.MAV_MISSION_INVALID_PARAM7, 0, "altitude 1e+09"),
    ],
)  # fmt: skip
def test_a_rejection_has_item_and_field(kind, items, result, seq, words):
    refused = refusal(kind, items)
    assert (refused.result, refused.seq) == (result, seq)
    assert words in refused.text
    assert "\n" not in refused.text


floats = st.floats(width=32) | st.sampled_from([0.0, 1.0, 3.0, 4.0, -1.0, NAN, INF])
OTHERS = (16, 17, 19, 20, 21, 22, 31, 93, 112, 115, 177, 178, 195, 197, 5000, 5001, 5002, 5003, 5004, 5100)
commands = st.sampled_from([*ACTS, *OTHERS]) | st.integers(0, 65_535)
wire_items = st.builds(
    WireItem,
    command=commands,
    frame=st.sampled_from([0, 2, 3, 5, 6, 10]) | st.integers(0, 255),
    params=st.tuples(floats, floats, floats, floats),
    x=st.integers(-(2**31), 2**31 - 1) | st.integers(-900_000_000, 900_000_000),
    y=st.integers(-(2**31), 2**31 - 1) | st.integers(-900_000_000, 900_000_000),
    z=floats,
)


@settings(deadline=None, max_examples=400)
@given(st.sampled_from(PlanType), st.lists(wire_items, max_size=8))
def test_every_list_is_accepted_or_rejected(kind, items):
    make = {MISSION: mission, FENCE: fence_shapes, RALLY: rally_points}[kind]
    refused = refusal(kind, items)
    if refused is None:
        made = make(items)
        if kind is MISSION and items:
            assert len(made.items) == len(items)  # with the same indices
    else:
        assert isinstance(refused, Refused)
        assert 0 <= refused.seq < len(items)
        assert refused.result != common.MAV_MISSION_ACCEPTED
        with pytest.raises(ValueError, match=r"."):
            make(items)


def test_the_longest_mission_is_checked_within_the_allowed_delay_of_a_step():
    # a transfer of 10,000 items takes minutes; a check of as many seconds would cause a failsafe
    jumps = [item(177, float(i + 2), 1.0) if i % 3 else WAYPOINT for i in range(9_998)]
    begin_s = time.process_time()
    assert refusal(MISSION, [*jumps, WAYPOINT, WAYPOINT]) is None
    assert time.process_time() - begin_s < 2.0


# ---- back to items


def test_a_scenarios_mission_is_the_same_for_stations_and_in_flight():
    made = make_mission([
        MissionItem(command=MissionCommand.TAKEOFF, height_m=7.5),
        at(12.0, 5.0, 8.0, hold_s=2.0, acceptance_m=1.5, yaw_deg=45.0),
        MissionItem(command=MissionCommand.CHANGE_SPEED, speed_m_s=2.5),
        MissionItem(command=MissionCommand.CHANGE_SPEED),
        at(30.0, 5.0, 8.0, MissionCommand.LOITER_TIME, hold_s=4.0),
        at(30.0, 5.0, 18.0, MissionCommand.LOITER_TO_ALT),
        at(0.0, 5.0, 1.0, MissionCommand.LOOK_AT),
        MissionItem(command=MissionCommand.TURN, yaw_deg=-30.0, yaw_relative=True),
        MissionItem(command=MissionCommand.TURN, yaw_deg=90.0),
        MissionItem(command=MissionCommand.LOOK_AHEAD),
        MissionItem(command=MissionCommand.ACT, act=common.MAV_CMD_VIDEO_START_CAPTURE),
        MissionItem(command=MissionCommand.DELAY, hold_s=3.0),
        MissionItem(command=MissionCommand.JUMP, jump_to=1, jump_count=2),
        at(0.0, 0.0, 500.0, frame=HeightFrame.AMSL),
        MissionItem(command=MissionCommand.LAND),
        MissionItem(command=MissionCommand.RETURN),
    ])  # fmt: skip
    items = mission_items(made)
    assert refusal(MISSION, items) is None
    again = mission(items)
    for before, after in zip(made.items, again.items, strict=True):
        if before.has_place:  # 1e-7 degrees are 11 mm
            assert abs(after.lat_deg - before.lat_deg) <= 0.5e-7 + 1e-12
            assert abs(after.lon_deg - before.lon_deg) <= 0.5e-7 + 1e-12
        plain = {"lat_deg": None, "lon_deg": None}
        for name in MissionItem.__struct_fields__:
            if name not in plain:
                assert getattr(after, name) == getattr(before, name), (before, name)
    assert mission_items(again) == items or any(math.isnan(p) for i in items for p in i.params)
    assert [i.x for i in mission_items(again)] == [i.x for i in items]


def test_a_fence_is_read_as_written():
    shapes = [
        FenceCircle(lat_deg=47.0, lon_deg=8.0, radius_m=25.5, inclusion=True),
        FencePolygon(vertices=((47.0, 8.0), (47.0, 8.001), (47.001, 8.0)), inclusion=False),
    ]
    items = fence_items(shapes)
    assert [i.command for i in items] == [5003, 5002, 5002, 5002]
    assert fence_shapes(items) == shapes
    assert items[0].params[0] == float32(25.5)
