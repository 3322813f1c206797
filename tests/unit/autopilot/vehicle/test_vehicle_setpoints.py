"""The whole vehicle with external setpoints of one source and of several."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from setpoint_world import PERIOD, STATION, Streamed
from vehicle_world import STEP_US

from autopilot.mavlink import dialect
from autopilot.mavlink.modes import FlightMode
from autopilot.services.service import COMPANION, Partner
from foundation.geometry.rotations import quat_from_euler, quat_to_euler

PROGRAM = Partner(COMPANION, 4)
POSITION, VELOCITY = 0b1101_1111_1000, 0b1101_1100_0111


@pytest.fixture
def flight():
    with Streamed() as flight:
        flight.lift()
        yield flight


def local(mask, x=0.0, y=0.0, z=0.0, *, frame=common.MAV_FRAME_LOCAL_NED, yaw=0.0):
    values = [x, y, z] * 2 + [0.0] * 3
    return common.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *values, yaw, 0.0)


def attitude(mask, *, euler_rad=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0), thrust):
    q = quat_from_euler(*euler_rad).tolist()
    return dialect.SetAttitudeTarget(0, 1, 1, mask, q, *rates, thrust, [0.0] * 3)


# ---- setpoints


def test_a_global_position_is_reached(flight):
    lat, lon = flight.place(4.0, -3.0)
    flight.offboard(
        common.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 6, POSITION & ~(1 << 10), round(lat * 1e7), round(lon * 1e7), 6.0, *[0.0] * 6, 1.0, 0.0
        )
    )
    flight.run(10.0)  # 5 m by a loop of 0.95 1/s: a millimetre is left, and the estimate's drift
    home_down_m = flight.vehicle.flight.home.pos_ned_m[2]
    off_m = flight.gather(2.0, lambda: flight.state.pos_ned_m) - (4.0, -3.0, home_down_m - 6.0)
    assert np.abs(off_m).max() < 0.3
    assert flight.yaw_rad == pytest.approx(1.0, abs=0.05)


def test_a_body_frame_velocity_is_in_the_direction_of_the_nose(flight):
    flight.offboard(local(VELOCITY, 1.5, 0.0, -0.5, frame=common.MAV_FRAME_BODY_NED))
    flight.run(3.0)
    yaw_rad = flight.yaw_rad
    got = flight.gather(2.0, lambda: flight.state.vel_ned_m_s).mean(axis=0)
    assert np.allclose(got, (1.5 * math.cos(yaw_rad), 1.5 * math.sin(yaw_rad), -0.5), atol=0.1)


def test_an_attitude_is_followed_with_its_yaw_rate_and_thrust(flight):
    hover = flight.vehicle.pilot.controller.hover_thrust
    pitch_rad, yaw_rad = -0.15, flight.yaw_rad
    vel_before = flight.state.vel_ned_m_s.copy()
    flight.offboard(attitude(0b111, euler_rad=(0.0, pitch_rad, yaw_rad), thrust=hover / math.cos(pitch_rad)))
    flight.run(1.0)
    assert np.allclose(quat_to_euler(flight.state.q_ned_frd), (0.0, pitch_rad, yaw_rad), atol=0.03)
    gained = flight.state.vel_ned_m_s - vel_before
    ahead = gained[0] * math.cos(yaw_rad) + gained[1] * math.sin(yaw_rad)
    # g tan(tilt) for one second, minus the turn's 0.1 s and drag
    assert 0.6 * 9.81 * math.tan(-pitch_rad) < ahead < 9.81 * math.tan(-pitch_rad) + 0.1
    assert abs(gained[2]) < 0.3
    # more thrust climbs: 5 % of hover are 0.5 m/s^2
    flight.streams[STATION] = attitude(0b111, euler_rad=(0.0, 0.0, yaw_rad), thrust=1.05 * hover)
    before = flight.state.vel_ned_m_s[2]
    flight.run(1.0)
    assert -0.8 < flight.state.vel_ned_m_s[2] - before < -0.2


def test_rates_are_followed_within_the_controllers_limits(flight):
    hover = flight.vehicle.pilot.controller.hover_thrust
    yaw_rad = flight.yaw_rad
    flight.offboard(attitude(1 << 7, rates=(0.0, 0.0, 0.6), thrust=hover))
    flight.run(1.5)
    rates = flight.gather(0.5, lambda: flight.state.omega_frd_rad_s)
    assert np.allclose(rates.mean(axis=0), (0.0, 0.0, 0.6), atol=0.05)
    turned_rad = math.remainder(flight.yaw_rad - yaw_rad, math.tau)
    assert turned_rad == pytest.approx(0.6 * 2.0, abs=0.15)  # the yaw loop takes about 0.2 s
    flight.streams[STATION] = attitude(1 << 7, rates=(0.0, 0.0, 30.0), thrust=hover)
    fastest = flight.gather(1.0, lambda: flight.state.omega_frd_rad_s[2]).max()
    limit = flight.vehicle.parameters.settings.control.attitude.yaw_rate_max_rad_s
    assert 0.5 * limit < fastest < 1.1 * limit
    # and back: the integrals of the attitude loop were kept
    assert flight.vehicle.commander.set_mode(FlightMode.HOLD) is None
    flight.run(6.0)
    assert np.abs(quat_to_euler(flight.state.q_ned_frd)[:2]).max() < 0.1
    assert np.abs(flight.state.vel_ned_m_s).max() < 0.3


def test_a_take_off_by_thrust_alone():
    with Streamed() as flight:
        commander = flight.vehicle.commander
        assert flight.run(20.0, until=lambda: commander.arm(flight.now_us) is None)
        hover = flight.vehicle.pilot.controller.hover_thrust
        flight.offboard(attitude(0b111, euler_rad=(0.0, 0.0, flight.yaw_rad), thrust=0.0))
        flight.run(2.0)
        assert commander.landed
        assert not any(flight.vehicle.flight.motors())
        flight.streams[STATION] = attitude(0b111, euler_rad=(0.0, 0.0, flight.yaw_rad), thrust=1.15 * hover)
        flight.run(2.0)
        assert not commander.landed
        assert flight.height_m > 0.3


# ---- sources


def test_the_requesting_source_takes_over_and_its_loss_counts_though_others_send(flight):
    commander = flight.vehicle.commander
    flight.offboard(local(POSITION, 0.0, 0.0, -5.0), PROGRAM)
    flight.run(5.0)
    flight.streams[STATION] = local(POSITION, 3.0, 0.0, -5.0)
    flight.run(5.0)
    assert abs(flight.state.pos_ned_m[0]) < 0.3  # the station's are newer, but it has not requested offboard
    flight.offboard(flight.streams[STATION], STATION)
    flight.run(8.0)
    assert flight.state.pos_ned_m[0] == pytest.approx(3.0, abs=0.3)
    # the station becomes silent: after COM_OF_LOSS_T it is lost, even if the program still sends
    del flight.streams[STATION]
    silent_us = flight.now_us
    assert flight.run(2.0, until=lambda: commander.failsafe)
    assert flight.now_us - silent_us == pytest.approx(1_000_000, abs=(PERIOD + 2) * STEP_US)
    assert flight.mode is FlightMode.HOLD
    flight.run(2.0)
    assert flight.mode is FlightMode.HOLD
    flight.offboard(flight.streams[PROGRAM], PROGRAM)
    flight.run(8.0)
    assert (flight.mode, commander.failsafe) == (FlightMode.OFFBOARD, False)
    assert abs(flight.state.pos_ned_m[0]) < 0.3
