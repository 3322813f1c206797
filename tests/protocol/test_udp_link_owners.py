"""The UDP link with owners of sockets and with a budget: what is dropped unread, and what is not sent."""

import contextlib
import select
import socket

import pytest
from other_user import as_other_user, root_only
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.input_budget import InputBudget
from autopilot.mavlink.links import MAX_DROPPED_PER_CALL
from autopilot.mavlink.partners import BROADCAST
from autopilot.mavlink.udp_link import UdpLink
from foundation.processes.socket_owners import DatagramOwners

HERE = "127.0.0.1"
DEADLINE_S = 5.0
OURS, THEIRS = frozenset({0}), frozenset({1_234})


class Owners(DatagramOwners):
    """Owners by port; other ports have no socket."""

    def __init__(self):
        super().__init__(HERE, lambda: "")
        self._uids = OURS
        self.by_port = {}

    def _owners_at(self, address, wall_s):  # noqa: ARG002
        return self.by_port.get(address[1], frozenset())


@pytest.fixture
def sockets():
    with contextlib.ExitStack() as stack:
        yield stack


def bound(stack):
    sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    sock.bind((HERE, 0))
    sock.settimeout(DEADLINE_S)
    return sock, sock.getsockname()[1]


def link_with(stack, remote_port=0, **how):
    encoder = Encoder(system=1, component=1)
    link = UdpLink(host=HERE, local_port=0, remote_port=remote_port, encoder=encoder, **how)
    return stack.enter_context(contextlib.closing(link))


def beat():
    return common.MAVLink_heartbeat_message(2, 12, 29, 0, 3, 3)


def send(sock, link, count=1):
    frame = Encoder(system=255, component=190).encode(beat())
    for _ in range(count):
        sock.sendto(frame, (HERE, link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]


def waiting(sock):
    return bool(select.select([sock], [], [], 0.0)[0])


def test_datagrams_of_another_user_are_counted_and_make_no_partner(sockets):
    owners = Owners()
    link = link_with(sockets, owners=owners)
    (stranger, port), (station, own_port) = bound(sockets), bound(sockets)
    owners.by_port = {port: THEIRS, own_port: OURS}
    send(stranger, link, 3)
    send(station, link)
    assert len(link.receive(0)) == 1
    assert link.counters.datagrams_foreign == 3
    assert link.foreign == (HERE, port)
    link.send([(BROADCAST, beat())])
    assert station.recv(2_048)
    assert not waiting(stranger)


def test_a_sender_that_has_ended_is_foreign(sockets):
    link = link_with(sockets, owners=Owners())
    send(bound(sockets)[0], link)
    assert link.receive(0) == []
    assert not link.active
    assert link.counters.datagrams_foreign == 1


@pytest.mark.parametrize(
    ("owner", "listens"), [(OURS, True), (THEIRS, False), (OURS | THEIRS, False), (frozenset(), False)]
)
def test_nothing_is_sent_to_a_default_partner_of_another_user(sockets, owner, listens):
    station, port = bound(sockets)
    owners = Owners()
    owners.by_port = {port: owner}
    link = link_with(sockets, port, owners=owners)
    link.send([(BROADCAST, beat())])
    assert link.active is listens
    assert waiting(station) is listens


def test_a_partner_whose_port_another_user_has_taken_receives_nothing_more(sockets):
    station, port = bound(sockets)
    owners = Owners()
    owners.by_port = {port: OURS}
    link = link_with(sockets, port, owners=owners)
    send(station, link)
    assert len(link.receive(0)) == 1
    link.send([(BROADCAST, beat())])
    assert station.recv(2_048)
    owners.by_port = {port: THEIRS}
    link.send([(BROADCAST, beat())])
    assert not waiting(station)


@root_only
def test_a_real_socket_of_another_user_neither_sends_nor_receives(sockets):
    taken, port = bound(sockets)
    taken.close()
    link = link_with(sockets, port, owners=DatagramOwners(HERE), budget=InputBudget())
    frame = Encoder(system=255, component=190).encode(beat())

    def send_from_default_port():
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stranger.bind((HERE, port))
        stranger.sendto(frame, (HERE, link.local_port))
        return stranger

    with as_other_user(send_from_default_port):
        assert select.select([link], [], [], DEADLINE_S)[0]
        assert link.receive(0) == []
        link.send([(BROADCAST, beat())])
        assert not link.active
    assert link.counters.datagrams_foreign == 1


def test_a_flood_is_dropped_unread_and_another_partner_still_read(sockets):
    """Each call reads what the budget admits, and empties the buffer for the others."""
    link = link_with(sockets, budget=InputBudget(partner_frames_s=50, link_frames_s=500))
    (flooding, _), (station, _) = bound(sockets), bound(sockets)
    now_us, from_station = 0, []
    for _ in range(100):
        now_us += 1_000_000
        send(flooding, link, 100)
        send(station, link)
        received = link.receive(now_us)
        while waiting(link):
            received += link.receive(now_us)
        from_station += [number for number, _ in received if number == 1]
        assert len(received) == 51
    assert len(from_station) == 100
    assert link.counters.datagrams_over_budget == 100 * 50


def test_one_call_drops_a_limited_number(sockets):
    link = link_with(sockets, budget=InputBudget(partner_frames_s=1))
    (flooding, _) = bound(sockets)
    sent = 0
    while link.counters.datagrams_over_budget < 2 * MAX_DROPPED_PER_CALL:
        send(flooding, link, 200)
        sent += 200
        before = link.counters.datagrams_over_budget
        link.receive(0)
        assert link.counters.datagrams_over_budget - before <= MAX_DROPPED_PER_CALL
        assert sent < 100 * MAX_DROPPED_PER_CALL
