"""Plans written, read and cleared over MAVLink: the state machine alone."""

import gc
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plan_clients import bits, drawn_plan
from plan_dialogue import (
    ACCEPTED,
    CANCELLED,
    ERROR,
    FENCE,
    MISSION,
    OTHER,
    RALLY,
    TO_ALL_TYPES,
    UNSUPPORTED,
    V,
    ack,
    clear,
    count,
    item,
    machine,
    request,
    request_list,
    requested,
    results,
    run_timers,
    send,
    write,
)
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import stamp
from autopilot.mavlink.dialect import MissionCount
from autopilot.navigation.plan_store import CAPACITY, PlanType, Refused
from autopilot.services.plan_upload import REPEAT_US, RETRY_US, TIMEOUT_US
from autopilot.services.service import ALL, NEVER_US, Partner

PLAN = drawn_plan(20)

# ---- time


def test_an_item_is_requested_again_and_the_upload_abandoned_in_silence():
    store, service = machine(mission=PLAN[:2])
    send(service, count(5))
    send(service, item(PLAN, 0), 4_000)
    sent = run_timers(service, 60_000_000)
    times = [now_us for now_us, message in sent if message.get_type() == "MISSION_REQUEST_INT"]
    assert times[0] == 4_000 + RETRY_US
    assert set(np.diff(times)) == {RETRY_US}
    assert [(now_us, m.text) for now_us, m in sent if m.get_type() == "STATUSTEXT"] == [
        (4_000 + TIMEOUT_US, "Operation timeout")
    ]
    assert not service.receiving
    assert bits(store[MISSION].items) == bits(PLAN[:2])


@pytest.mark.parametrize("length", range(9))
def test_every_prefix_of_a_conversation_ends_without_pending_timers(length):
    words = [count(3), item(PLAN, 0), item(PLAN, 1), item(PLAN, 2), request_list(), request(0), request(1)]
    words += [request(2), ack(ACCEPTED)]
    store, service = machine()
    for now_us, word in enumerate(words[: length + 1]):
        send(service, word, now_us)
    run_timers(service, TIMEOUT_US + length)
    assert not service.receiving
    assert service.next_deadline_us() == NEVER_US
    assert len(store[MISSION].items) == (3 if length >= 3 else 0)


def test_the_last_acknowledgement_is_repeated_while_the_station_is_silent():
    _, service = machine()
    (last,) = write(service, PLAN[:2])
    assert results([last]) == [ACCEPTED]
    assert run_timers(service, 10**9) == [(after_us, last) for after_us in REPEAT_US]


def test_the_last_acknowledgement_is_not_repeated_to_a_station_that_goes_on():
    _, service = machine()
    write(service, PLAN[:2])
    send(service, request_list(FENCE), 100_000)
    assert run_timers(service, 10**9) == []
    write(service, PLAN[:3], now_us=2_000_000)
    send(service, request_list(FENCE), 2_100_000, OTHER)  # another station does not end the repetitions
    assert len(run_timers(service, 10**9)) == len(REPEAT_US)


def test_a_repeated_last_item_is_answered_after_the_repetitions_have_ended():
    _, service = machine()
    write(service, PLAN[:2])
    assert send(service, item(PLAN, 1), 100_000) == []
    run_timers(service, 2_000_000)
    assert results(send(service, item(PLAN, 1), 3_000_000)) == [ACCEPTED]
    assert results(send(service, item(PLAN, 0), 3_000_000)) == [ERROR]


# ---- accepted and refused plans


@pytest.mark.parametrize("kind", PlanType)
def test_opaque_ids_identify_the_stored_plan(kind):
    store, service = machine()
    (empty,) = send(service, request_list(kind))
    assert (empty.count, empty.opaque_id, empty.mission_type) == (0, 0, kind)
    (last,) = write(service, PLAN[:4], kind)
    (full,) = send(service, request_list(kind))
    assert (full.count, full.mission_type) == (4, kind)
    assert full.opaque_id == last.opaque_id == store[kind].opaque_id != 0


