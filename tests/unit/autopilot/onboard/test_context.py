"""What an application may send in one iteration, and what is refused at the call that is wrong."""

import math
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from autopilot.onboard.client.autopilot_client import MOST_MESSAGES, AutopilotClient
from autopilot.onboard.context import MOST_ITEMS, MOST_WARNINGS, Context, Radio
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.parameters.config import Devices, Site
from netsim.wire.messages import Delivery, FtmResult, Sent, Survey, TxBatch, decode, encode

LOOP_US = 40_000


def radio(**settings):
    found = Radio(station=1, stations=3, loop_us=LOOP_US, **settings)
    found.now_us = 1_000_000
    return found


def context(kind="own"):
    client = AutopilotClient(system=2, site=Site(), gps_delay_s=0.12)
    return Context(
        uav=1, plan=FormationPlan(np.zeros((3, 3)), 0.0, None), site=Site(), devices=Devices(),
        loop_period_us=LOOP_US, rng=np.random.default_rng(1), radio=radio(), autopilot=client,
        autopilot_kind=kind,
    )  # fmt: skip


def test_items_are_returned_once_in_their_order_with_numbers_and_times_that_can_be_sent():
    own = radio(port=4000)
    assert own.broadcast(b"all") == 0
    assert own.unicast(np.int64(2), b"one", at_us=np.int64(1_010_000)) == 1
    assert own.range_to(np.uint8(0)) == 2
    items = own.take()
    assert [item.at_us for item in items] == [1_000_000, 1_010_000, 1_000_000]
    assert [item.port for item in items[:2]] == [4000, 4000]
    batch = TxBatch(station=1, now_us=own.now_us, items=items)
    assert decode(TxBatch, encode(batch)) == batch
    assert own.take() == ()


def test_what_is_sent_between_two_iterations_leaves_at_the_next_one():
    own = radio()
    own.broadcast(b"reply")
    own.range_to(0, at_us=1_030_000)
    own.now_us += LOOP_US
    own.broadcast(b"now")
    assert [item.at_us for item in own.take()] == [1_040_000] * 3


def test_results_belong_to_the_program_that_requested_them_and_datagrams_to_its_port():
    programs = [radio(program=number, programs=3, port=4000 + number) for number in range(3)]
    numbers = {each.range_to(0): each for each in programs for _ in range(4)}
    assert len(numbers) == 12
    for seq, requester in numbers.items():
        sent = Sent(destination=0, seq=seq, ended_ns=0, status="expired", attempts=0)
        ranged = FtmResult(
            peer=0, seq=seq, status="timeout", measured_ns=0, ended_ns=0, distance_m=0.0, distance_std_m=0.0,
            rssi_dbm=0.0, round_trips=0, measurements=0,
        )  # fmt: skip
        for item in (sent, ranged):
            assert [each for each in programs if each.is_for(item)] == [requester]
    datagram = Delivery(source=0, seq=0, received_ns=0, rssi_dbm=-60.0, payload=b"", port=4001)
    assert [each.is_for(datagram) for each in programs] == [False, True, False]
    assert all(each.is_for(Survey(ended_ns=0, busy_ns=0)) for each in programs)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda own: own.broadcast("text"), TypeError),
        (lambda own: own.broadcast(bytearray(2)), TypeError),
        (lambda own: own.broadcast(bytes(1473)), ValueError),
        (lambda own: own.broadcast(b"", at_us=999_999), ValueError),
        (lambda own: own.broadcast(b"", at_us=1_040_001), ValueError),
        (lambda own: own.broadcast(b"", at_us=1_000_000.5), TypeError),
        (lambda own: own.unicast(1, b""), ValueError),
        (lambda own: own.unicast(-1, b""), ValueError),
        (lambda own: own.unicast(65_536, b""), ValueError),
        (lambda own: own.unicast("2", b""), TypeError),
        (lambda own: own.range_to(1), ValueError),
        (lambda own: own.range_to(0.5), TypeError),
    ],
)
def test_what_a_radio_cannot_send_is_refused(call, error):
    own = radio()
    with pytest.raises(error):
        call(own)
    assert own.take() == ()


def test_an_iteration_is_bounded():
    own = context()
    for _ in range(MOST_ITEMS):
        own.radio.broadcast(b"")
    with pytest.raises(ValueError, match="more than 10000 transmissions"):
        own.radio.range_to(0)
    for _ in range(MOST_WARNINGS):
        own.warn("again")
    with pytest.raises(ValueError, match="more than 10 warnings"):
        own.warn("again")
    message = common.MAVLink_param_request_read_message(2, 1, b"MPC_XY_P", -1)
    for _ in range(MOST_MESSAGES):
        own.autopilot.send(message)
    with pytest.raises(ValueError, match="more than 1000 messages"):
        own.autopilot.send(message)
    assert len(own.radio.take()) == MOST_ITEMS
    assert own.take_warnings() == ["again"] * MOST_WARNINGS
    own.radio.broadcast(b"")  # the next iteration


@pytest.mark.parametrize(
    ("message", "error"),
    [
        ("take off", TypeError),
        (None, TypeError),
        (common.MAVLink_param_request_read_message("2", 1, b"MPC_XY_P", -1), struct.error),
    ],
)
def test_what_is_no_message_is_refused(message, error):
    with pytest.raises(error):
        context().autopilot.send(message)


def test_the_truth_is_not_available_beside_another_autopilot():
    own = context()
    own.request_truth()
    assert own.needs_truth
    with pytest.raises(ValueError, match="px4 does not pass the true state on"):
        context("px4").request_truth()


@pytest.mark.parametrize(
    "setpoint",
    [
        {},
        {"yaw_rad": 1.0},
        {"pos_ned_m": (0.0, 0.0)},
        {"pos_ned_m": (0.0, 0.0, math.nan)},
        {"vel_ned_m_s": ("1", "2", "down")},
        {"acc_ned_m_s2": 1.0},
        {"pos_ned_m": (0.0, 0.0, 0.0), "yaw_rad": math.inf},
    ],
)
def test_a_setpoint_is_checked_before_the_vehicle_follows_it(setpoint):
    with pytest.raises(ValueError, match="expected"):
        context().autopilot.fly(**setpoint)
