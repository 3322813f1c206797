"""Commands that request messages, and calibrations with their progress reports."""

import math

import numpy as np
import pytest
from protocol_bench import CLIENT, NAN, Commanded
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import stamp

ACCEPTED, DENIED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_DENIED
REFUSED, UNSUPPORTED = common.MAV_RESULT_TEMPORARILY_REJECTED, common.MAV_RESULT_UNSUPPORTED
ARM = common.MAV_CMD_COMPONENT_ARM_DISARM


# ---- messages on request


def test_all_modes_are_listed_and_each_can_be_requested():
    vehicle = Commanded()
    request, modes_id = common.MAV_CMD_REQUEST_MESSAGE, 435.0
    result, modes = vehicle.long(request, modes_id, 0.0)
    assert result == ACCEPTED
    assert [mode.mode_index for mode in modes] == list(range(1, len(modes) + 1))
    assert {mode.number_modes for mode in modes} == {len(modes)}
    assert len({mode.custom_mode for mode in modes}) == len(modes)
    for mode in modes:
        assert (mode.standard_mode == 0) is (mode.mode_name != "")
        (alone,) = vehicle.long(request, modes_id, float(mode.mode_index))[1]
        assert alone.custom_mode == mode.custom_mode
    assert vehicle.long(request, modes_id, float(len(modes) + 1))[0] == REFUSED
    assert vehicle.long(request, modes_id, NAN)[0] == REFUSED


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (common.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, "AUTOPILOT_VERSION"),
        (common.MAV_CMD_REQUEST_PROTOCOL_VERSION, "PROTOCOL_VERSION"),
        (common.MAV_CMD_REQUEST_FLIGHT_INFORMATION, "FLIGHT_INFORMATION"),
    ],
)
def test_older_commands_that_request_one_message(command, name):
    result, (message,) = Commanded().long(command, 1.0)
    assert (result, message.get_type()) == (ACCEPTED, name)


@pytest.mark.parametrize(
    ("message_id", "result"), [(148.0, ACCEPTED), (1.0, ACCEPTED), (30.0, REFUSED), (NAN, UNSUPPORTED)]
)
def test_requests_for_a_message(message_id, result):
    assert Commanded().long(common.MAV_CMD_REQUEST_MESSAGE, message_id)[0] == result


def test_intervals_are_reported_as_set():
    vehicle = Commanded()
    attitude = float(common.MAVLINK_MSG_ID_ATTITUDE)

    def reported(message_id):
        result, (by_command,) = vehicle.long(common.MAV_CMD_GET_MESSAGE_INTERVAL, message_id)
        request = (common.MAV_CMD_REQUEST_MESSAGE, float(common.MAVLINK_MSG_ID_MESSAGE_INTERVAL), message_id)
        (by_request,) = vehicle.long(*request)[1]
        assert result == ACCEPTED
        assert by_request.interval_us == by_command.interval_us
        return by_command.interval_us

    assert reported(attitude) == 20_000
    for requested_us, interval_us in [(1e5, 100_000), (0.1, 20_000), (1.0, 4_000), (-1.0, -1), (0.0, 20_000)]:
        result, _ = vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, requested_us)
        assert result == ACCEPTED
        assert reported(attitude) == interval_us
    assert reported(float(common.MAVLINK_MSG_ID_SCALED_IMU)) == -1
    assert reported(12_345.0) == reported(NAN) == 0
    heartbeat = float(common.MAVLINK_MSG_ID_HEARTBEAT)
    assert vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, heartbeat, -1.0)[0] == DENIED
    assert vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, heartbeat, 1e9)[0] == ACCEPTED
    assert reported(heartbeat) == 1_000_000
    assert vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, 12_345.0, 1e5)[0] == UNSUPPORTED
    assert vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, math.inf)[0] == DENIED


# ---- calibration


def sample(*gyro_rad_s):
    return common.MAVLink_hil_sensor_message(0, 0.0, 0.0, -9.8, *gyro_rad_s, *[0.0] * 7, 0)


def calibrate(vehicle, *params, turn=lambda _: 0.0):
    """Result and texts of a calibration, over at most ten seconds of sensor data."""
    result, texts = vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, *params)
    sent = [text.text for text in texts]
    machine = vehicle.calibration
    while machine.next_deadline_us() < 10_000_000:
        now_us = machine.next_deadline_us()
        vehicle.flight.sensor = sample(turn(now_us), 0.0, 0.0)
        sent += [message.text for _, message in machine.on_timer(now_us)]
    return result, sent


@pytest.mark.parametrize(
    ("params", "what"), [((1.0,), "gyro"), ((0.0, 0.0, 1.0), "baro"), ((0.0, 0.0, 0.0, 0.0, 2.0), "level")]
)
def test_a_calibration_at_rest_sends_the_texts_that_clients_parse(params, what):
    vehicle = Commanded()
    noise = np.random.default_rng(1)
    result, sent = calibrate(vehicle, *params, turn=lambda _: noise.normal(0.0, 0.014))
    assert result == ACCEPTED
    assert vehicle.woken == 1
    progress = [f"[cal] progress <{percent}>" for percent in (20, 40, 60, 80, 100)]
    assert sent == [f"[cal] calibration started: 2 {what}", *progress, f"[cal] calibration done: {what}"]
    assert calibrate(vehicle, *params)[0] == ACCEPTED  # it can be repeated


def test_a_calibration_fails_in_motion_and_can_be_cancelled():
    vehicle = Commanded()
    _, sent = calibrate(vehicle, 1.0, turn=lambda now_us: 0.2 * (now_us > 1_000_000))
    assert sent[-1] == "[cal] calibration failed: motion"
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)[0] == ACCEPTED
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)[0] == REFUSED  # one at a time
    result, (text,) = vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION)
    assert (result, text.text) == (ACCEPTED, "[cal] calibration cancelled")
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION) == (ACCEPTED, [])


def test_calibration_is_denied_while_armed_and_if_it_requires_turning_by_hand():
    vehicle = Commanded()
    result, (text,) = vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 0.0, 1.0)
    assert (result, text.text) == (DENIED, "Calibration denied: the vehicle cannot be turned by hand")
    vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)
    vehicle.long(ARM, 1.0)
    ((_, message),) = vehicle.calibration.on_timer(vehicle.calibration.next_deadline_us())
    assert message.text == "[cal] calibration cancelled"
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)[0] == REFUSED


def test_a_station_with_system_id_zero_is_answered():
    vehicle = Commanded()
    message = stamp(common.MAVLink_command_long_message(0, 0, ARM, 0, 1.0, *[0.0] * 6), system=0, component=0)
    ((partner, ack),) = vehicle.service.on_message(message, 0, CLIENT)
    assert (partner, ack.target_system) == (CLIENT, 0)
