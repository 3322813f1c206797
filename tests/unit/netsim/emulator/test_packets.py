"""Packets of network interfaces on the channel: receivers, acknowledgements, order, categories, counters."""

import msgspec
import numpy as np
import pytest
from netsim_swarm import STEP_US, Swarm

from netsim.emulator.service import EmulatorService
from netsim.model.config import RadioConfig, ServerConfig
from netsim.phy.frames import Packet
from netsim.wire.addresses import GROUP_ADDRESS, ipv4_address, is_group, mac_address, station_of
from netsim.wire.lockstep import Advance, pack_rows
from netsim.wire.messages import Broadcast, TxBatch
from netsim.wire.packets import SentPacket

IPV6 = 0x86DD
MULTICAST = bytes.fromhex("333300000001")
PLACES = [(0.0, 0.0, -10.0), (0.0, 8.5, -10.0), (2.5, 0.0, -10.0)]
SETTINGS = {"rician_k_db": None, "broadcast_rts": False}
CHANNELS = pytest.mark.parametrize("channel", ["ideal", "emulated"])


def packet(station, destination=GROUP_ADDRESS, *, category="be", payload=b"p" * 100):
    return SentPacket(
        station=station,
        destination=destination,
        ether_type=IPV6,
        category=category,
        read_ns=0,
        payload=payload,
    )  # fmt: skip


def swarm_of(**settings):
    return Swarm(PLACES, **{**SETTINGS, **settings})


def packet_counters(swarm):
    return msgspec.to_builtins(swarm.emulator.counters)["packets"]


def test_addresses_are_those_of_stations():
    assert mac_address(258) == bytes.fromhex("020000000102")
    assert ipv4_address(258) == bytes((10, 1, 1, 2))
    assert station_of(mac_address(65_535)) == 65_535
    assert [station_of(each) for each in (GROUP_ADDRESS, b"\x02\x00\x00\x01\x00\x00")] == [None, None]
    assert [is_group(each) for each in (GROUP_ADDRESS, MULTICAST, mac_address(1))] == [True, True, False]


@CHANNELS
def test_a_group_packet_reaches_all_other_stations_once(channel):
    frames = []
    swarm = swarm_of(channel=channel, on_transmission=frames.append, access="dcf")
    swarm.emulator.submit_packet(packet(1, MULTICAST), 1_000_000)
    assert swarm.run(8_000) == []  # no datagram
    (reception,) = swarm.emulator.take_packets()
    assert reception[1:] == ((0, 2), 1, MULTICAST, IPV6, b"p" * 100)
    (frame,) = frames
    assert frame.frame.frame_bytes == 100 + 36
    assert frame.frame.body == Packet(MULTICAST, IPV6, b"p" * 100)
    assert frame.start_ns == 1_000_000  # no latency of a host
    assert reception.end_ns == frame.end_ns + max(frame.delays_ns[[0, 2]])
    assert swarm.emulator.take_packets() == []
    assert swarm.emulator.take_ended() == {1: 1}
    assert packet_counters(swarm) == {"outcomes": {"sent": 1}, "delivered": 2, "lost_by_hosts": 0}


@CHANNELS
def test_a_unicast_packet_reaches_its_destination_and_is_acknowledged(channel):
    swarm = swarm_of(channel=channel)
    swarm.emulator.submit_packet(packet(0, mac_address(2)), 1_000_000)
    swarm.run(8_000)
    (reception,) = swarm.emulator.take_packets()
    assert reception[1:] == ((2,), 0, mac_address(2), IPV6, b"p" * 100)
    frames = swarm.emulator.take_frames()
    assert [(each.kind, each.source, each.bytes) for each in frames] == [("data", 0, 136), ("ack", 2, 14)]
    assert packet_counters(swarm)["outcomes"] == {"acknowledged": 1}


@CHANNELS
def test_a_unicast_packet_is_retried_and_lost_without_a_link(channel):
    swarm = swarm_of(channel=channel, retry_limit=4)
    swarm.emulator.links.set_extra_attenuation_db(200.0)
    swarm.emulator.submit_packet(packet(0, mac_address(2)), 1_000_000)
    swarm.run(40_000)
    assert swarm.emulator.take_packets() == []
    assert [each.kind for each in swarm.emulator.take_frames()] == ["data"] * 5
    assert swarm.emulator.take_ended() == {0: 1}
    assert packet_counters(swarm) == {"outcomes": {"retry_limit": 1}, "delivered": 0, "lost_by_hosts": 0}