def test_a_plan_that_is_refused_leaves_the_old_one_and_reports_the_reason():
    def make(kind, items):
        assert (kind, bits(items)) == (MISSION, bits(PLAN[:3]))
        return Refused(common.MAV_MISSION_INVALID_PARAM2, 1, "Item 1: radius")

    store, service = machine(make=make, mission=PLAN[:2])
    answers = write(service, PLAN[:3])
    assert results(answers) == [common.MAV_MISSION_INVALID_PARAM2]
    assert [m.text for m in answers if m.get_type() == "STATUSTEXT"] == ["Item 1: radius"]
    assert bits(store[MISSION].items) == bits(PLAN[:2])
    assert store.version[MISSION] == 1


def test_a_cancelled_transfer_leaves_the_old_plan():
    store, service = machine(mission=PLAN[:2])
    send(service, count(3))
    send(service, item(PLAN, 0))
    assert send(service, ack(CANCELLED)) == []
    assert not service.receiving
    assert send(service, item(PLAN, 1)) == []  # was in transit
    assert results(write(service, PLAN[:3])) == [ACCEPTED]
    assert len(store[MISSION].items) == 3


def test_another_station_cannot_end_or_change_the_upload():
    store, service = machine(rally=PLAN[:1])
    send(service, count(3))
    send(service, item(PLAN, 0))
    assert send(service, ack(CANCELLED), partner=OTHER) == []
    assert send(service, item(PLAN, 1), partner=OTHER) == []
    assert results(send(service, count(1), partner=OTHER)) == [ERROR]
    assert results(send(service, clear(TO_ALL_TYPES), partner=OTHER)) == [ERROR]
    assert requested(send(service, item(PLAN, 1))) == [2]
    send(service, item(PLAN, 2))
    assert bits(store[MISSION].items) == bits(PLAN[:3])
    assert len(store[RALLY].items) == 1


def test_a_station_may_restart_its_upload():
    _, service = machine()
    send(service, count(5))
    assert requested(send(service, count(5), 1_000)) == [0]  # the request may be lost
    assert requested(send(service, count(4, FENCE), 2_000)) == [0]
    send(service, item(PLAN, 0, FENCE), 3_000)
    assert send(service, count(4, FENCE), 4_000) == []  # a late copy
    (again,) = send(service, count(4, FENCE), 1_500_000)
    assert (again.seq, again.mission_type) == (0, FENCE)


def test_a_late_copy_of_the_previous_mission_count_does_not_end_the_upload():
    _, service = machine()
    write(service, PLAN[:3])
    send(service, count(5, FENCE), 10_000)
    send(service, item(PLAN, 0, FENCE), 20_000)
    assert send(service, count(3), 30_000) == []
    assert send(service, item(PLAN, 2), 30_000) == []
    assert requested(send(service, item(PLAN, 1, FENCE), 40_000)) == [2]


def test_a_late_copy_of_mission_clear_all_does_not_end_the_upload():
    _, service = machine(mission=PLAN[:2])
    assert results(send(service, clear(MISSION))) == [ACCEPTED]
    assert results(send(service, clear(MISSION), 1_000)) == [ACCEPTED]
    send(service, count(3), 2_000)
    assert send(service, clear(MISSION), 100_000) == []
    assert service.receiving


@pytest.mark.parametrize("kind", PlanType)
def test_the_capacity_is_px4s(kind):
    _, service = machine()
    assert results(send(service, count(CAPACITY[kind] + 1, kind))) == [common.MAV_MISSION_NO_SPACE]
    assert not service.receiving
    assert requested(send(service, count(CAPACITY[kind], kind))) == [0]


def test_a_count_of_zero_clears_a_plan():
    store, service = machine(mission=PLAN[:2], fence=PLAN[:3], rally=PLAN[:4])
    assert results(send(service, count(0, FENCE))) == [ACCEPTED]
    assert results(send(service, clear(RALLY))) == [ACCEPTED]
    assert [len(store[kind].items) for kind in PlanType] == [2, 0, 0]
    (last,) = send(service, clear(TO_ALL_TYPES))
    assert (last.type, last.mission_type) == (ACCEPTED, TO_ALL_TYPES)
    assert [len(store[kind].items) for kind in PlanType] == [0, 0, 0]


def test_clearing_ends_the_upload_of_its_station():
    store, service = machine(mission=PLAN[:2])
    send(service, count(3))
    assert results(send(service, clear(MISSION))) == [ACCEPTED]
    assert not service.receiving
    assert store[MISSION].items == ()


