"""The UDP link over loopback sockets on free ports. Waiting is select with a deadline, never a sleep."""

import contextlib
import select
import socket
import sys
import time

import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.links import (
    MAX_BYTES_PER_CALL,
    MAX_DATAGRAM_BYTES,
    MAX_DATAGRAMS_PER_CALL,
    MAX_FRAMES_PER_CALL,
)
from autopilot.mavlink.partners import BROADCAST, MAX_PARTNERS
from autopilot.mavlink.udp_link import UdpLink
from autopilot.mavlink.udp_socket import MAX_RECEIVED_DATAGRAM_BYTES, UdpSocket

DEADLINE_S = 5.0
KERNEL_KEEPS_BYTES = 60_000
"""Least capacity of a socket's receive buffer, for datagrams of any size."""


@pytest.fixture
def sockets():
    with contextlib.ExitStack() as stack:
        yield stack


def partner(stack):
    sock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    sock.bind(("127.0.0.1", 0))
    sock.settimeout(DEADLINE_S)
    return sock


def link_to(stack, remote_port):
    encoder = Encoder(system=1, component=1)
    link = UdpLink(host="127.0.0.1", local_port=0, remote_port=remote_port, encoder=encoder)
    return stack.enter_context(contextlib.closing(link))


def heartbeat():
    return common.MAVLink_heartbeat_message(2, 12, 29, 0, 3, 3)


