"""The application beside a PX4, without its sockets: accepted messages, its clock, its requests."""

import contextlib
import math
import socket

import msgspec
import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.logs.companion_record import CompanionLog
from autopilot.logs.vehicle_record import VEHICLE_RECORD
from autopilot.mavlink.codec import Encoder, Parser, stamp
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.programs import OnboardOutput
from autopilot.parameters.config import VehicleConfig, VehiclePorts
from autopilot.process import companion as companion_module
from autopilot.process.companion import Companion, CompanionProcess
from autopilot.process.iteration import Iterate
from foundation.records.record_log import read
from netsim.wire.messages import Broadcast

SYSTEM = 2


def config(**onboard):
    places = [[0.0, 0.0, -3.0], [0.0, 3.0, -3.0]]
    fields = {
        "run_id": "x", "instance": 1, "seed": 1, "places_ned_m": places, "onboard": onboard,
        "autopilot": {"kind": "px4", "px4_build": "build"},
    }  # fmt: skip
    return msgspec.convert(fields, VehicleConfig)


def from_px4(message, *, system=SYSTEM, component=1):
    return stamp(message, system=system, component=component)


def attitude(time_ms):
    return common.MAVLink_attitude_message(time_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def position(time_ms):
    return common.MAVLink_local_position_ned_message(time_ms, 1.0, 2.0, -3.0, 0.5, 0.0, 0.0)


def origin():
    return common.MAVLink_gps_global_origin_message(473_977_420, 85_455_940, 488_000, 0)


def beat(mode=0):
    return common.MAVLink_heartbeat_message(2, 12, 157, mode, 4, 3)


def requests(output):
    return [
        message for message in output.mavlink
        if message.get_type() == "COMMAND_LONG" and message.command == common.MAV_CMD_REQUEST_MESSAGE
    ]  # fmt: skip


def fly(companion, until_ms, period_ms=40, begin_ms=40, px4=(attitude,)):
    """Run iterations with PX4's messages of their times; returns their outputs."""
    outputs = []
    for time_ms in range(begin_ms, until_ms + 1, period_ms):
        for message in px4:
            companion.on_message(from_px4(message(time_ms)), time_ms * 1_000)
        outputs.append(companion.on_timer((), time_ms * 1_000))
    return outputs


@pytest.mark.parametrize("ranging", ["all_pairs", "scheduled"])
@pytest.mark.parametrize("gap_ms", [30_000, 60_000, 3_600_000, 4_000_000_000])
def test_a_leap_of_the_clock_is_followed_and_causes_no_burst(ranging, gap_ms):
    companion = Companion(config(ranging=ranging))
    period_ms = companion.app.application._config.beacon_period_ms
    px4 = (lambda _: origin(), attitude, position)
    sent = [output.radio for output in fly(companion, 2_000, px4=px4)]
    before = len(sent)
    sent += [output.radio for output in fly(companion, gap_ms + 1_960, begin_ms=gap_ms, px4=px4)]
    assert max(map(len, sent[before:])) <= 2  # one due to the gap, and one that may be due
    beacons = [[item for item in items if isinstance(item, Broadcast)] for items in sent[before:]]
    assert sum(map(len, beacons)) == pytest.approx(2_000 / period_ms, abs=2)


@pytest.mark.parametrize(("system", "component"), [(3, 1), (SYSTEM, 100), (255, 190), (0, 0)])
def test_only_messages_of_its_own_autopilot_are_used(system, component):
    companion = Companion(config())
    companion.on_message(from_px4(attitude(100)), 100_000)
    companion.on_message(from_px4(beat(), system=system, component=component), 100_000)
    companion.on_message(from_px4(position(100), system=system, component=component), 100_000)
    output = companion.on_timer((), 100_000)
    assert output.radio == ()
    assert all(message.get_srcComponent() == 191 for message in output.reports)


def test_the_origin_is_requested_each_second_until_it_is_known():
    companion = Companion(config())
    sent = [requests(output) for output in fly(companion, 5_000)]
    assert sum(map(len, sent)) == 5
    (request,) = sent[0]
    assert (request.target_system, request.target_component, request.param1) == (SYSTEM, 1, 49.0)
    companion.on_message(from_px4(origin()), 5_000_000)
    assert sum(map(len, map(requests, fly(companion, 35_000, begin_ms=5_040)))) in {3, 4}


def test_long_texts_are_sent_in_chunks_of_one_id():
    """A STATUSTEXT holds 50 bytes; PX4 forwards each to the ground station."""
    companion = Companion(config())
    companion.on_message(from_px4(attitude(100)), 100_000)
    text = "formation not localised in 10 s: beacons of 0 of 7 other UAVs received"
    warning = common.MAVLink_statustext_message(common.MAV_SEVERITY_WARNING, text.encode())
    companion.app.on_timer = lambda _: OnboardOutput([warning], ())
    sent = [m for m in companion.on_timer((), 100_000).mavlink if m.get_type() == "STATUSTEXT"]
    assert "".join(message.text for message in sent) == text
    assert [(message.id, message.chunk_seq) for message in sent] == [(1, 0), (1, 1)]
    assert all(message.get_srcComponent() == 191 for message in sent)


def test_px4s_mode_and_the_own_phase_are_reported_to_the_simulator_with_their_sources():
    companion = Companion(config())
    companion.on_message(from_px4(attitude(10)), 10_000)
    companion.on_message(from_px4(beat(mode=0x03040000)), 10_000)
    reports = companion.on_timer((), 40_000).reports
    named = {
        (message.get_srcSystem(), message.get_srcComponent()): message.custom_mode for message in reports
    }
    assert named == {(SYSTEM, 1): 0x03040000, (SYSTEM, 191): int(FlightPhase.WAITING)}
    # encoding and parsing preserve them
    encoder = Encoder(system=SYSTEM, component=191)
    received = Parser().push_datagram(b"".join(map(encoder.encode, reports)))
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in received} == set(named)


