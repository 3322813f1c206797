"""Which parameters of a scenario an ArduPilot does not have, from its silence."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from autopilot.mavlink.codec import Encoder
from harness.simulator.parameter_check import MOST_AT_ONCE, PERIOD_US, REQUESTS, ParameterCheck

STORED = 20
"""Requests that ArduPilot stores between two answers; it drops the others."""
BEAT = mavlink.MAVLink_heartbeat_message(2, 3, 1, 0, 3, 3)


def value(name):
    message = mavlink.MAVLink_param_value_message(name.encode("ascii"), 1.0, 9, 900, 0)
    message.pack(mavlink.MAVLink(None, srcSystem=4, srcComponent=1))
    (received,) = mavlink.MAVLink(None).parse_buffer(bytes(message.get_msgbuf()))
    return received


def checking(*names):
    encoder = Encoder(system=200, component=1)
    return ParameterCheck(names, target_system=4, encoder=encoder)


def run(check, known, seconds, begin_us=0):
    """Answer the requests of each period; returns their names by period, and the unknown parameters."""
    rounds, unknown = [], []
    for second in range(seconds):
        now_us = begin_us + second * PERIOD_US
        requests = mavlink.MAVLink(None).parse_buffer(check.requests(now_us)) or []
        assert all((each.target_system, each.target_component) == (4, 1) for each in requests)
        assert check.requests(now_us) == b""  # once a period
        rounds.append([each.param_id for each in requests])
        for name in rounds[-1][:STORED]:
            if name in known:
                check.on_message(value(name), now_us)
        unknown += check.unknown()
    return rounds, unknown


def test_nothing_is_requested_before_the_first_heartbeat():
    check = checking("WP_SPD")
    assert run(check, (), 10) == ([[]] * 10, [])
    check.on_message(BEAT, 10 * PERIOD_US)
    assert run(check, (), 1, 10 * PERIOD_US)[0] == [["WP_SPD"]]


def test_a_parameter_is_requested_until_it_arrives():
    check = checking("WP_SPD", "RTL_ALT")
    check.on_message(BEAT, 0)
    rounds, unknown = run(check, ("WP_SPD",), 2)
    assert rounds == [["WP_SPD", "RTL_ALT"], ["RTL_ALT"]]
    rounds, rest = run(check, ("RTL_ALT",), 20, 2 * PERIOD_US)
    assert rounds == [["RTL_ALT"], *[[]] * 19]
    assert unknown == rest == []


def test_one_that_does_not_arrive_is_unknown_once():
    check = checking("WP_SPD", "NO_SUCH")
    check.on_message(BEAT, 0)
    rounds, unknown = run(check, ("WP_SPD",), 20)
    assert rounds.count(["NO_SUCH"]) == REQUESTS
    assert unknown == ["NO_SUCH"]


def test_a_lost_answer_makes_no_parameter_unknown():
    check = checking("WP_SPD")
    check.on_message(BEAT, 0)
    run(check, (), REQUESTS)
    check.on_message(value("WP_SPD"), REQUESTS * PERIOD_US)
    assert run(check, (), 10, REQUESTS * PERIOD_US) == ([[]] * 10, [])


@pytest.mark.parametrize("count", [1, MOST_AT_ONCE, MOST_AT_ONCE + 1, 300])
def test_any_number_of_parameters_is_checked_without_more_requests_than_are_stored(count):
    names = [f"P{number}" for number in range(count)]
    missing = names[::7]
    check = checking(*names)
    check.on_message(BEAT, 0)
    rounds, unknown = run(check, set(names) - set(missing), 400)
    assert max(map(len, rounds)) <= STORED
    assert sorted(unknown) == sorted(missing)


def test_without_parameters_nothing_is_requested():
    check = checking()
    check.on_message(BEAT, 0)
    assert run(check, (), 10) == ([[]] * 10, [])
