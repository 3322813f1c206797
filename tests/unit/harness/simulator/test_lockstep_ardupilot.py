"""Lockstep with ArduPilots beside other kinds of vehicles: handshake, answers, silence and end."""

import contextlib
import random
import socket
import struct
import threading
import time

import pytest
from px4_stand_in import Manners, StandIn
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Encoder
from harness.simulator import response_watchdog
from harness.simulator.ardupilot_link import ArduPilotLink
from harness.simulator.lockstep import CLOSED, OWN, PX4, ConnectTimeout, Lockstep
from harness.simulator.response_watchdog import ResponseWatchdog

HOST = "127.0.0.1"
STEP_US = 4_000


class Program(threading.Thread):
    """An ArduPilot with 1 us more in its pulses after each state; ``mute_from``: its first missing packet."""

    def __init__(self, system, address, *, mute_from=None, with_link=True):
        super().__init__(daemon=True)
        self.system, self.address, self.mute_from = system, address, mute_from
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.settimeout(0.05)
        self.link = socket.create_connection(address, 5.0) if with_link else None
        self.states = []
        self.ended = threading.Event()

    def run(self):
        encoder = Encoder(system=self.system, component=1)
        if self.link is not None:
            beat = mavlink.MAVLink_heartbeat_message(2, 3, 1, 4, 3, 3)
            self.link.sendall(encoder.encode(beat))
        count = 0
        while not self.ended.is_set():
            if self.mute_from is None or count < self.mute_from:
                packet = struct.pack("<HHI16H", 18_458, 1_200, count, *[1_000 + count] * 16)
                self.sock.sendto(packet, self.address)
            while not self.ended.is_set():
                with contextlib.suppress(TimeoutError, ConnectionError):
                    self.states.append(self.sock.recv(65_000))
                    count += 1
                    break

    def end(self):
        """End as a process does: all its sockets close."""
        self.ended.set()
        self.join(5.0)
        self.sock.close()
        if self.link is not None:
            self.link.close()


class Run:
    """Lockstep with vehicles of the given kinds, and what it reported."""

    def __init__(self, *kinds, limit_s=5.0, **how):
        self.listeners = [socket.create_server((HOST, 0)) for _ in kinds]
        self.messages, self.silent, self.lost = [], [], []
        self.links, self.programs, self.others = {}, {}, {}
        for i, kind in enumerate(kinds):
            if kind == "ardupilot":
                states = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                states.bind(self.listeners[i].getsockname())
                self.links[i] = ArduPilotLink(states, self.listeners[i], system=i + 1)
        self.lockstep = Lockstep(
            {i: each for i, each in enumerate(self.listeners) if i not in self.links},
            watchdog=ResponseWatchdog(limit_s),
            on_message=lambda i, message: self.messages.append((i, message.get_type())),
            on_silent=lambda i, _: self.silent.append(i),
            on_lost=lambda *loss: self.lost.append(loss),
            policies=[PX4 if kind == "px4" else OWN for kind in kinds],
            ardupilots=self.links,
        )
        self.kinds, self.how = kinds, how
        self.time_us = 0

    def address(self, i):
        return self.listeners[i].getsockname()

    def begin(self):
        for i, kind in enumerate(self.kinds):
            if kind == "ardupilot":
                self.programs[i] = Program(i + 1, self.address(i), **self.how)
                self.programs[i].start()
            else:
                other = self.others[i] = StandIn(i, self.address(i)[1], Manners(seed=i))
                other.silence_s *= kind == "px4"
                other.connect()
                threading.Thread(target=other.run, daemon=True).start()
        self.lockstep.connect(5.0, keep_waiting=lambda: True)

    def step(self):
        self.time_us += STEP_US
        line = b'\n{"timestamp":%d}\n' % self.time_us
        sensors = Encoder(system=0, component=1).encode(
            mavlink.MAVLink_hil_sensor_message(self.time_us, *[0.0] * 13, 0x3F, 0)
        )
        self.lockstep.send([line if kind == "ardupilot" else sensors for kind in self.kinds])
        self.inbox = self.lockstep.receive(self.time_us)
        return self.inbox.answered_us.tolist()

    def close(self):
        self.lockstep.close()
        for program in self.programs.values():
            program.end()
        for other in self.others.values():
            other.close()


@pytest.fixture
def run():
    with contextlib.ExitStack() as stack:
        yield lambda *args, **kwargs: stack.enter_context(contextlib.closing(Run(*args, **kwargs)))


