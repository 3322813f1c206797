"""Take-off, hold, land and descend, their common reference, and changes between modes. Costs 2 s."""

import math

import numpy as np
import pytest
from control_fixtures import estimate
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from navigation_fixtures import CONTROL, DT_S, FlightMode, Ideal, Real

from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.navigation.flight_mode import IDLE
from autopilot.navigation.guide import Guide
from autopilot.navigation.landing import speed_by_height_m_s
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.return_home import ReturnPhase
from autopilot.navigation.setpoints import down_demand_m_s
from foundation.types import AttitudeSetpoint, TrajectorySetpoint

LIMITS = CONTROL.trajectory
P = NavigationParams()


# ---- the reference


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(*[st.floats(-8.0, 8.0)] * 3), st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(-math.pi, math.pi),
)  # fmt: skip
@example((0.0, 0.0, 3.0), (1.0, 0.0, 0.0), (1.2e-7, 0.0, 1.0), 0.0)  # almost vertical
def test_a_leg_ends_at_rest_at_its_target_from_any_motion(target, vel, along, yaw_rad):
    # No move is longer than 14 m. A stop from 5.2 m/s takes 2.6 s, a move of 20 m at 1.5 m/s and more 15 s
    reference = Guide(LIMITS)
    reference.reset(np.zeros(3), vel_ned_m_s=np.array(vel), yaw_rad=0.5)
    reference.go_to(np.array(target), along_ned=np.array(along))
    reference.turn_to(yaw_rad)
    positions, velocities = [], []
    for _ in range(round(25.0 / DT_S)):
        setpoint = reference.update(DT_S)
        positions.append(setpoint.pos_ned_m)
        velocities.append(setpoint.vel_ned_m_s)
        if reference.resting:
            break
    assert reference.resting
    np.testing.assert_array_equal(setpoint.pos_ned_m, target)
    assert not setpoint.vel_ned_m_s.any()
    assert setpoint.yaw_rate_rad_s == 0.0
    assert abs(math.remainder(setpoint.yaw_rad - yaw_rad, math.tau)) < 1e-9
    steps = 0.5 * DT_S * (np.array(velocities)[1:] + np.array(velocities)[:-1])
    np.testing.assert_allclose(np.diff(positions, axis=0), steps, atol=2e-4)


def test_a_target_off_the_line_is_reached_without_circling():
    # 0.42 m away and moving past it: a line recomputed at every step circles for 25 s and as far as 2.2 m
    target, vel = np.array((0.0, 0.3, 0.0)), np.array((0.0, 1.0, 0.0))
    reference = Guide(LIMITS)
    reference.reset(np.array((0.3, 0.0, 0.0)), vel_ned_m_s=vel, yaw_rad=0.0)
    reference.go_to(target)
    furthest_m, steps = 0.0, 0
    while not reference.resting and steps < 2500:
        setpoint = reference.update(DT_S)
        furthest_m = max(furthest_m, float(np.linalg.norm(setpoint.pos_ned_m - target)))
        steps += 1
    # along and across the leg 0.71 m/s stop within v sqrt(v / J) = 0.30 m: along it that is before the
    # target, across it the reference leaves the line and returns, in 2 sqrt(v / J) + 4 (d / 2J)^(1/3) = 2.2 s
    # if it rested in between, which it does not
    assert steps * DT_S < 2.2
    assert furthest_m <= math.hypot(0.3, 0.3) + 1e-6


def test_the_reference_waits_for_a_vehicle_that_does_not_follow():
    reference = Guide(LIMITS)
    reference.reset(np.zeros(3), vel_ned_m_s=np.zeros(3), yaw_rad=0.0)
    reference.go_to(np.array((50.0, 0.0, 0.0)))
    for _ in range(2500):
        setpoint = reference.update(DT_S, vehicle_pos_ned_m=np.zeros(3))
    assert 0.5 * LIMITS.xy_error_max_m < setpoint.pos_ned_m[0] <= LIMITS.xy_error_max_m
    assert not reference.resting


# ---- hold and take-off


def test_hold_stops_within_its_limits_and_is_then_cheap():
    loop = Ideal((0.0, 0.0, -20.0), vel_ned_m_s=(3.0, 4.0, -2.0), yaw_rad=1.0)
    loop.enter(FlightMode.HOLD)
    loop.run(10.0)
    # v (v / A + A / J) / 2 at 5 m/s; 2 m/s up does not reach the acceleration limit: v sqrt(v / J)
    way_m = 5.0 * (5.0 / 3.0 + 3.0 / 4.0) / 2.0
    expected = (0.6 * way_m, 0.8 * way_m, -20.0 - 2.0 * math.sqrt(2.0 / 4.0))
    np.testing.assert_allclose(loop.state.pos_ned_m, expected, atol=0.02)
    assert loop.setpoint.yaw_rad == pytest.approx(1.0)
    assert loop.update() is loop.update()
    loop.landed = True
    assert loop.update() is IDLE


def test_a_take_off_ends_at_its_height_and_continues_as_hold():
    loop = Real(0.0)
    loop.enter(FlightMode.TAKEOFF, takeoff_height_m=4.0)
    assert loop.run(15.0, lambda: loop.ends_in_hold)
    loop.enter(FlightMode.HOLD)
    loop.run(4.0)
    np.testing.assert_allclose(loop.state.pos_ned_m, (0.0, 0.0, -4.0), atol=0.1)


