"""Mission items that turn, point the nose and change height, and arbitrary missions. Costs 5 s."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from navigation_fixtures import FlightMode, Ideal, at, refusal

from autopilot.navigation import mission_items
from autopilot.navigation.mission import MissionCommand, MissionItem, make_mission
from autopilot.navigation.plan_store import PlanType, WireItem


def start(loop, *items):
    loop.navigator.mission.load(make_mission(items))
    loop.enter(FlightMode.MISSION)
    return loop


def turn(yaw_deg, **details):
    return MissionItem(command=MissionCommand.TURN, yaw_deg=yaw_deg, **details)


def heading_deg(loop):
    w, _, _, z = loop.state.q_ned_frd
    return math.degrees(2.0 * math.atan2(z, w))


def test_a_turn_is_in_place_and_relative_to_its_start():
    loop = start(
        Ideal((0.0, 0.0, -10.0)),
        at(10.0, 0.0, 10.0),
        turn(-90.0),
        turn(-45.0, yaw_relative=True),
        MissionItem(command=MissionCommand.DELAY, hold_s=1.0),
    )
    runner = loop.navigator.mission.runner
    assert loop.run(30.0, lambda: runner.current == 2)
    assert math.remainder(heading_deg(loop) + 90.0, 360.0) == pytest.approx(0.0, abs=12.0)
    began_deg = heading_deg(loop)
    loop.run(0.3)
    loop.enter(FlightMode.HOLD)  # a pause must not make it turn further
    loop.run(1.0)
    loop.enter(FlightMode.MISSION)
    assert loop.run(30.0, lambda: runner.current == 3)
    assert math.remainder(heading_deg(loop) - began_deg + 45.0, 360.0) == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(loop.state.pos_ned_m, (10.0, 0.0, -10.0), atol=1e-3)


def test_a_loiter_to_altitude_flies_level_and_then_climbs_vertically():
    item = at(20.0, 0.0, 18.0, MissionCommand.LOITER_TO_ALT)
    loop = start(Ideal((0.0, 0.0, -10.0)), item, at(20.0, 10.0, 18.0))
    assert loop.run(60.0, lambda: loop.ends_in_hold)
    loop.run(5.0)
    track = np.array(loop.track)
    level = track[track[:, 0] < 20.0 - 2.0]  # until within NAV_ACC_RAD
    assert np.abs(level[:, 2] + 10.0).max() < 1e-6
    climbing = track[(track[:, 2] < -10.01) & (track[:, 2] > -17.0)]
    assert np.abs(climbing[:, 0] - 20.0).max() < 2.0
    np.testing.assert_allclose(loop.state.pos_ned_m, (20.0, 10.0, -18.0), atol=1e-3)


def test_the_nose_points_at_the_region_of_interest():
    tower = at(10.0, 30.0, 0.0, MissionCommand.LOOK_AT)
    ahead = MissionItem(command=MissionCommand.LOOK_AHEAD)
    loop = start(Ideal((0.0, 0.0, -10.0)), tower, at(30.0, 0.0, 10.0), ahead, at(60.0, 0.0, 10.0))
    runner = loop.navigator.mission.runner
    loop.run(4.0)
    off_deg = []

    def watch():
        north_m, east_m, _ = loop.state.pos_ned_m
        off_deg.append(heading_deg(loop) - math.degrees(math.atan2(30.0 - east_m, 10.0 - north_m)))
        return runner.current == 3

    assert loop.run(30.0, watch)
    # the bearing changes by at most 5 m/s / 30 m = 9.5 degrees per second; the heading lags by less than one
    assert max(map(abs, (math.remainder(off, 360.0) for off in off_deg))) < 9.5
    loop.run(4.0)
    assert heading_deg(loop) == pytest.approx(0.0, abs=1.0)


def test_removing_a_mission_stops_the_vehicle():
    loop = start(Ideal((0.0, 0.0, -10.0)), at(50.0, 0.0, 10.0))
    assert loop.run(10.0, lambda: loop.state.pos_ned_m[0] > 20.0)
    loop.navigator.mission.load(None)
    loop.run(0.02)
    assert loop.navigator.next_mode(loop.state) is FlightMode.HOLD
    loop.enter(FlightMode.HOLD)
    loop.run(10.0)
    # from V = 5 m/s at A = 3 m/s^2 and J = 4 m/s^3 it stops in V^2 / 2A + V A / 2J = 6.0 m
    assert 20.0 < loop.state.pos_ned_m[0] < 20.0 + 6.1


# ---- arbitrary missions

near_e7 = st.integers(-300, 300)
"""1e-7 degrees: at most 3 m."""
anywhere_e7 = st.sampled_from([-900_000_000, 0, 900_000_000])
numbers = st.sampled_from([0.0, 0.1, 1.0, 2.0, -1.0, math.nan, 1e4, 359.0])
FLYABLE = (16, 17, 19, 20, 21, 22, 31, 93, 112, 115, 177, 178, 195, 197, 201, 2000, 189)
written = st.builds(
    WireItem,
    command=st.sampled_from(FLYABLE),
    frame=st.sampled_from([0, 2, 3, 6]),
    params=st.tuples(numbers, numbers, numbers, numbers),
    x=near_e7.map(lambda e7: 470_000_000 + e7) | anywhere_e7,
    y=near_e7.map(lambda e7: 80_000_000 + e7) | anywhere_e7,
    z=st.sampled_from([0.0, 10.0, 11.0, 498.0, -1e5, 1e5]),
)
LAST = WireItem(command=16, frame=3, params=(0.0, 0.0, 0.0, math.nan), x=470_000_000, y=80_000_000, z=10.0)
taken = written.filter(lambda item: refusal(PlanType.MISSION, [item, LAST]) is None)


@settings(max_examples=60, deadline=None)
@given(st.lists(taken, max_size=5), st.integers(0, 5))
def test_every_accepted_mission_can_be_flown(others, start_at):
    """For two seconds, with a pause: no position is too far and no sequence too unusual."""
    items = [*others, LAST]
    if refusal(PlanType.MISSION, items) is not None:
        return
    loop = Ideal((0.0, 0.0, -10.0))
    mission = loop.navigator.mission
    mission.load(mission_items.mission(items), start=start_at % len(items))
    for mode in (FlightMode.MISSION, FlightMode.HOLD, FlightMode.MISSION):
        loop.enter(mode)
        loop.run(0.7)
        assert np.isfinite(loop.state.pos_ned_m).all()
        assert 0 <= mission.runner.current < len(items)
        assert all(0 <= index < len(items) for index in mission.runner.done)
        loop.navigator.next_mode(loop.state)
