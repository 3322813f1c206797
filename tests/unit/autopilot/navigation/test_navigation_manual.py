"""Manual modes: limits for all stick input, and the modes with the real dynamics. Costs 4 s."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from navigation_fixtures import CONTROL, DT_S, FlightMode, Ideal, Real

from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.navigation.flight_mode import IDLE, ManualInput, ModeInputs
from autopilot.navigation.manual import curve
from autopilot.navigation.params import ManualParams, NavigationParams
from foundation.geometry.rotations import quat_rotate, quat_to_euler

P = ManualParams()
POSITION, LIMITS = CONTROL.position, CONTROL.trajectory
DOWN = np.array((0.0, 0.0, 1.0))


def sticks(**kwargs):
    return ManualInput(time_us=0, **kwargs)


def in_mode(loop, mode, manual=None):
    loop.manual = manual
    loop.enter(mode)
    return loop


stick_values = st.one_of(st.floats(-1.0, 1.0), st.sampled_from([-1.0, -0.1, 0.0, 0.1, 1.0]))
inputs = st.builds(
    sticks, roll=stick_values, pitch=stick_values, yaw=stick_values, throttle=st.floats(0.0, 1.0)
)
handfuls = st.lists(st.tuples(inputs, st.integers(1, 300)), min_size=1, max_size=6)
"""Sticks and the number of steps for which they are held."""


# ---- sticks


@settings(deadline=None)
@given(stick_values, st.floats(0.0, 0.5), st.floats(0.0, 1.0))
def test_the_curve_is_odd_within_one_and_flat_in_the_deadzone(stick, deadzone, expo):
    demand = curve(stick, deadzone=deadzone, expo=expo)
    assert curve(-stick, deadzone=deadzone, expo=expo) == -demand
    assert abs(demand) <= 1.0 + 1e-12
    assert (demand == 0.0) == (abs(stick) <= deadzone) or abs(stick) - deadzone < 1e-12
    assert abs(demand) <= max(abs(stick) - deadzone, 0.0) / (1.0 - deadzone) + 1e-12  # below linear
    assert curve(1.0, deadzone=deadzone, expo=expo) == pytest.approx(1.0)


@settings(deadline=None)
@given(st.floats(0.0, 0.3), st.floats(0.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_the_demand_is_monotonic_in_the_stick(deadzone, expo, one, other):
    low, high = sorted((one, other))
    assert curve(low, deadzone=deadzone, expo=expo) <= curve(high, deadzone=deadzone, expo=expo)


# ---- limits for all stick input


@settings(max_examples=60, deadline=None)
@given(handfuls)
def test_position_mode_limits_speed_acceleration_and_jerk(handful):
    no_lead = replace(CONTROL, trajectory=replace(LIMITS, acc_lead_s=0.0))
    loop = in_mode(Ideal((0.0, 0.0, -100.0), control=no_lead), FlightMode.POSITION)
    acc_before, vel_before = np.zeros(3), np.zeros(3)
    for manual, steps in handful:
        loop.manual = manual
        for _ in range(steps):
            loop.step()
            vel, acc = loop.setpoint.vel_ned_m_s, loop.setpoint.acc_ned_m_s2
            assert math.hypot(*vel[:2]) <= P.xy_speed_m_s + 1e-6
            assert -POSITION.z_vel_max_up_m_s - 1e-6 <= vel[2] <= POSITION.z_vel_max_dn_m_s + 1e-6
            assert math.hypot(*acc[:2]) <= LIMITS.acc_xy_m_s2 + 1e-6
            assert -LIMITS.acc_up_m_s2 - 1e-6 <= acc[2] <= LIMITS.acc_dn_m_s2 + 1e-6
            # the last step of a move snaps to its end: up to one step's jerk more
            step_m_s2 = 2.0 * P.jerk_m_s3 * DT_S + 1e-6
            assert math.hypot(*(acc - acc_before)[:2]) <= step_m_s2
            assert abs(acc[2] - acc_before[2]) <= step_m_s2
            # and the velocity is the acceleration's integral except for that step
            off_m_s = vel - vel_before - 0.5 * DT_S * (acc + acc_before)
            assert np.abs(off_m_s).max() <= step_m_s2 * DT_S
            assert abs(loop.setpoint.yaw_rate_rad_s) <= P.yaw_rate_max_rad_s
            acc_before, vel_before = acc.copy(), vel.copy()


@settings(max_examples=60, deadline=None)
@given(handfuls)
def test_altitude_mode_limits_tilt_and_climb(handful):
    loop = in_mode(Ideal((0.0, 0.0, -100.0)), FlightMode.ALTITUDE)
    for manual, steps in handful:
        loop.manual = manual
        for _ in range(steps):
            loop.step()
            vel, acc = loop.setpoint.vel_ned_m_s, loop.setpoint.acc_ned_m_s2
            assert math.hypot(*acc[:2]) <= GRAVITY_M_S2 * math.tan(P.tilt_max_rad) + 1e-9
            assert -POSITION.z_vel_max_up_m_s - 1e-6 <= vel[2] <= POSITION.z_vel_max_dn_m_s + 1e-6


@settings(deadline=None)
@given(inputs, st.floats(-math.pi, math.pi), st.booleans())
def test_stabilized_mode_limits_tilt_and_thrust_and_tilts_in_the_sticks_direction(manual, yaw_rad, landed):
    loop = in_mode(Ideal((0.0, 0.0, -10.0), yaw_rad=yaw_rad), FlightMode.STABILIZED, manual)
    loop.landed = landed
    setpoint = loop.update()
    up_ned = -quat_rotate(setpoint.q_ned_frd, DOWN)
    length = math.hypot(manual.roll, manual.pitch)
    tilt_rad = math.atan2(math.hypot(up_ned[0], up_ned[1]), -up_ned[2])
    assert tilt_rad == pytest.approx(min(length, 1.0) * P.tilt_max_rad, abs=1e-9)
    if length > 1e-3:
        towards_rad = math.atan2(manual.roll, manual.pitch)
        heading_rad = math.remainder(math.atan2(up_ned[1], up_ned[0]) - towards_rad - yaw_rad, math.tau)
        assert abs(heading_rad) <= P.yaw_rate_max_rad_s * DT_S + 1e-6
    assert (0.0 if landed else P.thrust_min) <= setpoint.thrust <= POSITION.thr_max
    assert abs(setpoint.yaw_rate_rad_s) <= P.yaw_rate_max_rad_s


@pytest.mark.parametrize(
    ("throttle", "landed", "thrust"),
    [
        (0.0, True, 0.0),
        (0.0, False, P.thrust_min),
        (0.5, False, POSITION.thr_hover),
        (1.0, False, POSITION.thr_max),
        (0.25, False, 0.5 * (P.thrust_min + POSITION.thr_hover)),
        (0.75, False, 0.5 * (POSITION.thr_hover + POSITION.thr_max)),
    ],
)
def test_the_thrust_curve_is_hover_thrust_in_the_middle(throttle, landed, thrust):
    loop = in_mode(Ideal((0.0, 0.0, -10.0)), FlightMode.STABILIZED, sticks(throttle=throttle))
    loop.landed = landed
    assert loop.update().thrust == pytest.approx(thrust)


def test_an_estimated_hover_thrust_is_used_in_the_middle():
    loop = in_mode(Ideal((0.0, 0.0, -10.0)), FlightMode.STABILIZED)
    inputs = ModeInputs(state=loop.state, dt_s=DT_S, landed=False, touching=False, hover_thrust=0.4)
    setpoint = loop.navigator.update(inputs)
    assert setpoint.thrust == 0.4


# ---- timelines of the reference


def braking_m(speed_m_s):
    """Return the stopping distance with both limits reached: v (v / A + A / J) / 2."""
    return speed_m_s * (speed_m_s / LIMITS.acc_xy_m_s2 + LIMITS.acc_xy_m_s2 / P.jerk_m_s3) / 2.0


@pytest.mark.parametrize("entry", [(8.0, 6.0, 0.0), (0.0, -4.0, 1.0)])
def test_entered_in_motion_position_mode_brakes_within_the_limits_and_holds(entry):
    loop = in_mode(Ideal((0.0, 0.0, -50.0), vel_ned_m_s=entry), FlightMode.POSITION)
    loop.run(10.0)
    speed_m_s = math.hypot(*entry[:2])
    stopped = np.array((*(braking_m(speed_m_s) * np.array(entry[:2]) / speed_m_s), -50.0))
    stopped[2] += entry[2] * math.sqrt(entry[2] / P.jerk_m_s3)  # 1 m/s: only the jerk is limited
    np.testing.assert_allclose(loop.state.pos_ned_m, stopped, atol=0.01)
    held = loop.setpoint
    loop.run(1.0)
    assert loop.setpoint is held  # and is cheap


def test_the_position_is_held_once_the_motion_is_slow():
    loop = in_mode(Ideal((0.0, 0.0, -50.0)), FlightMode.POSITION, sticks(pitch=1.0))
    loop.run(6.0)
    assert loop.setpoint.pos_axes == (False, False, True)
    loop.manual = sticks()
    assert loop.run(6.0, lambda: loop.setpoint.pos_axes[0])
    speed_m_s = math.hypot(*loop.setpoint.vel_ned_m_s[:2])
    assert speed_m_s == pytest.approx(P.hold_max_xy_m_s, abs=2.0 * LIMITS.acc_xy_m_s2 * DT_S)
    loop.manual = sticks(roll=0.5)
    loop.step()
    assert loop.setpoint.pos_axes[:2] == (False, False)


def test_a_displaced_vehicle_keeps_its_held_position_until_the_stick_moves():
    loop = in_mode(Ideal((0.0, 0.0, -50.0)), FlightMode.POSITION)
    loop.run(1.0)
    place = loop.setpoint.pos_ned_m.copy()
    loop.state.pos_ned_m = loop.state.pos_ned_m + np.array((1.5, 0.0, 0.0))
    loop.state.vel_ned_m_s = np.array((2.0, 0.0, 0.0))
    np.testing.assert_array_equal(loop.update().pos_ned_m, place)


def test_the_heading_turns_with_the_stick_and_is_held_without():
    loop = in_mode(Ideal((0.0, 0.0, -50.0), yaw_rad=1.0), FlightMode.POSITION, sticks(yaw=1.0))
    loop.run(2.0)
    assert loop.setpoint.yaw_rate_rad_s == pytest.approx(P.yaw_rate_max_rad_s, rel=1e-3)
    loop.manual = sticks()
    loop.run(2.0)
    held_rad = loop.setpoint.yaw_rad
    assert loop.setpoint.yaw_rate_rad_s == 0.0
    # the filter's lag occurs before and after: in total 2 s of the full rate
    turned_rad = math.remainder(held_rad - 1.0 - 2.0 * P.yaw_rate_max_rad_s, math.tau)
    assert abs(turned_rad) < 0.02
    loop.run(1.0)
    assert loop.setpoint.yaw_rad == held_rad


def test_forward_is_the_direction_of_the_nose():
    for yaw_rad in (0.0, 2.0, -1.2):
        loop = in_mode(
            Ideal((0.0, 0.0, -50.0), yaw_rad=yaw_rad), FlightMode.POSITION, sticks(pitch=1.0, roll=1.0)
        )
        loop.run(6.0)
        vel = loop.setpoint.vel_ned_m_s
        assert math.hypot(*vel[:2]) == pytest.approx(P.xy_speed_m_s)
        assert math.remainder(math.atan2(vel[1], vel[0]) - yaw_rad, math.tau) == pytest.approx(math.pi / 4)


def test_near_the_ground_the_climb_rate_is_limited():
    # as PX4: landing and take-off speed below MPC_LAND_ALT2, full speed above MPC_LAND_ALT1
    params = NavigationParams()
    for height_m, up_m_s, down_m_s in ((3.0, 1.5, 0.7), (50.0, 3.0, 1.5), (7.5, 2.25, 1.1)):
        for throttle, expected_m_s in ((1.0, -up_m_s), (0.0, down_m_s)):
            loop = in_mode(
                Ideal((0.0, 0.0, -height_m), params=params), FlightMode.POSITION, sticks(throttle=throttle)
            )
            for _ in range(1000):
                loop.update()  # the vehicle does not move
            assert loop.setpoint.vel_ned_m_s[2] == pytest.approx(expected_m_s)


def test_missing_sticks_count_as_centred():
    for mode in (FlightMode.POSITION, FlightMode.ALTITUDE):
        loop = in_mode(Ideal((0.0, 0.0, -20.0)), mode, None)
        loop.run(2.0)
        np.testing.assert_allclose(loop.state.pos_ned_m, (0.0, 0.0, -20.0), atol=1e-9)


@pytest.mark.parametrize("mode", [FlightMode.POSITION, FlightMode.ALTITUDE])
def test_on_the_ground_only_a_raised_throttle_climbs(mode):
    loop = in_mode(Ideal((0.0, 0.0, 0.0)), mode, sticks(throttle=0.64, pitch=1.0))
    loop.landed = True
    assert loop.update() is IDLE
    loop.manual = sticks(throttle=0.66, pitch=1.0)  # 0.3 of the half range above the middle
    setpoint = loop.update()
    assert setpoint.vel_ned_m_s[2] == -POSITION.tko_speed_m_s
    assert not setpoint.acc_ned_m_s2.any()


def test_params_change_in_flight_without_a_jump():
    loop = in_mode(Ideal((0.0, 0.0, -50.0)), FlightMode.POSITION, sticks(pitch=1.0))
    loop.run(6.0)
    slower = replace(loop.params, manual=replace(P, xy_speed_m_s=4.0))
    loop.navigator.set_params(slower, LIMITS, POSITION)
    before = loop.setpoint.vel_ned_m_s[0]
    loop.step()
    assert abs(loop.setpoint.vel_ned_m_s[0] - before) <= LIMITS.acc_xy_m_s2 * DT_S
    loop.run(5.0)
    assert loop.setpoint.vel_ned_m_s[0] == pytest.approx(4.0)


# ---- with dynamics


def test_position_mode_stops_within_the_derived_distance_and_holds():
    loop = in_mode(Real(20.0), FlightMode.POSITION, sticks(pitch=1.0))
    loop.run(8.0)
    assert loop.state.vel_ned_m_s[0] == pytest.approx(P.xy_speed_m_s, abs=0.2)
    from_m = loop.state.pos_ned_m[0]
    loop.manual = sticks()
    loop.run(8.0)
    # the reference's distance, and the vehicle's lag behind it: attitude loop and motors, at most 0.1 s
    assert 0.0 <= loop.state.pos_ned_m[0] - from_m - braking_m(P.xy_speed_m_s) < 0.1 * P.xy_speed_m_s
    held = loop.setpoint.pos_ned_m.copy()
    loop.force_ned_n = np.array((1.0, -1.0, 0.0))
    loop.run(10.0)
    np.testing.assert_array_equal(loop.setpoint.pos_ned_m, held)
    assert np.abs(loop.state.pos_ned_m - held).max() < 0.1
    assert abs(loop.state.pos_ned_m[2] + 20.0) < 0.3


@pytest.mark.parametrize("observed", [True, False])
def test_altitude_mode_holds_height_while_tilted_and_coasts_when_centred(observed):
    control = replace(CONTROL, disturbance=replace(CONTROL.disturbance, enabled=observed))
    loop = in_mode(Real(20.0, control=control), FlightMode.ALTITUDE)
    loop.run(3.0)
    height_m = -loop.setpoint.pos_ned_m[2]
    loop.manual = sticks(pitch=0.6)
    worst_m = 0.0
    for _ in range(10):
        loop.run(1.0)
        worst_m = max(worst_m, abs(-loop.state.pos_ned_m[2] - height_m))
    assert worst_m < 0.2
    # half sticks give the angle whose tangent is that fraction of the greatest one's, independent of drag
    tilt_rad = math.atan(0.6 * math.tan(P.tilt_max_rad))
    assert loop.tilt_rad == pytest.approx(tilt_rad, abs=math.radians(1.5))
    speed_m_s = loop.state.vel_ned_m_s[0]
    assert speed_m_s > 5.0
    loop.manual = sticks()
    loop.run(2.0)
    assert loop.tilt_rad < math.radians(1.0)
    # drag of 0.565 N/(m/s) on 1.55 kg halves the velocity in 1.9 s: it is not controlled
    assert loop.state.vel_ned_m_s[0] == pytest.approx(speed_m_s * math.exp(-0.565 / 1.55 * 2.0), rel=0.15)


def test_stabilized_mode_levels_when_centred_and_turns_at_the_sticks_rate():
    loop = in_mode(Real(20.0), FlightMode.STABILIZED, sticks(roll=1.0, throttle=0.55))
    loop.run(1.5)
    assert loop.tilt_rad == pytest.approx(P.tilt_max_rad, abs=math.radians(2.0))
    loop.manual = sticks(yaw=1.0)
    loop.run(1.5)
    assert loop.tilt_rad < math.radians(1.0)
    assert loop.iris.omega_frd_rad_s[2] == pytest.approx(P.yaw_rate_max_rad_s, rel=0.05)
    loop.manual = sticks()
    loop.run(2.0)
    held_rad = float(quat_to_euler(loop.iris.q_ned_frd)[2])
    loop.run(1.0)
    turned_rad = math.remainder(float(quat_to_euler(loop.iris.q_ned_frd)[2]) - held_rad, math.tau)
    assert abs(turned_rad) < math.radians(0.5)


@pytest.mark.parametrize("mode", [FlightMode.POSITION, FlightMode.ALTITUDE, FlightMode.STABILIZED])
def test_throttle_takes_off_and_lands(mode):
    loop = in_mode(Real(0.0), mode, sticks(throttle=0.5))
    loop.run(2.0)
    assert loop.landed
    loop.manual = sticks(throttle=0.7)
    assert loop.run(5.0, lambda: not loop.landed)
    assert loop.run(10.0, lambda: loop.state.pos_ned_m[2] < -1.0)
    lowering = 0.45 if mode is FlightMode.STABILIZED else 0.2  # thrust in stabilized mode, else a speed
    loop.manual = sticks(throttle=lowering)
    assert loop.run(30.0, lambda: loop.iris.on_ground)
    loop.manual = sticks(throttle=0.0)
    assert loop.run(5.0, lambda: loop.landed)
    loop.run(1.0)
    assert loop.landed
    assert loop.controller.thrust == 0.0
    assert math.hypot(*loop.iris.pos_ned_m[:2]) < 0.2
