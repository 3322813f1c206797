"""Commands with positions: take-off, positions in every frame, orbit and home."""

import pytest
from protocol_bench import HOME, NAN, TAKEOFF_HEIGHT_M, Commanded
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Reason
from autopilot.mavlink.modes import FlightMode

ACCEPTED, DENIED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_DENIED
REFUSED, UNSUPPORTED = common.MAV_RESULT_TEMPORARILY_REJECTED, common.MAV_RESULT_UNSUPPORTED
TAKE_OFF, MODE = common.MAV_CMD_NAV_TAKEOFF, common.MAV_CMD_DO_SET_MODE
REPOSITION, ORBIT, SET_HOME = (
    common.MAV_CMD_DO_REPOSITION,
    common.MAV_CMD_DO_ORBIT,
    common.MAV_CMD_DO_SET_HOME,
)
NOTHING_GIVEN = 2**31 - 1
RELATIVE = common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


# ---- take-off


@pytest.mark.parametrize(
    ("requested_m", "climbs_to_m", "is_reported"),
    [
        (NAN, None, False),
        (1e30, None, False),
        (490.5, 490.5, False),
        (5.0, HOME.alt_m + TAKEOFF_HEIGHT_M, True),  # five metres above sea level are below ground
        (HOME.alt_m + TAKEOFF_HEIGHT_M - 0.05, HOME.alt_m + TAKEOFF_HEIGHT_M, False),
    ],
)
def test_a_take_off_is_at_least_as_high_as_the_parameter(requested_m, climbs_to_m, is_reported):
    vehicle = Commanded()
    result, texts = vehicle.long(TAKE_OFF, 0, 0, 0, NAN, NAN, NAN, requested_m)
    assert result == ACCEPTED
    assert vehicle.commander.mode is FlightMode.TAKEOFF
    assert vehicle.altitude.amsl_m == climbs_to_m
    assert [text.text for text in texts] == ["Using minimum takeoff altitude: 2.50 m"] * is_reported
    assert vehicle.long(MODE, 1.0, 4.0, 2.0)[0] == ACCEPTED
    assert vehicle.altitude.amsl_m is None  # not kept for the next take-off


def test_a_take_off_altitude_is_interpreted_by_its_frame():
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
def test_a_take_off_altitude_in_another_frame_is_refused(frame):
    vehicle = Commanded()
    before = vehicle.commander.mode
    assert vehicle.int(TAKE_OFF, 0, 0, 0, NAN, frame=frame, z=10.0)[0] == UNSUPPORTED
    assert (vehicle.commander.mode, vehicle.altitude.amsl_m) == (before, None)


# ---- positions


def test_positions_are_converted_to_degrees_from_both_messages():
    vehicle = Commanded()
    params = (-1.0, 1.0, 0.0, 0.5)
    vehicle.int(REPOSITION, *params, x=471_234_567, y=-81_234_567, z=420.0)
    vehicle.long(REPOSITION, *params, 47.125, -8.125, 420.0)
    (_, *by_int), (_, *by_long) = vehicle.done
    assert by_int == pytest.approx([47.1234567, -8.1234567, 420.0, 0.5, None])
    assert by_long == [47.125, -8.125, 420.0, 0.5, None]


@pytest.mark.parametrize("nothing", [NOTHING_GIVEN, 0x7FF8_0000])
def test_values_that_are_not_given_are_none(nothing):
    vehicle = Commanded()
    vehicle.int(REPOSITION, 3.0, 1.0, 0.0, NAN, x=nothing, y=nothing, z=NAN)
    vehicle.long(REPOSITION, 3.0, 1.0, 0.0, NAN, NAN, NAN, NAN)
    assert vehicle.done == [("reposition", None, None, None, None, 3.0)] * 2


def test_altitudes_in_relative_frames_are_above_home():
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
def test_invalid_positions_are_refused(command, place, result):
    vehicle = Commanded()
    assert vehicle.int(command, 0.0, 1.0, **place)[0] == result
    assert not vehicle.done


def test_reposition_requires_its_flag_and_returns_the_pilots_reason():
    vehicle = Commanded()
    assert vehicle.long(REPOSITION, -1.0, 0.0, 0.0, NAN, 47.0, 8.0, 500.0)[0] == UNSUPPORTED
    assert vehicle.long(REPOSITION, -1.0, 3.0, 0.0, NAN, 47.0, 8.0, 500.0)[0] == UNSUPPORTED
    assert not vehicle.done
    vehicle.refusal = Reason.NO_POSITION
    result, (text,) = vehicle.long(REPOSITION, -1.0, 1.0, 0.0, NAN, 47.0, 8.0, 500.0)
    assert (result, text.text) == (REFUSED, "Reposition denied: no position estimate")


def test_a_position_outside_the_fence_is_accepted_and_reported_as_not_flown():
    vehicle = Commanded()
    vehicle.refusal = Reason.OUTSIDE_GEOFENCE
    result, (text,) = vehicle.long(REPOSITION, -1.0, 1.0, 0.0, NAN, 47.0, 8.0, 500.0)
    assert (result, text.text) == (ACCEPTED, "Reposition is outside geofence")


def test_altitude_orbit_speed_and_home_are_passed_to_the_pilot():
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
def test_orbit_and_home_are_above_sea_level_in_every_frame_as_from_mavsdk(home):
    vehicle = Commanded()
    vehicle.flight.home = home
    place = {"frame": common.MAV_FRAME_GLOBAL_RELATIVE_ALT, "x": 470_000_000, "y": 80_000_000, "z": 495.0}
    assert vehicle.int(ORBIT, 12.0, 2.0, 0.0, NAN, **place)[0] == ACCEPTED
    assert vehicle.int(SET_HOME, 0.0, **place)[0] == ACCEPTED
    assert [order[-1] for order in vehicle.done] == [495.0, 495.0]


def test_do_set_actuator_is_accepted_without_an_actuator():
    vehicle = Commanded()
    assert vehicle.long(common.MAV_CMD_DO_SET_ACTUATOR, 0.5, *[NAN] * 5, 0.0) == (ACCEPTED, [])
    assert not vehicle.done
