"""Packets during an interval, with a clock that only waiting advances: times, order, limits, lateness."""

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from netsim.emulator.service import EmulatorService
from netsim.model.config import RadioConfig, ServerConfig
from netsim.transport.packet_exchange import (
    LEAST_STEP_NS,
    LONGEST_RECEIVED_BYTES,
    LONGEST_SENT_BYTES,
    MOST_WAITING_PACKETS,
    PacketExchange,
)
from netsim.transport.packet_pace import Lateness, Pace, pace_of
from netsim.wire.addresses import GROUP_ADDRESS, mac_address
from netsim.wire.lockstep import Advance, pack_rows
from netsim.wire.packets import SentPacket, SentPackets, decode_received, encode_packets

STEP_US = 40_000
DEADLINE_S = 20.0
WALL_NS = 7_000_000_000
"""Wall time of simulated time 0"""
PLACES = np.array([(0.0, 0.0, -10.0), (0.0, 8.5, -10.0), (2.5, 0.0, -10.0)])
AIR_NS = 1_000_000
"""More than the time of a frame without contention"""


class World:
    """An emulator of three stations, a wall clock, and messages that arrive at wall times."""

    def __init__(self, *, work_ns=0, **radio):
        frames = {"rician_k_db": None, "broadcast_rts": False, "access": "dcf", **radio}
        config = ServerConfig(run_id="r", stations=3, seed=1, radio=RadioConfig(**frames))
        self.service = EmulatorService(config)
        self.wall_ns = WALL_NS
        self.work_ns = work_ns
        """Wall time that passes each time when all messages have been taken"""
        self.arriving = []
        self.messages = []
        """Messages that have arrived"""
        self.receives_in_another_thread = False
        """Whether messages that arrive during a wait are given to `PacketExchange.receive`"""
        self.wakes = 0
        self.published = []
        """Wall time and message"""
        self.publishers = []
        """Threads that have published the messages"""
        self.dropped = 0
        self.looks = 0
        self.calls = []
        self.exchange = PacketExchange(
            self.service,
            self,
            vehicles=3,
            publish=self.publish,
            now_ns=lambda: self.wall_ns,
            on_packets=lambda: self.calls.append("packets"),
            on_malformed=lambda: self.calls.append("malformed"),
        )
        self.to_us = 0

    def take(self):
        if self.messages:
            return self.messages.pop(0)
        if self.arriving and self.arriving[0][0] <= self.wall_ns:
            return self.arriving.pop(0)[1]
        self.wall_ns += self.work_ns
        return None

    def put(self, payload):
        self.messages.append(payload)

    def wait(self, wall_limit_s):
        self.looks += 1
        until_ns = self.wall_ns + round(1e9 * wall_limit_s)
        if self.arriving and self.arriving[0][0] <= until_ns:
            at_ns, payload = self.arriving.pop(0)
            self.wall_ns = max(self.wall_ns, at_ns)
            if self.receives_in_another_thread:
                thread = threading.Thread(target=self.exchange.receive, args=(payload,))
                thread.start()
                thread.join(DEADLINE_S)
                assert not thread.is_alive()
            else:
                self.messages.append(payload)
            return
        self.wall_ns = until_ns

    def wake(self):
        self.wakes += 1

    def publish(self, payload):
        assert len(payload) <= LONGEST_RECEIVED_BYTES + 1_000
        message = decode_received(payload)
        assert message is not None
        self.published.append((self.wall_ns, message))
        self.publishers.append(threading.current_thread())

    def arrive(self, wall_ns, *packets):
        self.arriving.append((wall_ns, encode_packets(SentPackets(packets=packets))))
        self.arriving.sort(key=lambda each: each[0])

    def advance(self, *, speed=1.0, paced=True):
        self.to_us += STEP_US
        due_ns = WALL_NS + round(1_000 * self.to_us / speed) if paced else 0
        request = Advance(
            to_us=self.to_us,
            release_us=self.to_us,
            at_us=self.to_us - STEP_US,
            pos_ned_m=pack_rows(PLACES),
            vel_ned_m_s=pack_rows(np.zeros((3, 3))),
            q_ned_frd=pack_rows(np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))),
            extra_attenuation_db=0.0,
            due_ns=due_ns,
            speed=speed if paced else 0.0,
        )
        return self.exchange.advance(request)

    @property
    def received(self):
        """(Wall time of publication, packet) of all receptions."""
        return [(wall_ns, packet) for wall_ns, message in self.published for packet in message.packets]

    @property
    def ended(self):
        counts = [0, 0, 0]
        for _, message in self.published:
            for station, count in message.ended:
                counts[station] += count
        return counts


