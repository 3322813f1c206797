"""Lockstep: a step waits for every living vehicle's answer, and reports those that are lost."""

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

by_name = pytest.mark.skipif(not HAS_NAMED_SOCKETS, reason="no abstract Unix sockets on this system")


class Vehicles:
    """Listeners, lockstep and what it reported."""

    def __init__(self, count, limit_s=1.0):
        self.listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
        self.watchdog = ResponseWatchdog(limit_s)
        self.messages, self.silent, self.lost = [], [], []
        self.lockstep = Lockstep(
            self.listeners,
            watchdog=self.watchdog,
            on_message=lambda i, message: self.messages.append((i, message.get_type())),
            on_silent=lambda i, _: self.silent.append(i),
            on_lost=lambda i, reason: self.lost.append((i, reason)),
        )
        self.clients = [introduced(listener, i) for i, listener in enumerate(self.listeners)]
        self.lockstep.connect(5.0, keep_waiting=lambda: True)

    def answering(self, i, *, lag=0, before=()):
        """Answer each HIL_SENSOR with its time stamp in a thread, after other messages and a stale answer."""

        def run():
            parser, encoder = Parser(), Encoder(system=i + 1, component=1)
            with contextlib.suppress(OSError):  # closed at the end of the test
                while data := self.clients[i].recv(4096):
                    for sensor in parser.push(data):
                        stale = [actuators(sensor.time_usec - lag)] if lag else []
                        for message in (*before, *stale, actuators(sensor.time_usec)):
                            self.clients[i].sendall(encoder.encode(message))

        threading.Thread(target=run, daemon=True).start()

    def exchange(self, time_us, frames):
        """Send the sensors of a step and wait for the answers; returns their times, 0 for none."""
        self.lockstep.send(frames)
        return self.lockstep.receive(time_us).answered_us.tolist()

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
    """Connect as vehicle i."""
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


def test_a_stopped_process_is_given_up_within_a_second_whatever_the_limit(vehicles):
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


def test_vehicles_that_do_not_connect_are_named():
    listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep(listeners, watchdog=ResponseWatchdog(1.0), **nothing)
    with (
        introduced(listeners[1], 1),
        pytest.raises(ConnectTimeout, match="uav 0, 2 within"),
    ):
        lockstep.connect(0.2, keep_waiting=lambda: True)
    lockstep.close()


def test_an_interrupted_handshake_continues_with_the_missing_vehicles():
    listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep(listeners, watchdog=ResponseWatchdog(1.0), **nothing)
    with contextlib.closing(lockstep), introduced(listeners[1], 1):
        lockstep.connect(5.0, keep_waiting=lambda: lockstep.living < 1)
        assert [slot.alive for slot in lockstep.slots] == [False, True]
        with introduced(listeners[0], 0):
            lockstep.connect(5.0, keep_waiting=lambda: True)
            assert lockstep.living == 2


def test_a_vehicle_that_introduces_itself_after_an_interruption_is_accepted_by_the_next_handshake():
    listener = socket.create_server(("127.0.0.1", 0))
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep([listener], watchdog=ResponseWatchdog(1.0), **nothing)
    with contextlib.closing(lockstep), socket.create_connection(listener.getsockname()) as vehicle:
        waits = iter([True, True, False])
        lockstep.connect(5.0, keep_waiting=lambda: next(waits))
        assert lockstep.living == 0
        vehicle.sendall(introduction(0))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        assert lockstep.living == 1


def test_strangers_before_and_after_the_vehicle_change_nothing():
    """The vehicle gets its slot whatever the strangers send and though some connect before it."""
    rng = np.random.default_rng(7)
    inputs = [
        b"",
        b"GET / HTTP/1.1\r\n\r\n",
        rng.bytes(20_000),
        b"\xfe" * 20_000,
        sensors(4_000),
        Encoder(system=1, component=1).encode(actuators(4_000)),  # an answer is no introduction
        introduction(1),  # of another vehicle
    ]
    messages = []
    listener = socket.create_server(("127.0.0.1", 0))
    nothing = {"on_silent": None, "on_lost": None}
    lockstep = Lockstep(
        [listener],
        watchdog=ResponseWatchdog(1.0),
        on_message=lambda *message: messages.append(message),
        **nothing,
    )
    with contextlib.ExitStack() as stack:
        stack.callback(lockstep.close)

        def stranger(data):
            sock = stack.enter_context(socket.create_connection(listener.getsockname()))
            sock.settimeout(5.0)
            with contextlib.suppress(OSError):  # may be closed while it sends
                sock.sendall(data)
            return sock

        before = [stranger(each) for each in inputs]
        stranger(b"").close()
        vehicle = stack.enter_context(introduced(listener, 0))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        for sock in before:
            with contextlib.suppress(ConnectionResetError):
                assert sock.recv(1) == b""
        after = [stranger(each) for each in inputs]
        for time_us in (4_000, 8_000):
            lockstep.send([sensors(time_us)])
            assert vehicle.recv(4096) == sensors(time_us)
            vehicle.sendall(Encoder(system=1, component=1).encode(actuators(time_us)))
            assert lockstep.receive(time_us).answered_us.tolist() == [time_us]
        assert not select.select(after, [], [], 0.0)[0]
    assert messages == []  # the introduction is not passed on either


