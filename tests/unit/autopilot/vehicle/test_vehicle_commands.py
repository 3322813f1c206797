"""Commands of a ground station to a whole vehicle, and its telemetry."""

import math

import numpy as np
import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common
from vehicle_world import STEP_US, Flight, vehicle_config

from autopilot.mavlink.modes import FlightMode
from autopilot.services.service import COMPANION, GROUND_STATION, Partner, reply
from autopilot.vehicle.host import warnings
from foundation.geometry.geodesy import ned_to_geodetic

NAN = math.nan
ACCEPTED, REFUSED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_TEMPORARILY_REJECTED
COMMANDS = {
    16, 17, 20, 21, 22, 34, 176, 178, 179, 183, 186, 187, 192, 193, 195, 206, 207, 209, 224, 241, 245, 246,
    252, 262, 300, 310, 400, 401, 420, 510, 511, 512, 519, 520, 528, 1000, 2000, 2500, 2510, 31010, 42006,
}  # fmt: skip
ARM, TAKE_OFF = common.MAV_CMD_COMPONENT_ARM_DISARM, common.MAV_CMD_NAV_TAKEOFF
EPOCH_US = 1_767_225_600_000_000


def place_of(flight, north_m, east_m, down_m):
    """Return degrees E7 and altitude of a position from the estimator's origin."""
    state = flight.vehicle.flight.state
    lat_deg, lon_deg, alt_m = ned_to_geodetic(
        (north_m, east_m, down_m),
        origin_lat_deg=state.origin_lat_deg,
        origin_lon_deg=state.origin_lon_deg,
        origin_alt_m=state.origin_alt_m,
    )
    return round(float(lat_deg) * 1e7), round(float(lon_deg) * 1e7), float(alt_m)


def go_to(flight, place, *, speed_m_s=-1.0, yaw_rad=NAN):
    x, y, z = place
    flight.send(
        common.MAVLink_command_int_message(
            1, 1, common.MAV_FRAME_GLOBAL_INT, common.MAV_CMD_DO_REPOSITION, 0, 0,
            speed_m_s, 1.0, 0.0, yaw_rad, x, y, z,
        )
    )  # fmt: skip
    return len(flight.received)


def acks(flight, since):
    return [m.result for _, m in flight.received[since:] if m.get_type() == "COMMAND_ACK"]


def listen(flight, seconds, link=GROUND_STATION):
    """Return the messages streamed on a link, with their times."""
    received = []
    for _ in range(round(seconds * 1e6 / STEP_US)):
        output = flight.step(streams=True)
        received += [(flight.now_us, m) for partner, m in output.links if partner.link == link]
    return received


def of_type(received, name):
    return [(time_us, m) for time_us, m in received if m.get_type() == name]


def test_a_take_off_altitude_above_sea_level_and_a_reposition():
    with Flight(vehicle_config()) as flight:
        vehicle = flight.vehicle
        assert flight.run(20.0, until=lambda: vehicle.commander.arm(flight.now_us) is None)
        vehicle.commander.disarm()
        since = go_to(flight, place_of(flight, 5.0, 0.0, -4.0))
        flight.step()
        assert acks(flight, since) == [REFUSED]  # on the ground
        assert flight.command(ARM, 1.0) == ACCEPTED
        assert (
            flight.command(TAKE_OFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0) == ACCEPTED
        )  # as MAVProxy's takeoff 5
        assert flight.texts()[-1] == "Using minimum takeoff altitude: 2.50 m"
        assert flight.run(15.0, until=lambda: vehicle.commander.mode is FlightMode.HOLD)
        flight.run(3.0)
        home_m = -vehicle.flight.home.pos_ned_m[2]
        assert -float(vehicle.flight.state.pos_ned_m[2]) - home_m == pytest.approx(2.5, abs=0.4)
        target_ned_m = (6.0, -3.0, -4.0)
        since = go_to(flight, place_of(flight, *target_ned_m), yaw_rad=1.0)
        assert flight.run(15.0, until=lambda: math.dist(vehicle.flight.state.pos_ned_m, target_ned_m) < 0.3)
        assert acks(flight, since) == [ACCEPTED]
        assert vehicle.commander.mode is FlightMode.HOLD
        # home is changed in flight, and the streams report it immediately, not after their two seconds
        listen(flight, 0.1)
        x, y, z = place_of(flight, 2.0, 1.0, 0.0)
        flight.send(
            common.MAVLink_command_int_message(
                1,
                1,
                common.MAV_FRAME_GLOBAL_INT,
                common.MAV_CMD_DO_SET_HOME,
                0,
                0,
                0.0,
                0.0,
                0.0,
                0.0,
                x,
                y,
                z,
            )
        )
        requested_us = flight.now_us
        reports = of_type(listen(flight, 0.02), "HOME_POSITION")
        assert [(m.latitude, m.longitude, m.altitude) for _, m in reports] == [
            (x, y, pytest.approx(1e3 * z, abs=1))
        ]
        assert reports[0][0] - requested_us <= 2 * STEP_US
        assert vehicle.flight.home.pos_ned_m == pytest.approx((2.0, 1.0, 0.0), abs=0.02)
        information = vehicle.messaging.telemetry.system.flight_information()
        assert 0 < information.arming_time_utc < information.takeoff_time_utc < flight.now_us