def test_a_take_off_in_the_air_climbs_and_never_descends():
    for wanted_m, reached_m in ((15.0, 15.0), (5.0, 10.0)):
        loop = Ideal((0.0, 0.0, -10.0))
        loop.enter(FlightMode.TAKEOFF, takeoff_height_m=wanted_m)
        assert loop.run(20.0, lambda loop=loop: loop.ends_in_hold)
        assert max(-pos[2] for pos in loop.track) <= reached_m
        loop.run(5.0)
        assert loop.state.pos_ned_m[2] == pytest.approx(-reached_m)


def test_a_take_off_in_progress_uses_a_new_speed():
    loop = Ideal((0.0, 0.0, -10.0))
    loop.enter(FlightMode.TAKEOFF, takeoff_height_m=60.0)
    loop.run(4.0)
    assert loop.state.vel_ned_m_s[2] == pytest.approx(-CONTROL.position.tko_speed_m_s)
    loop.navigator.set_params(P, LIMITS, replace(CONTROL.position, tko_speed_m_s=2.5))
    loop.run(4.0)
    assert loop.state.vel_ned_m_s[2] == pytest.approx(-2.5)
    assert loop.navigator.place_ned_m[2] == -60.0
    loop.enter(FlightMode.HOLD)  # before its end, and with the speeds of every other mode
    loop.run(5.0)
    loop.enter(FlightMode.LAND)
    loop.run(3.0)
    assert loop.state.vel_ned_m_s[2] == pytest.approx(LIMITS.z_vel_dn_m_s)


# ---- land and descend


@settings(deadline=None)
@given(st.floats(-5.0, 200.0))
def test_the_landing_speed_is_proportional_to_the_height(height_m):
    speed_m_s = speed_by_height_m_s(height_m, P, slow_m_s=0.7, fast_m_s=1.5)
    if height_m <= P.land_slow_height_m:
        assert speed_m_s == pytest.approx(0.7)
    elif height_m >= P.land_fast_height_m:
        assert speed_m_s == pytest.approx(1.5)
    else:
        assert speed_m_s == pytest.approx(0.7 + 0.8 * (height_m - 5.0) / 5.0)


def test_height_parameters_in_the_wrong_order_give_a_step():
    params = NavigationParams(land_slow_height_m=10.0, land_fast_height_m=8.0)
    assert speed_by_height_m_s(9.9, params, slow_m_s=0.7, fast_m_s=1.5) == 0.7
    assert speed_by_height_m_s(10.1, params, slow_m_s=0.7, fast_m_s=1.5) == 1.5


def test_landing_is_vertical_and_does_not_push_against_the_ground():
    loop = Ideal((3.0, 4.0, -12.0), vel_ned_m_s=(1.0, 0.0, 0.0))
    loop.enter(FlightMode.LAND)
    loop.run(1.0)
    assert loop.setpoint.pos_axes == (True, True, False)
    loop.touching = True
    setpoint = loop.update()
    assert setpoint.pos_ned_m is None
    assert setpoint.vel_axes == (False, False, True)
    assert not setpoint.acc_ned_m_s2.any()
    loop.touching = False
    assert loop.run(60.0, lambda: loop.landed)
    # 1 m/s does not reach the acceleration limit: v sqrt(v / J) = 0.5 m
    np.testing.assert_allclose(loop.state.pos_ned_m, (3.5, 4.0, 0.0), atol=0.01)
    assert loop.update() is IDLE


def test_descending_needs_no_velocity():
    loop = Ideal((0.0, 0.0, -12.0))
    loop.enter(FlightMode.DESCEND)
    assert loop.update().vel_ned_m_s[2] == P.land_speed_m_s
    loop.state.velocity_valid = False
    assert loop.update().vel_ned_m_s[2] == P.land_speed_m_s  # by the valid height
    loop.state.height_valid = False
    assert 0.0 < loop.update().acc_ned_m_s2[2] <= 2.0


def test_a_landing_that_bounces_continues():
    loop = Ideal((0.0, 0.0, -3.0))
    loop.enter(FlightMode.RETURN)
    assert loop.run(60.0, lambda: loop.landed)
    loop.update()
    assert loop.return_phase is ReturnPhase.DONE
    loop.landed, loop.state.pos_ned_m = False, np.array((0.0, 0.0, -0.2))
    loop.track.clear()
    loop.run(0.2)
    assert loop.return_phase is ReturnPhase.LAND
    assert loop.run(5.0, lambda: loop.landed)
    assert min(pos[2] for pos in loop.track) > -0.25


# ---- input of the land detector


def test_the_downward_demand_of_every_kind_of_setpoint():
    state = estimate(pos_ned_m=np.array((0.0, 0.0, -5.0)))

    def demand(setpoint):
        return down_demand_m_s(state, setpoint, z_p_1_s=1.5, hover_thrust=0.5)

    level = np.array((1.0, 0.0, 0.0, 0.0))
    assert demand(TrajectorySetpoint(pos_ned_m=np.array((0.0, 0.0, -3.0)))) == pytest.approx(3.0)
    assert demand(TrajectorySetpoint(vel_ned_m_s=np.array((0.0, 0.0, 0.7)))) == pytest.approx(0.7)
    assert demand(TrajectorySetpoint(acc_ned_m_s2=np.array((0.0, 0.0, -2.0)))) == pytest.approx(-2.0)
    assert demand(TrajectorySetpoint()) == 0.0
    for thrust, expected in ((0.5, 0.0), (0.0, GRAVITY_M_S2), (1.0, -GRAVITY_M_S2)):
        setpoint = AttitudeSetpoint(q_ned_frd=level, yaw_rate_rad_s=0.0, thrust=thrust)
        assert demand(setpoint) == pytest.approx(expected)