class ConnectingSimulation:
    """A simulation whose two vehicles are not connected: one connects in each call of `connect`."""

    def __init__(self, inbox):
        self.inbox = inbox
        self.slots = [SimpleNamespace(alive=False) for _ in range(2)]
        self.lockstep = self
        self.time_us = 4_000
        self.any_alive, self.must_end, self.formed = True, False, False
        self.connected_at_steps = []

    @property
    def living(self):
        return sum(slot.alive for slot in self.slots)

    def connect(self, wall_timeout_s, *, keep_waiting):
        assert wall_timeout_s == 5.0
        self.slots[self.living].alive = True
        if self.living == 1:
            self.inbox.put(SetAttenuation(extra_attenuation_db=0.0))
            self.inbox.put(RunUntil(time_us=8_000))
            assert not keep_waiting()

    def step(self):
        self.connected_at_steps.append(self.living)
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


def test_no_step_is_made_before_all_vehicles_are_connected_though_a_command_interrupts_the_wait():
    inbox, events = queue.SimpleQueue(), []
    simulation = ConnectingSimulation(inbox)
    inbox.put(RunUntil(time_us=8_000))
    obey(simulation, inbox, connect_timeout_s=5.0, emit=events.append)
    assert simulation.connected_at_steps == [2]
    assert [(event.time_us, event.reason) for event in events] == [(4_000, "command"), (8_000, "time")]


def given_up_s(watchdog, observations, *, every_s=0.1, starting=False):
    """Check every 0.1 s of wall time; returns when the vehicle was given up, or None.

    ``observations`` are psutil's values for the vehicle at each check: (status, cpu seconds).
    """
    script = iter(observations)
    watchdog._process_state = lambda _instance: next(script)
    watchdog.begin(100.0)
    for k in range(1, len(observations) + 1):
        if watchdog.check(0, 100.0 + k * every_s, starting=starting).give_up is not None:
            return k * every_s
    return None


def test_a_starved_process_is_awaited_and_a_sleeping_or_spinning_one_is_not():
    checks = 100
    starved = [(psutil.STATUS_RUNNING, 0.001 * k) for k in range(checks)]
    assert given_up_s(ResponseWatchdog(2.0), starved) is None
    sleeping = [(psutil.STATUS_SLEEPING, 0.0)] * checks
    assert given_up_s(ResponseWatchdog(2.0), sleeping) == pytest.approx(2.4, abs=0.25)
    spinning = [(psutil.STATUS_RUNNING, 0.1 * k) for k in range(checks)]
    assert given_up_s(ResponseWatchdog(2.0), spinning) is None  # within these 10 s
    spinning = [(psutil.STATUS_RUNNING, 0.1 * k) for k in range(10 * checks)]
    assert given_up_s(ResponseWatchdog(2.0), spinning) == pytest.approx(COMPUTING_LIMIT_S + 0.3, abs=0.3)
    assert given_up_s(ResponseWatchdog(2.0), sleeping, starting=True) is None
    assert given_up_s(ResponseWatchdog(2.0), [(psutil.STATUS_ZOMBIE, 0.0)] * checks) == pytest.approx(
        LOOK_AFTER_S, abs=0.11
    )


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


class Local(NamedTuple):
    """A lockstep with a Unix socket in addition to its TCP ports."""

    lockstep: Lockstep
    listeners: list[socket.socket]
    name: str
    lost: list[tuple[int, str]]


@pytest.fixture
def local():
    with contextlib.ExitStack() as stack:

        def make(count, policies=()):
            name, lost = f"coflight-test-{uuid.uuid4().hex}", []
            listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
            lockstep = Lockstep(
                listeners,
                own_listener=bind_local(name, backlog=16),
                watchdog=ResponseWatchdog(1.0),
                on_message=lambda *_: None,
                on_silent=lambda *_: None,
                on_lost=lambda *loss: lost.append(loss),
                policies=policies,
            )
            return Local(stack.enter_context(contextlib.closing(lockstep)), listeners, name, lost)

        yield make


