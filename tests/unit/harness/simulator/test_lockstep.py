"""The rendezvous of a step: every living vehicle's answer is waited for, and whoever is gone is named."""

import contextlib
import queue
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import psutil
import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot.__main__ import SimulatorUnreachable, connect_simulator
from autopilot.mavlink.codec import Encoder, Parser
from autopilot.parameters.config import VehiclePorts
from foundation.processes.child_protocol import Stop
from harness.launch.resources import HAS_NAMED_SOCKETS, bind_local
from harness.simulator.lockstep import CLOSED, OWN, PX4, ConnectTimeout, Lockstep
from harness.simulator.messages import RunUntil, SetAttenuation
from harness.simulator.response_watchdog import (
    COMPUTING_LIMIT_S,
    LOOK_AFTER_S,
    REPORT_AFTER_S,
    ResponseWatchdog,
)
from harness.simulator.server import obey

by_name = pytest.mark.skipif(not HAS_NAMED_SOCKETS, reason="Unix sockets' names are files' here")


class Vehicles:
    """Listeners, lockstep and what it reported."""

    def __init__(self, count, limit_s=1.0):
        self.listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
        self.patience = ResponseWatchdog(limit_s)
        self.messages, self.silent, self.lost = [], [], []
        self.lockstep = Lockstep(
            self.listeners,
            patience=self.patience,
            on_message=lambda i, message: self.messages.append((i, message.get_type())),
            on_silent=lambda i, _: self.silent.append(i),
            on_lost=lambda i, reason: self.lost.append((i, reason)),
        )
        self.clients = [introduced(listener, i) for i, listener in enumerate(self.listeners)]
        self.lockstep.connect(5.0, keep_waiting=lambda: True)

    def answering(self, i, *, lag=0, before=()):
        """A thread that answers each HIL_SENSOR with its time stamp.

        After other messages and a stale answer if asked.
        """

        def run():
            parser, encoder = Parser(), Encoder(system=i + 1, component=1)
            with contextlib.suppress(OSError):  # the test is over
                while data := self.clients[i].recv(4096):
                    for sensor in parser.push(data):
                        stale = [actuators(sensor.time_usec - lag)] if lag else []
                        for message in (*before, *stale, actuators(sensor.time_usec)):
                            self.clients[i].sendall(encoder.encode(message))

        threading.Thread(target=run, daemon=True).start()

    def exchange(self, time_us, frames):
        """Send the sensors of a step and wait for the answers; their times, 0 for none."""
        self.lockstep.send(frames)
        return self.lockstep.answers(time_us).answered_us.tolist()

    def close(self):
        self.lockstep.close()
        for client in self.clients:
            client.close()


@pytest.fixture
def vehicles():
    made = []

    def make(*args, **kwargs):
        made.append(Vehicles(*args, **kwargs))
        return made[-1]

    yield make
    for each in made:
        each.close()


def introduced(listener, i):
    """Connect as vehicle i does."""
    client = socket.create_connection(listener.getsockname())
    client.sendall(introduction(i))
    return client


def introduction(i):
    return Encoder(system=i + 1, component=1).encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3))


def actuators(time_us):
    return mavlink.MAVLink_hil_actuator_controls_message(time_us, [0.5] * 16, 129, 1)


def sensors(time_us):
    message = mavlink.MAVLink_hil_sensor_message(time_us, *[0.0] * 13, 0x3F, 0)
    return Encoder(system=0, component=1).encode(message)


def test_all_answers_of_the_step_come_back_and_stale_ones_do_not(vehicles):
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


def test_a_closed_connection_is_lost_at_once_and_the_others_go_on(vehicles):
    two = vehicles(2)
    two.answering(0)
    two.clients[1].close()
    assert two.exchange(4000, [sensors(4000)] * 2) == [4000, 0]
    assert two.lost == [(1, "its connection closed")]
    assert two.exchange(8000, [sensors(8000), None]) == [8000, 0]


def test_a_sleeping_vehicle_is_reported_and_given_up_after_its_limit(vehicles):
    one = vehicles(1, limit_s=0.3)
    one.answering(0)
    one.exchange(4000, [sensors(4000)])  # it works, so the long patience of the start is over
    before = time.monotonic()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as sleeper:
        one.patience.set_pid(0, sleeper.pid)
        one.exchange(8000, [b"\x00"])  # nothing it could answer
    assert one.silent == [0]
    assert one.lost[0][0] == 0
    assert "has not answered" in one.lost[0][1]
    assert time.monotonic() - before >= REPORT_AFTER_S


