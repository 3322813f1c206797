"""Lockstep: a step waits for every living vehicle's answer, and reports those that are lost."""

import errno
import signal
import subprocess
import sys
import threading
import time

import pytest
from lockstep_vehicles import Vehicles, actuators, introduced, introduction, linked_locksteps, sensors
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Encoder
from harness.simulator.lockstep import CLOSED
from harness.simulator.response_watchdog import (
    LOOK_AFTER_S,
    REPORT_AFTER_S,
)


@pytest.fixture
def vehicles():
    made = []

    def make(*args, **kwargs):
        made.append(Vehicles(*args, **kwargs))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def linked():
    with linked_locksteps() as make:
        yield make


def test_all_answers_of_the_step_are_returned_and_stale_ones_are_not(vehicles):
    three = vehicles(3)
    for i in range(3):
        three.answering(i, lag=4000 if i == 1 else 0)
    for time_us in (4000, 8000, 12_000):
        assert three.exchange(time_us, [sensors(time_us)] * 3) == [time_us] * 3
    assert three.lost == []


def test_other_messages_are_passed_on_before_the_answer_counts(vehicles):
    one = vehicles(1)
    one.answering(0, before=[mavlink.MAVLink_heartbeat_message(2, 12, 129, 0, 4, 3)])
    one.exchange(4000, [sensors(4000)])
    assert one.messages == [(0, "HEARTBEAT")]


def test_a_closed_connection_is_lost_at_once_and_the_others_continue(vehicles):
    two = vehicles(2)
    two.answering(0)
    two.clients[1].close()
    assert two.exchange(4000, [sensors(4000)] * 2) == [4000, 0]
    assert two.lost == [(1, "its connection closed")]
    assert two.exchange(8000, [sensors(8000), None]) == [8000, 0]


def test_a_sleeping_vehicle_is_reported_and_given_up_after_its_limit(vehicles):
    one = vehicles(1, limit_s=0.3)
    one.answering(0)
    one.exchange(4000, [sensors(4000)])  # answered once, so the limit of the start no longer applies
    before = time.monotonic()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as sleeper:
        one.watchdog.set_pid(0, sleeper.pid)
        one.exchange(8000, [b"\x00"])  # no message to answer
    assert one.silent == [0]
    assert one.lost[0][0] == 0
    assert "has not answered" in one.lost[0][1]
    assert time.monotonic() - before >= REPORT_AFTER_S


def test_a_stopped_process_is_given_up_whatever_the_limit(vehicles):
    one = vehicles(1, limit_s=600.0)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        try:
            process.send_signal(signal.SIGSTOP)
            one.watchdog.set_pid(0, process.pid)
            one.exchange(4000, [sensors(4000)])
        finally:
            process.send_signal(signal.SIGCONT)
    assert one.lost == [(0, "its process is stopped")]
    assert one.silent == [0]


def test_the_others_are_received_and_checked_while_one_is_silent(vehicles):
    """Wherever the silent vehicle is: a dead one is detected, and the answers of the rest are not lost."""
    four = vehicles(4, limit_s=600.0)
    for i in (0, 2):
        four.answering(i)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        four.watchdog.set_pid(3, process.pid)
        process.send_signal(signal.SIGSTOP)
        threading.Timer(LOOK_AFTER_S, four.clients[1].close).start()
        try:
            answers = four.exchange(4000, [sensors(4000)] * 4)
        finally:
            process.send_signal(signal.SIGCONT)
    assert four.lost == [(1, "its connection closed"), (3, "its process is stopped")] or four.lost == [
        (3, "its process is stopped"),
        (1, "its connection closed"),
    ]
    assert answers == [4000, 0, 4000, 0]


class BrokenLink:
    """A link that fails in one of its calls."""

    def __init__(self, link, call, code):
        self._link, self._call, self._error = link, call, OSError(code, "injected")

    def sendall(self, data):
        if self._call == "send":
            raise self._error
        self._link.sendall(data)

    def recv_into(self, _buffer):
        raise self._error

    def recv(self, _size, _flags=0):
        raise self._error

    def close(self):
        self._link.close()


@pytest.mark.parametrize(("call", "reason"), [("send", "its connection broke"), ("receive", CLOSED)])
@pytest.mark.parametrize("code", [errno.EHOSTUNREACH, errno.ENETDOWN, errno.ETIMEDOUT])
def test_an_unreachable_vehicle_is_lost_and_the_others_continue(vehicles, call, reason, code):
    two = vehicles(2)
    two.answering(0)
    slot = two.lockstep.slots[1]
    slot.link = BrokenLink(slot.link, call, code)
    assert two.exchange(4000, [sensors(4000)] * 2) == [4000, 0]
    assert two.lost == [(1, reason)]
    assert two.exchange(8000, [sensors(8000), None]) == [8000, 0]


@pytest.mark.parametrize("call", ["send", "receive"])
def test_an_error_of_the_machine_ends_the_run(vehicles, call):
    """A full disk or an exhausted table of descriptors is no fault of the vehicle."""
    one = vehicles(1)
    slot = one.lockstep.slots[0]
    slot.link = BrokenLink(slot.link, call, errno.ENOSPC)
    with pytest.raises(OSError, match="injected") as raised:
        one.exchange(4000, [sensors(4000)])
    assert raised.value.errno == errno.ENOSPC
    assert one.lost == []


@pytest.mark.parametrize("by_tcp", [[], [0]])
def test_the_last_messages_of_a_closed_connection_are_received_in_the_step_that_loses_it(linked, by_tcp):
    lockstep, clients, listeners, messages, lost = linked(1, by_tcp)
    with introduced(listeners[0], 0) if by_tcp else clients[0] as client:
        lockstep.connect(5.0, keep_waiting=lambda: True)
        client.sendall(introduction(0))
    lockstep.send([sensors(4_000)])
    assert lost == []
    assert lockstep.receive(4_000).answered_us.tolist() == [0]
    assert messages == [(0, "HEARTBEAT")]
    assert lost == [(0, CLOSED)]


def test_a_stopped_vehicle_at_an_inherited_socket_is_given_up(linked):
    lockstep, clients, _, _, lost = linked(1)
    lockstep.connect(5.0, keep_waiting=lambda: True)
    lockstep.send([b"sensors"])
    clients[0].sendall(Encoder(system=1, component=1).encode(actuators(4_000)))
    lockstep.receive(4_000)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        lockstep._watchdog.set_pid(0, process.pid)
        process.send_signal(signal.SIGSTOP)
        lockstep.send([b"sensors"])
        assert lockstep.receive(8_000).answered_us.tolist() == [0]
        process.send_signal(signal.SIGCONT)
    assert lost == [(0, "its process is stopped")]
