"""Busy time of a station: the union of sensed and sent signals, to the nanosecond. 4 s."""

import numpy as np
import pytest
from netsim_air import UNDETECTED_DBM, A, Air, B, C
from netsim_swarm import STEP_US, Swarm

from netsim.model.config import GuestConfig, InterfererConfig
from netsim.wire.messages import Broadcast, FtmRequest, Survey, TxBatch, Unicast

SENSED_MW = 10.0**-8.2
HERE = (0.0, 0.0, -20.0)


def union_ns(intervals, until_ns):
    """Length of a union of intervals up to a time."""
    total_ns, covered_ns = 0, 0
    for begin_ns, end_ns in sorted(intervals):
        begin_ns, end_ns = max(begin_ns, covered_ns), min(end_ns, until_ns)
        if end_ns > begin_ns:
            total_ns += end_ns - begin_ns
            covered_ns = end_ns
    return total_ns


def expected_ns(transmissions, station, until_ns):
    """What a station sends, and what reaches it at -82 dBm or more, from its arrival on."""
    return union_ns(
        [
            (t.start_ns + t.delays_ns[station], t.end_ns + t.delays_ns[station])
            for t in transmissions
            if t.source == station or t.powers_mw[station] >= SENSED_MW
        ],
        until_ns,
    )


def surveyed_us(air, station):
    return air.radios.surveyed_ns()[station] / 1_000


def test_busy_time_of_a_given_timeline():
    """A to B at 100 us, 100 bytes at 6 Mbit/s: C receives only B, and so only the ACK.

    us    100      260    276      320
    A      [  data  ]                     20 + 4 ceil((22 + 800) / 24) = 160
    B                 SIFS [  ACK  ]      20 + 4 ceil((22 + 112) / 24) = 44
    """
    air = Air(3, powers_dbm={(A, C): UNDETECTED_DBM, (C, A): UNDETECTED_DBM})
    air.send(100, A, B)
    for until_us, of_a, of_c in (
        (100, 0, 0), (150, 50, 0), (260, 160, 0), (270, 160, 0), (280, 164, 4), (400, 204, 44),
    ):  # fmt: skip
        sent = air.run(until_us)
        assert (surveyed_us(air, A), surveyed_us(air, B), surveyed_us(air, C)) == (of_a, of_a, of_c)
    assert sent == [(100, 260, A, "data"), (276, 320, B, "ack")]


def test_nav_alone_does_not_count_as_busy():
    """C receives A, whose RTS reserves the medium to the end of the ACK, but not B.

    The RTS of 20 bytes at 24 Mbit/s lasts 28 us, the frame 160 us; B's CTS and ACK, and four SIFS, are NAV.
    """
    air = Air(3, powers_dbm={(B, C): UNDETECTED_DBM})
    air.send(100, A, B, rts=True)
    assert [kind for *_, kind in air.run(1_000)] == ["rts", "cts", "data", "ack"]
    assert surveyed_us(air, C) == 28.0 + 160.0
    # a CTS at 24 Mbit/s and an ACK at 6 Mbit/s, both of 14 bytes
    assert surveyed_us(air, A) == surveyed_us(air, B) == 28.0 + 28.0 + 160.0 + 44.0


def test_sending_during_a_sensed_signal_counts_once():
    """Within 4 us of its arrival B has not sensed A's frame and sends too; C sends after both."""
    air = Air(3)
    air.send(100, A)
    air.send(102, B)
    air.send(103, C, frame_bytes=400)
    air.run(2_000)
    starts_us = {source: start for start, _, source, _ in air.run(2_000)}
    assert starts_us == {A: 100, B: 102, C: 103}
    # 400 bytes are 20 + 4 ceil((22 + 3200) / 24) = 560 us
    assert [surveyed_us(air, each) for each in (A, B, C)] == [563.0] * 3