def test_a_stopped_process_is_given_up_within_a_second_whatever_the_limit(vehicles):
    one = vehicles(1, limit_s=600.0)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        try:
            process.send_signal(signal.SIGSTOP)
            one.patience.set_pid(0, process.pid)
            one.exchange(4000, [sensors(4000)])
        finally:
            process.send_signal(signal.SIGCONT)
    assert one.lost == [(0, "its process is stopped")]
    assert one.silent == [0]


def test_who_does_not_connect_is_named():
    listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep(listeners, patience=ResponseWatchdog(1.0), **nothing)
    with (
        introduced(listeners[1], 1),
        pytest.raises(ConnectTimeout, match="uav 0, 2 within"),
    ):
        lockstep.connect(0.2, keep_waiting=lambda: True)
    lockstep.close()


def test_a_rendezvous_that_was_cut_short_goes_on_with_those_who_are_missing():
    listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep(listeners, patience=ResponseWatchdog(1.0), **nothing)
    with contextlib.closing(lockstep), introduced(listeners[1], 1):
        lockstep.connect(5.0, keep_waiting=lambda: lockstep.living < 1)
        assert [seat.alive for seat in lockstep.seats] == [False, True]
        with introduced(listeners[0], 0):
            lockstep.connect(5.0, keep_waiting=lambda: True)
            assert lockstep.living == 2


def test_who_has_connected_but_not_spoken_when_the_rendezvous_is_cut_short_is_heard_in_the_next():
    listener = socket.create_server(("127.0.0.1", 0))
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep([listener], patience=ResponseWatchdog(1.0), **nothing)
    with contextlib.closing(lockstep), socket.create_connection(listener.getsockname()) as vehicle:
        looks = iter([True, True, False])
        lockstep.connect(5.0, keep_waiting=lambda: next(looks))
        assert lockstep.living == 0
        vehicle.sendall(introduction(0))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        assert lockstep.living == 1


def test_strangers_before_and_after_the_vehicle_change_nothing():
    """Whatever they do, and though the first of them is there before it: the seat is whose it is."""
    rng = np.random.default_rng(7)
    words = [
        b"",
        b"GET / HTTP/1.1\r\n\r\n",
        rng.bytes(20_000),
        b"\xfe" * 20_000,
        sensors(4_000),
        Encoder(system=1, component=1).encode(actuators(4_000)),  # an answer is no introduction
        introduction(1),  # of another
    ]
    said = []
    listener = socket.create_server(("127.0.0.1", 0))
    nothing = {"on_silent": None, "on_lost": None}
    lockstep = Lockstep(
        [listener], patience=ResponseWatchdog(1.0), on_message=lambda *what: said.append(what), **nothing
    )
    with contextlib.ExitStack() as stack:
        stack.callback(lockstep.close)

        def stranger(first_words):
            sock = stack.enter_context(socket.create_connection(listener.getsockname()))
            sock.settimeout(5.0)
            with contextlib.suppress(OSError):  # it may be sent away while it speaks
                sock.sendall(first_words)
            return sock

        before = [stranger(each) for each in words]
        stranger(b"").close()
        vehicle = stack.enter_context(introduced(listener, 0))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        for sock in before:
            with contextlib.suppress(ConnectionResetError):
                assert sock.recv(1) == b""
        after = [stranger(each) for each in words]
        for time_us in (4_000, 8_000):
            lockstep.send([sensors(time_us)])
            assert vehicle.recv(4096) == sensors(time_us)
            vehicle.sendall(Encoder(system=1, component=1).encode(actuators(time_us)))
            assert lockstep.answers(time_us).answered_us.tolist() == [time_us]
        assert not select.select(after, [], [], 0.0)[0]
    assert said == []  # nor is the introduction passed on


