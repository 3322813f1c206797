"""Vehicles at the listeners of a lockstep: connections that introduce themselves and answer."""

import contextlib
import socket
import threading
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Encoder, Parser
from harness.simulator.lockstep import Lockstep
from harness.simulator.response_watchdog import (
    ResponseWatchdog,
)


class Vehicles:
    """Listeners, lockstep and what it reported."""

    def __init__(self, count, limit_s=1.0):
        self.listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
        self.watchdog = ResponseWatchdog(limit_s)
        self.messages, self.silent, self.lost = [], [], []
        self.lockstep = Lockstep(
            dict(enumerate(self.listeners)),
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


class Linked(NamedTuple):
    """A lockstep with vehicles at inherited sockets, and others at TCP listeners."""

    lockstep: Lockstep
    clients: dict[int, socket.socket]
    """The vehicles' ends of the inherited sockets."""
    listeners: dict[int, socket.socket]
    messages: list[tuple[int, str]]
    lost: list[tuple[int, str]]


@contextlib.contextmanager
def linked_locksteps():
    """Yield a function that makes a lockstep with the given number of vehicles, some of them at listeners."""
    with contextlib.ExitStack() as stack:

        def make(count, by_tcp=(), policies=()):
            messages, lost = [], []
            listeners = {i: socket.create_server(("127.0.0.1", 0)) for i in by_tcp}
            pairs = {i: socket.socketpair() for i in range(count) if i not in by_tcp}
            lockstep = Lockstep(
                listeners,
                links={i: ours for i, (ours, _) in pairs.items()},
                watchdog=ResponseWatchdog(1.0),
                on_message=lambda i, message: messages.append((i, message.get_type())),
                on_silent=lambda *_: None,
                on_lost=lambda *loss: lost.append(loss),
                policies=policies,
            )
            stack.enter_context(contextlib.closing(lockstep))
            clients = {i: stack.enter_context(theirs) for i, (_, theirs) in pairs.items()}
            for client in clients.values():
                client.settimeout(5.0)
            return Linked(lockstep, clients, listeners, messages, lost)

        yield make
