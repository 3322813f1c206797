"""ArduPilot's flight modes: numbers, names and PX4's counterparts, and the modes in records."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from autopilot.mavlink.ardupilot_modes import COPTER_MODES, GUIDED, counterpart, label_of
from autopilot.mavlink.modes import EXTERNAL_MODES, FlightMode
from autopilot.onboard.application import NO_APPLICATION
from harness.records.columns import flight_kind

FLIGHT = flight_kind(NO_APPLICATION)


def heartbeat(mode, autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA):
    return mavlink.MAVLink_heartbeat_message(2, autopilot, 1, mode, 4, 3)


def test_the_numbers_are_those_of_the_dialect():
    names = {
        entry: value.name.removeprefix("COPTER_MODE_").replace("_", "")
        for entry, value in mavlink.enums["COPTER_MODE"].items()
        if value.name != "COPTER_MODE_ENUM_END"
    }
    for number in names.keys() & COPTER_MODES.keys():
        assert COPTER_MODES[number].label.upper() == names[number]
    assert names[GUIDED] == "GUIDED"
    assert names.keys() <= COPTER_MODES.keys() | {8, 10}


@pytest.mark.parametrize("number", COPTER_MODES)
def test_each_mode_has_its_own_label_in_heartbeats_and_records(number):
    label = COPTER_MODES[number].label
    assert label_of(heartbeat(number)) == label
    assert FLIGHT.columns["mode"].values[str(number)] == label


def test_unknown_modes_have_no_label_and_no_counterpart():
    assert label_of(heartbeat(999)) == ""
    assert counterpart(999) is None
    assert counterpart(11) is None  # Drift


def test_a_number_is_read_by_the_kind_of_autopilot():
    offboard = FlightMode.OFFBOARD
    assert label_of(heartbeat(offboard.custom_mode, mavlink.MAV_AUTOPILOT_PX4)) == offboard.label
    assert label_of(heartbeat(offboard.custom_mode)) == ""
    assert label_of(heartbeat(GUIDED, mavlink.MAV_AUTOPILOT_PX4)) == ""


def test_no_number_is_both_a_mode_of_px4_and_of_ardupilot():
    assert not {mode.custom_mode for mode in FlightMode} & COPTER_MODES.keys()
    built_in = set(FlightMode) - {FlightMode.DESCEND, *EXTERNAL_MODES}  # the latter have the names of users
    assert {mode.custom_mode for mode in built_in} <= {int(value) for value in FLIGHT.columns["mode"].values}


def test_following_and_landing_have_counterparts():
    assert counterpart(GUIDED) is FlightMode.OFFBOARD
    assert counterpart(9) is FlightMode.LAND
    assert counterpart(6) is FlightMode.RETURN
    # no mode of ArduPilot but guided follows setpoints
    assert [number for number in COPTER_MODES if counterpart(number) is FlightMode.OFFBOARD] == [GUIDED]
