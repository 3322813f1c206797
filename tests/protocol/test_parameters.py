"""The parameter services message by message, and their refusals."""

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lossy import STEP_US
from parameter_dialogue import INT32, REAL32, UINT32, bits, expected, over_the_wire, set_message
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, stamp
from autopilot.parameters.table import ROWS, STATED, TABLE, ParameterSet, Settings
from autopilot.services.parameter import LIST_BATCH, LIST_PERIOD_US, ParameterService
from autopilot.services.parameter_ext import ParameterExtService
from autopilot.services.service import ALL, NEVER_US, Partner

CLIENT, OTHER = Partner(0, 3), Partner(1, 0)
MS = 1_000


class Served:
    def __init__(self):
        self.parameters = ParameterSet(Settings())
        self.service = ParameterService(self.parameters)

    def send(self, message, now_us=0, partner=CLIENT):
        return list(self.service.on_message(over_the_wire(message), now_us, partner))

    def listed(self, partner=CLIENT, now_us=0):
        self.send(common.MAVLink_param_request_list_message(1, 1), now_us, partner)
        messages = []
        while self.service.next_deadline_us() < NEVER_US:
            due_us = self.service.next_deadline_us()
            messages += [(due_us, to, message) for to, message in self.service.on_timer(due_us)]
        return messages


def read_message(name=b"", index=-1):
    return common.MAVLink_param_request_read_message(1, 1, name, index)


def test_a_list_begins_with_the_hash_is_paced_and_is_sent_to_the_requester_alone():
    served = Served()
    listed = served.listed()
    assert {to for _, to, _ in listed} == {CLIENT}
    assert [message.param_index for _, _, message in listed] == [65_535, *range(len(ROWS))]
    assert {message.param_count for _, _, message in listed} == {len(ROWS)}
    batches = math.ceil((len(ROWS) + 1) / LIST_BATCH)
    assert listed[-1][0] in range((batches - 1) * LIST_PERIOD_US, batches * LIST_PERIOD_US + 1)


def crc32_bit_by_bit(data):
    """PX4's table is of this polynomial; the initial value is 0, and the result is not inverted."""
    checksum = 0
    for byte in data:
        checksum ^= byte
        for _ in range(8):
            checksum = checksum >> 1 ^ (0xEDB88320 if checksum & 1 else 0)
    return checksum


def hash_of(served, partner=CLIENT):
    ((to, message),) = served.send(read_message(b"_HASH_CHECK"), partner=partner)
    assert (to, message.param_index, message.param_type) == (partner, 65_535, UINT32)
    frame = Encoder(system=1, component=1).encode(message)
    (value,) = struct.unpack_from("<I", frame, 10)
    return value


def test_the_hash_is_over_names_and_values():
    served = Served()
    data = b"".join(name.encode() + value for name, value in expected(served.parameters).values())
    before = hash_of(served)
    assert before == crc32_bit_by_bit(data)
    served.send(set_message("MPC_XY_P", 1.25))
    assert hash_of(served) != before
    served.send(set_message("MPC_XY_P", 0.95))
    assert hash_of(served) == before


def test_a_station_that_sends_the_hash_ends_its_own_list_only():
    served = Served()
    for partner in (CLIENT, OTHER):
        served.send(common.MAVLink_param_request_list_message(1, 1), partner=partner)
    served.service.on_timer(0)
    cached = common.MAVLink_param_set_message(1, 1, b"_HASH_CHECK", 0.0, UINT32)
    assert served.send(cached) == []
    rest = served.service.on_timer(served.service.next_deadline_us())
    assert {to for to, _ in rest} == {OTHER}


def test_a_repeated_request_restarts_the_list_without_the_hash():
    served = Served()
    served.send(common.MAVLink_param_request_list_message(1, 1))
    served.service.on_timer(0)
    again = [message.param_index for _, _, message in served.listed(now_us=MS)]
    assert again == list(range(len(ROWS)))


def test_a_change_by_param_set_is_reported_to_all_partners():
    served = Served()
    ((to, echo),) = served.send(set_message("MPC_XY_P", 1.2))
    assert (to, echo.param_id, bits(echo)) == (ALL, "MPC_XY_P", struct.pack("<f", 1.2))
    assert served.parameters.settings.control.position.xy_p == 1.2  # the shortest decimal of the float32
    ((to, echo),) = served.send(set_message("EKF2_REQ_NSATS", 7))
    assert (to, bits(echo)) == (ALL, struct.pack("<i", 7))
    assert served.parameters.get("EKF2_REQ_NSATS") == 7


