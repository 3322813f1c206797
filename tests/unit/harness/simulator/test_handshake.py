"""Handshake: which connection gets which vehicle's slot, and when the lockstep begins."""

import contextlib
import select
import socket

import numpy as np
import pytest
from lockstep_vehicles import (
    actuators,
    by_name,
    connect_local,
    introduced,
    introduction,
    local_locksteps,
    sensors,
)

from autopilot.__main__ import SimulatorUnreachable
from autopilot.mavlink.codec import Encoder
from harness.simulator.lockstep import CLOSED, OWN, PX4, ConnectTimeout, Lockstep
from harness.simulator.response_watchdog import (
    ResponseWatchdog,
)


@pytest.fixture
def local():
    with local_locksteps() as make:
        yield make


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
def test_a_missing_unix_socket_is_an_error_in_one_line():
    with pytest.raises(SimulatorUnreachable, match="no simulator at coflight-missing"):
        connect_local("coflight-missing", b"")