def test_the_streamed_messages_are_those_of_px4():
    config = replace(vehicle_config(), epoch_unix_us=EPOCH_US)
    with Flight(config) as flight:
        flight.run(12.0)
        received = listen(flight, 4.0, link=COMPANION)
        counts = {}
        for _, message in received:
            counts[message.get_type()] = counts.get(message.get_type(), 0) + 1
        for name, rate_hz in [
            ("HEARTBEAT", 1), ("ATTITUDE", 100), ("HIGHRES_IMU", 50), ("TIMESYNC", 10), ("SYS_STATUS", 5),
            ("SYSTEM_TIME", 1), ("MISSION_CURRENT", 1), ("CURRENT_MODE", 0.5), ("HOME_POSITION", 0.5),
        ]:  # fmt: skip
            assert counts[name] == pytest.approx(4 * rate_hz, abs=1), name
        for time_us, message in of_type(received, "SYSTEM_TIME"):
            assert message.time_unix_usec == EPOCH_US + time_us
        status = of_type(received, "SYS_STATUS")[-1][1]
        unfenced = common.MAV_SYS_STATUS_GEOFENCE  # without a fence there is no fence status
        assert status.onboard_control_sensors_health == status.onboard_control_sensors_present | unfenced
        assert not status.onboard_control_sensors_present & common.MAV_SYS_STATUS_GEOFENCE
        to_ground = {message.get_type() for _, message in listen(flight, 10.5)}
        assert {"VIBRATION", "PING", "CURRENT_MODE"} <= to_ground
        # at rest the vibration is the accelerometer's noise
        vibration = vehicle_vibration(flight)
        assert 0.0 < vibration.vibration_z < 1.0


def vehicle_vibration(flight):
    return flight.vehicle.messaging.telemetry.sensors.vibration()


def test_a_calibration_is_reported_to_its_end():
    with Flight(vehicle_config()) as flight:
        flight.run(1.0)
        assert flight.command(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0) == ACCEPTED
        flight.run(4.0)
        texts = [text for text in flight.texts() if text.startswith("[cal]")]
        assert texts[0] == "[cal] calibration started: 2 gyro"
        assert texts[-1] == "[cal] calibration done: gyro"
        assert len(texts) == 7


def test_no_command_in_flight_breaks_the_vehicle_or_is_unanswered():
    """Commands that would end the flight are excluded; the resulting targets stay finite."""
    with Flight(vehicle_config(params={"COM_LOW_BAT_ACT": 0})) as flight:
        flight.take_off(4.0)
        vehicle, rng = flight.vehicle, np.random.default_rng(11)
        ends = {ARM, common.MAV_CMD_NAV_LAND, common.MAV_CMD_DO_FLIGHTTERMINATION}
        commands = sorted(COMMANDS - ends)
        numbers = (0.0, 1.0, -1.0, 2.5, NAN, math.inf, -math.inf, 1e30, -3.4e38, 47.4, 488.0, 21196.0)
        for _ in range(400):
            command, since = int(rng.choice(commands)), len(flight.received)
            params = [numbers[i] for i in rng.integers(0, len(numbers), 7)]
            if rng.random() < 0.5:
                flight.send(common.MAVLink_command_long_message(1, 1, command, 0, *params))
            else:
                x, y = (int(n) for n in rng.integers(-(2**31), 2**31, 2))
                frame = int(rng.integers(0, 12))
                flight.send(
                    common.MAVLink_command_int_message(
                        1, 1, frame, command, 0, 0, *params[:4], x, y, params[6]
                    )
                )
            flight.step()
            assert len(acks(flight, since)) == 1, command
            flight.run(0.02)
        assert vehicle.commander.armed
        assert all(map(math.isfinite, vehicle.pilot.controls))
        assert vehicle.flight.home is None or all(map(math.isfinite, vehicle.flight.home.pos_ned_m))
        assert flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0) == ACCEPTED
        flight.run(10.0)  # until it is at rest
        assert math.hypot(*vehicle.flight.state.vel_ned_m_s) < 0.5


def test_a_long_text_reaches_every_link_in_pieces():
    with Flight(vehicle_config()) as flight:
        flight.step()
        messaging = flight.vehicle.messaging
        text = common.MAVLink_statustext_message(4, b"x" * 120)
        messaging.post(reply(Partner(GROUND_STATION, 2), text))
        outgoing = messaging.take_outgoing()
        assert [partner for partner, _ in outgoing] == [Partner(GROUND_STATION, 2)] * 3
        assert "".join(piece.text for _, piece in outgoing) == "x" * 120
        assert list(warnings(outgoing)) == ["x" * 120]  # and `warnings` joins them
