"""Commands to the whole vehicle: reposition, orbit, speed, and home."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from setpoint_world import Streamed

from autopilot.commander.arming_checks import Reason
from autopilot.mavlink.modes import FlightMode

NAN = math.nan
ACCEPTED = common.MAV_RESULT_ACCEPTED
MODE = common.MAV_CMD_DO_SET_MODE
TAKE_OFF = common.MAV_CMD_NAV_TAKEOFF


@pytest.fixture
def flight():
    with Streamed() as flight:
        flight.lift()
        yield flight


# ---- hold targets


def test_reposition_flies_there_nose_first_at_a_speed_and_stops(flight):
    pilot = flight.vehicle.pilot
    home_down_m = flight.vehicle.flight.home.pos_ned_m[2]
    lat, lon = flight.place(12.0, 9.0)
    assert pilot.reposition(lat, lon, None, None, 2.0) is None
    flight.run(3.0)
    height_m = flight.state.pos_ned_m[2]
    speeds = flight.gather(2.0, lambda: math.hypot(*flight.state.vel_ned_m_s[:2]))
    assert speeds.mean() == pytest.approx(2.0, abs=0.1)
    assert flight.yaw_rad == pytest.approx(math.atan2(9.0, 12.0), abs=0.1)
    flight.run(12.0)
    assert np.allclose(flight.state.pos_ned_m[:2], (12.0, 9.0), atol=0.3)
    assert flight.state.pos_ned_m[2] == pytest.approx(height_m, abs=0.3)
    # only up, with a heading
    assert pilot.reposition(None, None, flight.amsl(8.0), -1.0, None) is None
    flight.run(8.0)
    assert np.allclose(flight.state.pos_ned_m, (12.0, 9.0, -8.0), atol=0.3)
    assert flight.yaw_rad == pytest.approx(-1.0, abs=0.05)
    # away, and a stop on the way
    assert pilot.reposition(*flight.place(100.0, 9.0), None, None, 4.0) is None
    flight.run(5.0)
    assert pilot.reposition(None, None, None, None, None) is None
    flight.run(5.0)
    assert 15.0 < flight.state.pos_ned_m[0] < 40.0
    assert np.abs(flight.state.vel_ned_m_s).max() < 0.2
    assert flight.mode is FlightMode.HOLD
    assert home_down_m == flight.vehicle.flight.home.pos_ned_m[2]


def test_a_leg_to_a_hold_target_continues_after_a_reset_of_the_estimate(flight):
    pilot = flight.vehicle.pilot
    assert pilot.reposition(*flight.place(10.0, 0.0), None, 0.5, None) is None
    flight.run(1.0)
    flight.state.reset_counter += 1
    flight.run(9.0)
    assert np.allclose(flight.state.pos_ned_m[:2], (10.0, 0.0), atol=0.3)


def test_a_speed_ends_with_the_mode(flight):
    pilot = flight.vehicle.pilot
    cruise_m_s = flight.vehicle.parameters.settings.control.trajectory.xy_cruise_m_s
    pilot.change_speed(1.0)
    assert pilot.reposition(*flight.place(60.0, 0.0), None, None, None) is None
    flight.run(4.0)
    assert math.hypot(*flight.state.vel_ned_m_s[:2]) == pytest.approx(1.0, abs=0.15)
    pilot.change_speed(None)
    flight.run(5.0)
    assert math.hypot(*flight.state.vel_ned_m_s[:2]) == pytest.approx(cruise_m_s, abs=0.3)
    pilot.change_speed(1.0)
    assert flight.vehicle.commander.set_mode(FlightMode.LAND) is None
    flight.step()
    assert pilot.reposition(*flight.place(100.0, 0.0), None, None, None) is None
    flight.run(6.0)
    assert math.hypot(*flight.state.vel_ned_m_s[:2]) == pytest.approx(cruise_m_s, abs=0.3)


def test_commands_are_refused_on_the_ground_and_with_invalid_numbers():
    with Streamed() as flight:
        pilot, commander = flight.vehicle.pilot, flight.vehicle.commander
        flight.run(1.0)
        assert pilot.set_home(47.0, 8.0, 500.0) is Reason.NO_POSITION
        assert pilot.set_home_here() is Reason.NO_POSITION
        assert flight.run(20.0, until=lambda: commander.arm(flight.now_us) is None)
        lat, lon = flight.place(10.0, 0.0)
        assert pilot.reposition(lat, lon, None, None, None) is Reason.ON_GROUND
        assert pilot.orbit(5.0, 1.0, 0.0, lat, lon, None) is Reason.ON_GROUND
        for place in ((lat, None, None), (91.0, lon, None), (lat, NAN, None), (lat, lon, 1e30)):
            assert pilot.reposition(*place, None, None) is Reason.BAD_ARGUMENT
            assert pilot.orbit(5.0, 1.0, 0.0, *place) is Reason.BAD_ARGUMENT
        assert pilot.orbit(5.0, 1.0, 7.0, lat, lon, None) is Reason.BAD_ARGUMENT
        assert pilot.set_home(NAN, 8.0, 500.0) is Reason.BAD_ARGUMENT
        for speed in (NAN, math.inf, -1.0, 0.0):
            pilot.change_speed(speed)
        assert flight.mode is FlightMode.HOLD


@pytest.mark.parametrize("height_m", [-5.0, 0.0, 0.25])
def test_a_hold_target_on_the_ground_lands(flight, height_m):
    commander, home = flight.vehicle.commander, flight.vehicle.flight.home
    lat, lon = flight.place(6.0, 0.0)
    assert flight.vehicle.pilot.reposition(lat, lon, home.alt_m + height_m, None, None) is None
    assert flight.run(15.0, until=lambda: commander.landed)
    assert flight.height_m == pytest.approx(0.0, abs=0.02)
    assert flight.run(5.0, until=lambda: not commander.armed)
    # and it stays on the ground when armed again
    assert commander.arm(flight.now_us) is None
    flight.run(3.0)
    assert commander.landed


def test_a_home_on_a_hill_does_not_land_a_hold(flight):
    assert flight.vehicle.pilot.set_home(*flight.place(50.0, 0.0), flight.amsl(30.0)) is None
    lat, lon = flight.place(5.0, 0.0)
    assert flight.vehicle.pilot.reposition(lat, lon, flight.amsl(4.0), None, None) is None
    flight.run(8.0)
    assert np.allclose(flight.state.pos_ned_m, (5.0, 0.0, -4.0), atol=0.3)


def test_a_take_off_altitude_below_the_ground_is_replaced():
    with Streamed() as flight:
        commander = flight.vehicle.commander
        assert flight.run(20.0, until=lambda: commander.arm(flight.now_us) is None)
        assert flight.command(TAKE_OFF, *[NAN] * 6, 5.0) == ACCEPTED  # above sea level
        assert flight.run(20.0, until=lambda: flight.mode is FlightMode.HOLD)
        flight.run(3.0)
        above_m = flight.vehicle.flight.home.pos_ned_m[2] - flight.state.pos_ned_m[2]
        assert above_m == pytest.approx(2.5, abs=0.2)  # MIS_TAKEOFF_ALT


# ---- orbits


@pytest.mark.parametrize(("radius_m", "speed_m_s"), [(5.0, 2.0), (-8.0, 4.0)])
def test_an_orbit_stays_on_its_circle_with_the_nose_to_the_centre(flight, radius_m, speed_m_s):
    lat, lon = flight.place(10.0, 0.0)
    assert flight.vehicle.pilot.orbit(radius_m, speed_m_s, 0.0, lat, lon, flight.amsl(7.0)) is None
    assert flight.run(30.0, until=lambda: not flight.vehicle.pilot.navigator.orbit.approaching)
    lap_s = math.tau * abs(radius_m) / speed_m_s
    flight.run(lap_s)
    rows = flight.gather(lap_s, lambda: (*flight.state.pos_ned_m, flight.yaw_rad, flight.now_s))
    north, east, down = rows[:, 0] - 10.0, rows[:, 1], rows[:, 2]
    assert np.abs(np.hypot(north, east) - abs(radius_m)).max() < 0.3
    assert np.abs(down + 7.0).max() < 0.3
    off_rad = np.angle(np.exp(1j * (rows[:, 3] - np.arctan2(-east, -north))))
    assert np.abs(off_rad).max() < 0.15
    turned_rad = np.unwrap(np.arctan2(east, north))
    rate = (turned_rad[-1] - turned_rad[0]) / (rows[-1, 4] - rows[0, 4])
    assert rate == pytest.approx(speed_m_s / radius_m, rel=0.03)
    assert flight.mode is FlightMode.ORBIT
    # another circle with the same centre, in the other direction, with a tangential heading
    assert flight.vehicle.pilot.orbit(-radius_m, None, 3.0, None, None, None) is None
    flight.run(10.0)
    pos, vel = flight.state.pos_ned_m, flight.state.vel_ned_m_s
    assert math.hypot(pos[0] - 10.0, pos[1]) == pytest.approx(abs(radius_m), abs=0.3)
    assert math.remainder(flight.yaw_rad - math.atan2(vel[1], vel[0]), math.tau) == pytest.approx(
        0.0, abs=0.2
    )
    assert flight.vehicle.pilot.navigator.orbit.circle.speed_m_s == math.copysign(speed_m_s, -radius_m)


def test_the_mode_without_a_circle_uses_px4s(flight):
    assert flight.command(MODE, 1.0, 3.0, 1.0) == ACCEPTED
    north_m, east_m, _ = flight.state.pos_ned_m
    flight.run(12.0)
    north, east = flight.gather(math.tau, lambda: flight.state.pos_ned_m[:2]).T
    assert np.abs(np.hypot(north - (north_m - 1.0), east - east_m) - 1.0).max() < 0.4


# ---- home


def test_a_manual_home_is_kept_at_arming_and_used_by_return():
    with Streamed(RTL_RETURN_ALT=8.0) as flight:
        vehicle = flight.vehicle
        assert flight.run(20.0, until=lambda: vehicle.commander.arm(flight.now_us) is None)
        flight.step()
        vehicle.commander.disarm()
        flight.step()
        lat, lon = flight.place(15.0, 0.0)
        assert vehicle.pilot.set_home(lat, lon, flight.amsl(0.0)) is None
        flight.lift()
        home = vehicle.flight.home
        assert np.allclose(home.pos_ned_m, (15.0, 0.0, 0.0), atol=0.01)
        assert (home.lat_deg, home.lon_deg) == (lat, lon)
        assert vehicle.commander.set_mode(FlightMode.RETURN) is None
        assert flight.run(40.0, until=lambda: vehicle.commander.landed)
        assert np.allclose(flight.state.pos_ned_m[:2], (15.0, 0.0), atol=0.5)
        # after MAV_CMD_DO_SET_HOME to the vehicle's position, arming sets home again
        assert vehicle.pilot.set_home_here() is None
        assert np.allclose(vehicle.flight.home.pos_ned_m, flight.state.pos_ned_m)
