"""The socket between an application and its autopilot: the senders that it receives from."""

import contextlib
import random
import socket

import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from autopilot.process.autopilot_socket import AutopilotSocket

HOST = "127.0.0.1"
SYSTEM = 2


def datagram(number=0, *, system=SYSTEM, component=1):
    message = common.MAVLink_local_position_ned_message(number, *[0.0] * 6)
    return Encoder(system=system, component=component).encode(message)


@pytest.fixture
def peer():
    with contextlib.ExitStack() as stack:

        def make():
            sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            sock.bind((HOST, 0))
            sock.settimeout(0.0)
            return sock

        yield make


@pytest.fixture
def opened():
    with contextlib.ExitStack() as stack:

        def make(remote=None):
            made = AutopilotSocket((HOST, 0), remote, system=SYSTEM)
            stack.callback(made.close)
            return made, made._socket.getsockname()

        yield make


def numbers(messages):
    return [message.time_boot_ms for message in messages]


def test_the_first_sender_of_the_autopilots_messages_is_connected(peer, opened):
    made, address = opened()
    autopilot, other = peer(), peer()
    made.send(b"lost: there is no autopilot")
    autopilot.sendto(datagram(1), address)
    assert numbers(made.receive()) == [1]
    made.send(b"sent")
    assert autopilot.recv(100) == b"sent"
    other.sendto(datagram(2), address)
    autopilot.sendto(datagram(3), address)
    assert numbers(made.receive()) == [3]


def test_foreign_datagrams_before_it_connect_nothing(peer, opened):
    made, address = opened()
    autopilot, other = peer(), peer()
    generator = random.Random(2)  # noqa: S311
    foreign = [datagram(7, system=SYSTEM + 1), datagram(7, component=190), datagram(7)[:-1], b""]
    for data in [*foreign, *(generator.randbytes(200) for _ in range(50))]:
        other.sendto(data, address)
    assert made.receive() == []
    made.send(b"lost")
    autopilot.sendto(datagram(1), address)
    assert numbers(made.receive()) == [1]
    assert made.parser.bad_bytes == 0
    with pytest.raises(BlockingIOError):
        other.recv(100)


def test_foreign_datagrams_that_wait_behind_the_first_one_are_not_received(peer, opened):
    made, address = opened()
    autopilot, other = peer(), peer()
    autopilot.sendto(datagram(1), address)
    other.sendto(datagram(2), address)
    autopilot.sendto(datagram(3), address)
    assert numbers(made.receive()) == [1, 3]


def test_a_socket_with_a_remote_address_receives_from_it_alone(peer, opened):
    autopilot, other = peer(), peer()
    made, address = opened(autopilot.getsockname())
    made.send(b"first")
    assert autopilot.recv(100) == b"first"
    other.sendto(datagram(2), address)
    autopilot.sendto(datagram(3), address)
    assert numbers(made.receive()) == [3]


def test_an_autopilot_that_has_ended_causes_no_error(peer, opened):
    made, address = opened()
    autopilot = peer()
    autopilot.sendto(datagram(1), address)
    made.receive()
    autopilot.close()
    for _ in range(3):
        made.send(b"lost")
        assert made.receive() == []


def test_an_address_in_use_is_an_error(peer):
    with pytest.raises(OSError, match="in use"):
        AutopilotSocket(peer().getsockname(), None, system=SYSTEM)
