"""Missions as data, and the sequence of their items, without flight or time. Costs under a second."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigation_fixtures import ORIGIN, at
from pymavlink.dialects.v20 import common

from autopilot.navigation.mission import (
    FLOWN,
    MissionCommand,
    MissionError,
    MissionItem,
    make_mission,
)
from autopilot.navigation.mission_runner import MissionRunner
from foundation.geometry.geodesy import geodetic_to_ned

WAYPOINT = at(10.0, 0.0, 5.0)
JUMP, SPEED = MissionCommand.JUMP, MissionCommand.CHANGE_SPEED


def jump(to, count=1):
    return MissionItem(command=JUMP, jump_to=to, jump_count=count)


def speed(speed_m_s):
    return MissionItem(command=SPEED, speed_m_s=speed_m_s)


def runner_of(*items):
    runner = MissionRunner()
    runner.load(make_mission(items))
    return runner


def flown(runner, most=100):
    """Return the indices in the order in which they are flown, until the mission is finished."""
    order = []
    runner.settle()
    while runner.item is not None and len(order) < most:
        order.append(runner.current)
        runner.advance()
    return order


# ---- items


def test_commands_have_mavlinks_numbers():
    # the numbers of common.xml, which are sent over MAVLink
    assert [int(command) for command in MissionCommand] == [
        0, 16, 17, 19, 20, 21, 22, 31, 93, 115, 177, 178, 195, 197,
    ]  # fmt: skip
    assert MissionCommand(common.MAV_CMD_NAV_WAYPOINT) is MissionCommand.WAYPOINT


@settings(deadline=None)
@given(st.floats(-2000.0, 2000.0), st.floats(-2000.0, 2000.0), st.floats(-50.0, 500.0))
def test_a_position_in_metres_of_the_site_is_restored_from_geodetic_coordinates(north_m, east_m, height_m):
    item = at(north_m, east_m, height_m, hold_s=2.0, yaw_deg=90.0)
    # The item's position is on the tangent plane: at the plane's height over the ellipsoid there, d^2 / 2R,
    # it is the given one, and at the origin's height it differs horizontally by the angle d / R times that
    # height: 3000^3 / (2 * 6.35e6^2) = 0.33 mm at most
    north, east, _ = geodetic_to_ned(item.lat_deg, item.lon_deg, ORIGIN["origin_alt_m"], **ORIGIN)
    assert math.hypot(north - north_m, east - east_m) < 0.4e-3
    assert (item.height_m, item.hold_s, item.yaw_deg) == (height_m, 2.0, 90.0)


@pytest.mark.parametrize(
    ("items", "reason"),
    [
        ((), "the mission is empty"),
        ((speed(3.0),), "nothing to fly"),
        ((MissionItem(command=MissionCommand.WAYPOINT),), r"item 0 \(WAYPOINT\): it has no position"),
        (
            (WAYPOINT, MissionItem(command=MissionCommand.LAND, lat_deg=1.0)),
            "item 1 .*must be given together",
        ),
        ((at(0.0, 0.0, math.nan),), "height nan is outside"),
        ((at(0.0, 0.0, 5.0, hold_s=math.nan),), "hold time nan is outside"),
        ((at(0.0, 0.0, 5.0, acceptance_m=-1.0),), "acceptance radius -1 is outside"),
        ((at(0.0, 0.0, 5.0, yaw_deg=math.inf),), "heading inf is outside"),
        (
            (MissionItem(command=MissionCommand.WAYPOINT, lat_deg=91.0, lon_deg=0.0),),
            "latitude 91 is outside",
        ),
        (
            (MissionItem(command=MissionCommand.WAYPOINT, lat_deg=9.0, lon_deg=math.nan),),
            "longitude nan is outside",
        ),
        ((WAYPOINT, speed(0.0)), "speed 0 m/s is not positive"),
        ((WAYPOINT, speed(math.nan)), "speed nan m/s is not positive"),
        ((WAYPOINT, jump(2)), r"item 1 \(JUMP\): it jumps to 2, but the items are 0 .. 1"),
        ((WAYPOINT, jump(-1)), "it jumps to -1"),
        ((WAYPOINT, jump(0, -2)), "jump count -2 is below -1"),
        ((WAYPOINT, jump(1, -1)), r"item 1 \(JUMP\): loops without anything"),
        ((WAYPOINT, speed(3.0), jump(1, 5)), r"item 2 \(JUMP\): loops without anything"),
        ((WAYPOINT, jump(3, -1), WAYPOINT, jump(1, -1)), "loops without anything"),
    ],
)
def test_an_invalid_mission_is_rejected_with_its_first_fault(items, reason):
    with pytest.raises(MissionError, match=reason):
        make_mission(items)


# ---- sequence


def test_items_are_flown_in_order_and_the_last_one_stays_current():
    runner = runner_of(WAYPOINT, speed(3.0), WAYPOINT)
    assert (runner.current, runner.reached, runner.speed_m_s) == (0, None, None)
    runner.advance()
    assert (runner.current, runner.reached, runner.speed_m_s) == (2, 0, 3.0)
    runner.advance()
    assert (runner.finished, runner.current, runner.reached, runner.item) == (True, 2, 2, None)
    runner.advance()
    assert (runner.reached, runner.reached_count) == (2, 2)


@settings(deadline=None)
@given(st.integers(0, 20))
def test_a_jump_is_taken_exactly_as_often_as_given(count):
    # 0, then (1, 2) once and again for every jump, then 4
    runner = runner_of(WAYPOINT, WAYPOINT, WAYPOINT, jump(1, count), WAYPOINT)
    assert flown(runner) == [0] + [1, 2] * (count + 1) + [4]
    runner.restart()  # resets the counts too
    assert flown(runner) == [0] + [1, 2] * (count + 1) + [4]


def test_items_executed_on_the_way_are_reported_in_order():
    act = MissionItem(command=MissionCommand.ACT, act=2000)
    runner = runner_of(act, speed(3.0), WAYPOINT, act, jump(2, 1), WAYPOINT, act)
    assert (runner.current, list(runner.done), runner.begun) == (0, [], False)  # nothing is executed yet
    runner.settle()
    runner.settle()
    assert (runner.current, list(runner.done), runner.begun) == (2, [0, 1], True)
    while runner.item is not None:
        runner.advance()
    assert list(runner.done) == [0, 1, 2, 3, 2, 3, 5, 6]  # a jump is not reported
    runner.restart()
    assert (list(runner.done), runner.begun) == ([], False)


def test_a_mission_starts_with_the_marked_item():
    runner = MissionRunner()
    runner.load(make_mission([speed(3.0), WAYPOINT, WAYPOINT]), start=2)
    assert (runner.current, runner.speed_m_s, runner.begun) == (2, 3.0, False)
    runner.restart()
    assert runner.current == 0


def test_a_region_of_interest_lasts_until_the_next():
    here = at(5.0, 5.0, 0.0, MissionCommand.LOOK_AT)
    ahead = MissionItem(command=MissionCommand.LOOK_AHEAD)
    runner = runner_of(WAYPOINT, here, WAYPOINT, ahead, WAYPOINT)
    views = []
    while runner.item is not None:
        views.append(runner.look_at)
        runner.advance()
    assert views == [None, here, None]
    runner.set_current(2)
    assert runner.look_at is here
    runner.set_current(0)  # no region of interest before it, nor in another mission
    assert runner.look_at is None
    runner.set_current(2)
    assert runner.look_at is here
    runner.load(make_mission([WAYPOINT]))
    assert runner.look_at is None


def test_a_long_list_of_jumps_is_checked_in_linear_time():
    # 5000 jumps, each over all that follow: an exhaustive search would visit every path
    jumps = [jump(5001, 1)] * 5000
    mission = make_mission([*jumps, WAYPOINT, WAYPOINT])
    runner = MissionRunner()
    runner.load(mission)
    runner.settle()
    assert runner.current == 5001
    with pytest.raises(MissionError, match=r"item 0 \(JUMP\): loops without"):
        make_mission([*[jump(0, 1)] * 5000, WAYPOINT])


def test_a_jump_without_end_never_finishes():
    runner = runner_of(WAYPOINT, WAYPOINT, jump(0, -1))
    assert flown(runner, most=101) == [0, 1] * 50 + [0]


def test_nested_jumps_keep_their_counts():
    # the inner jump is used up in the first loop of the outer one
    runner = runner_of(WAYPOINT, WAYPOINT, jump(1, 2), jump(0, 1))
    assert flown(runner) == [0, 1, 1, 1, 0, 1]


@settings(deadline=None)
@given(st.lists(st.sampled_from(["fly", "speed", "jump"]), min_size=1, max_size=12), st.randoms())
def test_next_item_changes_nothing_and_returns_the_next_item(kinds, random):
    items = [
        {"fly": WAYPOINT, "speed": speed(random.uniform(1.0, 9.0)),
         "jump": jump(random.randrange(len(kinds)), random.choice([0, 1, 3]))}[kind]
        for kind in kinds
    ]  # fmt: skip
    try:
        runner = runner_of(*items)
    except MissionError:
        return
    runner.settle()
    for _ in range(200):
        if runner.item is None:
            break
        assert runner.item.command in FLOWN
        upcoming = runner.next_item()
        runner.advance()
        assert runner.item is upcoming
    else:
        pytest.fail("finite jumps must end: every one is taken 3 times at most")


def test_set_current_resets_jump_counts_and_uses_the_speed_of_the_items_before():
    runner = runner_of(WAYPOINT, speed(3.0), WAYPOINT, jump(0, 1), WAYPOINT)
    assert flown(runner) == [0, 2, 0, 2, 4]
    version = runner.version
    runner.set_current(2)
    assert (runner.finished, runner.current, runner.speed_m_s) == (False, 2, 3.0)
    assert runner.version > version
    assert flown(runner) == [2, 0, 2, 4]
    runner.set_current(1)  # not flown itself: it is executed when the vehicle passes it
    assert (runner.current, runner.speed_m_s) == (1, None)
    runner.settle()
    assert (runner.current, runner.speed_m_s) == (2, 3.0)
    runner.set_current(0)
    assert runner.speed_m_s is None
    for index in (-1, 5):
        with pytest.raises(MissionError, match=f"there is no item {index}"):
            runner.set_current(index)
    runner.load(None)
    with pytest.raises(MissionError, match="there is no mission"):
        runner.set_current(0)
    assert runner.item is None
    assert np.isclose(runner.current, 0)
