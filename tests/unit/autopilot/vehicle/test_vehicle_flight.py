"""The whole vehicle with the real physics and sensors: timelines of received messages."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from vehicle_world import STEP_US, Flight, vehicle_config

from autopilot.logs.vehicle_record import VEHICLE_RECORD, record
from autopilot.mavlink.codec import Encoder, Parser, stamp
from autopilot.mavlink.modes import FlightMode
from autopilot.onboard.application import Estimate
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.parameters.config import VehicleConfig
from autopilot.parameters.onboard_config import OnboardConfig
from autopilot.parameters.table import ParameterError
from autopilot.services.service import COMPANION, GROUND_STATION, Addressed, Partner
from autopilot.vehicle.vehicle import DECISION_PERIOD_US, Vehicle

NAN = math.nan
ACCEPTED = common.MAV_RESULT_ACCEPTED
REFUSED = common.MAV_RESULT_TEMPORARILY_REJECTED
ARM = common.MAV_CMD_COMPONENT_ARM_DISARM
MODE = common.MAV_CMD_DO_SET_MODE
TAKE_OFF = common.MAV_CMD_NAV_TAKEOFF
LAND = common.MAV_CMD_NAV_LAND
POSITION_ONLY = 0b1101_1111_1000


@pytest.fixture
def flight():
    with Flight(vehicle_config()) as flight:
        yield flight


def make_ready(flight):
    commander = flight.vehicle.commander
    assert flight.run(20.0, until=lambda: commander.arm(flight.now_us) is None)
    commander.disarm()


def take_off(flight, height_m=2.5):
    make_ready(flight)
    assert flight.command(ARM, 1.0) == ACCEPTED
    altitude_m = flight.vehicle.flight.state.origin_alt_m + height_m
    assert flight.command(TAKE_OFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, altitude_m) == ACCEPTED
    hold = flight.run(20.0, until=lambda: flight.vehicle.commander.mode is FlightMode.HOLD)
    assert hold


def position(north_m, east_m, down_m):
    return common.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, common.MAV_FRAME_LOCAL_NED, POSITION_ONLY, north_m, east_m, down_m, *[0.0] * 8
    )


def sensor(time_us, number=0):
    return common.MAVLink_hil_sensor_message(
        time_us, 0.0, 0.0, -9.81, 0.0, 0.0, 0.0, 0.2, 0.0, 0.4, 955.98, 0.0, 488.0, 15.0, 0x1FFF, number
    )


def test_every_sensor_message_is_answered_once_with_its_time_and_no_thrust():
    vehicle = Vehicle(vehicle_config())
    for time_us in (4_000, 8_000, 12_000, 20_000):
        actuators = vehicle.step(sim_messages=[sensor(time_us)]).actuators
        assert (actuators.time_usec, actuators.flags, actuators.mode) == (time_us, 1, 1)
        assert actuators.controls == [0.0] * 16


def test_the_first_step_sends_px4s_request_to_the_simulator():
    vehicle = Vehicle(vehicle_config())
    interval, heartbeat = vehicle.step(sim_messages=[sensor(4_000)]).simulator
    assert (interval.command, interval.param1, interval.param2) == (511, 115.0, -1.0)
    assert (heartbeat.get_type(), heartbeat.autopilot, heartbeat.base_mode) == ("HEARTBEAT", 12, 29)
    later = [vehicle.step(sim_messages=[sensor(t)]).simulator for t in range(8_000, 2_008_000, 4_000)]
    assert sum(map(len, later)) == 2


def test_only_the_first_sensor_is_used():
    vehicle = Vehicle(vehicle_config())
    vehicle.step(sim_messages=[sensor(4_000)])
    output = vehicle.step(sim_messages=[sensor(7_000, number=1), sensor(8_000)])
    assert output.now_us == 8_000
    assert vehicle.flight.sensor.time_usec == 8_000


def test_a_sensor_message_that_is_not_later_changes_nothing_and_is_answered():
    vehicle = Vehicle(vehicle_config())
    vehicle.step(sim_messages=[sensor(8_000)])
    for time_us in (8_000, 4_000):
        output = vehicle.step(sim_messages=[sensor(time_us)])
        assert output.actuators.time_usec == time_us
        assert (output.links, output.simulator) == ([], [])
        assert vehicle.flight.now_us == 8_000


def test_arming_is_refused_with_the_reason_until_the_estimator_is_ready(flight):
    assert flight.command(ARM, 1.0) == REFUSED
    assert flight.texts() == ["Arming denied: no barometer data"] or flight.texts()[0].startswith(
        "Arming denied: no"
    )
    assert not flight.vehicle.commander.armed
    make_ready(flight)
    assert flight.command(ARM, 1.0) == ACCEPTED


def test_without_gps_there_is_no_arming():
    with Flight(vehicle_config(), gps=False) as flight:
        flight.run(5.0)
        assert flight.command(ARM, 1.0) == REFUSED
        assert flight.texts() == ["Arming denied: no GPS fix"]


def test_take_off_hold_land_and_disarm(flight):
    take_off(flight)
    vehicle = flight.vehicle
    flight.run(3.0)
    held_m = vehicle.flight.state.pos_ned_m[2]
    assert held_m == pytest.approx(-2.5, abs=0.15)
    assert flight.height_m == pytest.approx(2.5, abs=0.5)  # includes the barometer's initial error
    assert flight.command(ARM, 0.0) == REFUSED
    assert flight.command(LAND) == ACCEPTED
    assert flight.run(20.0, until=lambda: vehicle.commander.landed)
    assert flight.height_m == pytest.approx(0.0, abs=0.02)
    landed_us = flight.now_us
    assert flight.run(5.0, until=lambda: not vehicle.commander.armed)
    assert flight.now_us - landed_us == pytest.approx(2_000_000, abs=DECISION_PERIOD_US)  # COM_DISARM_LAND
    assert flight.step().actuators.controls == [0.0] * 16
    assert [mode for _, mode, _ in flight.modes] == ["Hold", "Hold", "Takeoff", "Hold", "Land", "Hold"]
    assert [armed for _, _, armed in flight.modes] == [False, True, True, True, True, False]
    assert flight.texts() == [
        "Takeoff detected",
        "Disarming denied: not landed",
        "Landing detected",
        "Disarmed by landing",
    ]
    # and again: the first flight leaves no state that prevents the second
    assert flight.command(ARM, 1.0) == ACCEPTED


def test_motors_wait_for_the_spool_up(flight):
    #  0 s armed, take-off requested ..... 1 s (COM_SPOOLUP_TIME) thrust begins to rise
    make_ready(flight)
    assert flight.command(ARM, 1.0) == ACCEPTED
    armed_us = flight.now_us
    assert flight.command(TAKE_OFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, NAN) == ACCEPTED
    while flight.now_us < armed_us + 1_000_000 - STEP_US:
        assert flight.step().actuators.controls == [0.0] * 16
    flight.run(0.5)
    assert min(flight.vehicle.flight.motors()) > 0.0


def test_armed_without_further_commands_it_stays_on_the_ground_and_disarms(flight):
    make_ready(flight)
    assert flight.command(ARM, 1.0) == ACCEPTED
    armed_us = flight.now_us
    assert flight.run(12.0, until=lambda: not flight.vehicle.commander.armed)
    assert flight.now_us - armed_us == pytest.approx(10_000_000, abs=DECISION_PERIOD_US)  # COM_DISARM_PRFLT
    assert flight.height_m == pytest.approx(0.0, abs=0.01)
    assert flight.texts() == ["Disarmed: no takeoff"]


def test_offboard_follows_its_setpoints_and_holds_when_they_stop(flight):
    take_off(flight)
    vehicle = flight.vehicle
    assert flight.command(MODE, 1.0, 6.0, 0.0) == REFUSED  # no setpoints yet
    target = np.array([3.0, 2.0, -4.0])
    flight.send(position(*target))
    flight.step()
    assert flight.command(MODE, 1.0, 6.0, 0.0) == ACCEPTED
    for _ in range(160):
        flight.send(position(*target))
        flight.run(0.05)
    assert vehicle.commander.mode is FlightMode.OFFBOARD
    assert np.abs(vehicle.flight.state.pos_ned_m - target).max() < 0.25
    last_us = flight.now_us - round(0.05 * 1e6) + STEP_US  # the step that received the last setpoint
    assert flight.run(3.0, until=lambda: vehicle.commander.mode is FlightMode.HOLD)
    late_us = flight.now_us - last_us - 1_000_000  # COM_OF_LOSS_T
    assert late_us == pytest.approx(0, abs=DECISION_PERIOD_US + STEP_US)
    assert flight.texts()[-1] == "Failsafe: no offboard setpoints, Hold"
    flight.run(2.0)
    assert np.abs(vehicle.flight.state.pos_ned_m - target).max() < 0.4


def test_without_gps_in_flight_it_descends_and_disarms(flight):
    take_off(flight)
    flight.gps = False
    assert flight.run(20.0, until=lambda: flight.vehicle.commander.mode is FlightMode.DESCEND)
    assert flight.run(30.0, until=lambda: not flight.vehicle.commander.armed)
    assert flight.height_m == pytest.approx(0.0, abs=0.05)
    assert (
        float(flight.world.truth.q_ned_frd[0, 0]) ** 2 + float(flight.world.truth.q_ned_frd[0, 3]) ** 2 > 0.99
    )


def test_all_telemetry_in_flight_can_be_packed_and_has_its_rate(flight):
    take_off(flight)
    encoder, parser, counts = Encoder(system=1, component=1), Parser(), {GROUND_STATION: {}, COMPANION: {}}
    for _ in range(500):
        for (link, _), message in flight.step(streams=True).links:
            (decoded,) = parser.push(encoder.encode(message))
            counts[link][decoded.get_type()] = counts[link].get(decoded.get_type(), 0) + 1
    ground, companion = counts[GROUND_STATION], counts[COMPANION]
    expected = {
        "ATTITUDE": 100,
        "LOCAL_POSITION_NED": 100,
        "GLOBAL_POSITION_INT": 100,
        "GPS_RAW_INT": 10,
        "HEARTBEAT": 2,
    }
    assert {name: ground[name] for name in expected} == pytest.approx(expected, abs=1)
    expected = {
        "ATTITUDE": 200,
        "LOCAL_POSITION_NED": 60,
        "ODOMETRY": 60,
        "HIGHRES_IMU": 100,
        "GPS_GLOBAL_ORIGIN": 2,
    }
    assert {name: companion[name] for name in expected} == pytest.approx(expected, abs=1)


def test_a_new_take_off_altitude_acts_immediately(flight):
    take_off(flight, 2.5)
    altitude_m = flight.vehicle.flight.state.origin_alt_m + 6.0
    assert flight.command(TAKE_OFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, altitude_m - 2.0) == ACCEPTED
    flight.run(0.5)
    assert flight.command(TAKE_OFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, altitude_m) == ACCEPTED
    flight.run(8.0)
    assert flight.vehicle.flight.state.pos_ned_m[2] == pytest.approx(-6.0, abs=0.2)


def test_messages_with_random_contents_neither_raise_nor_start_anything():
    rng = np.random.default_rng(8)
    vehicle, parser = Vehicle(vehicle_config(onboard=True)), Parser()
    ids = [11, 20, 21, 23, 75, 76, 84, 0, 77, 111]
    for step in range(1, 600):
        sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
        messages = []
        for message_id in ids:
            kind = common.mavlink_map[message_id]
            payload = rng.bytes(kind.unpacker.size)
            # a valid checksum, random content
            frame = common.MAVLink_message(message_id, kind.msgname)._pack(sender, kind.crc_extra, payload)
            messages += parser.push_datagram(frame)
        for message in messages:
            if hasattr(message, "target_system"):
                message.target_system, message.target_component = 1, int(rng.integers(0, 2)) * 191
        output = vehicle.step(
            sim_messages=[sensor(4_000 * step)],
            link_messages=[Addressed(Partner(step % 2, 0), m) for m in messages],
        )
        assert output.actuators.controls == [0.0] * 16
    assert parser.bad_bytes == 0
    assert not vehicle.commander.armed


def test_messages_for_other_systems_are_ignored(flight):
    make_ready(flight)
    flight.send(common.MAVLink_command_long_message(2, 1, ARM, 0, 1.0, *[0.0] * 6))
    flight.step()
    assert not flight.vehicle.commander.armed
    assert flight.received == []


def test_messages_of_stations_do_not_reach_the_application_as_the_autopilots():
    vehicle = Vehicle(vehicle_config(onboard=True))
    vehicle.step(sim_messages=[sensor(4_000)])
    taken, vehicle.app.on_mavlink = [], lambda message, _: taken.append(message.get_type())
    answered, vehicle.app.on_request = [], lambda message: answered.append(message.get_type()) or []
    sent = [
        common.MAVLink_command_ack_message(ARM, ACCEPTED, 0, 0, 1, 191),
        common.MAVLink_command_long_message(1, 191, common.MAV_CMD_USER_1, 0, *[0.0] * 7),
    ]
    messages = [Addressed(Partner(GROUND_STATION, 0), stamp(m, system=255, component=190)) for m in sent]
    vehicle.step(sim_messages=[sensor(8_000)], link_messages=messages)
    assert (taken, answered) == ([], ["COMMAND_ACK", "COMMAND_LONG"])


def test_an_invalid_parameter_raises_when_the_vehicle_is_created():
    with pytest.raises(ParameterError, match="there is no parameter 'MPC_NOPE'"):
        Vehicle(vehicle_config(params={"MPC_NOPE": 1.0}))


def test_the_record_is_in_the_sites_frame(flight):
    take_off(flight)
    row = np.frombuffer(record(flight.vehicle), dtype=VEHICLE_RECORD)[0]
    state = flight.vehicle.flight.state
    truth = flight.world.truth.pos_ned_m[0]
    assert row["time_us"] == flight.now_us
    assert row["mode"] == FlightMode.HOLD.custom_mode
    assert row["armed"]
    assert row["phase"] == 255
    # the GPS bias of some metres is in both, the path from the origin in neither
    assert np.abs(row["estimator_pos_ned_m"][:2] - row["gps_pos_ned_m"][:2]).max() < 1.5
    assert np.abs(row["gps_pos_ned_m"] - truth).max() < 12.0
    assert row["estimator_pos_ned_m"][2] == state.pos_ned_m[2]
    assert np.isnan(row["onboard_pos_ned_m"]).all()


def test_the_applications_estimate_is_recorded_for_the_records_time(flight):
    """Not that of its last loop: records may be more frequent."""
    take_off(flight)

    def estimate(now_us):
        return Estimate((now_us, 0.0, 0.0), *[(0.0, 0.0, 0.0)] * 3)

    flight.vehicle.app = SimpleNamespace(phase=FlightPhase.ON_STATION, estimate=estimate, values=())
    row = np.frombuffer(record(flight.vehicle), dtype=VEHICLE_RECORD)[0]
    assert row["onboard_pos_ned_m"][0] == row["time_us"] == flight.now_us


def test_before_the_origin_the_record_has_no_position():
    vehicle = Vehicle(vehicle_config())
    vehicle.step(sim_messages=[sensor(4_000)])
    row = np.frombuffer(record(vehicle), dtype=VEHICLE_RECORD)[0]
    for name in ("estimator_pos_ned_m", "gps_pos_ned_m", "setpoint_pos_ned_m"):
        assert np.isnan(row[name]).all()


def test_the_onboard_application_flies_to_its_position_by_mavlink_only():
    config = VehicleConfig(
        run_id="test",
        instance=0,
        seed=7,
        places_ned_m=((0.0, 0.0, -5.0),),
        onboard=OnboardConfig(localisation="gps"),
    )
    with Flight(config) as flight:
        phases = []

        def on_station():
            phases.append(flight.vehicle.app.phase.name)
            return phases[-1] == "ON_STATION"

        assert flight.run(60.0, until=on_station)
        assert flight.vehicle.commander.mode is FlightMode.OFFBOARD
        assert flight.vehicle.flight.state.pos_ned_m[2] == pytest.approx(-5.0, abs=0.7)
        heartbeats = [
            message
            for _ in range(300)
            for message in flight.step().simulator
            if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 191
        ]
        assert {m.custom_mode for m in heartbeats} == {int(flight.vehicle.app.phase)}
        assert len(heartbeats) in {1, 2}


def test_the_disturbance_observer_starts_the_flight_with_the_actual_thrust(flight):
    make_ready(flight)
    assert flight.command(ARM, 1.0) == ACCEPTED
    altitude_m = flight.vehicle.flight.state.origin_alt_m + 2.5
    assert flight.command(TAKE_OFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, altitude_m) == ACCEPTED
    controller = flight.vehicle.pilot.controller
    assert flight.run(10.0, until=lambda: bool(controller.disturbance_ned_m_s2.any()))
    pushes_m_s2 = []
    for _ in range(50):
        flight.run(STEP_US * 1e-6)
        pushes_m_s2.append(float(controller.disturbance_ned_m_s2[2]))
    # in calm air the estimate is zero: a motor model that starts from rest would give -1.1
    assert min(pushes_m_s2) > -0.3