def test_a_command_to_the_application_that_px4_forwards_is_answered():
    companion = Companion(config(hold=True))
    release = common.MAVLink_command_long_message(
        SYSTEM, 191, common.MAV_CMD_USER_1, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    )
    companion.on_message(from_px4(release, system=255, component=190), 10_000)
    acks = [m for m in companion.replies() if m.get_type() == "COMMAND_ACK"]
    assert companion.replies() == []
    assert [(ack.command, ack.result) for ack in acks] == [(common.MAV_CMD_USER_1, 0)]


def test_streams_that_are_not_used_are_stopped_and_asked_again_if_they_go_on():
    companion = Companion(config())

    def imu(time_ms):
        return common.MAVLink_highres_imu_message(time_ms * 1_000, *[0.0] * 13, 0)

    outputs = fly(companion, 2_900, px4=(attitude, position, imu))
    stopped = [
        int(message.param1)
        for output in outputs
        for message in output.mavlink
        if message.get_type() == "COMMAND_LONG" and message.command == common.MAV_CMD_SET_MESSAGE_INTERVAL
    ]
    assert sorted(stopped) == sorted(  # at 0, 1 and 3 s
        2 * [common.MAVLINK_MSG_ID_ATTITUDE] + 2 * [common.MAVLINK_MSG_ID_HIGHRES_IMU]
    )


def test_requests_to_stop_a_message_that_goes_on_become_rarer():
    companion = Companion(config())
    times_s = []
    for time_s in range(64):
        companion.on_kind(42, 1_000_000 * time_s)
        times_s += [time_s] * len(companion.replies())
    assert times_s == [0, 1, 3, 7, 15, 31, 63]


def test_its_heartbeats_make_a_silent_px4_send_to_it():
    outputs = fly(Companion(config()), 10_000, px4=())
    sent = [message for output in outputs for message in output.mavlink]
    assert sum(message.get_type() == "HEARTBEAT" for message in sent) == 10
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in sent} == {(SYSTEM, 191)}


class SilentRadio:
    malformed = 0

    def __init__(self, **_):
        self.receive = lambda _: ()
        self.send = lambda *_: None
        self.close = lambda: None


def test_messages_that_arrive_in_a_pause_wait_for_the_next_iteration(monkeypatch):
    """They are newer than the last iteration: with its time the application would find a wrong clock."""
    monkeypatch.setattr(companion_module, "RadioClient", SilentRadio)
    with contextlib.ExitStack() as stack:
        px4 = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        px4.bind(("127.0.0.1", 0))
        ports = {
            "companion_local_udp": px4.getsockname()[1],
            "companion_remote_udp": 0,
            "radio_endpoint": {"locator": "x", "password": "y"},
        }
        settings = replace(config(hold=True), ports=msgspec.convert(ports, VehiclePorts))
        ends = [stack.enter_context(end) for end in socket.socketpair()]
        process = CompanionProcess(settings, ends[0], stack)
        px4.connect(process._autopilot._socket.getsockname())
        encoder = Encoder(system=SYSTEM, component=1)
        own = process._companion.app.application._own
        release = common.MAVLink_command_long_message(
            SYSTEM, 191, common.MAV_CMD_USER_1, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        )

        def send(*messages):
            px4.send(b"".join(map(encoder.encode, messages)))

        send(position(998))
        process._iterate(Iterate(time_us=1_000_000))
        known_us = own.time_us
        send(position(1_034), stamp(release, system=255, component=190))
        process._serve_while_paused()
        assert own.time_us == known_us
        acks = [m for m in Parser().push_datagram(px4.recv(65_535)) if m.get_type() == "COMMAND_ACK"]
        while not acks:
            acks = [m for m in Parser().push_datagram(px4.recv(65_535)) if m.get_type() == "COMMAND_ACK"]
        assert acks[0].result == 0
        process._iterate(Iterate(time_us=1_040_000))
        assert own.time_us == known_us + 36_000


def test_px4s_messages_are_recorded_at_the_instants_of_the_log(tmp_path):
    companion = Companion(config())
    path = tmp_path / "uav.bin"
    log = CompanionLog(config(), str(path), companion.app)
    for time_ms in range(12, 212, 8):
        for message in (attitude(time_ms), position(time_ms), beat(mode=0x06000000), origin()):
            log.on_message(from_px4(message), 1_000 * time_ms)
            companion.on_message(from_px4(message), 1_000 * time_ms)
    log.close()
    rows = read(path, VEHICLE_RECORD)
    assert rows["time_us"].tolist() == [k * 20_000 for k in range(1, 11)]
    assert set(rows["mode"].tolist()) == {0x06000000}
    assert rows["armed"].all()
    assert rows["estimator_pos_ned_m"][0] == pytest.approx((1.0, 2.0, -3.0), abs=0.02)
    assert all(map(math.isnan, rows["gps_pos_ned_m"][0]))
