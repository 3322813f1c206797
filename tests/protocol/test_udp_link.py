"""The UDP edge over loopback sockets on free ports. Waiting is select with a deadline, never a sleep."""

import contextlib
import select
import socket
import time

import pytest
from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.links import (
    BROADCAST,
    MAX_BYTES_PER_CALL,
    MAX_DATAGRAM_BYTES,
    MAX_DATAGRAMS_PER_CALL,
    MAX_FRAMES_PER_CALL,
    MAX_PARTNERS,
    MAX_RECEIVED_DATAGRAM_BYTES,
    UdpLink,
)

DEADLINE_S = 5.0
KERNEL_KEEPS_BYTES = 60_000
"""Of datagrams of any size, at least, in a socket that nobody reads."""


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


def greet(sock, link):
    frame = Encoder(system=255, component=190).encode(heartbeat())
    sock.sendto(frame, ("127.0.0.1", link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]
    return link.receive()


def test_the_default_partner_is_spoken_to_first_and_counts_as_listening(sockets):
    ground = partner(sockets)
    link = link_to(sockets, ground.getsockname()[1])
    assert not link.active
    link.send([(BROADCAST, heartbeat())])
    assert link.active
    data, address = ground.recvfrom(2048)
    assert address == ("127.0.0.1", link.local_port)
    assert [m.get_type() for m in Parser().push_datagram(data)] == ["HEARTBEAT"]


def test_nobody_at_the_default_port_is_no_error_and_is_noticed(sockets):
    ground = partner(sockets)
    port = ground.getsockname()[1]
    ground.close()
    link = link_to(sockets, port)
    for _ in range(5):
        link.send([(BROADCAST, heartbeat())])
        assert link.receive() == []
        assert not link.active
    late = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    late.settimeout(DEADLINE_S)
    late.bind(("127.0.0.1", port))
    link.send([(BROADCAST, heartbeat())])
    assert link.active
    assert late.recvfrom(2048)


def test_whoever_speaks_is_answered_until_it_closes(sockets):
    link = link_to(sockets, 0)
    link.send([(BROADCAST, heartbeat())])
    assert not link.active
    first, second = partner(sockets), partner(sockets)
    ((number, message),) = greet(first, link)
    assert number == 0
    assert message.get_srcSystem() == 255
    greet(second, link)
    link.send([(BROADCAST, heartbeat())])
    assert first.recvfrom(2048)[0] == second.recvfrom(2048)[0]
    first.close()
    link.send([(BROADCAST, heartbeat())])  # refused by the one, and not lost for the other
    assert second.recvfrom(2048)
    second.close()
    link.send([(BROADCAST, heartbeat())])
    link.send([(BROADCAST, heartbeat())])
    assert not link.active


def test_a_step_goes_out_in_few_datagrams(sockets):
    ground = partner(sockets)
    link = link_to(sockets, ground.getsockname()[1])
    link.send([(BROADCAST, heartbeat()) for _ in range(200)])
    sizes, heard = [], 0
    while heard < 200:
        data = ground.recvfrom(4096)[0]
        sizes.append(len(data))
        heard += len(Parser().push_datagram(data))
    assert max(sizes) <= MAX_DATAGRAM_BYTES
    assert len(sizes) == -(-200 // (MAX_DATAGRAM_BYTES // 21))  # a heartbeat is 9 + 12 bytes


def test_partners_are_bounded_and_garbage_makes_none(sockets):
    link = link_to(sockets, 0)
    stranger = partner(sockets)
    stranger.sendto(b"\xfd garbage", ("127.0.0.1", link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]
    assert link.receive() == []
    assert link.bad_bytes == 9
    assert not link.active
    partners = [partner(sockets) for _ in range(MAX_PARTNERS + 1)]
    for sock in partners:
        greet(sock, link)
    link.send([(BROADCAST, heartbeat())])
    for sock in partners[1:]:
        assert sock.recvfrom(2048)
    assert not select.select([partners[0]], [], [], 0.0)[0]


def test_a_flood_of_strangers_does_not_push_the_default_partner_out(sockets):
    ground = partner(sockets)
    link = link_to(sockets, ground.getsockname()[1])
    ((number, _),) = greet(ground, link)
    for _ in range(3 * MAX_PARTNERS):
        greet(partner(sockets), link)
    link.send([(number, heartbeat())])
    assert ground.recvfrom(2048)
    assert [again for again, _ in greet(ground, link)] == [number]


def test_every_partner_counts_what_it_is_sent(sockets):
    """A station shows a gap in the sequence numbers as loss."""
    ground = partner(sockets)
    link = link_to(sockets, ground.getsockname()[1])
    socks = [ground, *(partner(sockets) for _ in range(2))]
    numbers = [greet(sock, link)[0][0] for sock in socks]
    expected = [0] * len(socks)
    for step in range(300):
        to = numbers[step % 3] if step % 2 else BROADCAST
        link.send([(to, heartbeat()), (BROADCAST, heartbeat())])
        for i, sock in enumerate(socks):
            heard = [message.get_seq() for message in Parser().push_datagram(sock.recv(2048))]
            assert heard == [
                (expected[i] + k) % 256 for k in range(1 if to not in {BROADCAST, numbers[i]} else 2)
            ]
            expected[i] += len(heard)


def test_a_station_of_version_1_is_answered_in_version_2(sockets):
    link, station = link_to(sockets, 0), partner(sockets)
    sender = common.MAVLink(None, srcSystem=255, srcComponent=190)
    station.sendto(heartbeat().pack(sender, force_mavlink1=True), ("127.0.0.1", link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]
    ((number, message),) = link.receive()
    assert message.get_type() == "HEARTBEAT"
    link.send([(number, heartbeat())])
    assert station.recv(2048)[0] == 0xFD


def test_nobody_sets_a_key_over_the_link(sockets):
    link, station = link_to(sockets, 0), partner(sockets)
    setup = common.MAVLink_setup_signing_message(1, 1, [7] * 32, 1)
    station.sendto(Encoder(system=255, component=190).encode(setup), ("127.0.0.1", link.local_port))
    assert select.select([link], [], [], DEADLINE_S)[0]
    assert link.receive() == []
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


def test_what_is_for_one_partner_reaches_it_alone(sockets):
    """Two programs with the same MAVLink numbers are told apart by their addresses."""
    link = link_to(sockets, 0)
    first, second = partner(sockets), partner(sockets)
    numbers = [number for sock in (first, second) for number, _ in greet(sock, link)]
    assert numbers == [0, 1]
    for_second = common.MAVLink_command_ack_message(400, 0)
    link.send([(1, for_second), (BROADCAST, heartbeat()), (7, for_second)])
    kinds = [[m.get_type() for m in Parser().push_datagram(sock.recv(2048))] for sock in (first, second)]
    assert kinds == [["HEARTBEAT"], ["COMMAND_ACK", "HEARTBEAT"]]
    assert [number for number, _ in greet(first, link)] == [0]


def flood(sock, link, datagram, count_bytes=KERNEL_KEEPS_BYTES):
    """Send a datagram many times; how many."""
    count = count_bytes // len(datagram)
    for _ in range(count):
        sock.sendto(datagram, ("127.0.0.1", link.local_port))
    return count


def calls(link):
    """What each call of `receive` took until there was nothing more: (messages, process time)."""
    while select.select([link], [], [], 0.0)[0]:
        begun_s = time.process_time()
        heard = len(link.receive())
        yield heard, time.process_time() - begun_s


def beats(size_bytes):
    encoder = Encoder(system=255, component=190)
    return b"".join(encoder.encode(heartbeat()) for _ in range(size_bytes // 21))


@pytest.mark.parametrize("frames", [1, 20, 90])
def test_a_call_takes_so_much_and_leaves_the_rest_for_the_next(sockets, frames):
    link, station = link_to(sockets, 0), partner(sockets)
    datagram = beats(21 * frames)
    sent = flood(station, link, datagram, min(KERNEL_KEEPS_BYTES, 200 * len(datagram)))
    heard = [count for count, _ in calls(link)]
    assert sum(heard) == sent * frames
    # a call ends with the datagram in which it reaches a limit
    most = min(
        MAX_DATAGRAMS_PER_CALL * frames,
        MAX_FRAMES_PER_CALL + frames - 1,
        (MAX_BYTES_PER_CALL // len(datagram) + 1) * frames,
    )
    assert most - frames < heard[0] <= most
    assert heard[:-1] == heard[:1] * (len(heard) - 1)
    assert len(heard) > 2
    assert link.bad_bytes == 0


def test_a_datagram_longer_than_any_is_dropped_unread_and_counted(sockets):
    link, station = link_to(sockets, 0), partner(sockets)
    whole = beats(21)
    for size in (MAX_RECEIVED_DATAGRAM_BYTES, MAX_RECEIVED_DATAGRAM_BYTES + 1, 60_000):
        station.sendto(whole + bytes(size - len(whole)), ("127.0.0.1", link.local_port))
    assert sum(count for count, _ in calls(link)) == 1
    assert link.counters.datagrams_too_long == 2
    assert link.bad_bytes == MAX_RECEIVED_DATAGRAM_BYTES - len(whole)


@pytest.mark.parametrize(
    "garbage",
    [b"\xfe", b"\xfd", b"\xfe\x00", bytes([0xFE, 0xFE, 0, 0, 0, common.MAVLINK_MSG_ID_ATTITUDE])],
    ids=["version 1", "version 2", "short", "known"],
)
def test_no_call_costs_much_more_than_the_messages_it_may_bring(sockets, garbage):
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
    # a datagram of garbage has eight times as many beginnings as a call may look at, cheaper than messages
    assert MAX_RECEIVED_DATAGRAM_BYTES == 8 * MAX_FRAMES_PER_CALL
    assert sorted(costs_s)[len(costs_s) // 2] < 8.0 * sorted(fair_s)[len(fair_s) // 2]
    assert link.bad_bytes == 5 * (KERNEL_KEEPS_BYTES // len(garbage_bytes)) * len(garbage_bytes)