def test_ardupilots_answer_each_step_beside_other_vehicles(run):
    mixed = run("ardupilot", "own", "px4", "ardupilot")
    mixed.begin()
    while mixed.lockstep.is_starting(mixed.lockstep.slots[2]):
        answered_us = mixed.step()
        assert [answered_us[i] for i in (0, 1, 3)] == [mixed.time_us] * 3
    for _ in range(60):
        assert mixed.step() == [mixed.time_us] * 4
    steps = mixed.time_us // STEP_US
    for i in (0, 3):
        assert mixed.inbox.controls[i].tolist() == pytest.approx([min(steps / 1_000, 1.0)] * 4)
        assert mixed.inbox.armed[i]
        assert len(mixed.programs[i].states) == steps
    assert mixed.lost == mixed.silent == []
    assert mixed.lockstep.late_answers.keys() == {2}
    # the links' HEARTBEATs are passed on
    assert {(0, "HEARTBEAT"), (3, "HEARTBEAT")} <= set(mixed.messages)


def test_ardupilots_that_do_not_arrive_are_named(run):
    swarm = run("ardupilot", "own", "ardupilot")
    arrived = Program(1, swarm.address(0))
    arrived.start()
    try:
        with pytest.raises(ConnectTimeout, match=r"uav 1, 2 within 0\.3 s"):
            swarm.lockstep.connect(0.3, keep_waiting=lambda: True)
        assert [slot.alive for slot in swarm.lockstep.slots] == [True, False, False]
    finally:
        arrived.end()


def test_a_handshake_that_is_interrupted_continues(run):
    swarm = run("ardupilot", "ardupilot")
    swarm.lockstep.connect(5.0, keep_waiting=iter([True, False]).__next__)
    assert swarm.lockstep.living == 0
    swarm.begin()
    assert swarm.lockstep.living == 2
    assert swarm.step() == [STEP_US] * 2


def test_strangers_at_both_ports_take_no_slot(run):
    swarm = run("ardupilot")
    generator = random.Random(9)  # noqa: S311
    with contextlib.ExitStack() as stack:
        sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        for _ in range(1_000):
            sock.sendto(generator.randbytes(1_000), swarm.address(0))
            data = generator.randbytes(38)
            sock.sendto(struct.pack("<H", 18_458) + data + b"\0", swarm.address(0))
        for _ in range(40):
            stranger = stack.enter_context(socket.create_connection(swarm.address(0), 5.0))
            stranger.sendall(generator.randbytes(1_000))
        with pytest.raises(ConnectTimeout):
            swarm.lockstep.connect(0.3, keep_waiting=lambda: True)
        swarm.begin()
        for _ in range(200):
            assert swarm.step() == [swarm.time_us]
    assert (0, "HEARTBEAT") in swarm.messages
    assert swarm.lost == []


def test_one_that_is_mute_is_lost_and_the_others_go_on(run):
    swarm = run("own", "ardupilot", limit_s=0.5, mute_from=20)
    swarm.begin()
    while not swarm.lost:
        assert swarm.step()[0] == swarm.time_us
        assert swarm.time_us < 100 * STEP_US
    ((instance, reason),) = swarm.lost
    assert instance == 1
    assert "has not answered" in reason
    assert swarm.time_us == 20 * STEP_US
    assert swarm.step() == [swarm.time_us, 0]


def test_one_without_an_answer_to_its_first_state_is_lost_after_the_limit_of_a_start(run, monkeypatch):
    monkeypatch.setattr(response_watchdog, "STARTING_LIMIT_S", 0.6)
    swarm = run("ardupilot", "own", limit_s=0.1, mute_from=1)
    swarm.begin()
    begin_s = time.monotonic()
    assert swarm.step() == [0, swarm.time_us]
    assert 0.5 < time.monotonic() - begin_s < 5.0
    assert [instance for instance, _ in swarm.lost] == [0]


@pytest.mark.parametrize("with_link", [True, False])
def test_one_that_ends_is_lost_at_once(run, with_link):
    swarm = run("ardupilot", "own", with_link=with_link)
    swarm.begin()
    for _ in range(60):
        swarm.step()
    swarm.programs[0].end()
    begin_s = time.monotonic()
    assert swarm.step() == [0, swarm.time_us]
    assert time.monotonic() - begin_s < 2.0
    assert swarm.lost == [(0, CLOSED)]
    assert swarm.step() == [0, swarm.time_us]


def test_after_closing_all_ports_are_free(run):
    swarm = run("ardupilot", "ardupilot")
    addresses = [swarm.address(i) for i in range(2)]
    swarm.begin()
    swarm.step()
    swarm.close()
    for address in addresses:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(address)