def test_a_repeated_frame_is_delivered_once():
    # at the edge of the range some ACKs of received frames are lost
    distance_m = 10 ** ((16.0 - 46.78 - (13.5 - 93.99)) / 20)
    swarm = Swarm(
        [(0.0, 0.0, 0.0), (distance_m, 0.0, 0.0)], bandwidth_mhz=20, retry_limit=10, rician_k_db=3.0
    )
    for i in range(400):
        swarm.emulator.submit_packet(packet(0, mac_address(1), payload=i.to_bytes(2, "big")), 4_000_000 * i)
    swarm.run(1_700_000)
    numbers = [int.from_bytes(each.payload, "big") for each in swarm.emulator.take_packets()]
    assert len(swarm.emulator.take_frames()) > 2 * len(numbers) > 0  # attempts and ACKs
    assert numbers == sorted(set(numbers))


def test_rts_precedes_packets_as_configured():
    swarm = swarm_of(rts_threshold_bytes=200)
    for size in (164, 165):
        swarm.emulator.submit_packet(packet(0, mac_address(1), payload=bytes(size)), 0)
    swarm.run(8_000)
    assert [each.kind for each in swarm.emulator.take_frames()] == [
        "data", "ack", "rts", "cts", "data", "ack",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "destination",
    [mac_address(0), mac_address(3), bytes.fromhex("0a0000000001")],
    ids=["own", "no-station", "foreign"],
)
def test_a_packet_to_no_other_station_ends_at_once(destination):
    swarm = swarm_of()
    swarm.emulator.submit_packet(packet(0, destination), 1_000_000)
    swarm.run(4_000)
    assert swarm.emulator.take_frames() == []
    assert swarm.emulator.take_ended() == {0: 1}
    assert packet_counters(swarm)["outcomes"] == {"unknown_destination": 1}


def test_voice_overtakes_background_and_a_category_keeps_its_order():
    swarm = swarm_of()
    for category in ("bk", "vo"):
        for i in range(5):
            payload = f"{category}{i}".encode()
            swarm.emulator.submit_packet(packet(0, category=category, payload=payload), 1_000_000)
    swarm.run(20_000)
    received = [each.payload.decode() for each in swarm.emulator.take_packets()]
    assert [each for each in received if each < "c"] == [f"bk{i}" for i in range(5)]
    assert received[:5] == [f"vo{i}" for i in range(5)]


def test_packets_and_datagrams_share_a_queue():
    swarm = swarm_of(queue_frames=4)
    for _ in range(3):
        swarm.broadcast(0, 1_000)
    for _ in range(3):
        swarm.emulator.submit_packet(packet(0), 1_000_000)
    swarm.run(20_000)
    counters = swarm.emulator.counters
    sent = packet_counters(swarm)["outcomes"].get("sent", 0)
    assert counters.frames_sent["data"] == 3 + sent - counters.drops.get("overflow", 0)
    assert packet_counters(swarm)["outcomes"].get("overflow", 0) + counters.drops.get("overflow", 0) == 2


@CHANNELS
def test_as_many_packets_end_as_were_submitted(channel):
    rng = np.random.default_rng(7)
    swarm = swarm_of(channel=channel, queue_frames=10, queue_lifetime_us=5_000, rician_k_db=0.0)
    submitted, ended = [0] * 3, [0] * 3
    destinations = [GROUP_ADDRESS, MULTICAST, *map(mac_address, range(4))]
    for step in range(100):
        for _ in range(int(rng.integers(0, 12))):
            station = int(rng.integers(0, 3))
            submitted[station] += 1
            swarm.emulator.submit_packet(
                packet(
                    station,
                    destinations[rng.integers(0, len(destinations))],
                    category=("vo", "vi", "be", "bk")[rng.integers(0, 4)],
                    payload=bytes(int(rng.integers(0, 2_296))),
                ),
                1_000 * swarm.now_us + int(rng.integers(0, 4_000_000)),
            )
        if step == 60:
            swarm.emulator.set_silent(2)
        swarm.run(swarm.now_us + STEP_US)
        for station, count in swarm.emulator.take_ended().items():
            ended[station] += count
    swarm.run(swarm.now_us + 100_000)
    for station, count in swarm.emulator.take_ended().items():
        ended[station] += count
    assert ended == submitted
    assert sum(packet_counters(swarm)["outcomes"].values()) == sum(submitted)
    receptions = swarm.emulator.take_packets()
    assert [each.end_ns for each in receptions] == sorted(each.end_ns for each in receptions)


