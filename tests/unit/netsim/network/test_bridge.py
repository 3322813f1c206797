"""The bridge without sockets: packets, dropped frames, windows, lateness."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netsim.network.bridge import Bridge
from netsim.network.ethernet import build, parse
from netsim.wire.addresses import GROUP_ADDRESS, mac_address
from netsim.wire.packets import (
    MAX_PACKET_BYTES,
    ReceivedPacket,
    ReceivedPackets,
    SentPackets,
    decode_sent,
    encode_packets,
)

IPV4, ARP = 0x0800, 0x0806


def frame(source=0, destination=GROUP_ADDRESS, ether_type=ARP, payload=b"x"):
    return build(destination, mac_address(source), ether_type, payload)


def received(stations, due_ns=0, source=0):
    return ReceivedPacket(
        stations=stations, source=source, destination=GROUP_ADDRESS, ether_type=IPV4, due_ns=due_ns,
        payload=b"p",
    )  # fmt: skip


def dropped(bridge):
    return {reason: number for reason, number in bridge.counters["dropped_frames"].items() if number}


def test_frame_becomes_a_packet_of_the_wire():
    packet = Bridge([0, 700]).accept(700, frame(700, mac_address(0), IPV4, bytes((0x45, 0xC0))), 5)
    assert (packet.station, packet.destination, packet.ether_type) == (700, mac_address(0), IPV4)
    assert (packet.category, packet.read_ns, packet.payload) == ("vo", 5, bytes((0x45, 0xC0)))
    assert decode_sent(encode_packets(SentPackets(packets=(packet,)))).packets == (packet,)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b"", "not ethernet ii"),
        (frame()[:13], "not ethernet ii"),
        (frame(ether_type=0x05FF), "not ethernet ii"),
        (frame(payload=bytes(MAX_PACKET_BYTES + 1)), "length"),
        (frame(source=1), "source"),
        (frame(destination=bytes(6)), "destination"),
        (frame(destination=bytes.fromhex("02aaaaaaaaaa")), "destination"),
    ],
)
def test_dropped_frame_is_counted_by_its_reason(bad, reason):
    bridge = Bridge([0, 1])
    assert bridge.accept(0, bad, 0) is None
    assert dropped(bridge) == {reason: 1}
    assert bridge.counters["outstanding_packets"] == 0


def test_longest_packet_and_any_group_are_accepted():
    bridge = Bridge([0])
    assert bridge.accept(0, frame(payload=bytes(MAX_PACKET_BYTES)), 0)
    assert bridge.accept(0, frame(destination=bytes.fromhex("3333000000fb")), 0)
    assert dropped(bridge) == {}


@given(st.binary(max_size=100))
def test_any_bytes_are_accepted_or_counted(raw):
    bridge = Bridge([0])
    assert (bridge.accept(0, raw, 0) is None) == bool(dropped(bridge))


def test_window_closes_and_opens_by_station():
    bridge = Bridge([0, 1], window_packets=2)
    for _ in range(2):
        assert bridge.is_open(0)
        bridge.accept(0, frame(), 0)
    assert not bridge.is_open(0)
    assert bridge.is_open(1)
    assert bridge.end([(1, 1)]) == []
    assert bridge.end([(0, 1), (0, 1)]) == [0]
    assert bridge.counters["outstanding_packets"] == 0


@pytest.mark.parametrize("ended", [(9, 1), (0, 0), (0, -5), (0, 10**30)])
def test_impossible_numbers_of_ended_packets_leave_a_valid_window(ended):
    bridge = Bridge([0], window_packets=2)
    bridge.accept(0, frame(), 0)
    bridge.end([ended])
    assert bridge.counters["outstanding_packets"] in {0, 1}
    bridge.accept(0, frame(), 0)
    bridge.accept(0, frame(), 0)
    assert not bridge.is_open(0)


def test_received_packet_becomes_a_frame_of_each_receiver_that_has_an_interface():
    bridge = Bridge([0, 2])
    frames = list(bridge.receive(ReceivedPackets(packets=(received((0, 1, 2), source=1),)), 0))
    assert [station for station, _ in frames] == [0, 2]
    assert {parse(each) for _, each in frames} == {(GROUP_ADDRESS, mac_address(1), IPV4, b"p")}


def test_lateness_is_of_packets_with_a_due_time():
    bridge = Bridge([0, 1])
    due_ns = (0, 100_000_000, 70_000_000, 200_000_000)
    list(
        bridge.receive(ReceivedPackets(packets=tuple(received((0, 1), each) for each in due_ns)), 100_000_000)
    )
    assert bridge.counters["lateness"] == {"packets": 3, "late": 1, "mean_ms": 10.0, "largest_ms": 30.0}
    assert bridge.counters["delivered_frames"] == 8


def test_window_is_positive():
    with pytest.raises(ValueError, match="at least 1"):
        Bridge([0], window_packets=0)
