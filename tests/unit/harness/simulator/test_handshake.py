"""Handshake: which connection gets which vehicle's slot, and when the lockstep begins."""

import contextlib
import socket

import numpy as np
import pytest
from lockstep_vehicles import actuators, introduced, introduction, linked_locksteps, sensors

from autopilot.mavlink.codec import Encoder
from harness.simulator.lockstep import CLOSED, ConnectTimeout, Lockstep
from harness.simulator.response_watchdog import (
    ResponseWatchdog,
)


@pytest.fixture
def linked():
    with linked_locksteps() as make:
        yield make


def test_vehicles_that_do_not_connect_are_named():
    listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep(dict(enumerate(listeners)), watchdog=ResponseWatchdog(1.0), **nothing)
    with (
        introduced(listeners[1], 1),
        pytest.raises(ConnectTimeout, match="uav 0, 2 within"),
    ):
        lockstep.connect(0.2, keep_waiting=lambda: True)
    lockstep.close()


def test_an_interrupted_handshake_continues_with_the_missing_vehicles():
    listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep(dict(enumerate(listeners)), watchdog=ResponseWatchdog(1.0), **nothing)
    with contextlib.closing(lockstep), introduced(listeners[1], 1):
        lockstep.connect(5.0, keep_waiting=lambda: lockstep.living < 1)
        assert [slot.alive for slot in lockstep.slots] == [False, True]
        with introduced(listeners[0], 0):
            lockstep.connect(5.0, keep_waiting=lambda: True)
            assert lockstep.living == 2


def test_a_vehicle_that_introduces_itself_after_an_interruption_is_accepted_by_the_next_handshake():
    listener = socket.create_server(("127.0.0.1", 0))
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep({0: listener}, watchdog=ResponseWatchdog(1.0), **nothing)
    with contextlib.closing(lockstep), socket.create_connection(listener.getsockname()) as vehicle:
        waits = iter([True, True, False])
        lockstep.connect(5.0, keep_waiting=lambda: next(waits))
        assert lockstep.living == 0
        vehicle.sendall(introduction(0))
        lockstep.connect(5.0, keep_waiting=lambda: True)
        assert lockstep.living == 1


def test_strangers_before_and_after_the_vehicle_change_nothing():
    """The vehicle gets its slot whatever the strangers send and though they connect before it."""
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
    address = listener.getsockname()
    nothing = {"on_silent": None, "on_lost": None}
    lockstep = Lockstep(
        {0: listener},
        watchdog=ResponseWatchdog(1.0),
        on_message=lambda *message: messages.append(message),
        **nothing,
    )
    with contextlib.ExitStack() as stack:
        stack.callback(lockstep.close)

        def stranger(data):
            sock = stack.enter_context(socket.create_connection(address))
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
        with pytest.raises(ConnectionRefusedError):  # its slot is filled
            stranger(introduction(0))
        for time_us in (4_000, 8_000):
            lockstep.send([sensors(time_us)])
            assert vehicle.recv(4096) == sensors(time_us)
            vehicle.sendall(Encoder(system=1, component=1).encode(actuators(time_us)))
            assert lockstep.receive(time_us).answered_us.tolist() == [time_us]
    assert messages == []  # the introduction is not passed on either


def test_vehicles_with_a_link_need_no_handshake_beside_one_that_connects(linked):
    """Two vehicles have inherited sockets, one connects by TCP; bytes and losses are the same."""
    lockstep, clients, listeners, messages, lost = linked(3, by_tcp=[0])
    assert [slot.alive for slot in lockstep.slots] == [False, True, True]
    with introduced(listeners[0], 0) as first:
        lockstep.connect(5.0, keep_waiting=lambda: True)
        every_client = {0: first, **clients}
        frames = [b"first", b"second", b"third"]
        lockstep.send(frames)
        for i, client in every_client.items():
            assert client.recv(64) == frames[i]
            client.sendall(Encoder(system=i + 1, component=1).encode(actuators(4_000)))
        assert lockstep.receive(4_000).answered_us.tolist() == [4_000] * 3
        clients[1].close()
        lockstep.send(frames)
        for i in (0, 2):
            every_client[i].sendall(Encoder(system=i + 1, component=1).encode(actuators(8_000)))
        assert lockstep.receive(8_000).answered_us.tolist() == [8_000, 0, 8_000]
        lockstep.close()
        assert clients[2].recv(64) == b"third"
        assert clients[2].recv(64) == b""
    assert messages == []
    assert lost == [(1, CLOSED)]


