"""Commands: their acknowledgements and their effects."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from protocol_bench import CLIENT, EVERYTHING, HOME, NAN, Commanded
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition, Reason
from autopilot.mavlink.modes import FlightMode
from autopilot.services.command import REMEMBERED_MAX, REMEMBERED_US
from autopilot.services.service import ALL, Partner, is_addressed_to

ACCEPTED, DENIED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_DENIED
REFUSED, UNSUPPORTED = common.MAV_RESULT_TEMPORARILY_REJECTED, common.MAV_RESULT_UNSUPPORTED
ARM, MODE = common.MAV_CMD_COMPONENT_ARM_DISARM, common.MAV_CMD_DO_SET_MODE

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
def test_any_command_is_acknowledged_once_and_raises_nothing(command, params, refusal, landed, confirmation):
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
def test_any_command_with_a_position_passes_only_valid_ones_on(command, params, frame, x, y, z, at_home):
    vehicle = Commanded()
    vehicle.flight.home = HOME if at_home else None
    vehicle.int(command, *params, frame=frame, x=x, y=y, z=z)
    for name, *values in vehicle.done:
        if name in {"reposition", "set_home"}:  # the pilot receives valid positions only
            lat_deg, lon_deg, alt_m = values[:3]
            assert lat_deg is None or abs(lat_deg) <= 90.0
            assert lon_deg is None or abs(lon_deg) <= 180.0
            assert alt_m is None or abs(alt_m) <= 1e5
            assert (lat_deg is None) is (lon_deg is None)


def test_acknowledgements_are_for_the_sender_and_texts_for_all():
    vehicle = Commanded()
    vehicle.hold(0)
    message = common.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, *[0.0] * 6)
    ack, text = vehicle.service.on_message(message, 0, CLIENT)
    assert (ack.partner, text.partner) == (CLIENT, ALL)
    message = common.MAVLink_command_long_message(1, 1, common.MAV_CMD_REQUEST_MESSAGE, 0, 148.0, *[0.0] * 6)
    ack, sent = vehicle.service.on_message(message, 0, CLIENT)
    assert (ack.partner, sent.partner) == (CLIENT, Partner(CLIENT.link))


def test_a_repetition_is_answered_and_not_executed_again():
    vehicle = Commanded()

    def repeat_command(confirmation, now_us, height_m=10.0):
        return vehicle.long(
            common.MAV_CMD_DO_CHANGE_SPEED, 1.0, height_m, confirmation=confirmation, now_us=now_us
        )

    assert repeat_command(0, 0)[0] == ACCEPTED
    assert repeat_command(1, 500_000)[0] == ACCEPTED
    assert len(vehicle.done) == 1
    assert repeat_command(0, 600_000)[0] == ACCEPTED  # a new command with equal parameters
    assert len(vehicle.done) == 2
    repeat_command(1, 600_000, height_m=9.0)  # another one, whose first copy was lost
    assert len(vehicle.done) == 3
    repeat_command(2, 600_001 + REMEMBERED_US)
    assert len(vehicle.done) == 4


def test_the_number_of_remembered_commands_is_bounded():
    vehicle = Commanded()
    for i in range(10 * REMEMBERED_MAX):
        vehicle.long(common.MAV_CMD_DO_CHANGE_SPEED, 1.0, float(i + 1), confirmation=1)
    assert len(vehicle.service._done) == REMEMBERED_MAX
    assert len(vehicle.done) == 10 * REMEMBERED_MAX


def test_a_message_is_addressed_by_target_system_and_component():
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


def test_a_refusal_is_acknowledged_with_its_reason_as_text():
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
        (common.MAV_CMD_DO_FLIGHTTERMINATION, (1.0,), DENIED),  # not armed
        (common.MAV_CMD_MISSION_START, (NAN,), DENIED),
        (common.MAV_CMD_MISSION_START, (99.0,), DENIED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (4.0,), ACCEPTED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (5.0,), DENIED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (0.5,), DENIED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (2.0, 0.5), DENIED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (-1.0,), ACCEPTED),
        (common.MAV_CMD_DO_SET_MISSION_CURRENT, (-2.0,), DENIED),
        (common.MAV_CMD_LOGGING_START, (), UNSUPPORTED),
        (common.MAV_CMD_DO_CHANGE_SPEED, (2.0, 3.0), UNSUPPORTED),  # climb speed
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


def test_the_end_of_a_command_in_progress_is_acknowledged_once_and_then_from_memory():
    vehicle = Commanded()
    storage, in_progress = common.MAV_CMD_PREFLIGHT_STORAGE, common.MAV_RESULT_IN_PROGRESS
    assert vehicle.long(storage, 1.0)[0] == in_progress
    assert vehicle.long(storage, 1.0, confirmation=1)[0] == in_progress
    assert vehicle.service.finish(common.MAV_CMD_PREFLIGHT_CALIBRATION, ACCEPTED, 10) == []
    ((to, ack),) = vehicle.service.finish(storage, common.MAV_RESULT_FAILED, 10)
    assert to == CLIENT
    assert (ack.command, ack.result, ack.target_system, ack.target_component) == (
        storage, common.MAV_RESULT_FAILED, 255, 190,
    )  # fmt: skip
    assert vehicle.service.finish(storage, ACCEPTED, 20) == []
    assert vehicle.long(storage, 1.0, confirmation=2, now_us=20)[0] == common.MAV_RESULT_FAILED
    assert vehicle.long(storage, 1.0, confirmation=2, now_us=11 + REMEMBERED_US)[0] == in_progress


def test_the_number_of_commands_in_progress_is_bounded():
    vehicle = Commanded()
    for number in range(10 * REMEMBERED_MAX):
        vehicle.long(common.MAV_CMD_PREFLIGHT_STORAGE, 1.0, float(number))
    assert len(vehicle.service.finish(common.MAV_CMD_PREFLIGHT_STORAGE, ACCEPTED, 0)) == REMEMBERED_MAX


@pytest.mark.parametrize(("what", "reset"), [(2.0, {"MPC_XY_P", "CAL_MAG0_ROT"}), (3.0, {"CAL_MAG0_ROT"})])
def test_a_reset_restores_all_parameters_or_those_of_sensors(what, reset):
    vehicle = Commanded()
    parameters = vehicle.parameters
    changed = {"MPC_XY_P": 1.5, "CAL_MAG0_ROT": 2.0}
    before = {name: parameters.get(name) for name in changed}
    for name, value in changed.items():
        parameters.set(name, value)
    assert vehicle.long(common.MAV_CMD_PREFLIGHT_STORAGE, what)[0] == ACCEPTED
    assert {name for name in changed if parameters.get(name) == before[name]} == reset


def test_parameters_are_not_reset_while_armed():
    vehicle = Commanded()
    vehicle.parameters.set("MPC_XY_P", 1.5)
    assert vehicle.long(ARM, 1.0)[0] == ACCEPTED
    result, (text,) = vehicle.long(common.MAV_CMD_PREFLIGHT_STORAGE, 2.0)
    assert result == REFUSED
    assert text.text == "Parameter reset denied: armed"
    assert vehicle.parameters.get("MPC_XY_P") == 1.5


def test_offboard_is_requested_for_the_partner_before_the_mode_is_changed():
    vehicle = Commanded()
    vehicle.hold(EVERYTHING & ~Condition.SETPOINTS)
    assert vehicle.long(MODE, 1.0, 6.0, 0.0, now_us=5)[0] == REFUSED
    assert vehicle.done == [("ask_offboard", CLIENT, 5)]
    vehicle.hold(EVERYTHING)
    assert vehicle.long(MODE, 1.0, 6.0, 0.0, now_us=6)[0] == ACCEPTED
    assert vehicle.commander.mode is FlightMode.OFFBOARD


def test_set_mode_is_equivalent_to_do_set_mode_and_acknowledged_as_such():
    vehicle = Commanded()
    message = common.MAVLink_set_mode_message(
        1, common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, FlightMode.LAND.custom_mode
    )
    assert vehicle.send(message, MODE) == (ACCEPTED, [])
    assert vehicle.commander.mode is FlightMode.LAND
    assert vehicle.send(common.MAVLink_set_mode_message(1, 0, 0), MODE)[0] == DENIED
    assert vehicle.commander.mode is FlightMode.LAND


def test_a_mission_starts_at_an_item_and_only_if_there_is_one():
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
    assert vehicle.long(common.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)[0] == ACCEPTED  # already in Hold
    assert vehicle.long(common.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)[0] == ACCEPTED
    assert vehicle.commander.mode is FlightMode.MISSION
    assert vehicle.long(common.MAV_CMD_MISSION_START, -1.0)[0] == ACCEPTED
    assert vehicle.done == [("seq", 3)]  # continues at the current item


def test_a_mission_start_that_is_refused_leaves_the_current_item():
    vehicle = Commanded()
    assert vehicle.long(common.MAV_CMD_MISSION_START, 99.0)[0] == DENIED
    assert vehicle.commander.mode is not FlightMode.MISSION
    vehicle.commander.update(0, conditions=EVERYTHING & ~Condition.CHARGE, landed=True)
    assert vehicle.long(common.MAV_CMD_MISSION_START, 3.0)[0] == REFUSED  # arming is refused
    vehicle.hold(EVERYTHING)
    assert vehicle.long(ARM, 1.0)[0] == ACCEPTED
    vehicle.commander.update(0, conditions=EVERYTHING & ~Condition.POSITION, landed=False)
    assert vehicle.long(common.MAV_CMD_MISSION_START, 3.0)[0] == REFUSED  # the mode is refused
    assert vehicle.done == []