@pytest.mark.parametrize("seed", range(6))
def test_busy_time_is_the_union_of_sensed_and_sent_time(seed):
    """Stations up to 1.4 km apart, some hidden from each other, that collide, answer and reserve."""
    rng = np.random.default_rng(seed)
    count = 6
    transmissions = []
    swarm = Swarm(
        [(x, y, -20.0) for x, y in rng.uniform(-500.0, 500.0, (count, 2))],
        seed=seed,
        rician_k_db=None,
        bandwidth_mhz=20,
        broadcast_rts=bool(seed % 2),
        rts_threshold_bytes=500,
        on_transmission=transmissions.append,
    )
    emulator, seen = swarm.emulator, []
    for station in range(count):
        for _ in range(25):
            at_us = int(rng.integers(100_000))
            if rng.random() < 0.5:
                swarm.broadcast(station, at_us, b"x" * int(rng.integers(1400)))
            else:
                swarm.unicast(station, (station + 1) % count, at_us, b"x" * int(rng.integers(1400)))
    still = np.zeros((count, 3))
    now_us = 0
    while now_us < 300_000:
        before_us, now_us = now_us, now_us + int(rng.integers(1, 700))
        emulator.advance(to_us=now_us, at_us=before_us, pos_ned_m=swarm.places, vel_ned_m_s=still)
        seen.append((1_000 * now_us, emulator._channel.surveyed_ns()))
    expected = [[expected_ns(transmissions, i, at_ns) for i in range(count)] for at_ns, _ in seen]
    np.testing.assert_array_equal([counts for _, counts in seen], expected)
    assert len({tuple(counts) for counts in expected}) > 200
    assert min(expected[-1]) > 5_000_000


def test_stations_in_range_of_all_count_the_mediums_busy_time():
    """In one place there is no flight time, and surveys are equal to it to the nanosecond."""
    swarm = Swarm([HERE] * 5)
    rng = np.random.default_rng(3)
    for station in range(5):
        for i in range(100):
            swarm.broadcast(station, 4_000 * i + int(rng.integers(4_000)))
            if i % 10 == 0:
                swarm.request(station, (station + 1) % 5, 4_000 * i + int(rng.integers(4_000)))
    busy_ns = {}
    while swarm.now_us < 420_000:
        swarm.run(swarm.now_us + STEP_US)
        busy_ns[1_000 * swarm.now_us] = swarm.emulator.busy_ns
    assert len(swarm.surveys) > 400
    assert {survey.busy_ns - busy_ns[survey.ended_ns] for _, survey in swarm.surveys} == {0}
    assert 0.1 < swarm.surveys[-1][1].busy_ns / swarm.surveys[-1][1].ended_ns < 0.9


def test_interferers_count_as_busy_time():
    """Bursts and frames arrive 10 to 17 ns late, which moves the ends of busy periods by as much."""
    swarm = Swarm(
        [HERE, (4.0, 0.0, -20.0)],
        interferers=(InterfererConfig(pos_ned_m=(0.0, 3.0, -20.0), duty_cycle=0.3, burst_us=500.0),),
    )
    for i in range(200):
        swarm.broadcast(0, 10_000 * i)
    swarm.run(2_000_000)
    busy_ns = swarm.emulator.busy_ns
    assert 0.25 < busy_ns / 2e9 < 0.4
    # 200 frames and some 1200 bursts, of whose overlaps the flight times make more or less
    assert swarm.emulator._channel.surveyed_ns() == pytest.approx([busy_ns] * 2, abs=1_400 * 17)


def test_survey_is_the_last_item_of_each_vehicle():
    """Station 2 is a guest, which gets none; station 1 gets nothing else in the second interval, so none."""
    swarm = Swarm([HERE, HERE, HERE], guests=(GuestConfig(name="ground", pos_ned_m=HERE),))
    emulator, still = swarm.emulator, np.zeros((3, 3))

    def advance(to_us, *items):
        if items:
            emulator.submit(TxBatch(station=0, now_us=to_us - STEP_US, items=items))
        return emulator.advance(to_us=to_us, at_us=to_us - STEP_US, pos_ned_m=swarm.places, vel_ned_m_s=still)

    def kinds(arrived):
        return {station: [type(item).__name__ for item in items] for station, items in arrived.items()}

    first = advance(STEP_US, Broadcast(seq=1, at_us=100, payload=b"all"))
    (delivery, survey), (guest_delivery,) = first[1], first[2]
    assert (len(first), delivery.payload, guest_delivery.payload) == (2, b"all", b"all")
    # 64 bytes of headers and 3 at 24 Mbit/s
    assert survey == Survey(ended_ns=4_000_000, busy_ns=20_000 + 4_000 * 6)
    second = advance(2 * STEP_US, Unicast(seq=2, at_us=5_000, destination=2, payload=b"one"))
    assert kinds(second) == {0: ["Sent", "Survey"], 2: ["Delivery"]}
    third = advance(3 * STEP_US, FtmRequest(seq=3, at_us=9_000, peer=1))
    assert kinds(third) == {0: ["FtmResult", "Survey"]}
    assert third[0][-1].busy_ns == emulator.busy_ns > second[0][-1].busy_ns > survey.busy_ns
    assert advance(4 * STEP_US) == {}