def test_vehicles_with_links_alone_are_connected_from_the_start(linked):
    lockstep, clients, *_ = linked(2)
    lockstep.connect(0.0, keep_waiting=lambda: True)
    assert lockstep.living == 2
    lockstep.send([b"sensors"] * 2)
    assert [client.recv(64) for client in clients.values()] == [b"sensors"] * 2


def test_a_linked_vehicle_that_ended_before_its_first_message_is_lost_in_the_first_step(linked):
    lockstep, clients, _, _, lost = linked(2)
    clients[0].close()
    lockstep.connect(0.0, keep_waiting=lambda: True)
    lockstep.send([sensors(4_000)] * 2)
    clients[1].sendall(Encoder(system=2, component=1).encode(actuators(4_000)))
    assert lockstep.receive(4_000).answered_us.tolist() == [0, 4_000]
    assert lost == [(0, CLOSED)]


def test_a_listener_is_closed_when_its_vehicle_has_arrived(linked):
    lockstep, _, listeners, *_ = linked(2, by_tcp=[0, 1])
    address = listeners[0].getsockname()
    with introduced(listeners[0], 0):
        lockstep.connect(5.0, keep_waiting=lambda: lockstep.living < 1)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(address, 5.0)
        assert listeners[1].fileno() >= 0


class OnlyFrom:
    """A guard that admits the connections of some addresses, and notes how many it examines at once."""

    def __init__(self):
        self.addresses, self.examined = [], []

    def admits(self, connections):
        self.examined.append(len(connections))
        return [connection.getpeername() in self.addresses for _, connection in connections]

    def admits_sender(self, *_):
        return True


def test_a_connection_that_the_guard_rejects_is_closed_unread_and_the_vehicle_takes_the_slot():
    guard, listener = OnlyFrom(), socket.create_server(("127.0.0.1", 0))
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep({0: listener}, watchdog=ResponseWatchdog(1.0), guard=guard, **nothing)
    with contextlib.ExitStack() as stack:
        stack.callback(lockstep.close)
        thief = stack.enter_context(introduced(listener, 0))  # the first, with the vehicle's number
        vehicle = stack.enter_context(introduced(listener, 0))
        guard.addresses.append(vehicle.getsockname())
        lockstep.connect(5.0, keep_waiting=lambda: True)
        thief.settimeout(5.0)
        with contextlib.suppress(ConnectionResetError):
            assert thief.recv(1) == b""
        lockstep.send([b"sensors"])
        assert vehicle.recv(64) == b"sensors"


def test_a_hundred_idle_connections_delay_no_start():
    """Without a guard too: each is pending until it is replaced by later ones."""
    listener = socket.create_server(("127.0.0.1", 0), backlog=128)
    nothing = {"on_message": None, "on_silent": None, "on_lost": None}
    lockstep = Lockstep({0: listener}, watchdog=ResponseWatchdog(1.0), **nothing)
    with contextlib.ExitStack() as stack:
        stack.callback(lockstep.close)
        for _ in range(50):
            stack.enter_context(socket.create_connection(listener.getsockname(), 5.0))
        stack.enter_context(introduced(listener, 0))
        for _ in range(50):
            stack.enter_context(socket.create_connection(listener.getsockname(), 5.0))
        lockstep.connect(5.0, keep_waiting=lambda: True)  # half of the time that each could keep
        assert lockstep.living == 1