@pytest.mark.parametrize("kind", [3, 100, 254])
def test_unknown_plan_types_are_refused(kind):
    store, service = machine(mission=PLAN[:2])
    assert results(send(service, count(1, kind))) == [UNSUPPORTED]
    assert results(send(service, clear(kind))) == [UNSUPPORTED]
    assert send(service, request_list(kind))[0].count == 0
    assert send(service, request(0, kind)) == []
    assert len(store[MISSION].items) == 2


def test_broadcast_messages_are_ignored():
    _, service = machine()
    assert send(service, MissionCount(0, 1, 3, int(MISSION))) == []
    assert send(service, MissionCount(2, 1, 3, int(MISSION))) == []
    assert not service.receiving


def test_a_mission_starts_at_the_item_marked_as_current():
    store, service = machine()
    send(service, count(3))
    for seq in range(3):
        send(service, item(PLAN, seq, current=seq == 2))
    assert store[MISSION].start == 2


# ---- load and robustness


def test_10_000_items_are_received_in_linear_time():
    plan = drawn_plan(10_000)

    def seconds(length):
        gc.collect()
        gc.disable()  # collections would visit the objects of other tests
        try:
            begin_s = time.process_time()
            store, service = machine()
            assert results(write(service, plan[:length])) == [ACCEPTED]
            assert len(store[MISSION].items) == length
            return time.process_time() - begin_s
        finally:
            gc.enable()

    seconds(100)
    few_s, many_s = (min(seconds(length) for _ in range(3)) for length in (1_000, 10_000))
    assert many_s < 30 * few_s  # linear: 10 times; quadratic: 100 times


TINY = drawn_plan(4)
TYPES = st.sampled_from([0, 0, 0, 1, 2, 3, 255])
SEQ = st.integers(0, 5)
RAW = st.floats(width=32)
MESSAGES = st.one_of(
    st.builds(count, st.one_of(SEQ, st.integers(0, 65_535)), TYPES),
    st.builds(
        lambda seq, kind, in_integers: item(TINY * 2, seq, kind, in_integers=in_integers),
        SEQ, TYPES, st.booleans(),
    ),
    st.builds(
        lambda seq, frame, x, y, z, p: common.MAVLink_mission_item_message(
            *V, seq, frame, 16, 7, 9, p, p, p, p, x, y, z, 0
        ),
        SEQ, st.integers(0, 255), RAW, RAW, RAW, RAW,
    ),
    st.builds(request, st.one_of(SEQ, st.integers(0, 65_535)), TYPES),
    st.builds(lambda seq, kind: common.MAVLink_mission_request_message(*V, seq, kind), SEQ, TYPES),
    st.builds(request_list, TYPES),
    st.builds(
        lambda start, end, kind: common.MAVLink_mission_write_partial_list_message(*V, start, end, kind),
        st.integers(-2, 6), st.integers(-2, 6), TYPES,
    ),
    st.builds(
        lambda start, end, kind: common.MAVLink_mission_request_partial_list_message(*V, start, end, kind),
        st.integers(-2, 6), st.integers(-2, 6), TYPES,
    ),
    st.builds(ack, st.integers(0, 255), TYPES),
    st.builds(clear, TYPES),
)  # fmt: skip
EVENTS = st.lists(
    st.tuples(MESSAGES, st.integers(0, 400_000), st.integers(0, 3), st.integers(0, 255)), max_size=60
)


@given(EVENTS)
def test_any_messages_get_at_most_one_answer_each_and_end(events):
    store, service = machine(mission=TINY)
    now_us = 0
    for message, wait_us, number, system in events:
        now_us += wait_us
        if now_us >= service.next_deadline_us():
            service.on_timer(now_us)
        assert service.next_deadline_us() > now_us
        stamp(message, system=system, component=1)
        partner = Partner(0, number)
        answers = service.on_message(message, now_us, partner)
        assert sum(to == partner for to, _ in answers) <= 1
        assert all(to in {partner, ALL} for to, _ in answers)
        assert all(len(store[kind].items) <= CAPACITY[kind] for kind in PlanType)
    run_timers(service, now_us + TIMEOUT_US + sum(REPEAT_US))
    assert not service.receiving
    assert service.next_deadline_us() == NEVER_US


def test_the_number_of_readers_is_bounded():
    _, service = machine(mission=TINY)
    for number in range(1_000):
        send(service, request_list(), partner=Partner(0, number))
    assert len(service._readers) <= 32  # not observable otherwise
