"""Return mode: its phases as a timeline, its height, and a whole return with the real dynamics. Costs 5 s."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from navigation_fixtures import DT_S, FlightMode, Ideal, Real, lat_lon

from autopilot.navigation.flight_mode import IDLE
from autopilot.navigation.mission import HeightFrame
from autopilot.navigation.params import NavigationParams, ReturnParams
from autopilot.navigation.plan_store import RallyPoint
from autopilot.navigation.return_home import TRANSITIONS, ReturnEvent, ReturnPhase, return_height_m

LOW = NavigationParams(return_home=ReturnParams(height_m=20.0, descend_height_m=12.0))


def phases_of(loop, seconds=200.0, until=None):
    """Return (phase, second of its start) until the landing, or a condition."""
    seen = []

    def watch():
        phase = loop.return_phase
        if not seen or seen[-1][0] is not phase:
            seen.append((phase, loop.now_s))
        return phase is ReturnPhase.DONE if until is None else until()

    assert loop.run(seconds, watch)
    return seen


# ---- height


@settings(deadline=None)
@given(st.floats(0.0, 500.0))
def test_the_height_respects_cone_and_limits(distance_m):
    params = NavigationParams()
    height_m = return_height_m(distance_m, params)
    home = params.return_home
    assert height_m <= home.height_m
    if distance_m > home.min_distance_m:
        assert height_m == home.height_m
    elif distance_m > params.acceptance_m:  # with 45 degrees a cone is as high as wide
        assert height_m == pytest.approx(max(distance_m, 2.0 * params.acceptance_m))
    else:
        assert height_m == pytest.approx(2.0 * distance_m)
    flat = replace(params, return_home=replace(home, cone_half_angle_rad=0.0))
    assert return_height_m(distance_m, flat) == home.height_m


def test_a_narrow_cone_reaches_up_to_the_return_height():
    steep = NavigationParams(return_home=ReturnParams(height_m=60.0, cone_half_angle_rad=math.radians(10.0)))
    assert return_height_m(5.0, steep) == pytest.approx(5.0 / math.tan(math.radians(10.0)))
    assert return_height_m(10.0, steep) == pytest.approx(10.0 / math.tan(math.radians(10.0)))  # 56.7 m
    assert return_height_m(10.1, steep) == 60.0


# ---- table


def test_every_phase_ends_on_the_ground_and_leads_to_it():
    for phase, event in itertools.product(ReturnPhase, ReturnEvent):
        after = TRANSITIONS.get((phase, event))
        if event is ReturnEvent.LANDED and phase is not ReturnPhase.DONE:
            assert after is ReturnPhase.DONE
        assert (phase, after) != (phase, phase)  # no event restarts its phase
    for wait in (ReturnEvent.THERE, ReturnEvent.THERE_TO_WAIT):
        phase, way = ReturnPhase.CLIMB, []
        while phase is not ReturnPhase.DONE:
            way.append(phase)
            events = {ReturnPhase.WAIT: ReturnEvent.WAITED, ReturnPhase.LAND: ReturnEvent.LANDED}
            phase = TRANSITIONS[phase, events.get(phase, wait)]
        waits = [ReturnPhase.GO_DOWN, ReturnPhase.WAIT] if wait is ReturnEvent.THERE_TO_WAIT else []
        assert way == [ReturnPhase.CLIMB, ReturnPhase.FLY_HOME, *waits, ReturnPhase.LAND]


# ---- timelines


def test_from_below_it_climbs_vertically_then_flies_straight_home_nose_first():
    loop = Ideal((30.0, 40.0, -8.0), params=LOW)
    loop.enter(FlightMode.RETURN)
    seen = phases_of(loop)
    assert [phase for phase, _ in seen] == [
        ReturnPhase.CLIMB,
        ReturnPhase.FLY_HOME,
        ReturnPhase.LAND,
        ReturnPhase.DONE,
    ]
    track = np.array(loop.track)
    climb = track[: round(seen[1][1] / DT_S)]
    assert np.abs(climb[:, :2] - (30.0, 40.0)).max() < 1e-6
    fly = track[round(seen[1][1] / DT_S) : round(seen[2][1] / DT_S)]
    assert fly[:, 2].min() >= -20.0 - 1e-3  # never above the return height
    assert np.abs(fly[:, 0] * 0.8 - fly[:, 1] * 0.6).max() < 0.02  # on the line home
    # 50 m at 5 m/s, 3 m/s^2 and 4 m/s^3 take d/V + V/A + A/J = 12.4 s
    assert seen[2][1] - seen[1][1] == pytest.approx(50.0 / 5.0 + 5.0 / 3.0 + 3.0 / 4.0, abs=0.1)
    assert np.abs(track[-1]).max() < 1e-6
    assert loop.return_phase is ReturnPhase.DONE


def test_the_nose_points_home_until_near_and_is_then_kept():
    loop = Ideal((30.0, 40.0, -25.0), params=LOW)
    loop.enter(FlightMode.RETURN)
    assert loop.return_phase is ReturnPhase.FLY_HOME  # from above it keeps its height
    loop.run(8.0)
    assert loop.setpoint.yaw_rad == pytest.approx(math.atan2(-40.0, -30.0), abs=1e-3)
    assert loop.run(10.0, lambda: loop.return_phase is ReturnPhase.LAND)
    assert loop.setpoint.yaw_rad == pytest.approx(math.atan2(-40.0, -30.0), abs=1e-3)
    assert loop.state.pos_ned_m[2] == pytest.approx(-25.0, abs=0.01)


def test_near_home_the_cone_limits_the_climb():
    loop = Ideal((6.0, 0.0, -3.0))
    loop.enter(FlightMode.RETURN)
    assert loop.return_phase is ReturnPhase.CLIMB
    phases_of(loop)
    assert min(loop.track, key=lambda pos: pos[2])[2] == pytest.approx(-6.0, abs=0.05)  # 45 degrees


def test_with_a_delay_it_waits_at_the_waiting_height():
    params = replace(LOW, return_home=replace(LOW.return_home, land_delay_s=4.0))
    loop = Ideal((15.0, 0.0, -20.0), params=params)
    loop.enter(FlightMode.RETURN)
    seen = phases_of(loop)
    assert [phase for phase, _ in seen] == [
        ReturnPhase.FLY_HOME, ReturnPhase.GO_DOWN, ReturnPhase.WAIT, ReturnPhase.LAND, ReturnPhase.DONE,
    ]  # fmt: skip
    begin = dict(seen)
    assert begin[ReturnPhase.LAND] - begin[ReturnPhase.WAIT] == pytest.approx(4.0, abs=2 * DT_S)
    waiting = loop.track[round(begin[ReturnPhase.WAIT] / DT_S) + 1]
    np.testing.assert_allclose(waiting, (0.0, 0.0, -12.0), atol=0.01)


def test_minus_one_never_lands():
    params = replace(LOW, return_home=replace(LOW.return_home, land_delay_s=-1.0))
    loop = Ideal((15.0, 0.0, -20.0), params=params)
    loop.enter(FlightMode.RETURN)
    loop.run(120.0)
    assert loop.return_phase is ReturnPhase.WAIT
    np.testing.assert_allclose(loop.state.pos_ned_m, (0.0, 0.0, -12.0), atol=1e-6)
    assert loop.return_phase is not ReturnPhase.DONE


def test_without_home_it_lands_in_place_and_on_the_ground_it_stays():
    loop = Ideal((15.0, -4.0, -6.0), home_ned_m=None)
    loop.enter(FlightMode.RETURN)
    assert [phase for phase, _ in phases_of(loop)] == [ReturnPhase.LAND, ReturnPhase.DONE]
    np.testing.assert_allclose(loop.state.pos_ned_m, (15.0, -4.0, 0.0), atol=1e-6)
    loop.enter(FlightMode.HOLD)
    loop.enter(FlightMode.RETURN)
    assert loop.update() is IDLE
    assert loop.return_phase is ReturnPhase.DONE


def test_after_a_reset_of_the_estimate_the_phase_continues_from_the_new_position():
    loop = Ideal((30.0, 40.0, -8.0), params=LOW)
    loop.enter(FlightMode.RETURN)
    assert loop.run(60.0, lambda: loop.return_phase is ReturnPhase.FLY_HOME)
    loop.run(4.0)
    loop.state.pos_ned_m = loop.state.pos_ned_m + np.array((3.0, -2.0, 1.5))
    loop.enter(FlightMode.RETURN)
    assert loop.return_phase is ReturnPhase.FLY_HOME
    before = loop.state.pos_ned_m.copy()
    loop.step()
    assert np.abs(loop.state.pos_ned_m - before).max() < 5.0 * DT_S + 1e-6  # no jump of the setpoint
    assert loop.run(60.0, lambda: loop.return_phase is ReturnPhase.LAND)
    np.testing.assert_allclose(loop.state.pos_ned_m, (0.0, 0.0, -20.0), atol=0.01)  # the same height


# ---- rally points


def rally(north_m, east_m, height_m=0.0, frame=HeightFrame.ABOVE_HOME):
    return RallyPoint(*lat_lon(north_m, east_m).values(), height_m, frame)


def test_it_returns_to_the_nearest_of_home_and_rally_points():
    # PX4's rule: nearer by more than 2 m than the best so far, and more than 10 m from home
    loop = Ideal((30.0, 0.0, -20.0), params=LOW)
    for points, expected in (
        ((), (0.0, 0.0)),
        ((rally(30.0, 20.0), rally(30.0, 12.0)), (30.0, 12.0)),
        ((rally(30.0, 12.0), rally(30.0, 11.0)), (30.0, 12.0)),
        ((rally(30.0, 29.0),), (0.0, 0.0)),
        ((rally(9.0, 0.0),), (0.0, 0.0)),
        ((rally(200.0, 0.0),), (0.0, 0.0)),
    ):
        loop.navigator.set_rally_points(points)
        loop.enter(FlightMode.HOLD)
        loop.enter(FlightMode.RETURN)
        np.testing.assert_allclose(loop.navigator.place_ned_m[:2], expected, atol=1e-3)


def test_at_a_rally_point_it_lands_and_heights_are_relative_to_it():
    loop = Ideal((40.0, 0.0, -8.0), params=LOW)
    loop.navigator.set_rally_points([rally(40.0, 20.0, 5.0)])
    loop.enter(FlightMode.RETURN)
    seen = phases_of(loop)
    assert [phase for phase, _ in seen] == [
        ReturnPhase.CLIMB,
        ReturnPhase.FLY_HOME,
        ReturnPhase.LAND,
        ReturnPhase.DONE,
    ]
    assert min(pos[2] for pos in loop.track) == pytest.approx(-25.0, abs=0.05)  # RTL_RETURN_ALT above 5 m
    np.testing.assert_allclose(loop.state.pos_ned_m, (40.0, 20.0, 0.0), atol=1e-3)


def test_a_rally_point_above_sea_level_and_one_removed_during_the_return():
    loop = Ideal((40.0, 0.0, -30.0), params=LOW)
    # the ideal vehicle's origin is at 488 m above sea level
    loop.navigator.set_rally_points([rally(40.0, 20.0, 491.0, HeightFrame.AMSL)])
    loop.enter(FlightMode.RETURN)
    loop.run(2.0)
    loop.navigator.set_rally_points([])
    assert loop.run(60.0, lambda: loop.return_phase is ReturnPhase.DONE)
    np.testing.assert_allclose(loop.state.pos_ned_m[:2], (40.0, 20.0), atol=1e-3)


# ---- with dynamics


@pytest.mark.parametrize("wind_n", [0.0, 2.0])
def test_from_50_m_away_it_lands_at_home(wind_n):
    loop = Real(10.0, params=LOW)
    loop.iris.pos_ned_m[:2] = (40.0, -30.0)
    loop.state = loop.iris.estimate()
    loop.force_ned_n = np.array((wind_n, 0.5 * wind_n, 0.0))
    loop.enter(FlightMode.RETURN)
    seen = phases_of(loop)
    assert [phase for phase, _ in seen] == [
        ReturnPhase.CLIMB,
        ReturnPhase.FLY_HOME,
        ReturnPhase.LAND,
        ReturnPhase.DONE,
    ]
    assert loop.iris.on_ground
    assert math.hypot(*loop.iris.pos_ned_m[:2]) < 0.5
    assert loop.update() is IDLE


@pytest.mark.parametrize("phase", [ReturnPhase.CLIMB, ReturnPhase.FLY_HOME, ReturnPhase.LAND])
def test_home_and_rally_points_set_during_a_return_apply_to_the_next(phase):
    loop = Real(10.0, params=LOW)
    loop.iris.pos_ned_m[:2] = (20.0, -15.0)
    loop.state = loop.iris.estimate()
    loop.enter(FlightMode.RETURN)
    assert loop.run(60.0, lambda: loop.return_phase is phase)
    loop.home_ned_m = (100.0, 30.0, 40.0)
    loop.navigator.set_rally_points([rally(60.0, 60.0)])
    sideways_m_s, down_m_s = [], []

    def watch():
        if loop.return_phase is ReturnPhase.LAND:
            north_m_s, east_m_s, falls_m_s = loop.state.vel_ned_m_s
            sideways_m_s.append(math.hypot(north_m_s, east_m_s))
            if loop.state.pos_ned_m[2] > -1.0:
                down_m_s.append(falls_m_s)
        return loop.return_phase is ReturnPhase.DONE

    assert loop.run(120.0, watch)
    assert max(sideways_m_s) < 1.0
    assert max(down_m_s) < 2.0 * LOW.land_speed_m_s  # heights are relative to the home of the start
    assert math.hypot(*loop.iris.pos_ned_m[:2]) < 0.5


def test_after_a_lift_off_or_a_reset_it_lands_where_it_had_landed():
    # a Return on the ground far from home does not fly: after a lift-off it lands there
    loop = Ideal((40.0, 10.0, 0.0), params=LOW)
    loop.landed = True
    loop.enter(FlightMode.RETURN)
    assert loop.return_phase is ReturnPhase.DONE
    loop.landed, loop.state.pos_ned_m = False, np.array((40.0, 10.0, -0.6))
    loop.step()
    assert loop.return_phase is ReturnPhase.LAND
    loop.enter(FlightMode.RETURN)  # after a reset of the estimate
    assert loop.run(10.0, lambda: loop.return_phase is ReturnPhase.DONE)
    np.testing.assert_allclose(loop.state.pos_ned_m[:2], (40.0, 10.0), atol=0.05)