def packet(read_ns, *, station=0, destination=GROUP_ADDRESS, payload=b"x" * 100, category="be"):
    return SentPacket(
        station=station, destination=destination, ether_type=0x0800, category=category, read_ns=read_ns,
        payload=payload,
    )  # fmt: skip


def test_a_packet_is_on_the_air_when_it_is_read_and_published_when_it_is_received():
    world = World()
    read_ns = WALL_NS + 12_345_678
    world.arrive(read_ns + 30_000, packet(read_ns))
    world.advance()
    ((published_ns, received),) = world.received
    # 136 bytes at 24 Mbit/s take 20 + 48 us
    assert received.due_ns - read_ns == pytest.approx(68_000, abs=100)
    assert received.due_ns <= published_ns <= received.due_ns + LEAST_STEP_NS + 1_000
    assert (received.stations, received.source, received.ether_type) == ((1, 2), 0, 0x0800)
    assert world.ended == [1, 0, 0]
    assert world.wall_ns == WALL_NS + 1_000 * STEP_US  # not before the interval's end is due
    counters = world.exchange.counters
    assert (counters["sent"], counters["dropped"]) == (1, 0)
    assert counters["transmissions"] == {"packets": 1, "late": 0, "mean_ms": 0.0, "largest_ms": 0.0}
    assert counters["receptions"]["packets"] == 1
    assert counters["receptions"]["largest_ms"] <= 0.2


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_simulated_time_follows_wall_time_at_the_speed(speed):
    world = World()
    read_ns = WALL_NS + round(20_000_000 / speed)
    world.arrive(read_ns, packet(read_ns))
    world.advance(speed=speed)
    ((_, received),) = world.received
    assert received.due_ns - read_ns == pytest.approx(68_000 / speed, abs=1_000)
    assert world.wall_ns == WALL_NS + round(1_000 * STEP_US / speed)


def test_an_unpaced_interval_places_packets_at_its_beginning_and_publishes_at_its_end():
    world = World()
    world.arrive(WALL_NS, packet(WALL_NS - 5_000, payload=b"a"), packet(WALL_NS + 10**9, payload=b"b"))
    world.advance(paced=False)
    assert [each.payload for _, each in world.received] == [b"a", b"b"]
    assert {each.due_ns for _, each in world.received} == {0}
    assert len(world.published) == 1
    assert world.wall_ns == WALL_NS
    assert world.exchange.counters["receptions"]["packets"] == 0
    world.arrive(WALL_NS, packet(WALL_NS, payload=b"c"))
    world.advance(paced=False)
    assert [each.payload for _, each in world.received] == [b"a", b"b", b"c"]


def test_a_late_interval_does_not_wait_and_keeps_the_packets_places():
    world = World()
    reads_ns = [WALL_NS + 5_000_000, WALL_NS + 25_000_000]
    for read_ns in reads_ns:
        world.arrive(read_ns, packet(read_ns))
    world.wall_ns = WALL_NS + 100_000_000
    world.advance()
    assert world.wall_ns == WALL_NS + 100_000_000
    for (published_ns, received), read_ns in zip(world.received, reads_ns, strict=True):
        assert received.due_ns - read_ns == pytest.approx(68_000, abs=100)
        assert published_ns == WALL_NS + 100_000_000
    receptions = world.exchange.counters["receptions"]
    assert (receptions["packets"], receptions["late"]) == (2, 2)
    assert receptions["largest_ms"] == pytest.approx(95.0, abs=0.1)
    assert receptions["mean_ms"] == pytest.approx((95.0 + 75.0) / 2, abs=0.1)


