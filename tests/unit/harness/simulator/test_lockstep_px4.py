"""Lockstep with PX4s, simulated by a stand-in: they are silent at first and sometimes late."""

import contextlib
import socket
import threading
import time

import pytest
from px4_stand_in import Manners, StandIn
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Encoder
from harness.simulator.lockstep import OWN, PX4, STARTING_STEP_S, Lockstep
from harness.simulator.response_watchdog import ResponseWatchdog

STEP_US = 4_000
LATE_AFTER_S = PX4.late_after_s


class Run:
    """Lockstep with stand-ins in threads, and what it reported."""

    def __init__(self, *behaviours, limit_s=5.0, policies=None):
        self.listeners = [socket.create_server(("127.0.0.1", 0)) for _ in behaviours]
        self.messages, self.silent, self.lost = [], [], []
        self.lockstep = Lockstep(
            dict(enumerate(self.listeners)),
            watchdog=ResponseWatchdog(limit_s),
            on_message=lambda i, message: self.messages.append((i, message.get_type())),
            on_silent=lambda i, _: self.silent.append(i),
            on_lost=lambda i, reason: self.lost.append((i, reason)),
            policies=policies or [PX4] * len(behaviours),
        )
        self.px4s = [StandIn(i, self.port(i), each) for i, each in enumerate(behaviours)]
        self.threads = []
        self.time_us = 0

    def port(self, i):
        return self.listeners[i].getsockname()[1]

    def connect(self):
        for px4 in self.px4s:
            px4.connect()
            self.threads.append(threading.Thread(target=px4.run, daemon=True))
            self.threads[-1].start()
        self.lockstep.connect(5.0, keep_waiting=lambda: True)

    def step(self):
        self.time_us += STEP_US
        self.lockstep.send([sensors(self.time_us)] * len(self.px4s))
        self.inbox = self.lockstep.receive(self.time_us)
        return self.inbox.answered_us.tolist()

    def start(self):
        """Step until all have answered; returns the number of steps and their wall time."""
        self.connect()
        begin_s = time.monotonic()
        steps = 0
        while any(slot.alive and self.lockstep.is_starting(slot) for slot in self.lockstep.slots):
            self.step()
            steps += 1
        return steps, time.monotonic() - begin_s

    def close(self):
        self.lockstep.close()
        for px4 in self.px4s:
            px4.close()
        for thread in self.threads:
            thread.join(5.0)


@pytest.fixture
def run():
    with contextlib.ExitStack() as stack:
        yield lambda *args, **kwargs: stack.enter_context(contextlib.closing(Run(*args, **kwargs)))


def sensors(time_us):
    message = mavlink.MAVLink_hil_sensor_message(time_us, *[0.0] * 13, 0x3F, 0)
    return Encoder(system=0, component=1).encode(message)


@pytest.mark.parametrize("count", [1, 3])
def test_steps_wait_for_a_px4_only_after_its_first_answer(run, count):
    px4s = run(*(Manners(seed=seed) for seed in range(count)))
    steps, wall_s = px4s.start()
    # it starts up in wall time, so steps must not be shorter than this limit; on a machine under load they
    # are longer, and fewer
    assert wall_s >= (steps - 1) * STARTING_STEP_S
    assert steps >= 2
    assert wall_s + STARTING_STEP_S >= max(px4.silence_s for px4 in px4s.px4s)
    for _ in range(50):
        assert px4s.step() == [px4s.time_us] * count
    assert px4s.lockstep.late_answers == dict.fromkeys(range(count), 0)
    assert px4s.lost == px4s.silent == []
    # every HIL_SENSOR was sent exactly once while it started
    assert all(px4.sensors == list(range(STEP_US, px4s.time_us + 1, STEP_US)) for px4 in px4s.px4s)


def test_either_first_message_identifies_it_and_the_other_is_passed_on(run):
    orders = set()
    for seed in range(4):
        px4 = run(Manners(seed=seed))
        px4.start()
        orders.update(px4.messages)
        assert len(px4.messages) == 1
    assert orders == {(0, "COMMAND_LONG"), (0, "HEARTBEAT")}


def test_an_answer_that_takes_a_fifth_of_a_second_is_awaited(run):
    px4 = run(Manners(late={20: 0.2}))
    px4.start()
    begin_s = time.monotonic()
    for _ in range(40):
        assert px4.step() == [px4.time_us]
    assert time.monotonic() - begin_s >= 0.2
    assert px4.lockstep.late_answers == {0: 0}


