"""Iterations of applications beside PX4s: when they are requested, and what ends them."""

import socket
import threading
import time

import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from autopilot.process.iteration import Iterate, Iterated
from foundation.processes.message_stream import MessageStream
from harness.simulator.application_links import CLOSED, POLL_S, ApplicationLinks
from harness.simulator.response_watchdog import ResponseWatchdog

PERIOD_US, STEP_US = 40_000, 4_000
LIMIT_S = 1.0


class Swarm:
    """Links to applications 0 and 2, whose ends are served by the test."""

    def __init__(self):
        pairs = {instance: socket.socketpair() for instance in (0, 2)}
        self.ends = {instance: ends[1] for instance, ends in pairs.items()}
        self.applications = {
            instance: MessageStream(end, Iterate, limit_s=0.05) for instance, end in self.ends.items()
        }
        self.messages, self.silent, self.lost = [], [], []
        self.links = ApplicationLinks(
            {instance: ends[0] for instance, ends in pairs.items()},
            period_us=PERIOD_US,
            watchdog=ResponseWatchdog(LIMIT_S),
            on_message=lambda instance, message: self.messages.append((instance, message)),
            on_silent=lambda instance, _: self.silent.append(instance),
            on_lost=lambda instance, reason: self.lost.append((instance, reason)),
        )

    def requests(self):
        """Return the request that each application has received, if any."""
        found = {}
        for instance, line in self.applications.items():
            try:
                found[instance] = line.receive()
            except TimeoutError:
                continue
        return found

    def answer(self, instance, *, handed_over=False, reports=b""):
        result = Iterated(handed_over=handed_over, reports=reports)
        self.applications[instance].send(result)

    def close(self):
        self.links.close()
        for end in self.ends.values():
            end.close()


@pytest.fixture
def swarm():
    made = Swarm()
    yield made
    made.close()


def test_iterations_begin_at_the_multiples_of_the_loops_period(swarm):
    for time_us in range(PERIOD_US, 2 * PERIOD_US, STEP_US):
        swarm.links.begin(time_us, (), ())
        if time_us == PERIOD_US:
            swarm.answer(0, handed_over=True)
            swarm.answer(2)
        assert swarm.links.finish(()) == ((0,) if time_us == PERIOD_US else ())
    assert swarm.requests() == {i: Iterate(time_us=PERIOD_US) for i in (0, 2)}
    assert swarm.requests() == {}


def test_a_delivery_between_two_iterations_is_announced_with_the_next_one(swarm):
    released_us = PERIOD_US - 3 * STEP_US
    swarm.links.begin(released_us - STEP_US, (0, 1), ())
    swarm.links.begin(released_us, (0, 1), ())
    swarm.links.begin(PERIOD_US, (2,), ())
    assert swarm.requests() == {
        0: Iterate(time_us=PERIOD_US, released_us=released_us),
        2: Iterate(time_us=PERIOD_US, released_us=PERIOD_US),
    }
    for instance in (0, 2):
        swarm.answer(instance)
    swarm.links.finish(())
    swarm.links.begin(2 * PERIOD_US, (), ())
    assert {request.released_us for request in swarm.requests().values()} == {0}


def test_readings_between_two_iterations_are_sent_with_the_next_one_and_once(swarm):
    swarm.links.begin(STEP_US, (), (), {0: b"a", 1: b"x"})
    swarm.links.begin(2 * STEP_US, (), (), {0: b"b", 2: b"c"})
    swarm.links.begin(PERIOD_US, (), (), {2: b"d"})
    assert {instance: each.readings for instance, each in swarm.requests().items()} == {0: b"ab", 2: b"cd"}
    for instance in (0, 2):
        swarm.answer(instance)
    swarm.links.finish(())
    swarm.links.begin(2 * PERIOD_US, (), ())
    assert {instance: each.readings for instance, each in swarm.requests().items()} == {0: b"", 2: b""}


def test_reports_are_passed_on_with_their_vehicle(swarm):
    beat = common.MAVLink_heartbeat_message(18, 8, 0, 5, 4, 3)
    swarm.links.begin(PERIOD_US, (), ())
    swarm.answer(0)
    swarm.answer(2, reports=Encoder(system=3, component=191).encode(beat))
    swarm.links.finish(())
    ((instance, message),) = swarm.messages
    assert (instance, message.custom_mode, message.get_srcComponent()) == (2, 5, 191)


def test_the_application_of_a_lost_vehicle_rests(swarm):
    swarm.links.begin(PERIOD_US, (), (0,))
    swarm.answer(2)
    assert swarm.links.finish(()) == ()
    assert swarm.requests().keys() == {2}


def test_an_application_that_ends_is_lost_and_the_others_continue(swarm):
    swarm.links.begin(PERIOD_US, (), ())
    swarm.ends[0].close()
    swarm.answer(2, handed_over=True)
    assert swarm.links.finish(()) == (2,)
    assert swarm.lost == [(0, CLOSED)]
    swarm.links.begin(2 * PERIOD_US, (0,), ())
    swarm.answer(2)
    assert swarm.links.finish(()) == ()
    assert len(swarm.lost) == 1


def test_an_application_that_ended_with_its_vehicle_is_not_lost_itself(swarm):
    """The vehicle was lost after the request, in the same step."""
    swarm.links.begin(PERIOD_US, (), ())
    swarm.ends[0].close()
    swarm.answer(2)
    assert swarm.links.finish((0,)) == ()
    assert swarm.lost == []


def test_an_application_that_hangs_is_reported_and_given_up_after_the_limit(swarm):
    swarm.links.begin(PERIOD_US, (), ())
    swarm.answer(2)
    begin_s = time.monotonic()
    swarm.links.finish(())
    assert time.monotonic() - begin_s >= LIMIT_S
    assert swarm.silent == [0]
    ((instance, reason),) = swarm.lost
    assert instance == 0
    assert "has not answered for" in reason
    assert swarm.links.check((0, 2)) == (0,)


def test_a_late_answer_is_waited_for(swarm):
    late_s = POLL_S + 0.1
    thread = threading.Timer(late_s, swarm.answer, args=(0,), kwargs={"handed_over": True})
    swarm.links.begin(PERIOD_US, (), ())
    swarm.answer(2)
    thread.start()
    begin_s = time.monotonic()
    assert swarm.links.finish(()) == (0,)
    assert time.monotonic() - begin_s >= POLL_S
    thread.join(10.0)
    assert swarm.lost == []