def connect_local(name, data):
    """Connect to a Unix socket as a vehicle's process does, and send the data."""
    connection = connect_simulator(VehiclePorts(simulator_unix=name), 1.0)
    connection.settimeout(5.0)
    connection.sendall(data)
    return connection


@by_name
def test_a_slot_is_filled_through_either_of_its_listeners(local):
    """One vehicle connects by TCP, two by the shared Unix socket; bytes and losses are the same."""
    lockstep, listeners, name, lost = local(3)
    with contextlib.ExitStack() as stack:
        last = stack.enter_context(connect_local(name, introduction(2)))
        clients = [
            stack.enter_context(introduced(listeners[0], 0)),
            stack.enter_context(connect_local(name, introduction(1))),
            last,
        ]
        lockstep.connect(5.0, keep_waiting=lambda: True)
        frames = [b"first", b"second", b"third"]
        lockstep.send(frames)
        for i, client in enumerate(clients):
            assert client.recv(64) == frames[i]
            client.sendall(Encoder(system=i + 1, component=1).encode(actuators(4_000)))
        assert lockstep.receive(4_000).answered_us.tolist() == [4_000] * 3
        clients[1].close()
        lockstep.send(frames)
        for i in (0, 2):
            clients[i].sendall(Encoder(system=i + 1, component=1).encode(actuators(8_000)))
        assert lockstep.receive(8_000).answered_us.tolist() == [8_000, 0, 8_000]
        lockstep.close()
        assert last.recv(64) == b"third"
        assert last.recv(64) == b""
    assert lost == [(1, CLOSED)]


@pytest.mark.parametrize("by_unix", [False, pytest.param(True, marks=by_name)])
def test_the_last_messages_of_a_closed_connection_are_received_in_the_step_that_loses_it(local, by_unix):
    lockstep, (listener,), name, lost = local(1)
    messages = []
    lockstep._on_message = lambda i, message: messages.append((i, message.get_type()))
    with connect_local(name, introduction(0)) if by_unix else introduced(listener, 0) as client:
        lockstep.connect(5.0, keep_waiting=lambda: True)
        client.sendall(introduction(0))
    lockstep.send([sensors(4_000)])
    assert lost == []
    assert lockstep.receive(4_000).answered_us.tolist() == [0]
    assert messages == [(0, "HEARTBEAT")]
    assert lost == [(0, CLOSED)]


@by_name
def test_strangers_at_the_unix_socket_are_closed_and_none_gets_a_px4s_slot(local):
    lockstep, listeners, name, _ = local(3, [OWN, PX4, OWN])
    inputs = [
        b"GET / HTTP/1.1\r\n\r\n",
        sensors(4_000),
        introduction(1),  # of a vehicle whose slot is a PX4's
        introduction(3),  # of one that is not in the run
    ]
    with contextlib.ExitStack() as stack:
        silent = stack.enter_context(connect_local(name, b""))
        strangers = [stack.enter_context(connect_local(name, data)) for data in inputs]
        stack.enter_context(connect_local(name, introduction(0)))
        stack.enter_context(introduced(listeners[1], 1))
        twin = stack.enter_context(connect_local(name, introduction(0)))  # its slot is filled
        vehicle = stack.enter_context(connect_local(name, introduction(2)))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        for stranger in (silent, *strangers, twin):
            with contextlib.suppress(ConnectionResetError):
                assert stranger.recv(1) == b""
        lockstep.send([b"sensors"] * 3)
        assert vehicle.recv(64) == b"sensors"


@by_name
def test_a_stopped_vehicle_at_a_unix_socket_is_given_up(local):
    lockstep, _, name, lost = local(1)
    with connect_local(name, introduction(0)) as client:
        lockstep.connect(5.0, keep_waiting=lambda: True)
        lockstep.send([b"sensors"])
        client.sendall(Encoder(system=1, component=1).encode(actuators(4_000)))
        lockstep.receive(4_000)
        with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
            lockstep._watchdog.set_pid(0, process.pid)
            process.send_signal(signal.SIGSTOP)
            lockstep.send([b"sensors"])
            assert lockstep.receive(8_000).answered_us.tolist() == [0]
            process.send_signal(signal.SIGCONT)
    assert lost == [(0, "its process is stopped")]


@by_name
def test_a_missing_unix_socket_is_an_error_in_one_line():
    with pytest.raises(SimulatorUnreachable, match="no simulator at coflight-missing"):
        connect_local("coflight-missing", b"")