def test_after_a_lost_answer_the_step_continues_with_the_previous_controls(run):
    px4 = run(Manners(lost=(20,), armed_from=5))
    px4.start()
    stale = []
    for _ in range(40):
        begin_s = time.monotonic()
        (answered_us,) = px4.step()
        if answered_us != px4.time_us:
            stale.append((px4.time_us - answered_us, time.monotonic() - begin_s))
            assert px4.inbox.armed.all()
            assert px4.inbox.controls[0, 0] > 0.0
    ((age_us, wall_s),) = stale
    assert age_us == STEP_US
    assert LATE_AFTER_S <= wall_s < LATE_AFTER_S + 0.3
    assert px4.lockstep.late_answers == {0: 1}
    assert px4.lost == []


def test_an_answer_that_arrives_in_the_next_step_sets_the_controls_and_ends_no_wait(run):
    px4 = run(Manners(late={20: 0.5}, armed_from=20))
    px4.start()
    while px4.lockstep.late_answers == {0: 0}:
        px4.step()
    assert px4.inbox.controls[0, 0] == 0.0  # from before it armed
    assert px4.step() == [px4.time_us]  # the late answer arrives, then that of this step
    assert px4.lockstep.late_answers == {0: 1}


def test_answers_in_time_need_no_parser_and_late_ones_do_until_the_next_in_time(run):
    px4 = run(Manners(late={20: 0.5}))
    px4.start()
    needs_parser = px4.lockstep._inbox.states["needs_parser"]
    while px4.lockstep.late_answers == {0: 0}:
        assert px4.step() != [px4.time_us] or not needs_parser.any()
    assert needs_parser.all()
    assert px4.step() == [px4.time_us]
    assert not needs_parser.any()


def test_one_that_stops_answering_is_lost_though_steps_continue(run):
    px4s = run(Manners(mute_from=10), Manners(seed=1), limit_s=1.0)
    px4s.start()
    begin_s = time.monotonic()
    while not px4s.lost:
        assert px4s.step()[1] == px4s.time_us
        assert time.monotonic() - begin_s < 10.0
    ((instance, reason),) = px4s.lost
    assert instance == 0
    assert "has not answered" in reason
    assert px4s.silent == [0]
    # each of its steps took as long as an answer is awaited, not the watchdog's limit
    assert px4s.lockstep.late_answers[0] >= 2
    assert px4s.step()[0] == 0


def test_one_that_ends_during_its_start_or_later_is_lost_at_once(run):
    px4s = run(Manners(), Manners(seed=1))
    px4s.connect()
    px4s.step()
    px4s.px4s[0].close()
    deadline_s = time.monotonic() + 5.0
    while not px4s.lost and time.monotonic() < deadline_s:
        px4s.step()
    assert px4s.lost == [(0, "its connection closed")]
    while px4s.lockstep.is_starting(px4s.lockstep.slots[1]):
        px4s.step()
    px4s.px4s[1].close()
    px4s.step()
    assert [instance for instance, _ in px4s.lost] == [0, 1]


def test_strangers_get_no_slot_and_cause_no_delay(run):
    px4 = run(Manners())
    strangers = [socket.create_connection(("127.0.0.1", px4.port(0))) for _ in range(12)]
    try:
        wrong = Encoder(system=7, component=1).encode(mavlink.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3))
        strangers[0].sendall(b"GET / HTTP/1.1\r\n\r\n")
        strangers[1].sendall(wrong)
        strangers[2].sendall(sensors(STEP_US))
        begin_s = time.monotonic()
        px4.start()
        assert time.monotonic() - begin_s < 5.0
        assert px4.step() == [px4.time_us]
        for stranger in strangers:
            stranger.settimeout(5.0)
            with contextlib.suppress(ConnectionResetError):
                assert stranger.recv(1) == b""
    finally:
        for stranger in strangers:
            stranger.close()


def test_an_own_vehicle_beside_a_px4_is_awaited_from_the_first_step(run):
    mixed = run(Manners(), Manners(), policies=[OWN, PX4])
    mixed.px4s[0].silence_s = 0.0
    mixed.connect()
    while mixed.lockstep.is_starting(mixed.lockstep.slots[1]):
        assert mixed.step()[0] == mixed.time_us
    assert mixed.lockstep.late_answers == {1: 0}