class Rendezvous:
    """Stands for a simulation that has yet to meet its two vehicles: one comes with each time it waits."""

    def __init__(self, inbox):
        self.inbox = inbox
        self.seats = [SimpleNamespace(alive=False) for _ in range(2)]
        self.lockstep = self
        self.time_us = 4_000
        self.any_alive, self.must_end, self.formed = True, False, False
        self.met_at_steps = []

    @property
    def living(self):
        return sum(seat.alive for seat in self.seats)

    def connect(self, wall_timeout_s, *, keep_waiting):
        assert wall_timeout_s == 5.0
        self.seats[self.living].alive = True
        if self.living == 1:
            self.inbox.put(SetAttenuation(extra_attenuation_db=0.0))
            self.inbox.put(RunUntil(time_us=8_000))
            assert not keep_waiting()

    def step(self):
        self.met_at_steps.append(self.living)
        self.time_us += 4_000
        self.inbox.put(Stop())

    def set_extra_attenuation_db(self, value):
        assert value == 0.0

    def settle(self):
        pass

    def notice_collisions(self):
        pass

    def vehicles(self):
        return ()


def test_nobody_flies_before_everybody_has_come_though_a_command_cut_the_waiting_short():
    inbox, said = queue.SimpleQueue(), []
    simulation = Rendezvous(inbox)
    inbox.put(RunUntil(time_us=8_000))
    obey(simulation, inbox, connect_timeout_s=5.0, emit=said.append)
    assert simulation.met_at_steps == [2]
    assert [(event.time_us, event.reason) for event in said] == [(4_000, "command"), (8_000, "time")]


def judge(patience, looks, *, every_s=0.1, starting=False):
    """Judge every 0.1 s of wall time; returns when it was given up, or None.

    ``looks`` are what psutil would say of the vehicle: (status, cpu seconds) at each look.
    """
    script = iter(looks)
    patience._look = lambda _instance: next(script)
    patience.begin(100.0)
    for k in range(1, len(looks) + 1):
        if patience.judge(0, 100.0 + k * every_s, starting=starting).give_up is not None:
            return k * every_s
    return None


def test_a_starved_process_is_waited_for_and_a_sleeping_or_spinning_one_is_not():
    looks = 100
    starved = [(psutil.STATUS_RUNNING, 0.001 * k) for k in range(looks)]
    assert judge(ResponseWatchdog(2.0), starved) is None
    sleeping = [(psutil.STATUS_SLEEPING, 0.0)] * looks
    assert judge(ResponseWatchdog(2.0), sleeping) == pytest.approx(2.4, abs=0.25)
    spinning = [(psutil.STATUS_RUNNING, 0.1 * k) for k in range(looks)]
    assert judge(ResponseWatchdog(2.0), spinning) is None  # within these 10 s
    spinning = [(psutil.STATUS_RUNNING, 0.1 * k) for k in range(10 * looks)]
    assert judge(ResponseWatchdog(2.0), spinning) == pytest.approx(COMPUTING_LIMIT_S + 0.3, abs=0.3)
    assert judge(ResponseWatchdog(2.0), sleeping, starting=True) is None
    assert judge(ResponseWatchdog(2.0), [(psutil.STATUS_ZOMBIE, 0.0)] * looks) == pytest.approx(
        LOOK_AFTER_S, abs=0.11
    )


def test_the_others_are_heard_and_judged_while_one_keeps_silent(vehicles):
    """Whoever is waited for first: a dead one elsewhere is noticed, and answers of the rest are not lost."""
    four = vehicles(4, limit_s=600.0)
    for i in (0, 2):
        four.answering(i)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        four.patience.set_pid(3, process.pid)
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


class Local(NamedTuple):
    """A rendezvous that has a Unix socket beside its TCP ports."""

    lockstep: Lockstep
    listeners: list[socket.socket]
    name: str
    lost: list[tuple[int, str]]


@pytest.fixture
def local():
    with contextlib.ExitStack() as stack:

        def make(count, manners=()):
            name, lost = f"coflight-test-{uuid.uuid4().hex}", []
            listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
            lockstep = Lockstep(
                listeners,
                own_listener=bind_local(name, backlog=16),
                patience=ResponseWatchdog(1.0),
                on_message=lambda *_: None,
                on_silent=lambda *_: None,
                on_lost=lambda *who_and_why: lost.append(who_and_why),
                manners=manners,
            )
            return Local(stack.enter_context(contextlib.closing(lockstep)), listeners, name, lost)

        yield make


