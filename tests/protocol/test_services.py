"""The services as machines: messages and times in, messages out."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander
from autopilot.commander.conditions import Condition
from autopilot.commander.params import CommanderParams
from autopilot.estimation.estimator import Estimator
from autopilot.estimation.params import EstimatorParams
from autopilot.mavlink.codec import Encoder, Parser, stamp
from autopilot.mavlink.modes import FlightMode
from autopilot.params import TABLE, ParameterSet, Settings
from autopilot.protocol.command import CommandService, TakeoffAltitude
from autopilot.protocol.flight_data import FlightData
from autopilot.protocol.offboard import OffboardService
from autopilot.protocol.parameter import LIST_PERIOD_US, ParameterService
from autopilot.protocol.service import Partner, is_addressed_to
from autopilot.protocol.streams import COMPANION_HZ, GROUND_STATION_HZ, ON_NEW_DATA, Streams
from autopilot.protocol.telemetry import Telemetry

NAN = math.nan
ALL = sum(Condition)
STEP = 4_000
ASKER = Partner(0, 3)


def make_flight():
    estimator = Estimator(EstimatorParams())
    return FlightData(
        estimator=estimator, commander=Commander(CommanderParams()), state=estimator.state, conditions=ALL
    )


def count_streams(streams, duration_us, *, on_step=lambda _: None):
    counts = {}
    for now_us in range(0, duration_us, STEP):
        on_step(now_us)
        for message in streams.on_timer(now_us):
            counts[message.get_msgId()] = counts.get(message.get_msgId(), 0) + 1
    return counts


def dummy_builders(rates_hz):
    """Builders that all speak, so that the schedule alone decides."""

    def make(message_id):
        def build():
            message = common.MAVLink_system_time_message(0, 0)
            message.get_msgId = lambda: message_id
            return message

        return build

    return {message_id: make(message_id) for message_id in rates_hz}


# ---- streams


@pytest.mark.parametrize("rates_hz", [GROUND_STATION_HZ, COMPANION_HZ])
def test_every_stream_has_its_rate_on_the_4_ms_grid(rates_hz):
    streams = Streams(dummy_builders(rates_hz), rates_hz)
    counts = count_streams(
        streams, 10_000_000, on_step=lambda _: [streams.on_new_data(message_id) for message_id in ON_NEW_DATA]
    )
    for message_id, rate_hz in rates_hz.items():
        assert counts[message_id] == pytest.approx(10 * rate_hz, abs=1), message_id


def test_new_data_is_sent_once_and_never_above_the_rate():
    gps = common.MAVLINK_MSG_ID_GPS_RAW_INT
    streams = Streams(dummy_builders(COMPANION_HZ), COMPANION_HZ)

    def fixes(every_us):
        return lambda now_us: now_us % every_us or streams.on_new_data(gps)

    assert gps not in count_streams(streams, 1_000_000)
    assert count_streams(streams, 10_000_000, on_step=fixes(200_000))[gps] == 50
    streams = Streams(dummy_builders(COMPANION_HZ), COMPANION_HZ)
    assert count_streams(streams, 10_000_000, on_step=fixes(20_000))[gps] == pytest.approx(100, abs=1)


def test_for_nobody_only_the_heartbeat_is_formed():
    streams = Streams(dummy_builders(GROUND_STATION_HZ), GROUND_STATION_HZ)
    streams.active = False
    assert count_streams(streams, 3_000_000) == {common.MAVLINK_MSG_ID_HEARTBEAT: 3}
    streams.active = True  # what was not sent is not sent after
    assert count_streams(streams, 1_000_000)[common.MAVLINK_MSG_ID_ATTITUDE] <= 50


def test_the_deadline_says_when_the_next_message_comes():
    streams = Streams(dummy_builders(COMPANION_HZ), COMPANION_HZ)
    now_us = 0
    for _ in range(200):
        assert streams.on_timer(now_us)
        assert streams.next_deadline_us() > now_us
        assert streams.on_timer(streams.next_deadline_us() - 1) == ()
        now_us = streams.next_deadline_us()


def test_intervals_can_be_set_stopped_and_restored():
    attitude = common.MAVLINK_MSG_ID_ATTITUDE
    streams = Streams(dummy_builders(COMPANION_HZ), COMPANION_HZ)
    assert streams.set_interval(attitude, 500_000, 0)
    assert count_streams(streams, 1_000_000)[attitude] == 2
    assert streams.set_interval(attitude, -1, 0)
    assert attitude not in count_streams(streams, 1_000_000)
    assert streams.set_interval(attitude, 0, 0)
    assert count_streams(streams, 1_000_000)[attitude] == pytest.approx(100, abs=1)
    assert not streams.set_interval(12_345, 1_000, 0)


def test_before_the_estimator_knows_anything_every_builder_keeps_silent_or_can_be_packed():
    encoder = Encoder(system=1, component=1)
    for message_id, build in Telemetry(make_flight(), system=1).builders.items():
        message = build()
        if message is not None:
            (decoded,) = Parser().push(encoder.encode(message))
            assert decoded.get_msgId() == message_id


# ---- commands


class Commanded:
    def __init__(self):
        self.flight = make_flight()
        self.commander = self.flight.commander
        self.altitude = TakeoffAltitude()
        rates = {common.MAVLINK_MSG_ID_HEARTBEAT: 1.0}
        self.streams = Streams(Telemetry(self.flight, system=1).builders, rates)
        self.service = CommandService(self.commander, self.altitude, {0: self.streams})
        self.hold(ALL)

    def hold(self, conditions, *, landed=True):
        self.commander.update(0, conditions=conditions, landed=landed)

    def long(self, command, *params):
        message = common.MAVLink_command_long_message(1, 1, command, 0, *params, *[0.0] * (7 - len(params)))
        answers = self.service.on_message(stamp(message, system=255, component=190), 0, ASKER)
        (ack, *others) = [message for _, message in answers]
        assert answers[0].partner == ASKER
        assert ack.get_type() == "COMMAND_ACK"
        assert (ack.command, ack.target_system, ack.target_component) == (command, 255, 190)
        return ack.result, others


def test_a_refusal_is_acknowledged_with_its_reason_in_words():
    vehicle = Commanded()
    vehicle.hold(0)
    result, (text,) = vehicle.long(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    assert result == common.MAV_RESULT_TEMPORARILY_REJECTED
    assert text.text == "Arming denied: no inertial data"
    vehicle.hold(ALL)
    assert vehicle.long(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == (common.MAV_RESULT_ACCEPTED, [])
    assert vehicle.long(common.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)[0] == common.MAV_RESULT_ACCEPTED
    vehicle.hold(ALL, landed=False)
    result, (text,) = vehicle.long(common.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    assert result == common.MAV_RESULT_TEMPORARILY_REJECTED
    assert text.text == "Disarming denied: not landed"
    assert vehicle.long(common.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0)[0] == common.MAV_RESULT_ACCEPTED


@pytest.mark.parametrize(
    ("command", "params", "result"),
    [
        (common.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 3.0), common.MAV_RESULT_ACCEPTED),
        (common.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 5.0), common.MAV_RESULT_ACCEPTED),
        (common.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 1.0), common.MAV_RESULT_DENIED),
        (common.MAV_CMD_DO_SET_MODE, (0.0, 4.0, 3.0), common.MAV_RESULT_DENIED),
        (common.MAV_CMD_DO_SET_MODE, (NAN, NAN, NAN), common.MAV_RESULT_DENIED),
        (common.MAV_CMD_COMPONENT_ARM_DISARM, (NAN,), common.MAV_RESULT_DENIED),
        (common.MAV_CMD_NAV_LAND, (), common.MAV_RESULT_ACCEPTED),
        (common.MAV_CMD_REQUEST_MESSAGE, (148.0,), common.MAV_RESULT_ACCEPTED),
        (common.MAV_CMD_REQUEST_MESSAGE, (242.0,), common.MAV_RESULT_TEMPORARILY_REJECTED),
        (common.MAV_CMD_REQUEST_MESSAGE, (NAN,), common.MAV_RESULT_UNSUPPORTED),
        (common.MAV_CMD_SET_MESSAGE_INTERVAL, (30.0, 1e4), common.MAV_RESULT_ACCEPTED),
        (common.MAV_CMD_SET_MESSAGE_INTERVAL, (30.0, math.inf), common.MAV_RESULT_DENIED),
        (common.MAV_CMD_PREFLIGHT_CALIBRATION, (), common.MAV_RESULT_UNSUPPORTED),
    ],
)
def test_results(command, params, result):
    assert Commanded().long(command, *params)[0] == result


@pytest.mark.parametrize(("param7", "altitude_m"), [(NAN, None), (490.5, 490.5)])
def test_take_off_takes_an_altitude_or_leaves_it_to_the_parameter(param7, altitude_m):
    vehicle = Commanded()
    assert vehicle.long(common.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, NAN, NAN, NAN, param7)[0] == 0
    assert vehicle.commander.mode is FlightMode.TAKEOFF
    assert vehicle.altitude.amsl_m == altitude_m
    assert vehicle.long(common.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 2.0)[0] == 0
    assert vehicle.altitude.amsl_m is None  # the next take-off is not bound by the last one's


def test_command_int_and_set_mode_do_the_same():
    vehicle = Commanded()
    message = common.MAVLink_command_int_message(1, 1, 0, 22, 0, 0, 0.0, 0.0, 0.0, NAN, 0, 0, 500.0)
    ((_, ack),) = vehicle.service.on_message(message, 0, ASKER)
    assert (ack.result, vehicle.altitude.amsl_m) == (common.MAV_RESULT_ACCEPTED, 500.0)
    set_mode = common.MAVLink_set_mode_message(1, 1, FlightMode.LAND.custom_mode)
    assert not vehicle.service.on_message(set_mode, 0, ASKER)
    assert vehicle.commander.mode is FlightMode.LAND


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


# ---- offboard


def setpoint(mask, *, frame=common.MAV_FRAME_LOCAL_NED, **values):
    fields = (
        dict.fromkeys(("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate"), NAN) | values
    )
    return common.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, **fields)


POSITION_ONLY = 0b1101_1111_1000
VELOCITY_ONLY = 0b1101_1100_0111


def test_masks_choose_groups_axes_and_yaw():
    service = OffboardService(make_flight())
    service.on_message(setpoint(POSITION_ONLY, x=1.0, y=2.0, z=-3.0), 7, ASKER)
    assert service.received_us == 7
    assert service.setpoint.pos_ned_m.tolist() == [1.0, 2.0, -3.0]
    assert (service.setpoint.vel_ned_m_s, service.setpoint.acc_ned_m_s2, service.setpoint.yaw_rad) == (
        None,
    ) * 3
    # position of north and east, speed of down, with a yaw
    service.on_message(setpoint(0b1001_1101_1100, x=1.0, y=2.0, vz=0.5, yaw=0.1), 8, ASKER)
    assert service.setpoint.pos_axes == (True, True, False)
    assert service.setpoint.vel_axes == (False, False, True)
    assert service.setpoint.vel_ned_m_s[2] == 0.5
    assert service.setpoint.yaw_rad == 0.1


def test_body_frame_velocities_turn_with_the_heading():
    flight = make_flight()
    flight.state.q_ned_frd[:] = (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4))  # heading east
    service = OffboardService(flight)
    message = setpoint(VELOCITY_ONLY, frame=common.MAV_FRAME_BODY_NED, vx=2.0, vy=1.0, vz=0.5)
    service.on_message(message, 0, ASKER)
    assert np.allclose(service.setpoint.vel_ned_m_s, (-1.0, 2.0, 0.5))


@pytest.mark.parametrize(
    "message",
    [
        setpoint(0b1101_1111_1111),
        setpoint(POSITION_ONLY, x=1.0, y=NAN, z=0.0),
        setpoint(POSITION_ONLY & ~common.POSITION_TARGET_TYPEMASK_YAW_IGNORE, x=0.0, y=0.0, z=0.0),
        setpoint(POSITION_ONLY, frame=common.MAV_FRAME_BODY_NED, x=0.0, y=0.0, z=0.0),
        setpoint(VELOCITY_ONLY, frame=common.MAV_FRAME_GLOBAL, vx=0.0, vy=0.0, vz=0.0),
        setpoint(VELOCITY_ONLY | common.POSITION_TARGET_TYPEMASK_FORCE_SET, vx=0.0, vy=0.0, vz=0.0),
    ],
)
def test_a_setpoint_without_sense_keeps_nothing_alive(message):
    service = OffboardService(make_flight())
    assert service.on_message(message, 5, ASKER) == ()
    assert (service.setpoint, service.rejected) == (None, 1)
    assert not service.is_fresh(5, 1_000_000)


def test_freshness_ends_with_the_timeout():
    service = OffboardService(make_flight())
    service.on_message(setpoint(POSITION_ONLY, x=0.0, y=0.0, z=0.0), 1_000, ASKER)
    assert service.is_fresh(501_000, 500_000)
    assert not service.is_fresh(501_001, 500_000)


# ---- parameters


def lossy_list(seed, loss):
    """List the parameters, then ask for what is missing, over a link that drops messages both ways."""
    rng = np.random.default_rng(seed)
    parameters = ParameterSet(Settings())
    service = ParameterService(parameters.get, parameters.set)
    got, now_us = {}, 0

    def through(messages):
        return [m for m in messages if rng.uniform() >= loss]

    def hear(messages):
        got.update({m.param_index: m.param_value for m in through([m for _, m in messages])})

    for request in through([common.MAVLink_param_request_list_message(1, 1)]):
        service.on_message(request, now_us, ASKER)
    while len(got) < len(TABLE) and now_us < 100_000_000:
        now_us += LIST_PERIOD_US
        hear(service.on_timer(now_us))
        if now_us > 1_000_000:
            missing = min(set(range(len(TABLE))) - set(got))
            for request in through([common.MAVLink_param_request_read_message(1, 1, b"", missing)]):
                hear(service.on_message(request, now_us, ASKER))
    return parameters, got


@pytest.mark.parametrize("seed", range(20))
def test_all_parameters_arrive_over_a_lossy_link(seed):
    parameters, got = lossy_list(seed, 0.3)
    assert len(got) == len(TABLE)
    for index, parameter in enumerate(TABLE):
        if not parameter.is_integer:
            assert got[index] == parameters.get(parameter.name)


def test_a_list_without_loss_takes_its_pace_and_then_ends():
    parameters = ParameterSet(Settings())
    service = ParameterService(parameters.get, parameters.set)
    service.on_message(common.MAVLink_param_request_list_message(1, 1), 0, ASKER)
    indices = []
    while service.next_deadline_us() < 10_000_000:
        indices += [m.param_index for _, m in service.on_timer(service.next_deadline_us())]
    assert indices == list(range(len(TABLE)))


def over_the_wire(message):
    (decoded,) = Parser().push(Encoder(system=1, component=1).encode(message))
    return decoded


def put(service, name, value, kind=common.MAV_PARAM_TYPE_REAL32):
    message = over_the_wire(common.MAVLink_param_set_message(1, 1, name, value, kind))
    return [answer for _, answer in service.on_message(message, 0, ASKER)]


def test_a_set_value_is_echoed_and_a_refused_one_is_not():
    parameters = ParameterSet(Settings())
    service = ParameterService(parameters.get, parameters.set)
    (echo,) = put(service, b"MPC_XY_P", 1.2)
    assert (echo.param_id, echo.param_value) == ("MPC_XY_P", 1.2)
    assert parameters.settings.control.position.xy_p == 1.2
    echo, text = put(service, b"MPC_XY_P", 7.0)
    assert echo.param_value == 1.2
    assert text.text == "parameter MPC_XY_P = 7 is outside 0 .. 2 1/s"
    echo, _ = put(service, b"MPC_XY_P", NAN)
    assert echo.param_value == 1.2
    assert put(service, b"NO_SUCH", 1.0) == []


def test_whole_numbers_travel_as_their_bytes():
    parameters = ParameterSet(Settings())
    service = ParameterService(parameters.get, parameters.set)
    as_float = float(np.array([7], dtype=np.int32).view(np.float32)[0])
    (echo,) = put(service, b"EKF2_REQ_NSATS", as_float, common.MAV_PARAM_TYPE_INT32)
    assert parameters.get("EKF2_REQ_NSATS") == 7
    assert np.array([over_the_wire(echo).param_value], dtype=np.float32).view(np.int32)[0] == 7
    assert len(put(service, b"EKF2_REQ_NSATS", 7.0)) == 2  # a wrong type is refused with a text
    assert parameters.get("EKF2_REQ_NSATS") == 7
