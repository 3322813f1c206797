"""Missions in flight: paths of the reference only, as timelines, and with the real dynamics. Costs 8 s."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from navigation_fixtures import CONTROL, DT_S, HOME, FlightMode, Ideal, Real, at, lat_lon, off_path_m

from autopilot.navigation.flight_mode import IDLE
from autopilot.navigation.mission import HeightFrame, MissionCommand, MissionItem, make_mission
from autopilot.navigation.mission_flight import MissionStage, overshoot_ned_m
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.return_home import ReturnPhase

TAKEOFF = MissionItem(command=MissionCommand.TAKEOFF, height_m=10.0)
LAND = MissionItem(command=MissionCommand.LAND)
SQUARE = ((20.0, 0.0, 10.0), (20.0, 20.0, 10.0), (0.0, 20.0, 12.0), (0.0, 0.0, 10.0))
CRUISE_M_S = CONTROL.trajectory.xy_cruise_m_s


def delay(hold_s):
    return MissionItem(command=MissionCommand.DELAY, hold_s=hold_s)


def speed(speed_m_s):
    return MissionItem(command=MissionCommand.CHANGE_SPEED, speed_m_s=speed_m_s)


def jump(to, count):
    return MissionItem(command=MissionCommand.JUMP, jump_to=to, jump_count=count)


def start(loop, *items):
    loop.navigator.mission.load(make_mission(items))
    loop.enter(FlightMode.MISSION)
    return loop


def flown(loop, seconds):
    """Return [(item reached, second)] until the mission is finished and the reference is at rest."""
    mission, order, count = loop.navigator.mission, [], 0

    def watch():
        nonlocal count
        if mission.runner.reached_count > count:
            count = mission.runner.reached_count
            order.append((mission.runner.reached, loop.now_s))
        return loop.ends_in_hold

    assert loop.run(seconds, watch)
    return order


# ---- corners


vectors = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-20.0, 20.0)).map(np.array)


@settings(deadline=None)
@given(vectors, vectors, st.floats(0.2, 10.0))
def test_the_target_beyond_a_corner_is_near_the_next_leg(way, onward, radius_m):
    way_m, onward_m = np.linalg.norm(way), np.linalg.norm(onward)
    assume(way_m > 1.0 and onward_m > 1.0)
    past = overshoot_ned_m(np.zeros(3), way, way + onward, radius_m=radius_m, height_m=0.8, enough_m=6.0)
    ahead = past @ way / way_m
    assert 0.0 <= ahead <= 6.0 + 1e-9
    np.testing.assert_allclose(past, ahead * way / way_m, atol=1e-9)  # on the leg's line
    along = max(past @ onward / onward_m, 0.0)
    assert along <= onward_m + 1e-9  # stops before the next leg's end
    across = past - along * onward / onward_m
    used = math.hypot(*(across[:2] / radius_m), across[2] / 0.8)
    assert used <= 0.5 + 1e-9
    # and is limited by one of these
    assert max(used / 0.5, along / onward_m, ahead / 6.0) == pytest.approx(1.0)


HIGH_NED_M = (0.0, 0.0, -300.0)
"""Four legs of 180 m with a slope of 0.3 descend by 216 m; below the ground nothing can be reached."""


@pytest.mark.parametrize(("shortest_radii", "share"), [(6.0, 0.5), (3.0, 1.0)])
@settings(max_examples=20, deadline=None)
@given(
    legs=st.lists(
        st.tuples(st.floats(-math.pi, math.pi), st.floats(1.0, 6.0), st.floats(-0.3, 0.3)),
        min_size=2, max_size=4,
    ),
    radius_m=st.sampled_from([0.5, 1.0, 2.0, 5.0]),
)  # fmt: skip
def test_the_reference_stays_within_the_acceptance_on_any_path(shortest_radii, share, legs, radius_m):
    """Headings, lengths from this many acceptance radii, and slopes.

    A corner uses half the acceptance; the other half is left for the vehicle. If legs are as short as three
    radii, one corner's motion lasts into the next, and they may add up.
    """
    pos, places = np.array(HIGH_NED_M), []
    for heading_rad, length, slope in legs:
        way_m = shortest_radii * radius_m * length
        pos = pos + way_m * np.array((math.cos(heading_rad), math.sin(heading_rad), slope))
        places.append(pos)
    loop = Ideal(HIGH_NED_M, params=NavigationParams(acceptance_m=radius_m))
    start(loop, *(at(p[0], p[1], -p[2]) for p in places))
    assert [item for item, _ in flown(loop, 400.0)] == list(range(len(places)))
    loop.run(20.0)
    assert off_path_m(loop.track, [HIGH_NED_M, *places]).max() <= share * radius_m
    np.testing.assert_allclose(loop.state.pos_ned_m, places[-1], atol=1e-3)


def test_a_waypoint_on_a_straight_path_takes_no_time():
    # 60 m take d/V + V/A + A/J in one leg or in three
    loop = start(Ideal((0.0, 0.0, -10.0)), at(20.0, 0.0, 10.0), at(40.0, 0.0, 10.0), at(60.0, 0.0, 10.0))
    assert loop.run(30.0, lambda: loop.navigator.mission.done and loop.state.pos_ned_m[0] > 60.0 - 1e-9)
    assert loop.now_s == pytest.approx(60.0 / 5.0 + 5.0 / 3.0 + 3.0 / 4.0, abs=0.05)
    speeds = np.diff(np.array(loop.track)[:, 0]) / DT_S
    assert speeds.max() <= CRUISE_M_S + 1e-5
    middle = (np.array(loop.track)[1:, 0] > 10.0) & (np.array(loop.track)[1:, 0] < 50.0)
    assert speeds[middle].min() == pytest.approx(CRUISE_M_S, abs=1e-5)


@pytest.mark.parametrize("degrees", [45.0, 90.0, 135.0, 180.0])
def test_the_vehicle_does_not_stop_at_a_corner(degrees):
    turn = math.radians(degrees)
    beyond = (30.0 + 30.0 * math.cos(turn), 30.0 * math.sin(turn), 10.0)
    loop = start(Ideal((0.0, 0.0, -10.0)), at(30.0, 0.0, 10.0), at(*beyond))
    assert loop.run(20.0, lambda: loop.navigator.mission.runner.reached == 0)
    # Passed with at least the speed from which the limits stop within the radius R = 2 m plus R / 2 beyond
    # the corner: the last jerk phase takes A^3 / 6J^2 of it and ends at A^2 / 2J
    jerk_m, jerk_m_s = 3.0**3 / (6.0 * 4.0**2), 3.0**2 / (2.0 * 4.0)
    least_m_s = math.sqrt(jerk_m_s**2 + 2.0 * 3.0 * (2.0 + 1.0 - jerk_m))
    assert math.hypot(*loop.state.vel_ned_m_s) > min(least_m_s, CRUISE_M_S) - 0.05


# ---- items


def test_a_hold_lasts_its_time_at_its_position():
    for item in (at(8.0, 0.0, 10.0, hold_s=3.0), at(8.0, 0.0, 10.0, MissionCommand.LOITER_TIME, hold_s=3.0)):
        loop = start(Ideal((0.0, 0.0, -10.0)), item, at(8.0, 8.0, 10.0))
        mission = loop.navigator.mission
        assert loop.run(20.0, lambda mission=mission: mission.stage is MissionStage.STAY)
        arrived_s = loop.now_s
        assert loop.run(20.0, lambda mission=mission: mission.runner.reached == 0)
        assert loop.now_s - arrived_s == pytest.approx(3.0, abs=2 * DT_S)
        np.testing.assert_allclose(loop.state.pos_ned_m, (8.0, 0.0, -10.0), atol=1e-3)
    loop = start(Ideal((0.0, 0.0, -10.0)), at(8.0, 0.0, 10.0), delay(2.0), at(8.0, 8.0, 10.0))
    (_, first_s), (_, second_s), _ = flown(loop, 40.0)
    assert second_s - first_s == pytest.approx(2.0, abs=2 * DT_S)


def test_loitering_without_limit_never_ends():
    loop = start(
        Ideal((0.0, 0.0, -10.0)), at(8.0, 0.0, 10.0, MissionCommand.LOITER_UNLIMITED), at(8.0, 8.0, 10.0)
    )
    loop.run(100.0)
    assert (loop.navigator.mission.runner.current, loop.navigator.mission.stage) == (0, MissionStage.STAY)
    np.testing.assert_allclose(loop.state.pos_ned_m, (8.0, 0.0, -10.0), atol=1e-6)


def test_the_speed_changes_and_returns_and_keeps_within_the_limit():
    items = [speed(2.0), at(30.0, 0.0, 10.0), speed(99.0), at(130.0, 0.0, 10.0),
             MissionItem(command=MissionCommand.CHANGE_SPEED), at(190.0, 0.0, 10.0)]  # fmt: skip
    loop = start(Ideal((0.0, 0.0, -10.0)), *items)
    fastest = {}

    def watch():
        # changing speed takes some distance: only the second half of a leg counts
        current, north_m = loop.navigator.mission.runner.current, loop.state.pos_ned_m[0]
        if north_m > {1: 15.0, 3: 80.0, 5: 165.0}[current]:
            fastest[current] = max(fastest.get(current, 0.0), float(loop.state.vel_ned_m_s[0]))
        return loop.ends_in_hold

    assert loop.run(120.0, watch)
    # MPC_XY_VEL_MAX is 12 m/s
    assert fastest == pytest.approx({1: 2.0, 3: 12.0, 5: 5.0}, abs=1e-6)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_jump_is_flown_exactly_as_often_as_given(count):
    loop = start(Ideal((0.0, 0.0, -10.0)), at(6.0, 0.0, 10.0), at(6.0, 6.0, 10.0), jump(0, count), delay(0.1))
    assert [item for item, _ in flown(loop, 200.0)] == [0, 1] * (count + 1) + [3]


def test_heights_are_above_home_or_sea_level():
    home = (0.0, 0.0, 3.0)  # three metres below the origin, which is at 488 m
    for item, down_m in (
        (at(5.0, 0.0, 10.0), 3.0 - 10.0),
        (replace(at(5.0, 0.0, 10.0), frame=HeightFrame.AMSL, height_m=500.0), 488.0 - 500.0),
    ):
        loop = start(Ideal((0.0, 0.0, -10.0), home_ned_m=home), item)
        flown(loop, 30.0)
        loop.run(10.0)
        assert loop.state.pos_ned_m[2] == pytest.approx(down_m, abs=1e-9)


def test_the_nose_points_forward_and_an_items_heading_must_be_reached():
    loop = start(Ideal((0.0, 0.0, -10.0)), at(0.0, 30.0, 10.0), at(0.0, 60.0, 10.0, yaw_deg=-90.0))
    loop.run(5.0)
    assert loop.setpoint.yaw_rad == pytest.approx(math.radians(90.0), abs=1e-3)
    flown(loop, 60.0)
    error_rad = math.remainder(loop.setpoint.yaw_rad + math.radians(90.0), math.tau)
    assert abs(error_rad) <= NavigationParams().yaw_acceptance_rad
    loop.run(5.0)
    assert loop.setpoint.yaw_rad == pytest.approx(math.radians(-90.0), abs=1e-9)


@pytest.mark.parametrize(("mode", "degrees"), [(0, 90.0), (1, -90.0), (2, 90.0), (3, 90.0)])
def test_the_heading_is_that_of_the_parameter(mode, degrees):
    params = NavigationParams(yaw_mode=mode)
    loop = start(Ideal((0.0, 20.0, -10.0), params=params, yaw_rad=0.5), at(0.0, 80.0, 10.0))
    loop.run(8.0)
    assert loop.setpoint.yaw_rad == pytest.approx(math.radians(degrees), abs=1e-3)


# ---- interruptions


def test_a_mission_continues_after_another_mode():
    loop = start(Ideal((0.0, 0.0, -10.0)), *(at(*place) for place in SQUARE))
    mission = loop.navigator.mission
    assert loop.run(60.0, lambda: mission.runner.reached == 1)
    loop.run(2.0)
    loop.enter(FlightMode.HOLD)
    loop.run(10.0)
    held = loop.state.pos_ned_m.copy()
    assert mission.runner.current == 2
    loop.enter(FlightMode.MISSION)
    assert [item for item, _ in flown(loop, 60.0)] == [1, 2, 3]  # the first one was reached before
    assert off_path_m([held], [(20.0, 0.0, -10.0), (20.0, 20.0, -10.0), (0.0, 20.0, -12.0)])[0] < 1.2


def test_a_finished_mission_holds_its_end_and_restarts_only_when_entered_again():
    loop = start(Ideal((0.0, 0.0, -10.0)), at(10.0, 0.0, 10.0), at(10.0, 10.0, 10.0))
    flown(loop, 60.0)
    loop.enter(FlightMode.HOLD)  # like the commander when the mission is done
    loop.run(10.0)
    np.testing.assert_allclose(loop.state.pos_ned_m, (10.0, 10.0, -10.0), atol=1e-6)
    loop.enter(FlightMode.MISSION)
    assert (loop.navigator.mission.runner.current, loop.ends_in_hold) == (0, False)
    flown(loop, 60.0)
    loop.enter(FlightMode.MISSION)  # after a reset of the estimate
    assert loop.ends_in_hold


def test_after_a_reset_of_the_estimate_the_leg_continues_without_a_jump_of_the_setpoint():
    loop = start(Ideal((0.0, 0.0, -10.0)), *(at(*place) for place in SQUARE))
    mission = loop.navigator.mission
    assert loop.run(60.0, lambda: mission.runner.current == 2)
    loop.run(1.0)
    loop.state.pos_ned_m = loop.state.pos_ned_m + np.array((1.0, -2.0, 0.5))
    loop.enter(FlightMode.MISSION)
    before = loop.state.pos_ned_m.copy()
    loop.step()
    assert np.abs(loop.setpoint.pos_ned_m - before).max() < CRUISE_M_S * DT_S + 1e-6
    assert mission.runner.current == 2
    flown(loop, 60.0)


def test_another_item_or_mission_is_flown_immediately():
    loop = start(Ideal((0.0, 0.0, -10.0)), *(at(*place) for place in SQUARE))
    loop.run(2.0)
    loop.navigator.mission.runner.set_current(2)
    assert loop.run(20.0, lambda: loop.navigator.mission.runner.reached == 2)
    np.testing.assert_allclose(loop.state.pos_ned_m[:2], (0.0, 20.0), atol=2.01)
    loop.navigator.mission.load(make_mission([at(-10.0, 0.0, 15.0)]))
    flown(loop, 60.0)
    loop.run(10.0)
    np.testing.assert_allclose(loop.state.pos_ned_m, (-10.0, 0.0, -15.0), atol=1e-3)


def test_without_a_mission_it_holds_and_a_return_item_requests_the_mode():
    loop = Ideal((0.0, 0.0, -10.0), vel_ned_m_s=(1.0, 0.0, 0.0))
    loop.enter(FlightMode.MISSION)
    loop.run(10.0)
    assert np.abs(loop.state.vel_ned_m_s).max() == 0.0
    assert loop.ends_in_hold
    start(loop, at(5.0, 0.0, 10.0), MissionItem(command=MissionCommand.RETURN))
    assert loop.run(30.0, lambda: loop.navigator.next_mode(loop.state) is FlightMode.RETURN)
    assert not loop.ends_in_hold  # return is next, not hold
    loop.enter(FlightMode.RETURN)
    assert loop.navigator.next_mode(loop.state) is None
    assert loop.run(200.0, lambda: loop.return_phase is ReturnPhase.DONE)


def test_after_an_unexpected_lift_off_a_finished_mission_stays_low_and_a_leg_continues():
    loop = start(Ideal((0.0, 0.0, -10.0)), LAND)
    flown(loop, 60.0)
    loop.run(0.1)
    loop.landed, loop.state.pos_ned_m = False, np.array((0.0, 0.0, -0.2))
    loop.run(3.0)
    assert loop.state.pos_ned_m[2] == pytest.approx(-0.2, abs=0.01)
    loop = start(Ideal((0.0, 0.0, -10.0)), at(20.0, 0.0, 10.0))
    loop.run(2.0)
    loop.landed = True  # false detection
    assert loop.update() is IDLE
    loop.landed = False
    assert [item for item, _ in flown(loop, 30.0)] == [0]


def test_limits_change_on_the_way_without_a_jump():
    loop = start(Ideal((0.0, 0.0, -10.0)), at(100.0, 0.0, 10.0))
    loop.run(5.0)
    faster = replace(CONTROL.trajectory, xy_cruise_m_s=8.0)
    before = loop.state.vel_ned_m_s[0]
    loop.navigator.set_params(loop.params, faster, CONTROL.position)
    loop.step()
    assert abs(loop.state.vel_ned_m_s[0] - before) <= CONTROL.trajectory.acc_xy_m_s2 * DT_S
    loop.run(4.0)
    assert loop.state.vel_ned_m_s[0] == pytest.approx(8.0)
    assert loop.navigator.mission.runner.current == 0


# ---- with dynamics


def fly_square(radius_m, wind_n=0.0):
    loop = Real(0.0, params=NavigationParams(acceptance_m=radius_m))
    loop.force_ned_n = np.array((wind_n, 0.0, 0.0))
    start(loop, TAKEOFF, *(at(*place) for place in SQUARE), LAND)
    order = flown(loop, 120.0)
    return loop, [item for item, _ in order]


@pytest.mark.parametrize(("radius_m", "wind_n"), [(2.0, 0.0), (1.0, 0.0), (2.0, 2.0)])
def test_a_square_is_flown_in_order_near_its_path_from_the_ground_to_the_ground(radius_m, wind_n):
    loop, order = fly_square(radius_m, wind_n)
    assert order == [0, 1, 2, 3, 4, 5]
    assert loop.landed
    assert loop.iris.on_ground
    assert loop.update() is IDLE
    corners = [HOME, (0.0, 0.0, -10.0), *((n, e, -h) for n, e, h in SQUARE), HOME]
    assert off_path_m(loop.track, corners).max() < radius_m
    assert math.hypot(*loop.iris.pos_ned_m[:2]) < 0.5


def test_on_the_ground_any_first_position_starts_with_a_climb():
    loop = start(Real(0.0), at(10.0, 0.0, 8.0))
    assert loop.run(30.0, lambda: loop.navigator.mission.stage is MissionStage.FLY)
    assert math.hypot(*loop.state.pos_ned_m[:2]) < 0.3
    assert loop.state.pos_ned_m[2] == pytest.approx(-8.0, abs=0.8)
    assert [item for item, _ in flown(loop, 60.0)] == [0]


def test_a_mission_continues_after_a_landing():
    there = MissionItem(command=MissionCommand.LAND, **lat_lon(6.0, 0.0))
    loop = start(Real(5.0), there, replace(TAKEOFF, height_m=4.0), LAND)
    assert [item for item, _ in flown(loop, 120.0)] == [0, 1, 2]
    assert max(pos[2] for pos in loop.track[: len(loop.track) // 2]) > -0.01
    assert math.hypot(loop.iris.pos_ned_m[0] - 6.0, loop.iris.pos_ned_m[1]) < 0.3