def come(name, first_words):
    """Connect to a Unix socket as a vehicle's process does."""
    connection = connect_simulator(VehiclePorts(simulator_unix=name), 1.0)
    connection.settimeout(5.0)
    connection.sendall(first_words)
    return connection


@by_name
def test_a_seat_is_taken_through_either_of_its_doors(local):
    """One comes by TCP, two by the Unix socket that all share; bytes and losses are the same either way."""
    lockstep, listeners, name, lost = local(3)
    with contextlib.ExitStack() as stack:
        last = stack.enter_context(come(name, introduction(2)))
        clients = [
            stack.enter_context(introduced(listeners[0], 0)),
            stack.enter_context(come(name, introduction(1))),
            last,
        ]
        lockstep.connect(5.0, keep_waiting=lambda: True)
        frames = [b"first", b"second", b"third"]
        lockstep.send(frames)
        for i, client in enumerate(clients):
            assert client.recv(64) == frames[i]
            client.sendall(Encoder(system=i + 1, component=1).encode(actuators(4_000)))
        assert lockstep.answers(4_000).answered_us.tolist() == [4_000] * 3
        clients[1].close()
        lockstep.send(frames)
        for i in (0, 2):
            clients[i].sendall(Encoder(system=i + 1, component=1).encode(actuators(8_000)))
        assert lockstep.answers(8_000).answered_us.tolist() == [8_000, 0, 8_000]
        lockstep.close()
        assert last.recv(64) == b"third"
        assert last.recv(64) == b""
    assert lost == [(1, CLOSED)]


@pytest.mark.parametrize("by_unix", [False, pytest.param(True, marks=by_name)])
def test_last_words_of_a_vehicle_that_hung_up_are_heard_in_the_step_that_loses_it(local, by_unix):
    lockstep, (listener,), name, lost = local(1)
    said = []
    lockstep._on_message = lambda i, message: said.append((i, message.get_type()))
    with come(name, introduction(0)) if by_unix else introduced(listener, 0) as client:
        lockstep.connect(5.0, keep_waiting=lambda: True)
        client.sendall(introduction(0))
    lockstep.send([sensors(4_000)])
    assert lost == []
    assert lockstep.answers(4_000).answered_us.tolist() == [0]
    assert said == [(0, "HEARTBEAT")]
    assert lost == [(0, CLOSED)]


@by_name
def test_strangers_at_the_unix_socket_are_sent_away_and_none_takes_a_px4s_seat(local):
    lockstep, listeners, name, _ = local(3, [OWN, PX4, OWN])
    strange_words = [
        b"GET / HTTP/1.1\r\n\r\n",
        sensors(4_000),
        introduction(1),  # of a vehicle whose seat is a PX4's
        introduction(3),  # of one that is not in the run
    ]
    with contextlib.ExitStack() as stack:
        silent = stack.enter_context(come(name, b""))
        strangers = [stack.enter_context(come(name, words)) for words in strange_words]
        stack.enter_context(come(name, introduction(0)))
        stack.enter_context(introduced(listeners[1], 1))
        twin = stack.enter_context(come(name, introduction(0)))  # its seat is taken
        vehicle = stack.enter_context(come(name, introduction(2)))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        for stranger in (silent, *strangers, twin):
            with contextlib.suppress(ConnectionResetError):
                assert stranger.recv(1) == b""
        lockstep.send([b"sensors"] * 3)
        assert vehicle.recv(64) == b"sensors"


@by_name
def test_a_hung_vehicle_at_a_unix_socket_is_reported_and_given_up(local):
    lockstep, _, name, lost = local(1)
    with come(name, introduction(0)) as client:
        lockstep.connect(5.0, keep_waiting=lambda: True)
        lockstep.send([b"sensors"])
        client.sendall(Encoder(system=1, component=1).encode(actuators(4_000)))
        lockstep.answers(4_000)
        with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
            lockstep._patience.set_pid(0, process.pid)
            process.send_signal(signal.SIGSTOP)
            lockstep.send([b"sensors"])
            assert lockstep.answers(8_000).answered_us.tolist() == [0]
            process.send_signal(signal.SIGCONT)
    assert lost == [(0, "its process is stopped")]


@by_name
def test_a_unix_socket_that_nobody_listens_at_is_one_line():
    with pytest.raises(SimulatorUnreachable, match="no simulator at coflight-nobody"):
        come("coflight-nobody", b"")