def test_a_packet_that_arrives_late_is_placed_at_the_present_and_counted():
    world = World()
    read_ns = WALL_NS + 4_000_000
    world.arrive(WALL_NS + 29_000_000, packet(read_ns))
    world.arrive(WALL_NS + 28_000_000)  # wakes the channel, which simulates up to here
    world.advance()
    ((_, received),) = world.received
    assert received.due_ns == pytest.approx(WALL_NS + 28_068_000, abs=1_000)
    transmissions = world.exchange.counters["transmissions"]
    assert (transmissions["packets"], transmissions["late"]) == (1, 1)
    assert transmissions["largest_ms"] == pytest.approx(24.0, abs=0.01)


def test_a_packet_read_after_the_interval_waits_for_the_next():
    world = World()
    read_ns = WALL_NS + 45_000_000
    world.wall_ns = WALL_NS + 50_000_000
    world.arrive(world.wall_ns, packet(read_ns))
    world.advance()
    assert world.published == []
    world.advance()
    ((_, received),) = world.received
    assert received.due_ns - read_ns == pytest.approx(68_000, abs=100)


def test_a_packet_cannot_be_read_in_the_future():
    world = World()
    world.arrive(WALL_NS + 10_000_000, packet(2**63 - 1))
    world.advance()
    ((_, received),) = world.received
    assert received.due_ns == pytest.approx(WALL_NS + 10_068_000, abs=1_000)


def test_a_quiet_channel_waits_once_for_the_end_of_the_interval():
    world = World()
    world.advance()
    assert world.wall_ns == WALL_NS + 1_000 * STEP_US
    assert world.looks <= 3
    assert world.published == []


def test_a_packet_that_arrives_during_a_wait_is_exchanged_where_it_arrives():
    world = World()
    world.receives_in_another_thread = True
    read_ns = WALL_NS + 12_000_000
    world.arrive(read_ns + AIR_NS, packet(read_ns))
    world.advance()
    ((published_ns, received),) = world.received
    assert published_ns == read_ns + AIR_NS  # its frame has ended: no further wait
    assert received.due_ns - read_ns == pytest.approx(68_000, abs=100)
    (thread,) = world.publishers
    assert thread is not threading.main_thread()
    assert world.wakes == 1
    assert world.ended == [1, 0, 0]


def test_a_message_between_intervals_or_without_a_pace_waits_for_the_interval():
    world = World()
    for paced in (True, False):
        world.exchange.receive(encode_packets(SentPackets(packets=(packet(world.wall_ns),))))
        assert len(world.messages) == 1
        assert world.exchange.counters["sent"] == (0 if paced else 1)
        world.advance(paced=paced)
    assert len(world.received) == 2
    assert set(world.publishers) == {threading.main_thread()}


def test_an_error_of_the_emulator_where_a_packet_arrives_ends_the_interval(monkeypatch):
    world = World()
    world.receives_in_another_thread = True
    world.arrive(WALL_NS + 5_000_000, packet(WALL_NS))

    def fail(_packet, _at_ns):
        raise ValueError("of a user's model")

    monkeypatch.setattr(world.service, "submit_packet", fail)
    with pytest.raises(ValueError, match="of a user's model"):
        world.advance()


def test_malformed_messages_are_counted_and_change_nothing():
    world = World()
    stranger = encode_packets(SentPackets(packets=(packet(0, station=3), packet(0))))
    too_long = encode_packets(SentPackets(packets=(packet(0, payload=bytes(2_296)),) * 66))
    assert len(too_long) > LONGEST_SENT_BYTES
    world.arriving = [(WALL_NS, each) for each in (b"", b"\xc1", stranger, too_long)]
    world.advance()
    assert world.exchange.malformed.count == 4
    assert world.calls == ["malformed"] * 4
    assert world.published == []
    assert "packets" not in world.service.counters


def test_the_first_packet_is_reported():
    world = World()
    world.arrive(WALL_NS)
    world.advance()
    assert world.calls == []  # a message without packets
    world.arrive(world.wall_ns, packet(world.wall_ns))
    world.advance()
    assert world.calls == ["packets"]