@CHANNELS
def test_a_silent_station_neither_sends_nor_receives(channel):
    swarm = swarm_of(channel=channel)
    swarm.emulator.set_silent(2)
    for station in range(3):
        swarm.emulator.submit_packet(packet(station), 1_000_000 * (station + 1))
    swarm.run(8_000)
    receptions = swarm.emulator.take_packets()
    assert [(each.source, each.stations) for each in receptions] == [(0, (1,)), (1, (0,))]
    assert swarm.emulator.take_ended() == {0: 1, 1: 1, 2: 1}
    assert packet_counters(swarm)["outcomes"] == {"expired": 1, "sent": 2}


def test_hosts_lose_packets_as_datagrams():
    swarm = swarm_of(channel="ideal", drop_fraction=0.25)
    for i in range(400):
        swarm.emulator.submit_packet(packet(0), 1_000_000 * i)
    swarm.run(404_000)
    counters = packet_counters(swarm)
    assert counters["delivered"] + counters["lost_by_hosts"] == 800
    assert counters["lost_by_hosts"] == pytest.approx(200, abs=50)
    assert sum(len(each.stations) for each in swarm.emulator.take_packets()) == counters["delivered"]
    assert swarm.emulator.counters.lost_by_hosts == 0


def test_a_packet_of_an_unknown_station_raises():
    with pytest.raises(ValueError, match="packet of station 3: there are 3 stations"):
        swarm_of().emulator.submit_packet(packet(3), 0)


# --- the interval in parts

CONFIG = ServerConfig(run_id="r", stations=3, seed=1, radio=RadioConfig())


def request(to_us):
    return Advance(
        to_us=to_us,
        release_us=to_us,
        at_us=to_us - 4_000,
        pos_ned_m=pack_rows(np.array(PLACES)),
        vel_ned_m_s=pack_rows(np.zeros((3, 3))),
        q_ned_frd=pack_rows(np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))),
        extra_attenuation_db=0.0,
    )


def test_an_interval_in_parts_equals_the_whole():
    results = []
    for parts in (1, 2, 37):
        service, delivered = EmulatorService(CONFIG), []
        for to_us in range(4_000, 84_000, 4_000):
            at_us = to_us - 4_000
            for station in range(3):
                item = Broadcast(seq=to_us, at_us=at_us, payload=bytes(200))
                assert service.submit(TxBatch(station=station, now_us=at_us, items=(item,)))
            if parts == 1:
                delivered.append(service.advance(request(to_us)))
                continue
            service.begin(request(to_us))
            assert service.next_event_ns >= 1_000 * at_us
            for part in range(1, parts + 1):
                service.run_until(1_000 * at_us + 4_000_000 * part // parts)
            assert service.next_event_ns > 1_000 * to_us
            delivered.append(service.end(request(to_us)))
        results.append((delivered, service.counters, service.advanced()))
    assert results[0] == results[1] == results[2]
    assert results[0][1]["frames_sent"]["data"] > 0
    assert "packets" not in results[0][1]  # manifests of runs without packets are unchanged


def test_only_vehicles_send_packets():
    service = EmulatorService(CONFIG)
    assert not service.submit_packet(packet(3), 0)
    assert service.submit_packet(packet(2), 0)
    service.advance(request(4_000))
    assert service.counters["packets"]["outcomes"] == {"sent": 1}
    assert service.take_ended() == {2: 1}
    assert [each.stations for each in service.take_packets()] == [(0, 1)]
