"""Commands: one acknowledgement for each, what it is, and what is done at all."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from protocol_bench import ASKER, EVERYTHING, HOME, NAN, TAKEOFF_HEIGHT_M, Commanded
from pymavlink.dialects.v20 import common

from autopilot.commander.conditions import Condition, Reason
from autopilot.mavlink.codec import stamp
from autopilot.mavlink.modes import FlightMode
from autopilot.protocol.command import REMEMBERED_MAX, REMEMBERED_US
from autopilot.protocol.service import ALL, Partner, is_addressed_to

ACCEPTED, DENIED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_DENIED
REFUSED, UNSUPPORTED = common.MAV_RESULT_TEMPORARILY_REJECTED, common.MAV_RESULT_UNSUPPORTED
ARM, TAKE_OFF, MODE = (
    common.MAV_CMD_COMPONENT_ARM_DISARM,
    common.MAV_CMD_NAV_TAKEOFF,
    common.MAV_CMD_DO_SET_MODE,
)
REPOSITION, ORBIT, SET_HOME = (
    common.MAV_CMD_DO_REPOSITION,
    common.MAV_CMD_DO_ORBIT,
    common.MAV_CMD_DO_SET_HOME,
)
NOTHING_GIVEN = 2**31 - 1
RELATIVE = common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT

single = st.floats(width=32, allow_nan=True, allow_infinity=True) | st.sampled_from(
    (0.0, 1.0, 2.0, -1.0, NAN, math.inf, 1e30, 21196.0)
)


# ---- any command at all


@settings(max_examples=300, deadline=None)
@given(
    command=st.sampled_from(sorted(Commanded().table)) | st.integers(0, 65_535),
    params=st.tuples(*[single] * 7),
    refusal=st.none() | st.sampled_from(Reason),
    landed=st.booleans(),
    confirmation=st.integers(0, 255),
)
def test_whatever_is_asked_is_acknowledged_once_and_breaks_nothing(
    command, params, refusal, landed, confirmation
):
    vehicle = Commanded()
    vehicle.refusal = refusal
    vehicle.hold(EVERYTHING, landed=landed)
    result, others = vehicle.long(command, *params, confirmation=confirmation)
    assert (result == UNSUPPORTED) or command in vehicle.table
    for other in others:
        if other.get_type() == "STATUSTEXT":
            assert other.text


@settings(max_examples=300, deadline=None)
@given(
    command=st.sampled_from(sorted(Commanded().table)) | st.integers(0, 65_535),
    params=st.tuples(*[single] * 4),
    frame=st.integers(0, 255),
    x=st.integers(-(2**31), 2**31 - 1),
    y=st.integers(-(2**31), 2**31 - 1),
    z=single,
    at_home=st.booleans(),
)
def test_nor_does_any_command_with_a_place(command, params, frame, x, y, z, at_home):
    vehicle = Commanded()
    vehicle.flight.home = HOME if at_home else None
    vehicle.int(command, *params, frame=frame, x=x, y=y, z=z)
    for name, *values in vehicle.done:
        if name in {"reposition", "set_home"}:  # what reaches the pilot is a place on Earth
            lat_deg, lon_deg, alt_m = values[:3]
            assert lat_deg is None or abs(lat_deg) <= 90.0
            assert lon_deg is None or abs(lon_deg) <= 180.0
            assert alt_m is None or abs(alt_m) <= 1e5
            assert (lat_deg is None) is (lon_deg is None)


def test_answers_are_the_askers_and_texts_are_for_all():
    vehicle = Commanded()
    vehicle.hold(0)
    message = common.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, *[0.0] * 6)
    ack, text = vehicle.service.on_message(message, 0, ASKER)
    assert (ack.partner, text.partner) == (ASKER, ALL)
    message = common.MAVLink_command_long_message(1, 1, common.MAV_CMD_REQUEST_MESSAGE, 0, 148.0, *[0.0] * 6)
    ack, sent = vehicle.service.on_message(message, 0, ASKER)
    assert (ack.partner, sent.partner) == (ASKER, Partner(ASKER.link))


def test_a_repetition_is_answered_and_not_done_again():
    vehicle = Commanded()

    def ask(confirmation, now_us, height_m=10.0):
        return vehicle.long(
            common.MAV_CMD_DO_CHANGE_SPEED, 1.0, height_m, confirmation=confirmation, now_us=now_us
        )

    assert ask(0, 0)[0] == ACCEPTED
    assert ask(1, 500_000)[0] == ACCEPTED
    assert len(vehicle.done) == 1
    assert ask(0, 600_000)[0] == ACCEPTED  # a new command that says the same
    assert len(vehicle.done) == 2
    ask(1, 600_000, height_m=9.0)  # another one, whose first copy was lost
    assert len(vehicle.done) == 3
    ask(2, 600_001 + REMEMBERED_US)
    assert len(vehicle.done) == 4


def test_of_commands_only_so_many_are_remembered():
    vehicle = Commanded()
    for i in range(10 * REMEMBERED_MAX):
        vehicle.long(common.MAV_CMD_DO_CHANGE_SPEED, 1.0, float(i + 1), confirmation=1)
    assert len(vehicle.service._done) == REMEMBERED_MAX
    assert len(vehicle.done) == 10 * REMEMBERED_MAX


def test_addresses():
    def to(system, component):
        return common.MAVLink_command_long_message(system, component, 400, 0, *[0.0] * 7)

    for system, component, meant in [
        (3, 1, True),
        (0, 0, True),
        (3, 0, True),
        (4, 1, False),
        (3, 191, False),
    ]:
        assert is_addressed_to(to(system, component), system=3, component=1) is meant
    assert is_addressed_to(common.MAVLink_system_time_message(0, 0), system=3, component=1)


# ---- arming and modes


def test_a_refusal_is_acknowledged_with_its_reason_in_words():
    vehicle = Commanded()
    vehicle.hold(0)
    result, (text,) = vehicle.long(ARM, 1.0)
    assert result == REFUSED
    assert text.text == "Arming denied: no inertial data"
    vehicle.hold(EVERYTHING)
    assert vehicle.long(ARM, 1.0) == (ACCEPTED, [])
    assert vehicle.long(ARM, 1.0)[0] == ACCEPTED
    vehicle.hold(EVERYTHING, landed=False)
    result, (text,) = vehicle.long(ARM, 0.0)
    assert result == REFUSED
    assert text.text == "Disarming denied: not landed"
    assert vehicle.long(ARM, 0.0, 21196.0)[0] == ACCEPTED


@pytest.mark.parametrize(
    ("command", "params", "result"),
    [
        (MODE, (1.0, 4.0, 3.0), ACCEPTED),
        (MODE, (1.0, 4.0, 5.0), ACCEPTED),
        (MODE, (1.0, 4.0, 1.0), DENIED),
        (MODE, (0.0, 4.0, 3.0), DENIED),
        (MODE, (NAN, NAN, NAN), DENIED),
        (common.MAV_CMD_DO_SET_STANDARD_MODE, (5.0,), ACCEPTED),
        (common.MAV_CMD_DO_SET_STANDARD_MODE, (0.0,), UNSUPPORTED),
        (common.MAV_CMD_DO_SET_STANDARD_MODE, (3.0,), UNSUPPORTED),
        (ARM, (NAN,), DENIED),
        (common.MAV_CMD_NAV_LAND, (), ACCEPTED),
        (common.MAV_CMD_DO_FLIGHTTERMINATION, (1.0,), DENIED),  # nothing flies
        (common.MAV_CMD_MISSION_START, (NAN,), DENIED),
        (common.MAV_CMD_MISSION_START, (99.0,), DENIED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (4.0,), ACCEPTED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (5.0,), DENIED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (0.5,), DENIED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (2.0, 0.5), DENIED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (-1.0,), ACCEPTED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (-2.0,), DENIED),
        (common.MAV_CMD_LOGGING_START, (), UNSUPPORTED),
        (common.MAV_CMD_DO_CHANGE_SPEED, (2.0, 3.0), UNSUPPORTED),  # of climbing
        (common.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (1.0,), DENIED),
        (common.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (0.0,), ACCEPTED),
        (common.MAV_CMD_PREFLIGHT_STORAGE, (0.0,), UNSUPPORTED),
        (common.MAV_CMD_PREFLIGHT_STORAGE, (1.0,), common.MAV_RESULT_IN_PROGRESS),
        (common.MAV_CMD_PREFLIGHT_STORAGE, (2.0,), ACCEPTED),
        (common.MAV_CMD_PREFLIGHT_STORAGE, (3.0,), ACCEPTED),
        (common.MAV_CMD_PREFLIGHT_STORAGE, (4.0,), ACCEPTED),
        (common.MAV_CMD_PREFLIGHT_STORAGE, (5.0,), UNSUPPORTED),
        (common.MAV_CMD_PREFLIGHT_STORAGE, (NAN,), UNSUPPORTED),
        (common.MAV_CMD_IMAGE_START_CAPTURE, (), UNSUPPORTED),
        (common.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, (), UNSUPPORTED),
        (common.MAV_CMD_INJECT_FAILURE, (), UNSUPPORTED),
        (common.MAV_CMD_DO_FENCE_ENABLE, (1.0,), UNSUPPORTED),
    ],
)
def test_results(command, params, result):
    assert Commanded().long(command, *params)[0] == result


def test_who_waits_for_an_end_hears_it_once_and_from_memory_again():
    vehicle = Commanded()
    storage, in_progress = common.MAV_CMD_PREFLIGHT_STORAGE, common.MAV_RESULT_IN_PROGRESS
    assert vehicle.long(storage, 1.0)[0] == in_progress
    assert vehicle.long(storage, 1.0, confirmation=1)[0] == in_progress
    assert vehicle.service.finish(common.MAV_CMD_PREFLIGHT_CALIBRATION, ACCEPTED, 10) == []
    ((to, ack),) = vehicle.service.finish(storage, common.MAV_RESULT_FAILED, 10)
    assert to == ASKER
    assert (ack.command, ack.result, ack.target_system, ack.target_component) == (
        storage, common.MAV_RESULT_FAILED, 255, 190,
    )  # fmt: skip
    assert vehicle.service.finish(storage, ACCEPTED, 20) == []
    assert vehicle.long(storage, 1.0, confirmation=2, now_us=20)[0] == common.MAV_RESULT_FAILED
    assert vehicle.long(storage, 1.0, confirmation=2, now_us=11 + REMEMBERED_US)[0] == in_progress


def test_those_who_wait_for_an_end_do_not_pile_up():
    vehicle = Commanded()
    for number in range(10 * REMEMBERED_MAX):
        vehicle.long(common.MAV_CMD_PREFLIGHT_STORAGE, 1.0, float(number))
    assert len(vehicle.service.finish(common.MAV_CMD_PREFLIGHT_STORAGE, ACCEPTED, 0)) == REMEMBERED_MAX


def test_an_armed_vehicle_keeps_its_parameters():
    vehicle = Commanded()
    assert vehicle.long(ARM, 1.0)[0] == ACCEPTED
    result, (text,) = vehicle.long(common.MAV_CMD_PREFLIGHT_STORAGE, 2.0)
    assert result == REFUSED
    assert text.text == "Parameter reset denied: armed"


def test_offboard_is_asked_for_the_partner_before_the_commander_is():
    vehicle = Commanded()
    vehicle.hold(EVERYTHING & ~Condition.SETPOINTS)
    assert vehicle.long(MODE, 1.0, 6.0, 0.0, now_us=5)[0] == REFUSED
    assert vehicle.done == [("ask_offboard", ASKER, 5)]
    vehicle.hold(EVERYTHING)
    assert vehicle.long(MODE, 1.0, 6.0, 0.0, now_us=6)[0] == ACCEPTED
    assert vehicle.commander.mode is FlightMode.OFFBOARD


def test_set_mode_does_the_same_and_is_acknowledged_as_the_command():
    vehicle = Commanded()
    message = common.MAVLink_set_mode_message(
        1, common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, FlightMode.LAND.custom_mode
    )
    assert vehicle.send(message, MODE) == (ACCEPTED, [])
    assert vehicle.commander.mode is FlightMode.LAND
    assert vehicle.send(common.MAVLink_set_mode_message(1, 0, 0), MODE)[0] == DENIED
    assert vehicle.commander.mode is FlightMode.LAND


def test_a_mission_is_started_at_an_item_and_only_if_there_is_one():
    vehicle = Commanded()
    vehicle.hold(EVERYTHING & ~Condition.MISSION)
    result, (text,) = vehicle.long(common.MAV_CMD_MISSION_START, 0.0)
    assert result == DENIED
    assert "no valid mission" in text.text
    assert not vehicle.commander.armed
    vehicle.hold(EVERYTHING)
    assert vehicle.long(common.MAV_CMD_MISSION_START, 3.0)[0] == ACCEPTED
    assert vehicle.done == [("seq", 3)]
    assert vehicle.commander.armed
    assert vehicle.commander.mode is FlightMode.MISSION
    assert vehicle.long(common.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)[0] == ACCEPTED
    assert vehicle.commander.mode is FlightMode.HOLD
    assert vehicle.long(common.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)[0] == ACCEPTED  # it holds
    assert vehicle.long(common.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)[0] == ACCEPTED
    assert vehicle.commander.mode is FlightMode.MISSION
    assert vehicle.long(common.MAV_CMD_MISSION_START, -1.0)[0] == ACCEPTED
    assert vehicle.done == [("seq", 3)]  # goes on where it stands


def test_a_mission_that_is_not_started_keeps_its_item():
    vehicle = Commanded()
    assert vehicle.long(common.MAV_CMD_MISSION_START, 99.0)[0] == DENIED
    assert vehicle.commander.mode is not FlightMode.MISSION
    vehicle.commander.update(0, conditions=EVERYTHING & ~Condition.CHARGE, landed=True)
    assert vehicle.long(common.MAV_CMD_MISSION_START, 3.0)[0] == REFUSED  # it does not arm
    vehicle.hold(EVERYTHING)
    assert vehicle.long(ARM, 1.0)[0] == ACCEPTED
    vehicle.commander.update(0, conditions=EVERYTHING & ~Condition.POSITION, landed=False)
    assert vehicle.long(common.MAV_CMD_MISSION_START, 3.0)[0] == REFUSED  # nor enters the mode
    assert vehicle.done == []


# ---- take-off


@pytest.mark.parametrize(
    ("asked_m", "climbs_to_m", "is_told"),
    [
        (NAN, None, False),
        (1e30, None, False),
        (490.5, 490.5, False),
        (5.0, HOME.alt_m + TAKEOFF_HEIGHT_M, True),  # five metres above the sea lie below the ground
        (HOME.alt_m + TAKEOFF_HEIGHT_M - 0.05, HOME.alt_m + TAKEOFF_HEIGHT_M, False),
    ],
)
def test_a_take_off_is_never_lower_than_the_parameter_says(asked_m, climbs_to_m, is_told):
    vehicle = Commanded()
    result, texts = vehicle.long(TAKE_OFF, 0, 0, 0, NAN, NAN, NAN, asked_m)
    assert result == ACCEPTED
    assert vehicle.commander.mode is FlightMode.TAKEOFF
    assert vehicle.altitude.amsl_m == climbs_to_m
    assert [text.text for text in texts] == ["Using minimum takeoff altitude: 2.50 m"] * is_told
    assert vehicle.long(MODE, 1.0, 4.0, 2.0)[0] == ACCEPTED
    assert vehicle.altitude.amsl_m is None  # the next take-off is not bound by the last one's


def test_a_take_off_altitude_counts_from_what_the_frame_says():
    vehicle = Commanded()
    for frame, z, amsl_m in [
        (common.MAV_FRAME_GLOBAL_INT, 500.0, 500.0),
        (common.MAV_FRAME_GLOBAL, 500.0, 500.0),
        (RELATIVE, 10.0, HOME.alt_m + 10.0),
        (common.MAV_FRAME_GLOBAL_RELATIVE_ALT, 1.0, HOME.alt_m + TAKEOFF_HEIGHT_M),
    ]:
        assert vehicle.int(TAKE_OFF, 0, 0, 0, NAN, frame=frame, z=z)[0] == ACCEPTED
        assert vehicle.altitude.amsl_m == amsl_m


@pytest.mark.parametrize(
    "frame",
    [
        common.MAV_FRAME_LOCAL_NED,
        common.MAV_FRAME_BODY_FRD,
        common.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
        common.MAV_FRAME_MISSION,
    ],
)
def test_a_take_off_altitude_from_elsewhere_is_not_taken_for_one_above_the_sea(frame):
    vehicle = Commanded()
    before = vehicle.commander.mode
    assert vehicle.int(TAKE_OFF, 0, 0, 0, NAN, frame=frame, z=10.0)[0] == UNSUPPORTED
    assert (vehicle.commander.mode, vehicle.altitude.amsl_m) == (before, None)


# ---- places


def test_places_are_degrees_whatever_message_brings_them():
    vehicle = Commanded()
    asked = (-1.0, 1.0, 0.0, 0.5)
    vehicle.int(REPOSITION, *asked, x=471_234_567, y=-81_234_567, z=420.0)
    vehicle.long(REPOSITION, *asked, 47.125, -8.125, 420.0)
    (_, *by_int), (_, *by_long) = vehicle.done
    assert by_int == pytest.approx([47.1234567, -8.1234567, 420.0, 0.5, None])
    assert by_long == [47.125, -8.125, 420.0, 0.5, None]


@pytest.mark.parametrize("nothing", [NOTHING_GIVEN, 0x7FF8_0000])
def test_what_is_not_given_stays_open(nothing):
    vehicle = Commanded()
    vehicle.int(REPOSITION, 3.0, 1.0, 0.0, NAN, x=nothing, y=nothing, z=NAN)
    vehicle.long(REPOSITION, 3.0, 1.0, 0.0, NAN, NAN, NAN, NAN)
    assert vehicle.done == [("reposition", None, None, None, None, 3.0)] * 2


def test_altitudes_of_relative_frames_count_from_home():
    vehicle = Commanded()
    vehicle.int(REPOSITION, -1.0, 1.0, 0.0, NAN, frame=RELATIVE, x=0, y=0, z=12.0)
    assert vehicle.done[0][3] == HOME.alt_m + 12.0
    vehicle.flight.home = None
    assert vehicle.int(REPOSITION, -1.0, 1.0, 0.0, NAN, frame=RELATIVE, x=0, y=0, z=12.0)[0] == REFUSED


@pytest.mark.parametrize(
    ("place", "result"),
    [
        ({"x": 900_000_001, "y": 0}, DENIED),
        ({"x": 0, "y": -1_800_000_001}, DENIED),
        ({"x": NOTHING_GIVEN, "y": 0}, DENIED),
        ({"z": 1e30}, DENIED),
        ({"frame": common.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT}, UNSUPPORTED),
        ({"frame": common.MAV_FRAME_LOCAL_NED}, UNSUPPORTED),
    ],
)
@pytest.mark.parametrize("command", [REPOSITION, ORBIT, SET_HOME])
def test_what_is_no_place_is_refused(command, place, result):
    vehicle = Commanded()
    assert vehicle.int(command, 0.0, 1.0, **place)[0] == result
    assert not vehicle.done


def test_reposition_needs_its_flag_and_gives_the_pilots_reason():
    vehicle = Commanded()
    assert vehicle.long(REPOSITION, -1.0, 0.0, 0.0, NAN, 47.0, 8.0, 500.0)[0] == UNSUPPORTED
    assert vehicle.long(REPOSITION, -1.0, 3.0, 0.0, NAN, 47.0, 8.0, 500.0)[0] == UNSUPPORTED
    assert not vehicle.done
    vehicle.refusal = Reason.NO_POSITION
    result, (text,) = vehicle.long(REPOSITION, -1.0, 1.0, 0.0, NAN, 47.0, 8.0, 500.0)
    assert (result, text.text) == (REFUSED, "Reposition denied: no position estimate")


def test_a_place_outside_the_fence_is_accepted_and_said_not_to_be_flown_to():
    vehicle = Commanded()
    vehicle.refusal = Reason.OUTSIDE_GEOFENCE
    result, (text,) = vehicle.long(REPOSITION, -1.0, 1.0, 0.0, NAN, 47.0, 8.0, 500.0)
    assert (result, text.text) == (ACCEPTED, "Reposition is outside geofence")


def test_altitude_orbit_speed_and_home_reach_the_pilot():
    vehicle = Commanded()
    vehicle.long(common.MAV_CMD_DO_CHANGE_ALTITUDE, 30.0, float(common.MAV_FRAME_GLOBAL_RELATIVE_ALT))
    vehicle.int(ORBIT, -12.0, NAN, NAN, NAN, x=470_000_000, y=80_000_000, z=NAN)
    vehicle.long(common.MAV_CMD_DO_CHANGE_SPEED, 1.0, 4.0, -1.0)
    vehicle.long(common.MAV_CMD_DO_CHANGE_SPEED, 1.0, -2.0, -1.0)
    vehicle.long(SET_HOME, 1.0)
    vehicle.int(SET_HOME, 0.0, x=470_000_000, y=80_000_000, z=410.0)
    assert vehicle.done == [
        ("reposition", None, None, HOME.alt_m + 30.0, None, None),
        ("orbit", -12.0, None, None, pytest.approx(47.0), pytest.approx(8.0), None),
        ("change_speed", 4.0),
        ("change_speed", None),
        ("set_home_here",),
        ("set_home", pytest.approx(47.0), pytest.approx(8.0), 410.0),
    ]
    assert vehicle.int(SET_HOME, 0.0, x=470_000_000, y=80_000_000, z=NAN)[0] == DENIED


@pytest.mark.parametrize("home", [HOME, None])
def test_orbit_and_home_are_above_the_sea_whatever_the_frame_as_mavsdk_sends_them(home):
    vehicle = Commanded()
    vehicle.flight.home = home
    place = {"frame": common.MAV_FRAME_GLOBAL_RELATIVE_ALT, "x": 470_000_000, "y": 80_000_000, "z": 495.0}
    assert vehicle.int(ORBIT, 12.0, 2.0, 0.0, NAN, **place)[0] == ACCEPTED
    assert vehicle.int(SET_HOME, 0.0, **place)[0] == ACCEPTED
    assert [order[-1] for order in vehicle.done] == [495.0, 495.0]


def test_an_actuator_may_be_set_though_none_is_there():
    vehicle = Commanded()
    assert vehicle.long(common.MAV_CMD_DO_SET_ACTUATOR, 0.5, *[NAN] * 5, 0.0) == (ACCEPTED, [])
    assert not vehicle.done


# ---- messages on request


def test_all_modes_can_be_listed_and_each_can_be_asked_for():
    vehicle = Commanded()
    request, modes_id = common.MAV_CMD_REQUEST_MESSAGE, 435.0
    result, modes = vehicle.long(request, modes_id, 0.0)
    assert result == ACCEPTED
    assert [mode.mode_index for mode in modes] == list(range(1, len(modes) + 1))
    assert {mode.number_modes for mode in modes} == {len(modes)}
    assert len({mode.custom_mode for mode in modes}) == len(modes)
    for mode in modes:
        assert (mode.standard_mode == 0) is (mode.mode_name != "")  # a standard mode has a name of MAVLink's
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
def test_older_requests_for_one_message(command, name):
    result, (message,) = Commanded().long(command, 1.0)
    assert (result, message.get_type()) == (ACCEPTED, name)


@pytest.mark.parametrize(
    ("message_id", "result"), [(148.0, ACCEPTED), (1.0, ACCEPTED), (30.0, REFUSED), (NAN, UNSUPPORTED)]
)
def test_requests_of_a_message(message_id, result):
    assert Commanded().long(common.MAV_CMD_REQUEST_MESSAGE, message_id)[0] == result


def test_intervals_are_told_as_they_are():
    vehicle = Commanded()
    attitude = float(common.MAVLINK_MSG_ID_ATTITUDE)

    def told(message_id):
        result, (by_command,) = vehicle.long(common.MAV_CMD_GET_MESSAGE_INTERVAL, message_id)
        request = (common.MAV_CMD_REQUEST_MESSAGE, float(common.MAVLINK_MSG_ID_MESSAGE_INTERVAL), message_id)
        (by_request,) = vehicle.long(*request)[1]
        assert result == ACCEPTED
        assert by_request.interval_us == by_command.interval_us
        return by_command.interval_us

    assert told(attitude) == 20_000
    for asked_us, interval_us in [(1e5, 100_000), (0.1, 20_000), (1.0, 4_000), (-1.0, -1), (0.0, 20_000)]:
        result, _ = vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, asked_us)
        assert result == ACCEPTED
        assert told(attitude) == interval_us
    assert told(float(common.MAVLINK_MSG_ID_SCALED_IMU)) == -1
    assert told(12_345.0) == told(NAN) == 0
    heartbeat = float(common.MAVLINK_MSG_ID_HEARTBEAT)
    assert vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, heartbeat, -1.0)[0] == DENIED
    assert vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, heartbeat, 1e9)[0] == ACCEPTED
    assert told(heartbeat) == 1_000_000
    assert vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, 12_345.0, 1e5)[0] == UNSUPPORTED
    assert vehicle.long(common.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, math.inf)[0] == DENIED


# ---- calibration


def sample(*gyro_rad_s):
    return common.MAVLink_hil_sensor_message(0, 0.0, 0.0, -9.8, *gyro_rad_s, *[0.0] * 7, 0)


def calibrate(vehicle, *params, turn=lambda _: 0.0):
    """What is said, over at most ten seconds of sensor data."""
    result, texts = vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, *params)
    said = [text.text for text in texts]
    machine = vehicle.calibration
    while machine.next_deadline_us() < 10_000_000:
        now_us = machine.next_deadline_us()
        vehicle.flight.sensor = sample(turn(now_us), 0.0, 0.0)
        said += [message.text for _, message in machine.on_timer(now_us)]
    return result, said


@pytest.mark.parametrize(
    ("params", "what"), [((1.0,), "gyro"), ((0.0, 0.0, 1.0), "baro"), ((0.0, 0.0, 0.0, 0.0, 2.0), "level")]
)
def test_a_calibration_at_rest_is_told_in_the_words_that_clients_parse(params, what):
    vehicle = Commanded()
    noise = np.random.default_rng(1)
    result, said = calibrate(vehicle, *params, turn=lambda _: noise.normal(0.0, 0.014))
    assert result == ACCEPTED
    assert vehicle.woken == 1
    progress = [f"[cal] progress <{percent}>" for percent in (20, 40, 60, 80, 100)]
    assert said == [f"[cal] calibration started: 2 {what}", *progress, f"[cal] calibration done: {what}"]
    assert calibrate(vehicle, *params)[0] == ACCEPTED  # and again


def test_a_calibration_fails_in_motion_and_can_be_cancelled():
    vehicle = Commanded()
    _, said = calibrate(vehicle, 1.0, turn=lambda now_us: 0.2 * (now_us > 1_000_000))
    assert said[-1] == "[cal] calibration failed: motion"
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)[0] == ACCEPTED
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)[0] == REFUSED  # one at a time
    result, (text,) = vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION)
    assert (result, text.text) == (ACCEPTED, "[cal] calibration cancelled")
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION) == (ACCEPTED, [])


def test_there_is_no_calibration_armed_nor_of_what_needs_hands():
    vehicle = Commanded()
    result, (text,) = vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 0.0, 1.0)
    assert (result, text.text) == (DENIED, "Calibration denied: nobody here can turn the vehicle")
    vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)
    vehicle.long(ARM, 1.0)
    ((_, message),) = vehicle.calibration.on_timer(vehicle.calibration.next_deadline_us())
    assert message.text == "[cal] calibration cancelled"
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_CALIBRATION, 1.0)[0] == REFUSED


def test_a_station_without_numbers_is_answered_too():
    vehicle = Commanded()
    message = stamp(common.MAVLink_command_long_message(0, 0, ARM, 0, 1.0, *[0.0] * 6), system=0, component=0)
    ((partner, ack),) = vehicle.service.on_message(message, 0, ASKER)
    assert (partner, ack.target_system) == (ASKER, 0)
