"""The application beside a PX4, without its sockets: accepted messages, its clock, its requests."""

import math

import msgspec
import pytest
from pymavlink.dialects.v20 import common

from autopilot.logs.companion_record import CompanionLog
from autopilot.logs.vehicle_record import VEHICLE_RECORD
from autopilot.mavlink.codec import Encoder, Parser, stamp
from autopilot.onboard.application import OnboardOutput
from autopilot.onboard.formation.messages import warning
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.parameters.config import VehicleConfig
from autopilot.process.companion import CALL_PERIOD_S, LONGEST_LEAP_US, TICK_US, Companion
from foundation.records.record_log import read
from netsim.wire.messages import Broadcast

SYSTEM = 2


def config(**onboard):
    places = [[0.0, 0.0, -3.0], [0.0, 3.0, -3.0]]
    fields = {"run_id": "x", "instance": 1, "seed": 1, "places_ned_m": places, "onboard": onboard}
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


def fly(companion, until_ms, period_ms=10, begin_ms=10):
    outputs = []
    for time_ms in range(begin_ms, until_ms + 1, period_ms):
        companion.on_message(from_px4(attitude(time_ms)))
        if companion.is_due:
            outputs.append(companion.on_timer(()))
    return outputs


def test_the_clock_follows_px4_and_never_goes_back_or_leaps_for_one_message():
    companion = Companion(config())
    assert companion.now_us == -1
    assert not companion.is_due
    last_ms = 2**32 - 1
    for time_ms, clock_ms in (
        (5_000, 5_000), (4_990, 5_000), (5_010, 5_010), (last_ms, 5_010), (5_020, 5_020), (last_ms, 5_020),
    ):  # fmt: skip
        companion.on_message(from_px4(attitude(time_ms)))
        assert companion.now_us == clock_ms * 1_000
    leap_ms = 5_020 + LONGEST_LEAP_US // 1_000
    companion.on_message(from_px4(attitude(leap_ms)))
    assert companion.now_us == leap_ms * 1_000


@pytest.mark.parametrize("ranging", ["all_pairs", "scheduled"])
@pytest.mark.parametrize("gap_ms", [30_000, 60_001, 3_600_000, 4_000_000_000])
def test_a_gap_in_px4s_messages_is_followed_and_causes_no_burst(ranging, gap_ms):
    companion = Companion(config(ranging=ranging))
    period_ms = companion.app._config.beacon_period_ms
    sent = []

    def receive(begin_ms):
        for time_ms in range(begin_ms, begin_ms + 2_000, 10):
            for message in (origin(), attitude(time_ms), position(time_ms)):
                companion.on_message(from_px4(message))
            if companion.is_due:
                sent.append(companion.on_timer(()).radio)
        assert companion.now_us == (begin_ms + 1_990) * 1_000

    receive(10)
    before = len(sent)
    receive(gap_ms)
    assert max(map(len, sent[before:])) <= 2  # one due to the gap, and one that may be due
    beacons = [[item for item in items if isinstance(item, Broadcast)] for items in sent[before:]]
    assert sum(map(len, beacons)) == pytest.approx(2_000 / period_ms, abs=2)


def test_it_updates_with_each_attitude_at_100_hz_and_not_more_often():
    companion = Companion(config())
    assert len(fly(companion, 1_000)) == 100
    assert len(fly(Companion(config()), 1_000, period_ms=4, begin_ms=4)) == 1_000 // (TICK_US // 1_000)


@pytest.mark.parametrize(("system", "component"), [(3, 1), (SYSTEM, 100), (255, 190), (0, 0)])
def test_only_messages_of_its_own_autopilot_are_used(system, component):
    companion = Companion(config())
    companion.on_message(from_px4(attitude(100), system=system, component=component))
    assert companion.now_us == -1
    companion.on_message(from_px4(attitude(100)))
    companion.on_message(from_px4(beat(), system=system, component=component))
    companion.on_message(from_px4(position(100), system=system, component=component))
    assert companion.on_timer(()).radio == ()
    reports = companion.on_timer(()).said
    assert all(message.get_srcComponent() == 191 for message in reports)


def test_the_origin_is_requested_each_second_until_it_is_known():
    companion = Companion(config())
    sent = [requests(output) for output in fly(companion, 5_000)]
    assert sum(map(len, sent)) == 5
    (request,) = sent[0]
    assert (request.target_system, request.target_component, request.param1) == (SYSTEM, 1, 49.0)
    companion.on_message(from_px4(origin()))
    assert sum(map(len, map(requests, fly(companion, 35_000, begin_ms=5_010)))) in {3, 4}


def test_long_texts_are_sent_in_chunks_of_one_id():
    """A STATUSTEXT holds 50 bytes; PX4 forwards each to the ground station."""
    companion = Companion(config())
    companion.on_message(from_px4(attitude(100)))
    text = "formation not localised in 10 s: beacons of 0 of 7 other UAVs received"
    companion.app.on_timer = lambda _: OnboardOutput([warning(text)], ())
    sent = [m for m in companion.on_timer(()).mavlink if m.get_type() == "STATUSTEXT"]
    assert "".join(message.text for message in sent) == text
    assert [(message.id, message.chunk_seq) for message in sent] == [(1, 0), (1, 1)]
    assert all(message.get_srcComponent() == 191 for message in sent)


def test_px4s_mode_and_the_own_phase_are_reported_to_the_simulator_with_their_sources():
    companion = Companion(config())
    companion.on_message(from_px4(attitude(10)))
    companion.on_message(from_px4(beat(mode=0x03040000)))
    reports = companion.on_timer(()).said
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
    companion.on_message(from_px4(attitude(10)))
    release = common.MAVLink_command_long_message(
        SYSTEM, 191, common.MAV_CMD_USER_1, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    )
    companion.on_message(from_px4(release, system=255, component=190))
    acks = [m for m in companion.on_timer(()).mavlink if m.get_type() == "COMMAND_ACK"]
    assert [(ack.command, ack.result) for ack in acks] == [(common.MAV_CMD_USER_1, 0)]


def test_it_sends_px4_its_own_heartbeat():
    call = Companion(config()).call()
    assert (call.get_type(), call.get_srcSystem(), call.get_srcComponent()) == ("HEARTBEAT", SYSTEM, 191)
    assert CALL_PERIOD_S <= 1.0


def test_px4s_messages_are_recorded_at_the_instants_of_the_log(tmp_path):
    companion = Companion(config())
    path = tmp_path / "uav.bin"
    log = CompanionLog(config(), str(path), companion.app)
    for time_ms in range(12, 212, 8):
        for message in (attitude(time_ms), position(time_ms), beat(mode=0x06000000), origin()):
            companion.on_message(from_px4(message))
            log.on_message(from_px4(message))
        log.on_message(from_px4(beat(mode=1), system=9))
        log.write(companion.now_us)
    log.close()
    rows = read(path, VEHICLE_RECORD)
    assert rows["time_us"].tolist() == [k * 20_000 for k in range(1, 11)]
    assert set(rows["mode"].tolist()) == {0x06000000}
    assert rows["armed"].all()
    assert rows["estimator_pos_ned_m"][0] == pytest.approx((1.0, 2.0, -3.0), abs=0.02)
    assert all(map(math.isnan, rows["gps_pos_ned_m"][0]))
