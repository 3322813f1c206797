"""A vehicle while simulated time is paused: it replies, executes commands, and does not accumulate data."""

import math

import pytest
from pymavlink.dialects.v20 import common
from vehicle_world import Flight, vehicle_config

from autopilot.mavlink.codec import stamp
from autopilot.mavlink.dialect import MissionCount
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.plan_store import PlanType
from autopilot.services.service import GROUND_STATION, Partner, reply

ME, OTHER = Partner(GROUND_STATION, 0), Partner(GROUND_STATION, 1)
NAN = math.nan
ACCEPTED, REFUSED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_TEMPORARILY_REJECTED
MODE = common.MAV_CMD_DO_SET_MODE
OFFBOARD, MISSION = (1.0, 6.0, 0.0), (1.0, 4.0, 4.0)


def command(number, *params):
    padded = [*params, *[0.0] * (7 - len(params))]
    return common.MAVLink_command_long_message(1, 1, number, 0, *padded)


def serve_while_paused(vehicle, *messages, partner=ME):
    """Return the replies to messages in a pause, without those for other partners."""
    answers = vehicle.serve_while_paused(
        reply(partner, *(stamp(m, system=255, component=190) for m in messages))
    )
    return [message for to, message in answers if to in {partner, Partner(partner.link)}]


def results(answers):
    return [message.result for message in answers if message.get_type() == "COMMAND_ACK"]


def here_e7(flight):
    state = flight.vehicle.flight.state
    return round(state.origin_lat_deg * 1e7), round(state.origin_lon_deg * 1e7)


def waypoints(flight, number):
    lat_e7, lon_e7 = here_e7(flight)
    return [
        common.MAVLink_mission_item_int_message(
            1, 1, seq, common.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, common.MAV_CMD_NAV_WAYPOINT, 0, 1,
            0.0, 0.0, 0.0, NAN, lat_e7 + 1_000 * (seq + 1), lon_e7, 8.0,
        )
        for seq in range(number)
    ]  # fmt: skip


def setpoint(down_m):
    return common.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, common.MAV_FRAME_LOCAL_NED, 0b1101_1111_1000, 0.0, 0.0, down_m, *[0.0] * 8
    )


@pytest.mark.parametrize("together", [False, True])
def test_offboard_can_be_entered_in_a_pause(together):
    with Flight(vehicle_config()) as flight:
        flight.take_off(4.0)
        vehicle = flight.vehicle
        assert results(serve_while_paused(vehicle, command(MODE, *OFFBOARD))) == [REFUSED]
        if together:  # the setpoint may be anywhere in the step
            answers = serve_while_paused(vehicle, command(MODE, *OFFBOARD), setpoint(-6.0))
        else:
            assert serve_while_paused(vehicle, setpoint(-6.0)) == []
            answers = serve_while_paused(vehicle, command(MODE, *OFFBOARD))
        assert results(answers) == [ACCEPTED]
        assert vehicle.commander.mode is FlightMode.OFFBOARD
        flight.step()
        assert vehicle.commander.mode is FlightMode.OFFBOARD
        assert vehicle.flight.setpoint.pos_ned_m[2] == -6.0


def test_a_mission_can_be_uploaded_and_started_in_a_pause():
    with Flight(vehicle_config()) as flight:
        flight.take_off(5.0)
        vehicle = flight.vehicle
        assert results(serve_while_paused(vehicle, command(MODE, *MISSION))) == [REFUSED]
        answers = serve_while_paused(vehicle, MissionCount(1, 1, 2, 0))
        for item in waypoints(flight, 2):
            assert answers[-1].get_type() == "MISSION_REQUEST_INT"
            answers = serve_while_paused(vehicle, item)
        assert answers[-1].type == common.MAV_MISSION_ACCEPTED
        assert results(serve_while_paused(vehicle, command(common.MAV_CMD_MISSION_START, -1.0))) == [ACCEPTED]
        assert vehicle.commander.mode is FlightMode.MISSION
        begin_m = float(vehicle.flight.state.pos_ned_m[0])
        flight.run(3.0)
        assert vehicle.commander.mode is FlightMode.MISSION
        assert vehicle.flight.state.pos_ned_m[0] > begin_m + 1.0
        serve_while_paused(vehicle, common.MAVLink_mission_clear_all_message(1, 1, 0))
        serve_while_paused(vehicle)
        assert vehicle.commander.mode is FlightMode.HOLD  # without a mission it holds


def test_in_a_pause_an_upload_is_replaced_only_if_its_station_is_silent():
    with Flight(vehicle_config()) as flight:
        flight.take_off(5.0)
        vehicle, items = flight.vehicle, waypoints(flight, 3)
        begin = MissionCount(1, 1, 3, 0)
        requested = [answer.seq for answer in serve_while_paused(vehicle, begin)]
        for item in items[:2]:  # every message of its station keeps the transfer alive
            (refused,) = serve_while_paused(vehicle, begin, partner=OTHER)
            assert refused.type == common.MAV_MISSION_ERROR
            requested += [answer.seq for answer in serve_while_paused(vehicle, item)]
        assert requested == [0, 1, 2]
        serve_while_paused(vehicle, begin, partner=OTHER)
        (answer,) = serve_while_paused(vehicle, begin, partner=OTHER)
        assert (answer.get_type(), answer.seq) == ("MISSION_REQUEST_INT", 0)
        for item in items:
            (answer,) = serve_while_paused(vehicle, item, partner=OTHER)
        assert answer.type == common.MAV_MISSION_ACCEPTED
        assert len(vehicle.messaging.plans[PlanType.MISSION].items) == 3


def test_a_station_can_restart_its_upload_in_a_pause():
    with Flight(vehicle_config()) as flight:
        flight.run(1.0)
        begin = MissionCount(1, 1, 3, 0)
        serve_while_paused(flight.vehicle, begin)
        serve_while_paused(flight.vehicle, waypoints(flight, 1)[0])
        (answer,) = serve_while_paused(flight.vehicle, begin)
        assert (answer.get_type(), answer.seq) == ("MISSION_REQUEST_INT", 0)


def test_parameters_changed_in_a_pause_are_reported_once_and_in_batches():
    with Flight(vehicle_config()) as flight:
        flight.run(0.1)
        changed = common.MAVLink_param_ext_set_message(
            1, 1, b"MPC_XY_P", b"\0\0\x80\x3f".ljust(128, b"\0"), common.MAV_PARAM_EXT_TYPE_REAL32
        )
        for _ in range(100):
            serve_while_paused(flight.vehicle, changed)
        values = [a for a in flight.step().links if a.message.get_type() == "PARAM_VALUE"]
        assert [a.partner.link for a in values] == [0, 1]
        values = [a for a in flight.step().links if a.message.get_type() == "PARAM_VALUE"]
        assert values == []
