"""The emulator through its interface: order, determinism, silenced stations, loss, counters."""

import msgspec
import numpy as np
import pytest
from netsim_swarm import STEP_US, Swarm

from netsim.emulator.emulator import NOTHING_PENDING_US
from netsim.model.config import FtmConfig
from netsim.wire.messages import Broadcast, Delivery, FtmRequest, FtmResult, TxBatch

FORMATION = [(2.5 * (i // 4), 8.5 * (i % 4), -20.0) for i in range(8)]


def traffic(swarm, until_us, *, backwards=False, rng_seed=2):
    """Beacons at 10 Hz and all-pairs ranging at 1 Hz, submitted step by step in one order or the other."""
    count = len(swarm.places)
    rng = np.random.default_rng(rng_seed)
    plan = [
        (int(t), i, None)
        for i in range(count)
        for t in rng.integers(0, 100_000) + 100_000 * np.arange(until_us // 100_000)
    ]
    plan += [(int(rng.integers(0, until_us)), i, j) for i in range(count) for j in range(count) if i != j]
    while swarm.now_us < until_us:
        stations = range(count)
        for station in reversed(stations) if backwards else stations:
            due = sorted(
                (at, peer or 0, peer)
                for at, i, peer in plan
                if i == station and swarm.now_us <= at < swarm.now_us + STEP_US
            )
            items = []
            for at_us, _, peer in due:
                seq = swarm._next(station)
                if peer is None:
                    items.append(Broadcast(seq=seq, at_us=at_us, payload=bytes([station, seq % 256])))
                else:
                    items.append(FtmRequest(seq=seq, at_us=at_us, peer=peer))
            if items:
                swarm.submit(station, *items)
        swarm.run(swarm.now_us + STEP_US)


def everything(seed=1, *, backwards=False):
    swarm = Swarm(FORMATION, seed=seed, host_latency_us=50, host_jitter_us=100)
    traffic(swarm, 600_000, backwards=backwards)
    emulator = swarm.emulator
    return msgspec.msgpack.encode(
        [
            swarm.received,
            emulator.take_frames(),
            emulator.take_sessions(),
            emulator.counters,
            emulator.busy_ns,
        ]
    )


def test_results_depend_only_on_the_seed_not_on_the_order_of_submission():
    first = everything()
    assert first == everything()
    assert first == everything(backwards=True)
    assert first != everything(seed=2)


def test_arrivals_come_in_order_and_within_their_interval():
    swarm = Swarm(FORMATION)
    for station in reversed(range(8)):
        swarm.broadcast(station, 1_000 + 500 * station)
    arrived = swarm.run(8_000)
    for receiver in range(8):
        keys = [(item.received_ns, item.source, item.seq) for station, item in arrived if station == receiver]
        assert keys == sorted(keys)
        assert len(keys) == 7
    assert all(1_000_000 < item.received_ns <= 8_000_000 for _, item in arrived)
    assert {item.payload for _, item in arrived} == {b"x" * 100}


def test_a_datagram_arrives_after_latency_access_and_air_time():
    # 100 bytes and 64 of headers at 24 Mbit/s last 76 us; 28.4 m take 95 ns
    swarm = Swarm([(0.0, 0.0, 0.0), (28.4, 0.0, 0.0)], host_latency_us=300, rician_k_db=None, access="dcf")
    seq = swarm.broadcast(0, 1_000)
    ((station, item),) = swarm.run(4_000)
    assert (station, item.source, item.seq) == (1, 0, seq)
    assert item.received_ns == 1_300_000 + 76_000 + 95
    # 16 dBm less Friis at 5210 MHz
    assert item.rssi_dbm == pytest.approx(16.0 - 46.78 - 29.07, abs=0.02)


def test_host_jitter_is_uniform_between_its_bounds():
    swarm = Swarm([(0.0, 0.0, 0.0), (5.0, 0.0, 0.0)], host_latency_us=50, host_jitter_us=100, access="dcf")
    for i in range(400):
        swarm.broadcast(0, 4_000 * i + 1_000)
    swarm.run(1_604_000)
    waits_us = np.array(
        [f.start_ns / 1_000 - 1_000 - 4_000 * i for i, f in enumerate(swarm.emulator.take_frames())]
    )
    assert waits_us.min() >= 50.0
    assert waits_us.max() < 150.0
    assert waits_us.mean() == pytest.approx(100.0, abs=4 * 28.9 / 20)


def test_single_station_has_no_receivers():
    swarm = Swarm([(0.0, 0.0, 0.0)])
    swarm.broadcast(0, 1_000)
    swarm.request(0, 0, 2_000)
    assert [item.status for _, item in swarm.run(200_000)] == ["rejected"]
    assert swarm.emulator.counters.frames_sent["data"] == 1


def test_a_cut_channel_delivers_nothing_and_ranging_fails():
    swarm = Swarm(FORMATION[:4])
    traffic(swarm, 400_000)
    delivered = swarm.emulator.counters.broadcasts_delivered
    assert min(delivered) > 0
    swarm.emulator.links.set_extra_attenuation_db(200.0)
    swarm.received.clear()
    swarm.emulator.take_sessions()
    for i in range(4):
        swarm.broadcast(i, swarm.now_us + 10_000 * i)
        swarm.request(i, (i + 1) % 4, swarm.now_us + 50_000 + 10_000 * i)
    swarm.run(swarm.now_us + 400_000)
    assert swarm.emulator.counters.broadcasts_delivered == delivered
    statuses = [item.status for _, item in swarm.received if isinstance(item, FtmResult)]
    assert len(statuses) == len(swarm.received) == 4
    assert set(statuses) <= {"no_response", "timeout"}
    swarm.emulator.links.set_extra_attenuation_db(0.0)
    swarm.broadcast(0, swarm.now_us)
    assert len(swarm.run(swarm.now_us + 8_000)) == 3


def test_losses_over_a_long_link_are_noise_and_match_the_error_model():
    # with 20 MHz and no fading 24 Mbit/s at 13.5 dB loses a tenth of 1458-byte frames
    distance_m = 10 ** ((16.0 - 46.78 - (13.5 - 93.99)) / 20)
    swarm = Swarm([(0.0, 0.0, 0.0), (distance_m, 0.0, 0.0)], bandwidth_mhz=20, rician_k_db=None)
    for i in range(1000):
        swarm.broadcast(0, 4_000 * i, b"x" * (1458 - 64))
    swarm.run(4_008_000)
    counters = swarm.emulator.counters
    lost = counters.broadcasts_lost_to_noise[1]
    assert counters.broadcasts_collided == (0, 0)
    assert counters.broadcasts_delivered[1] + lost == 1000
    # sigma of a count of 100 is 9.5; the ratio is known to 0.05 dB, which are 13 frames
    assert lost == pytest.approx(100, abs=45)


def test_silenced_station_neither_sends_nor_receives():
    swarm = Swarm(FORMATION[:3])
    swarm.broadcast(2, 1_000)
    for _ in range(20):
        swarm.broadcast(0, 3_900)
    swarm.run(4_000)
    swarm.emulator.set_silent(0)
    sent = swarm.emulator.counters.frames_sent["data"]
    swarm.broadcast(0, 5_000)
    swarm.broadcast(1, 9_000)
    swarm.run(100_000)
    # the frame on the air at 4 ms is completed; 1 asks 0 for a CTS in vain, and then 2
    assert swarm.emulator.counters.frames_sent["data"] <= sent + 2
    received = [(station, item.source) for station, item in swarm.received if item.received_ns > 5_000_000]
    assert received == [(2, 1)]
    assert swarm.emulator.counters.drops["expired"] >= 18


def test_every_reception_is_accounted_for():
    swarm = Swarm(FORMATION, broadcast_rts=False)
    for i in range(30):
        for station in range(8):
            swarm.broadcast(station, 20_000 * i + 7 * ((station * i) % 5))
    swarm.run(620_000)
    frames = swarm.emulator.take_frames()
    counters = swarm.emulator.counters
    data = [f for f in frames if f.kind == "data"]
    assert len(data) == counters.frames_sent["data"] == 240
    assert all(f.delivered + f.collided + f.lost_to_noise == 7 for f in data)
    assert sum(f.delivered for f in data) == sum(counters.broadcasts_delivered) == len(swarm.received)
    assert sum(f.collided for f in data) == sum(counters.broadcasts_collided) > 0
    assert swarm.emulator.take_frames() == []


def test_rts_before_broadcasts_saves_them_from_collisions():
    ratios = []
    for rts in (False, True):
        swarm = Swarm(FORMATION, broadcast_rts=rts)
        for i in range(30):
            for station in range(8):
                swarm.broadcast(station, 20_000 * i + 7 * ((station * i) % 5), b"x" * 1000)
        swarm.run(620_000)
        counters = swarm.emulator.counters
        ratios.append(sum(counters.broadcasts_delivered) / (7 * 240))
    assert ratios[1] > ratios[0] + 0.1


def test_quiet_time_is_the_next_event_or_unlimited():
    swarm = Swarm(FORMATION[:2], host_latency_us=50)
    assert swarm.emulator.next_event_us == NOTHING_PENDING_US
    swarm.broadcast(0, 10_000)
    assert swarm.emulator.next_event_us == 10_050
    swarm.run(12_000)
    assert swarm.emulator.next_event_us == NOTHING_PENDING_US


def weaving(time_s):
    """Three stations, of which two fly to and fro with up to 6 m/s, 4 m/s^2 at most, off on their ways."""
    amplitudes_m = np.array([[0.0, 0.0, 0.0], [1.0, 0.7, 0.3], [-0.5, 1.2, 0.0]])
    away = np.array([[0.0, 0.0, 0.0], [3.0, -2.0, 0.5], [4.0, 1.0, -1.0]])
    places = np.array(FORMATION[:3]) + away * time_s + amplitudes_m * np.sin(2.0 * time_s)
    return places, away + 2.0 * amplitudes_m * np.cos(2.0 * time_s)


def received(swarm, *, skip):
    """After beacons and rangings for 2 s, the time master leaving quiet steps out or not."""
    for i in range(40):
        swarm.broadcast(i % 3, 50_000 * i + 1_000)
        swarm.request(i % 3, (i + 1) % 3, 50_000 * i + 20_000)
    while swarm.now_us < 2_000_000:
        if skip and swarm.emulator.next_event_us > swarm.now_us + STEP_US:
            swarm.now_us += STEP_US
        else:
            swarm.run(swarm.now_us + STEP_US)
    return swarm.received


def test_skipping_quiet_steps_of_stations_at_rest_changes_nothing():
    runs = [received(Swarm(FORMATION[:3]), skip=skip) for skip in (True, False)]
    assert runs[0] == runs[1]


def test_skipping_quiet_steps_of_stations_in_flight_changes_nothing():
    """Without fading all is the same to the bit: places are.

    Fading goes by ways, and across the steps left out a way is its chord. Over 2 s the powers of K = 0 dB
    differ by 0.2 to 0.5 dB at most, of four seeds; had they other phases it would be 14 to 27 dB.
    """
    steady = [
        received(Swarm(FORMATION[:3], motion=weaving, rician_k_db=None), skip=skip) for skip in (True, False)
    ]
    assert steady[0] == steady[1]
    faded = [
        received(Swarm(FORMATION[:3], motion=weaving, rician_k_db=0.0), skip=skip) for skip in (True, False)
    ]
    assert [(station, type(item), item.seq) for station, item in faded[0]] == [
        (station, type(item), item.seq) for station, item in faded[1]
    ]
    powers_dbm = np.array([[item.rssi_dbm for _, item in run if isinstance(item, Delivery)] for run in faded])
    assert np.abs(powers_dbm[0] - powers_dbm[1]).max() < 1.0


def test_station_out_of_range_does_not_interfere():
    """5 km are a delay of 16.7 us: answers would be due before what they answer has ended there."""
    swarm = Swarm([(0.0, 0.0, -20.0), (10.0, 0.0, -20.0), (5_000.0, 0.0, -20.0)])
    swarm.request(0, 1, 100)
    swarm.broadcast(1, 30_000)
    swarm.broadcast(2, 60_000)
    swarm.run(200_000)
    arrived = [(station, type(item)) for station, item in swarm.received]
    assert arrived == [(0, FtmResult), (0, Delivery)]
    assert swarm.received[0][1].status == "ok"


def test_station_that_senses_weak_signals_still_gets_access():
    """The radios' noise is at -49 dBm, and the -82 dBm that arrive from each other still hold them back."""
    swarm = Swarm(
        [(0.0, 0.0, -20.0), (350.0, 0.0, -20.0)],
        rician_k_db=None,
        broadcast_rts=False,
        noise_figure_db=46.0,
        cca_energy_dbm=-100.0,
    )
    swarm.broadcast(0, 100, b"x" * 1400)
    swarm.broadcast(1, 300)
    swarm.run(400_000)
    first, second = swarm.emulator.take_frames()
    assert second.start_ns > first.start_ns + 400_000


def test_a_channel_without_stations_runs():
    swarm = Swarm(np.zeros((0, 3)))
    assert swarm.run(8_000) == []


def test_busy_time_is_the_union_of_what_was_on_the_air():
    swarm = Swarm(FORMATION[:3], rician_k_db=None, broadcast_rts=False, access="dcf")
    swarm.broadcast(0, 1_000)
    swarm.broadcast(1, 1_000)
    swarm.broadcast(2, 3_950)
    swarm.run(4_000)
    # two at once are 76 us, of the third 50 us have passed
    assert swarm.emulator.busy_ns == 76_000 + 50_000
    swarm.run(8_000)
    assert swarm.emulator.busy_ns == 2 * 76_000


def test_invalid_input_is_rejected():
    swarm = Swarm(FORMATION[:2])
    with pytest.raises(ValueError, match="station 2 is out of range"):
        swarm.emulator.submit(TxBatch(station=2, now_us=0, items=()))
    fine = np.zeros((2, 3))
    for wrong in (np.zeros((3, 3)), np.full((2, 3), np.nan)):
        for pos_ned_m, vel_ned_m_s in ((wrong, fine), (fine, wrong)):
            with pytest.raises(ValueError, match="finite and of shape"):
                swarm.emulator.advance(to_us=4_000, at_us=0, pos_ned_m=pos_ned_m, vel_ned_m_s=vel_ned_m_s)
    swarm.run(8_000)
    with pytest.raises(ValueError, match="go back"):
        swarm.emulator.advance(to_us=4_000, at_us=0, pos_ned_m=fine, vel_ned_m_s=fine)
    with pytest.raises(ValueError, match="MCS 9"):
        Swarm(FORMATION[:2], bandwidth_mhz=20, broadcast_mode="vht_mcs9")


def test_deliveries_and_results_are_wire_messages():
    swarm = Swarm(FORMATION[:2])
    swarm.broadcast(0, 1_000)
    swarm.request(0, 1, 2_000)
    kinds = [(station, type(item)) for station, item in swarm.run(20_000)]
    assert sorted(kinds) == [(0, FtmResult), (1, Delivery)]


@pytest.mark.parametrize("seed", range(6))
def test_every_item_has_exactly_one_outcome(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 12))
    reach_m = float(rng.choice([5.0, 100.0, 400.0]))
    swarm = Swarm(
        rng.uniform(-reach_m, reach_m, (count, 3)).tolist(),
        seed=seed,
        rician_k_db=6.0,
        shadowing_std_db=6.0,
        broadcast_rts=bool(seed % 2),
        queue_lifetime_us=int(rng.choice([5_000, 500_000])),
        ftm=FtmConfig(responder_sessions=2, access_category=str(rng.choice(["vo", "be"]))),
    )
    broadcasts, requests = 0, set()
    for _ in range(60):
        for station in range(count):
            for _ in range(rng.poisson(0.4)):
                swarm.broadcast(
                    station, swarm.now_us + int(rng.integers(STEP_US)), b"x" * int(rng.integers(1400))
                )
                broadcasts += 1
            if rng.random() < 0.15:
                peer = int(rng.integers(count + 1))
                requests.add(
                    (station, swarm.request(station, peer, swarm.now_us + int(rng.integers(STEP_US))))
                )
        if rng.random() < 0.05:
            swarm.emulator.links.set_extra_attenuation_db(float(rng.choice([0.0, 30.0, 200.0])))
        swarm.places = swarm.places + rng.normal(0.0, 0.05, (count, 3))
        swarm.run(swarm.now_us + STEP_US)
    swarm.run(swarm.now_us + 1_000_000)
    ended = [(station, item.seq) for station, item in swarm.received if isinstance(item, FtmResult)]
    assert len(ended) == len(requests)
    assert set(ended) == requests
    counters = swarm.emulator.counters
    assert counters.frames_sent["data"] + sum(counters.drops.values()) == broadcasts
    assert (
        counters.ftm.completed + sum(counters.ftm.failed.values()) == counters.ftm.requested == len(requests)
    )
    assert swarm.emulator.next_event_us == NOTHING_PENDING_US
