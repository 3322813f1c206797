"""Vehicles at the listeners of a lockstep: connections that introduce themselves and answer."""

import contextlib
import socket
import threading
import uuid
from typing import NamedTuple

import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot.__main__ import connect_simulator
from autopilot.mavlink.codec import Encoder, Parser
from autopilot.parameters.config import VehiclePorts
from harness.launch.resources import HAS_NAMED_SOCKETS, bind_local
from harness.simulator.lockstep import Lockstep
from harness.simulator.response_watchdog import (
    ResponseWatchdog,
)

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


class Local(NamedTuple):
    """A lockstep with a Unix socket in addition to its TCP ports."""

    lockstep: Lockstep
    listeners: list[socket.socket]
    name: str
    lost: list[tuple[int, str]]


@contextlib.contextmanager
def local_locksteps():
    """Yield a function that makes a lockstep with a Unix socket for a number of vehicles."""
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
