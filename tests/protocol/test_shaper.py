"""A link's budget: output stays within it, and requested messages are not starved."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import frame_bytes
from autopilot.parameters.config import LinksConfig, VehicleConfig
from autopilot.parameters.onboard_config import OnboardConfig
from autopilot.services.service import BROADCAST, COMPANION, GROUND_STATION, Addressed, Partner
from autopilot.services.shaper import BURST_US, MAX_WAITING, TRANSFER_SHARE, Shaper, Shapers
from studies.vehicle.solo import STEP_US, Solo

BUDGET = 5_000
ALL_HERE = Partner(GROUND_STATION)
CLIENT = Partner(GROUND_STATION, 0)


def attitude(time_ms):
    return Addressed(ALL_HERE, common.MAVLink_attitude_message(time_ms, *[0.1] * 6))


def home():
    return Addressed(
        ALL_HERE, common.MAVLink_home_position_message(1, 1, 1, 1.0, 1.0, 1.0, [1.0] * 4, 1.0, 1.0, 1.0)
    )


def value(index):
    return Addressed(CLIENT, common.MAVLink_param_value_message(b"MPC_XY_VEL_MAX", 1.0, 9, 1_000, index))


def sizes(messages):
    return sum(frame_bytes(addressed.message) for addressed in messages)


def kinds(messages):
    return [addressed.message.get_type() for addressed in messages]


def run(shaper, seconds, *, begin_us=0, transfers=(), streams=lambda _: ()):
    """Output of each step."""
    waiting, out = list(transfers), []
    for now_us in range(begin_us + STEP_US, begin_us + round(seconds * 1e6) + 1, STEP_US):
        count = 1 if shaper.has_room() else 0
        handed, waiting = waiting[:count], waiting[count:]
        out.append(shaper.shape(now_us, transfers=handed, streams=streams(now_us)))
    return out


def test_streams_use_the_budget_and_no_more():
    shaper = Shaper(BUDGET)
    out = run(shaper, 10.0, streams=lambda now_us: [attitude(now_us // 1_000)])
    assert sum(map(sizes, out)) == pytest.approx(10 * BUDGET, rel=0.01)
    sent = sum(map(len, out))
    assert shaper.limited == pytest.approx(10 * 250 - sent, abs=1)
    # the newest messages are sent
    assert out[-1] == [] or out[-1][0].message.time_boot_ms > 10_000 - 20


def test_below_the_budget_all_messages_are_sent_at_once():
    shaper = Shaper(BUDGET)
    out = run(shaper, 5.0, streams=lambda now_us: [attitude(0)] * (now_us % 100_000 == 0))
    assert [bool(messages) for messages in out] == [(i + 1) % 25 == 0 for i in range(len(out))]
    assert shaper.limited == 0


def test_a_slow_stream_is_not_starved_by_fast_ones():
    """ATTITUDE at 250 Hz exceeds the budget several times; HOME_POSITION at 2 Hz is still sent."""
    shaper = Shaper(BUDGET)
    out = run(shaper, 20.0, streams=lambda now_us: [attitude(0)] + [home()] * (now_us % 500_000 == 0))
    assert sum(kinds(messages).count("HOME_POSITION") for messages in out) >= 39


def test_transfers_and_streams_have_their_shares_and_use_what_the_other_leaves():
    shaper = Shaper(BUDGET)
    values = [value(i) for i in range(200)]
    out = run(shaper, 10.0, transfers=values, streams=lambda _: [attitude(0)])
    sent = [kind for messages in out for kind in kinds(messages)]
    assert sent.count("PARAM_VALUE") == 200
    during = next(i for i, m in enumerate(reversed(out)) if "PARAM_VALUE" in kinds(m))
    busy = [addressed for messages in out[: len(out) - during] for addressed in messages]
    of_list = sizes(a for a in busy if a.message.get_type() == "PARAM_VALUE")
    assert of_list / sizes(busy) == pytest.approx(0.75, rel=0.05)  # TRANSFER_SHARE to 1
    assert sum(map(sizes, out)) == pytest.approx(10 * BUDGET, rel=0.01)
    alone = run(Shaper(BUDGET), 1.0, transfers=values)
    assert sum(map(sizes, alone)) == pytest.approx(BUDGET, rel=0.02)


def test_answers_and_heartbeats_are_sent_at_once_and_charged_later():
    shaper = Shaper(BUDGET)
    ack = Addressed(CLIENT, common.MAVLink_command_ack_message(400, 0))
    beat = Addressed(ALL_HERE, common.MAVLink_heartbeat_message(2, 12, 29, 0, 3, 3))
    shaper.shape(0)
    out = shaper.shape(STEP_US, answers=[ack] * 200, streams=[beat, attitude(0)])
    assert kinds(out) == ["COMMAND_ACK"] * 200 + ["HEARTBEAT"]
    owed_us = (sizes(out) / BUDGET) * 1e6 - STEP_US
    after = run(shaper, 2.0, begin_us=STEP_US)
    first = next(i for i, messages in enumerate(after) if messages)
    assert (first + 1) * STEP_US == pytest.approx(min(owed_us, 1_000_000), abs=2 * STEP_US)


def test_a_silence_permits_only_a_short_burst():
    shaper = Shaper(BUDGET)
    shaper.shape(0)
    out = shaper.shape(3_600_000_000, transfers=[value(i) for i in range(400)])
    assert sizes(out) == pytest.approx(BUDGET * BURST_US * 1e-6, abs=frame_bytes(value(0).message))


def test_the_queue_of_transfers_is_bounded_and_has_room_reports_its_state():
    shaper = Shaper(BUDGET)
    shaper.shape(0)
    assert shaper.has_room()
    shaper.shape(STEP_US, transfers=[value(i) for i in range(3 * MAX_WAITING)])
    assert not shaper.has_room()
    assert shaper.limited == 2 * MAX_WAITING
    run(shaper, 60.0, begin_us=STEP_US)
    assert shaper.has_room()


def test_without_a_limit_there_are_no_shapers():
    shapers = Shapers(dict.fromkeys((GROUND_STATION, COMPANION), 0))
    assert not shapers
    assert shapers.has_room(CLIENT)
    assert shapers.limited(GROUND_STATION) == 0


def test_each_link_has_its_own_budget():
    shapers = Shapers(dict.fromkeys((GROUND_STATION, COMPANION), BUDGET))
    out = []
    for now_us in range(STEP_US, 1_000_001, STEP_US):
        streamed = [attitude(0), Addressed(Partner(COMPANION), attitude(0).message)]
        out += shapers.shape(now_us, answered=[], timed=[value(0)], streamed=streamed)
    for link in (GROUND_STATION, COMPANION):
        of_link = [addressed for addressed in out if addressed.partner.link == link]
        assert sizes(of_link) == pytest.approx(BUDGET, rel=0.05)
    assert not shapers.has_room(CLIENT)
    assert shapers.has_room(Partner(COMPANION, 0))
    assert shapers.has_room(Partner(BROADCAST))


def test_a_link_without_a_limit_passes_everything_beside_one_that_has_one():
    shapers = Shapers({GROUND_STATION: BUDGET, COMPANION: 0})
    to_companion = Addressed(Partner(COMPANION), attitude(0).message)
    streamed = [attitude(0), to_companion] * 40
    out = shapers.shape(STEP_US, answered=[to_companion], timed=[to_companion], streamed=streamed)
    assert [each.partner.link for each in out].count(COMPANION) == 42


def vehicle(bandwidth_bytes_s):
    config = VehicleConfig(
        run_id="test",
        instance=0,
        seed=7,
        onboard=OnboardConfig(enabled=False),
        links=LinksConfig(bandwidth_bytes_s=bandwidth_bytes_s),
        places_ned_m=((0.0, 0.0, -5.0),),
    )
    return Solo(config, seed=np.random.SeedSequence(3), recording=False)


def test_a_vehicle_on_a_slow_link_lists_its_parameters_and_still_sends_telemetry():
    free, thin = vehicle(0), vehicle(BUDGET)
    for flight in (free, thin):
        for _ in range(250):
            flight.step(streams=True)
    unlimited = {}
    for _ in range(500):
        for addressed in free.step(streams=True).links:
            if addressed.partner.link == GROUND_STATION:
                kind = addressed.message.get_type()
                unlimited[kind] = unlimited.get(kind, 0) + frame_bytes(addressed.message)
    assert sum(unlimited.values()) > 1.4 * 2 * BUDGET  # more than the budget permits
    thin.send(common.MAVLink_param_request_list_message(1, 1))
    requested_us, out = thin.now_us, []
    read = None
    for step in range(2_500):
        if step == 250:  # during the list one value is requested
            thin.send(common.MAVLink_param_request_read_message(1, 1, b"MPC_XY_VEL_MAX", -1))
        sent = [a for a in thin.step(streams=True).links if a.partner.link == GROUND_STATION]
        if step == 250:
            read = [a.message.param_id for a in sent if a.message.get_type() == "PARAM_VALUE"]
        out += [(thin.now_us, addressed) for addressed in sent]
    assert b"MPC_XY_VEL_MAX" in read or "MPC_XY_VEL_MAX" in read
    assert sizes(a for _, a in out) == pytest.approx(10 * BUDGET, rel=0.1)
    for second in range(10):
        in_it = [a for us, a in out if second * 1e6 < us - requested_us <= (second + 1) * 1e6]
        assert sizes(in_it) == pytest.approx(BUDGET, rel=0.1)
        assert kinds(in_it).count("HEARTBEAT") == 1
    values = [(us, a.message) for us, a in out if a.message.get_type() == "PARAM_VALUE"]
    count = values[0][1].param_count
    assert {m.param_index for _, m in values} >= set(range(count))
    list_bytes = sum(frame_bytes(m) for _, m in values)
    expected_s = list_bytes / (BUDGET * TRANSFER_SHARE / (TRANSFER_SHARE + 1))
    assert (values[-1][0] - requested_us) * 1e-6 < 1.2 * expected_s
    sent_kinds = {a.message.get_type() for _, a in out}
    assert sent_kinds >= unlimited.keys()