def send_heartbeat(sock, link):
    frame = Encoder(system=255, component=190).encode(heartbeat())
    sock.sendto(frame, ("127.0.0.1", link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]
    return link.receive(0)


def test_the_default_partner_receives_messages_first_and_counts_as_listening(sockets):
    ground = partner(sockets)
    link = link_to(sockets, ground.getsockname()[1])
    assert not link.active
    link.send([(BROADCAST, heartbeat())])
    assert link.active
    data, address = ground.recvfrom(2048)
    assert address == ("127.0.0.1", link.local_port)
    assert [m.get_type() for m in Parser().push_datagram(data)] == ["HEARTBEAT"]


def test_an_unreachable_default_partner_is_no_error_and_is_detected(sockets):
    ground = partner(sockets)
    port = ground.getsockname()[1]
    ground.close()
    link = link_to(sockets, port)
    for _ in range(5):
        link.send([(BROADCAST, heartbeat())])
        assert link.receive(0) == []
        assert not link.active
    late = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    late.settimeout(DEADLINE_S)
    late.bind(("127.0.0.1", port))
    link.send([(BROADCAST, heartbeat())])
    assert link.active
    assert late.recvfrom(2048)


def test_a_sender_becomes_a_partner_until_its_port_is_closed(sockets):
    link = link_to(sockets, 0)
    link.send([(BROADCAST, heartbeat())])
    assert not link.active
    first, second = partner(sockets), partner(sockets)
    ((number, message),) = send_heartbeat(first, link)
    assert number == 0
    assert message.get_srcSystem() == 255
    send_heartbeat(second, link)
    link.send([(BROADCAST, heartbeat())])
    assert first.recvfrom(2048)[0] == second.recvfrom(2048)[0]
    first.close()
    link.send([(BROADCAST, heartbeat())])  # refused by the first, delivered to the second
    assert second.recvfrom(2048)
    second.close()
    link.send([(BROADCAST, heartbeat())])
    link.send([(BROADCAST, heartbeat())])
    assert not link.active


def test_the_messages_of_a_step_share_few_datagrams(sockets):
    ground = partner(sockets)
    link = link_to(sockets, ground.getsockname()[1])
    link.send([(BROADCAST, heartbeat()) for _ in range(200)])
    sizes, received = [], 0
    while received < 200:
        data = ground.recvfrom(4096)[0]
        sizes.append(len(data))
        received += len(Parser().push_datagram(data))
    assert max(sizes) <= MAX_DATAGRAM_BYTES
    assert len(sizes) == -(-200 // (MAX_DATAGRAM_BYTES // 21))  # a heartbeat is 9 + 12 bytes


def test_partners_are_bounded_and_garbage_adds_none(sockets):
    link = link_to(sockets, 0)
    stranger = partner(sockets)
    stranger.sendto(b"\xfd garbage", ("127.0.0.1", link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]
    assert link.receive(0) == []
    assert link.counters.bytes_bad == 9
    assert not link.active
    partners = [partner(sockets) for _ in range(MAX_PARTNERS + 1)]
    for sock in partners:
        send_heartbeat(sock, link)
    link.send([(BROADCAST, heartbeat())])
    for sock in partners[1:]:
        assert sock.recvfrom(2048)
    assert not select.select([partners[0]], [], [], 0.0)[0]


def test_many_new_partners_do_not_replace_the_default_partner(sockets):
    ground = partner(sockets)
    link = link_to(sockets, ground.getsockname()[1])
    ((number, _),) = send_heartbeat(ground, link)
    for _ in range(3 * MAX_PARTNERS):
        send_heartbeat(partner(sockets), link)
    link.send([(number, heartbeat())])
    assert ground.recvfrom(2048)
    assert [again for again, _ in send_heartbeat(ground, link)] == [number]


def test_sequence_numbers_are_counted_per_partner(sockets):
    """A ground station reports gaps in the sequence numbers as loss."""
    ground = partner(sockets)
    link = link_to(sockets, ground.getsockname()[1])
    socks = [ground, *(partner(sockets) for _ in range(2))]
    numbers = [send_heartbeat(sock, link)[0][0] for sock in socks]
    expected = [0] * len(socks)
    for step in range(300):
        to = numbers[step % 3] if step % 2 else BROADCAST
        link.send([(to, heartbeat()), (BROADCAST, heartbeat())])
        for i, sock in enumerate(socks):
            received = [message.get_seq() for message in Parser().push_datagram(sock.recv(2048))]
            assert received == [
                (expected[i] + k) % 256 for k in range(1 if to not in {BROADCAST, numbers[i]} else 2)
            ]
            expected[i] += len(received)


def test_a_station_of_version_1_is_answered_in_version_2(sockets):
    link, station = link_to(sockets, 0), partner(sockets)
    sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
    station.sendto(heartbeat().pack(sender, force_mavlink1=True), ("127.0.0.1", link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]
    ((number, message),) = link.receive(0)
    assert message.get_type() == "HEARTBEAT"
    link.send([(number, heartbeat())])
    assert station.recv(2048)[0] == 0xFD


def test_setup_signing_is_refused(sockets):
    link, station = link_to(sockets, 0), partner(sockets)
    setup = common.MAVLink_setup_signing_message(1, 1, [7] * 32, 1)
    station.sendto(Encoder(system=255, component=190).encode(setup), ("127.0.0.1", link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]
    assert link.receive(0) == []
    assert link.counters.setup_signing == 1


def test_a_port_in_use_is_an_error(sockets):
    link = link_to(sockets, 0)
    with pytest.raises(OSError, match="in use"):
        UdpLink(
            host="127.0.0.1",
            local_port=link.local_port,
            remote_port=0,
            encoder=Encoder(system=1, component=1),
        )


def test_a_message_to_one_partner_is_sent_to_it_alone(sockets):
    """Two programs with the same MAVLink ids are distinguished by their addresses."""
    link = link_to(sockets, 0)
    first, second = partner(sockets), partner(sockets)
    numbers = [number for sock in (first, second) for number, _ in send_heartbeat(sock, link)]
    assert numbers == [0, 1]
    for_second = common.MAVLink_command_ack_message(400, 0)
    link.send([(1, for_second), (BROADCAST, heartbeat()), (7, for_second)])
    kinds = [[m.get_type() for m in Parser().push_datagram(sock.recv(2048))] for sock in (first, second)]
    assert kinds == [["HEARTBEAT"], ["COMMAND_ACK", "HEARTBEAT"]]
    assert [number for number, _ in send_heartbeat(first, link)] == [0]


def flood(sock, link, datagram, count_bytes=KERNEL_KEEPS_BYTES):
    """Send a datagram many times; return the number of copies."""
    count = count_bytes // len(datagram)
    for _ in range(count):
        sock.sendto(datagram, ("127.0.0.1", link.local_port))
    return count


def calls(link):
    """Yield (number of messages, process time) of each call of `receive` until the buffer is empty."""
    while select.select([link], [], [], 0.0)[0]:
        begun_s = time.process_time()
        received = len(link.receive(0))
        yield received, time.process_time() - begun_s


def beats(size_bytes):
    encoder = Encoder(system=255, component=190)
    return b"".join(encoder.encode(heartbeat()) for _ in range(size_bytes // 21))


@pytest.mark.parametrize("frames", [1, 20, 90])
def test_a_call_is_limited_and_leaves_the_rest_for_the_next(sockets, frames):
    link, station = link_to(sockets, 0), partner(sockets)
    datagram = beats(21 * frames)
    sent = flood(station, link, datagram, min(KERNEL_KEEPS_BYTES, 200 * len(datagram)))
    received = [count for count, _ in calls(link)]
    assert sum(received) == sent * frames
    # a call ends with the datagram in which it reaches a limit
    most = min(
        MAX_DATAGRAMS_PER_CALL * frames,
        MAX_FRAMES_PER_CALL + frames - 1,
        (MAX_BYTES_PER_CALL // len(datagram) + 1) * frames,
    )
    assert most - frames < received[0] <= most
    assert received[:-1] == received[:1] * (len(received) - 1)
    assert len(received) > 2
    assert link.counters.bytes_bad == 0


def test_an_oversized_datagram_is_dropped_unread_and_counted(sockets):
    link, station = link_to(sockets, 0), partner(sockets)
    whole = beats(21)
    for size in (MAX_RECEIVED_DATAGRAM_BYTES, MAX_RECEIVED_DATAGRAM_BYTES + 1, 60_000):
        station.sendto(whole + bytes(size - len(whole)), ("127.0.0.1", link.local_port))
    assert sum(count for count, _ in calls(link)) == 1
    assert link.counters.datagrams_too_long == 2
    assert link.counters.bytes_bad == MAX_RECEIVED_DATAGRAM_BYTES - len(whole)


@pytest.mark.parametrize(
    "garbage",
    [b"\xfe", b"\xfd", b"\xfe\x00", bytes([0xFE, 0xFE, 0, 0, 0, common.MAVLINK_MSG_ID_ATTITUDE])],
    ids=["version 1", "version 2", "short", "known"],
)
def test_garbage_costs_a_call_little_more_than_valid_messages(sockets, garbage):
    link, station = link_to(sockets, 0), partner(sockets)
    garbage_bytes = (garbage * MAX_RECEIVED_DATAGRAM_BYTES)[:MAX_RECEIVED_DATAGRAM_BYTES]
    messages, parser = beats(21 * MAX_FRAMES_PER_CALL), Parser()
    costs_s, fair_s = [], []
    for _ in range(5):
        flood(station, link, garbage_bytes)
        costs_s += [cost_s for _, cost_s in calls(link)]
        begun_s = time.process_time()
        assert len(parser.push_datagram(messages)) == MAX_FRAMES_PER_CALL
        fair_s.append(time.process_time() - begun_s)
    # a datagram of garbage has eight times as many apparent frames as a call may check, cheaper than messages
    assert MAX_RECEIVED_DATAGRAM_BYTES == 8 * MAX_FRAMES_PER_CALL
    assert sorted(costs_s)[len(costs_s) // 2] < 8.0 * sorted(fair_s)[len(fair_s) // 2]
    assert link.counters.bytes_bad == 5 * (KERNEL_KEEPS_BYTES // len(garbage_bytes)) * len(garbage_bytes)


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's count is Linux's")
def test_datagrams_that_find_the_buffer_full_are_counted():
    with (
        contextlib.closing(UdpSocket("127.0.0.1", 0)) as receiver,
        socket.socket(type=socket.SOCK_DGRAM) as sender,
    ):
        assert receiver.dropped == 0
        sent, received = 0, 0
        while not receiver.dropped and sent < 20_000:
            sender.sendto(bytes(1400), ("127.0.0.1", receiver.local_port))
            sent += 1
        while receiver.receive() is not None:
            received += 1
        assert 0 < received == sent - receiver.dropped < sent
