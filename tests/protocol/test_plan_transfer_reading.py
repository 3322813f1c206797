"""Plans read over MAVLink, parts of plans, and stations of MAVLink 1's time."""

import math

import pytest
from plan_clients import bits, drawn_plan
from plan_dialogue import (
    ACCEPTED,
    ERROR,
    FENCE,
    INVALID_SEQUENCE,
    MISSION,
    OTHER,
    UNSUPPORTED,
    V,
    ack,
    count,
    item,
    machine,
    request,
    request_list,
    requested,
    results,
    send,
    write,
)
from pymavlink.dialects.v20 import common

from autopilot.navigation.plan_store import NOT_GIVEN, WireItem
from autopilot.services.plan_wire import decode_item

PLAN = drawn_plan(20)

# ---- reading


def test_items_are_read_in_any_order_and_the_current_one_is_marked():
    _, service = machine(current=lambda: 2, mission=PLAN[:4], fence=PLAN[:4])
    send(service, request_list())
    read = [send(service, request(seq))[0] for seq in (3, 0, 2, 2, 1)]
    assert [message.seq for message in read] == [3, 0, 2, 2, 1]
    assert [message.current for message in read] == [0, 0, 1, 1, 0]
    assert bits(decode_item(message) for message in read) == bits(PLAN[seq] for seq in (3, 0, 2, 2, 1))
    send(service, request_list(FENCE))
    assert send(service, request(2, FENCE))[0].current == 0


def test_a_request_beyond_the_end_is_an_error_for_a_reader_and_ignored_for_others():
    _, service = machine(mission=PLAN[:4])
    assert send(service, request(4)) == []
    send(service, request_list())
    assert results(send(service, request(4))) == [ERROR]


def test_a_reader_of_a_plan_that_was_replaced_receives_an_error():
    _, service = machine(mission=PLAN[:4], fence=PLAN[:4])
    send(service, request_list())
    send(service, request_list(FENCE))
    send(service, request(0))
    write(service, PLAN[4:8], partner=OTHER)
    assert results(send(service, request(1))) == [ERROR]
    assert results(send(service, request(2))) == [ERROR]
    assert len(send(service, request(1, FENCE))) == 1
    send(service, request_list())
    assert bits([decode_item(send(service, request(1))[0])]) == bits([PLAN[5]])


def test_part_of_a_list_is_read_by_the_plans_item_numbers():
    _, service = machine(mission=PLAN[:9])

    def partial(start, end):
        return send(service, common.MAVLink_mission_request_partial_list_message(*V, start, end, 0))

    assert partial(3, 5)[0].count == partial(8, -1)[0].count == 9
    assert bits([decode_item(send(service, request(5))[0])]) == bits([PLAN[5]])
    for start, end in ((9, 9), (-1, 3), (5, 4), (3, 9), (0, -2)):
        assert results(partial(start, end)) == [INVALID_SEQUENCE]


# ---- part of a plan


def write_part(service, start, end, now_us=0):
    return send(service, common.MAVLink_mission_write_partial_list_message(*V, start, end, 0), now_us)


@pytest.mark.parametrize(("start", "end"), [(0, 0), (3, 5), (8, 8), (0, 8), (7, 12), (9, 10)])
def test_part_of_a_plan_is_written(start, end):
    store, service = machine(mission=PLAN[:9])
    assert requested(write_part(service, start, end)) == [start]
    new = drawn_plan(20, seed=2)
    for seq in range(start, end):
        assert requested(send(service, item(new, seq))) == [seq + 1]
    assert results(send(service, item(new, end))) == [ACCEPTED]
    expected = [new[seq] if start <= seq <= end else PLAN[seq] for seq in range(max(9, end + 1))]
    assert bits(store[MISSION].items) == bits(expected)


@pytest.mark.parametrize(("start", "end"), [(5, 4), (-1, 3), (10, 10), (-32_768, 32_767), (3, -1)])
def test_an_invalid_part_of_a_plan_is_refused(start, end):
    _, service = machine(mission=PLAN[:9])
    assert results(write_part(service, start, end)) == [INVALID_SEQUENCE]
    assert results(write_part(service, 3, 32_767)) == [common.MAV_MISSION_NO_SPACE]
    assert not service.receiving


# ---- old stations


def test_the_station_selects_the_kind_of_message():
    _, service = machine()
    assert send(service, count(3))[0].get_type() == "MISSION_REQUEST_INT"
    assert send(service, ack(UNSUPPORTED))[0].get_type() == "MISSION_REQUEST"
    assert send(service, ack(UNSUPPORTED))[0].get_type() == "MISSION_REQUEST_INT"
    send(service, item(PLAN, 0, in_integers=False))
    assert send(service, item(PLAN, 1, in_integers=False))[0].get_type() == "MISSION_REQUEST"


def test_floats_are_degrees_in_global_frames_and_plain_values_in_others():
    place = WireItem(16, 6, (0.0,) * 4, 473_977_400, -85_455_900, 10.0)
    act = WireItem(177, 2, (0.0,) * 4, 3, -7, 0.0)
    nowhere = WireItem(21, 3, (0.0,) * 4, NOT_GIVEN, NOT_GIVEN, 0.0)
    sent = [item((place, act, nowhere), seq, in_integers=False) for seq in range(3)]
    assert (sent[0].x, sent[0].frame) == (47.39774, 3)  # MISSION_ITEM uses the equivalent float frames
    assert (sent[1].x, sent[1].y) == (3.0, -7.0)
    assert math.isnan(sent[2].x)
    assert [decode_item(message) for message in sent] == [place._replace(frame=3), act, nowhere]


@pytest.mark.parametrize("wild", [math.inf, -math.inf, 1e30, -1e30, 400.0])
def test_floats_out_of_range_stay_out_of_range(wild):
    message = item((WireItem(16, 3, (0.0,) * 4, 0, 0, 0.0),), 0, in_integers=False)
    message.x, message.y = wild, -wild
    decoded = decode_item(message)
    assert decoded.x * wild > 0 > decoded.y * wild
    assert abs(decoded.x) > 180e7
    assert NOT_GIVEN not in {decoded.x, decoded.y}