def test_another_change_is_reported_once():
    served = Served()
    served.parameters.set("MPC_XY_P", 1.1)
    served.parameters.set("MPC_XY_P", 1.2)
    assert served.service.next_deadline_us() == 0
    ((to, reported),) = served.service.on_timer(STEP_US)
    assert (to, reported.param_id) == (ALL, "MPC_XY_P")
    assert served.service.next_deadline_us() == NEVER_US


def test_a_change_by_param_set_is_not_reported_again_as_another_change():
    served = Served()
    served.parameters.set("MPC_Z_P", 1.1)
    assert len(served.send(set_message("MPC_XY_P", 1.2))) == 1
    assert [reported.param_id for _, reported in served.service.on_timer(STEP_US)] == ["MPC_Z_P"]
    assert served.service.next_deadline_us() == NEVER_US


def test_simultaneous_changes_are_reported_in_batches():
    served = Served()
    fixed = {row.name for row in TABLE if row.only_at_start} | {row.name for row in STATED if row.read_only}
    changed = [index for index, row in enumerate(ROWS) if row.name not in fixed]
    for _ in range(3):
        for index in changed:
            name = ROWS[index].name
            served.parameters.set(name, served.parameters.get(name))
    reported, now_us = [], STEP_US
    while (due_us := served.service.next_deadline_us()) < NEVER_US:
        now_us = max(now_us, due_us)
        batch = served.service.on_timer(now_us)
        assert 0 < len(batch) <= LIST_BATCH
        assert served.service.on_timer(now_us) == []
        reported += [message.param_index for _, message in batch]
    assert reported == changed
    assert now_us == STEP_US + LIST_PERIOD_US * ((len(changed) - 1) // LIST_BATCH)


@pytest.mark.parametrize(
    ("message", "error", "text"),
    [
        (set_message("NO_SUCH", 1.0), 1, "there is no parameter 'NO_SUCH'"),
        (set_message("MPC_XY_P", 7.0), 2, "parameter MPC_XY_P = 7 is outside 0 .. 2 1/s"),
        (set_message("MPC_XY_P", math.nan), 2, "parameter MPC_XY_P = nan is outside 0 .. 2 1/s"),
        (set_message("MAV_SYS_ID", 9), 5, "parameter MAV_SYS_ID is read only"),
        (set_message("EKF2_REQ_NSATS", 7.0, REAL32), 7, "EKF2_REQ_NSATS: wrong type"),
        (set_message("MPC_XY_P", 1, INT32), 7, "MPC_XY_P: wrong type"),
        (read_message(b"NO_SUCH"), 1, None),
        (read_message(index=len(ROWS)), 1, None),
        (read_message(index=32_767), 1, None),
    ],
)
def test_a_refusal_is_an_error_to_the_requester_alone_without_a_value(message, error, text):
    """MAVSDK would repeat the request at once if it received the old value."""
    served = Served()
    before = dict(expected(served.parameters))
    (to, refusal), *texts = served.send(message)
    assert to == CLIENT
    assert (refusal.get_type(), refusal.error) == ("PARAM_ERROR", error)
    assert (refusal.target_system, refusal.target_component) == (255, 190)
    assert refusal.param_id == message.param_id
    assert refusal.param_index == getattr(message, "param_index", -1)
    assert [(to, text.text) for to, text in texts] == ([] if text is None else [(ALL, text)])
    assert expected(served.parameters) == before


def test_repeated_refusals_cause_one_text_per_second():
    served = Served()
    texts = sum(
        len(served.send(set_message("MPC_XY_P", 7.0), now_us)) - 1 for now_us in range(0, 5_000 * MS, 20 * MS)
    )
    assert texts == 5


def test_integers_as_floats_are_accepted_from_a_reader_of_the_packed_file_until_it_lists():
    served = Served()
    served.service.take_by_value(CLIENT)
    as_float = set_message("EKF2_REQ_NSATS", 8.0, REAL32)
    assert served.send(as_float)[0].message.get_type() == "PARAM_VALUE"
    assert served.parameters.get("EKF2_REQ_NSATS") == 8
    assert served.send(set_message("EKF2_REQ_NSATS", 8.5, REAL32))[0].message.error == 2
    assert served.send(as_float, partner=OTHER)[0].message.error == 7
    served.listed()
    assert served.send(as_float)[0].message.error == 7


def test_the_newest_readers_of_the_packed_file_are_stored():
    served = Served()
    for number in range(1_000):
        served.service.take_by_value(Partner(0, number))
        served.service.take_by_value(Partner(1, 0))  # a partner that reads it repeatedly is kept
    as_float = set_message("EKF2_REQ_NSATS", 8.0, REAL32)
    for partner in (Partner(0, 999), Partner(1, 0)):
        assert served.send(as_float, partner=partner)[0].message.get_type() == "PARAM_VALUE"
    assert served.send(as_float, partner=Partner(0, 0))[0].message.error == 7


def test_the_number_of_lists_is_bounded():
    served = Served()
    for number in range(1_000):
        served.send(common.MAVLink_param_request_list_message(1, 1), partner=Partner(0, number))
        served.service.take_by_value(Partner(0, number))
    assert len(served.service.on_timer(0)) <= 16 * (LIST_BATCH + 1)


names = st.sampled_from([row.name.encode() for row in ROWS[::20]]) | st.binary(max_size=16)
floats = st.floats(width=32)
anything = st.one_of(
    st.builds(common.MAVLink_param_set_message, st.just(1), st.just(1), names, floats, st.integers(0, 255)),
    st.builds(
        common.MAVLink_param_request_read_message, st.just(1), st.just(1), names, st.integers(-32_768, 32_767)
    ),
    st.builds(common.MAVLink_param_request_list_message, st.just(1), st.just(1)),
)
anything_ext = st.one_of(
    st.builds(
        common.MAVLink_param_ext_set_message,
        st.just(1), st.just(1), names, st.binary(max_size=128), st.integers(0, 255),
    ),
    st.builds(
        common.MAVLink_param_ext_request_read_message,
        st.just(1), st.just(1), names, st.integers(-32_768, 32_767),
    ),
    st.builds(common.MAVLink_param_ext_request_list_message, st.just(1), st.just(1)),
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(st.lists(st.one_of(anything, anything_ext), max_size=12))
def test_any_messages_leave_every_value_in_its_range(messages):
    parameters = ParameterSet(Settings())
    services = (ParameterService(parameters), ParameterExtService(parameters))
    encoder = Encoder(system=1, component=1)
    for place, message in enumerate(messages):
        received = over_the_wire(message)
        for service in services:
            answers = (
                list(service.on_message(received, place, CLIENT))
                if received.get_msgId() in service.takes
                else []
            )
            assert len(answers) <= 2
            answers += service.on_timer(place * LIST_PERIOD_US)
            for _, answer in answers:
                encoder.encode(answer)
    for row in ROWS:
        assert row.minimum <= parameters.get(row.name) <= row.maximum


# ---- the extended protocol


def ext_value(message):
    return message._param_value_raw[:4]


def test_the_extended_protocol_lists_reads_and_sets_the_same_values():
    parameters = ParameterSet(Settings())
    service = ParameterExtService(parameters)
    service.on_message(over_the_wire(common.MAVLink_param_ext_request_list_message(1, 1)), 0, CLIENT)
    listed = []
    while service.next_deadline_us() < NEVER_US:
        listed += service.on_timer(service.next_deadline_us())
    got = {m.param_index: (m.param_id, ext_value(m)) for _, m in listed}
    assert got == expected(parameters)

    def put(name, data, kind):
        message = common.MAVLink_param_ext_set_message(1, 1, name, data.ljust(128, b"\0"), kind)
        ((to, ack),) = service.on_message(over_the_wire(message), 0, CLIENT)
        assert to == CLIENT
        return ack.param_result, ext_value(ack)

    value = struct.pack("<f", 1.2)
    assert put(b"MPC_XY_P", value, REAL32) == (common.PARAM_ACK_ACCEPTED, value)
    assert parameters.get("MPC_XY_P") == 1.2
    assert put(b"MPC_XY_P", struct.pack("<f", 9.0), REAL32) == (common.PARAM_ACK_VALUE_UNSUPPORTED, value)
    assert put(b"MPC_XY_P", value, INT32) == (common.PARAM_ACK_VALUE_UNSUPPORTED, value)
    assert put(b"NO_SUCH", value, REAL32)[0] == common.PARAM_ACK_FAILED
    ((_, refusal),) = service.on_message(
        stamp(common.MAVLink_param_ext_request_read_message(1, 1, b"NO_SUCH", -1), system=255, component=190),
        0,
        CLIENT,
    )
    assert (refusal.get_type(), refusal.error) == ("PARAM_ERROR", 1)


def test_a_list_waits_for_its_own_link_only():
    parameters, full = ParameterSet(Settings()), {CLIENT}
    service = ParameterService(parameters, lambda partner: partner not in full)
    request = common.MAVLink_param_request_list_message(1, 1)
    for partner in (CLIENT, OTHER):
        service.on_message(request, 0, partner)
    sent = []
    for _ in range(100):
        sent += [to for to, _ in service.on_timer(service.next_deadline_us())]
    assert sent == [OTHER] * (len(ROWS) + 1)
    full.clear()
    while service.next_deadline_us() < NEVER_US:
        sent += [to for to, _ in service.on_timer(service.next_deadline_us())]
    assert sent.count(CLIENT) == len(ROWS) + 1