def test_packets_beyond_the_limit_of_a_station_are_dropped_counted_and_end():
    world = World(queue_frames=10_000)
    one = packet(WALL_NS, payload=b"", category="bk", destination=mac_address(1))
    for _ in range(MOST_WAITING_PACKETS // 32 + 1):
        world.arrive(WALL_NS, *(one,) * 32)
    world.arrive(WALL_NS, packet(WALL_NS, station=2))
    world.advance()
    counters = world.exchange.counters
    assert (counters["sent"], counters["dropped"]) == (MOST_WAITING_PACKETS + 1, 32)
    while sum(world.ended) < MOST_WAITING_PACKETS + 32 + 1 and world.to_us < 2_000_000:
        world.advance()
    assert world.ended == [MOST_WAITING_PACKETS + 32, 0, 1]
    # all have left the radio: there is room again
    world.arrive(world.wall_ns, one)
    world.advance()
    assert world.exchange.counters["dropped"] == 32


def test_many_receptions_are_published_in_messages_of_limited_length():
    world = World(queue_frames=1_000, broadcast_mode="ofdm54", queue_lifetime_us=1_000_000)
    payloads = [bytes([i]) * 2_000 for i in range(60)]
    world.arrive(WALL_NS, *(packet(WALL_NS, payload=each) for each in payloads[:30]))
    world.arrive(WALL_NS, *(packet(WALL_NS, payload=each) for each in payloads[30:]))
    world.advance(paced=False)
    assert len(world.published) > 2
    assert [each.payload for _, each in world.received] == payloads
    assert world.ended == [60, 0, 0]


@settings(max_examples=15, deadline=None)
@given(
    reads=st.lists(st.tuples(st.integers(0, 119_000_000), st.integers(0, 2)), max_size=30),
    delay_ns=st.integers(0, 3_000_000),
    work_ns=st.integers(0, 50_000),
    another_thread=st.booleans(),
)
def test_packets_are_never_early_and_of_a_station_in_order(reads, delay_ns, work_ns, another_thread):
    world = World(work_ns=work_ns, channel="ideal")  # without collisions
    world.receives_in_another_thread = another_thread
    for number, (at_ns, station) in enumerate(sorted(reads)):
        one = packet(WALL_NS + at_ns, station=station, payload=number.to_bytes(2, "big"))
        world.arrive(WALL_NS + at_ns + delay_ns, one)
    for _ in range(5):
        world.advance()
        assert world.wall_ns >= WALL_NS + 1_000 * world.to_us
    numbers = [int.from_bytes(each.payload, "big") for _, each in world.received]
    assert sorted(numbers) == list(range(len(reads)))
    order = sorted(reads)
    for station in range(3):
        own = [number for number in numbers if order[number][1] == station]
        assert own == sorted(own)
    for published_ns, each in world.received:
        read_ns = WALL_NS + order[int.from_bytes(each.payload, "big")][0]
        assert read_ns < each.due_ns <= published_ns + 1_000
        assert published_ns - read_ns < delay_ns + 30 * AIR_NS
    assert sum(world.ended) == len(reads)


# --- pace and lateness


def test_pace_relates_simulated_and_wall_time():
    pace = Pace(to_ns=40_000_000, due_ns=1_000_000_000, speed=2.0)
    assert pace.wall_ns(40_000_000) == 1_000_000_000
    assert pace.wall_ns(20_000_000) == 990_000_000
    assert pace.simulated_ns(990_000_000) == 20_000_000


@pytest.mark.parametrize("given", [{}, {"due_ns": 5}, {"speed": 1.0}])
def test_an_interval_without_due_time_or_speed_has_no_pace(given):
    fields = {"pos_ned_m": b"", "vel_ned_m_s": b"", "q_ned_frd": b"", "extra_attenuation_db": 0.0}
    assert pace_of(Advance(to_us=1, release_us=1, at_us=0, **fields, **given)) is None


def test_lateness_counts_what_is_later_than_20_ms():
    lateness = Lateness()
    for late_ns in (-5e6, 1e6, 20e6, 21.5e6):
        lateness.add(late_ns)
    assert lateness.counters == {"packets": 4, "late": 1, "mean_ms": 10.625, "largest_ms": 21.5}
