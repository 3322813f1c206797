"""The ideal channel compared to the emulated one and to calculated times, without disturbances. 3 s."""

from collections import Counter

import msgspec
import numpy as np
import pytest
from netsim_swarm import STEP_US, Swarm

from netsim.emulator.emulator import NOTHING_PENDING_US
from netsim.model.config import FtmConfig, InterfererConfig, StationConfig
from netsim.phy.modes import phy_mode
from netsim.wire.messages import Delivery, FtmResult, Sent

PAIR = [(0.0, 0.0, -20.0), (28.4, 0.0, -20.0)]
FORMATION = [(2.5 * (i // 4), 8.5 * (i % 4), -20.0) for i in range(8)]
FLIGHT_NS = 95
"""Over 28.4 m."""
REACH_M = 10.0 ** ((16.0 - 20.0 * np.log10(4e6 * np.pi * 5210.0 / 299_792_458.0) + 82.0) / 20.0)
"""Where 16 dBm have become -82 dBm by Friis at 5210 MHz."""
DISTURBED = {
    "shadowing_std_db": 8.0,
    "rician_k_db": 0.0,
    "nlos_fraction": 0.5,
    "interferers": (InterfererConfig(pos_ned_m=(0.0, 0.0, -19.0), duty_cycle=0.9),),
}


def both(places, **settings):
    """An ideal and an emulated swarm whose links do not fade, with DCF: EDCA waits for slot boundaries."""
    settings = {"rician_k_db": None, "broadcast_rts": False, "access": "dcf", **settings}
    return (Swarm(places, channel=channel, **settings) for channel in ("ideal", "emulated"))


def alone(swarm):
    """Broadcasts and datagrams to one station that never meet: 20 ms apart, the longest lasts 0.6 ms."""
    for i in range(30):
        swarm.broadcast(i % 2, 20_000 * i + 1_000, b"x" * (1 + 47 * i))
        swarm.unicast(i % 2, 1 - i % 2, 20_000 * i + 11_000, b"x" * (1 + 47 * i))
    swarm.run(620_000)
    return swarm


def test_uncontended_frames_match_the_emulated_channel_exactly():
    """A frame that finds the medium idle goes at once: with no contention both channels are the same."""
    ideal, emulated = (alone(swarm) for swarm in both(PAIR, host_latency_us=50, host_jitter_us=100))
    assert len(ideal.received) == 30 + 2 * 30
    assert ideal.received == emulated.received
    assert ideal.emulator.take_frames() == emulated.emulator.take_frames()
    assert ideal.emulator.counters == emulated.emulator.counters


def test_datagram_delay_is_independent_of_other_traffic():
    """100 bytes and 64 of headers at 24 Mbit/s last 76 us; no frame waits or collides.

    Eight at once, and three of one's own at once, which the emulated channel has to put in a row.
    """
    swarm = Swarm(FORMATION, channel="ideal", host_latency_us=300)
    for _ in range(3):
        for station in range(8):
            swarm.broadcast(station, 1_000)
    swarm.run(4_000)
    received = {(to, item.source, item.seq) for to, item in swarm.received}
    assert received == {(to, of, seq) for to in range(8) for of in range(8) for seq in (1, 2, 3) if to != of}
    for to, item in swarm.received:
        distance_m = float(np.linalg.norm(np.subtract(FORMATION[to], FORMATION[item.source])))
        assert item.received_ns == 1_300_000 + 76_000 + round(distance_m / 0.299792458)
        assert item.rssi_dbm == pytest.approx(16.0 - 46.78 - 20.0 * np.log10(distance_m), abs=0.02)


def sessions(swarm, count=40):
    for i in range(count):
        swarm.request(i % 2, 1 - i % 2, 20_000 * i + 1_000)
    swarm.run(20_000 * count + 40_000)
    return [item for _, item in swarm.received]


def test_ranging_matches_the_emulated_channel():
    """Clocks and noise come from the same streams in the same order.

    So each distance is the same but for where stamps are rounded to 1 ps (0.3 mm of a range, twice in each of
    7 round trips) and for the carrier's part: t3 - t2 is the same.
    """
    ideal, emulated = (sessions(swarm) for swarm in both(PAIR))
    assert {item.status for item in ideal + emulated} == {"ok"}
    for one, other in zip(ideal, emulated, strict=True):
        assert one.distance_m == pytest.approx(other.distance_m, abs=0.5e-3)
        assert one.distance_std_m == pytest.approx(other.distance_std_m, abs=0.5e-3)
        assert (one.round_trips, one.measurements, one.rssi_dbm) == pytest.approx((7, 8, other.rssi_dbm))
    errors_m = np.array([item.distance_m for item in ideal]) - 28.4
    # one round trip has 0.081 m; 7 are averaged; the mean of 40 sessions within 4 sigma, their spread too
    std_m = 0.0806 / np.sqrt(7)
    assert errors_m.mean() == pytest.approx(0.0, abs=4 * std_m / np.sqrt(40))
    assert errors_m.std() == pytest.approx(std_m, rel=4 / np.sqrt(80))


def test_a_session_lasts_as_long_as_its_frames():
    """From the request to the eighth measurement frame, seven times the least time between two of them."""
    swarm = Swarm(PAIR, channel="ideal")
    swarm.request(0, 1, 1_000)
    ((_, result),) = swarm.run(8_000)
    frames = swarm.emulator.take_frames()
    mode = phy_mode("vht_mcs0", 80)
    request_ns, last_ns = (
        mode.duration_ns(next(f.bytes for f in each if f.kind == kind))
        for each, kind in ((frames, "ftm_request"), (frames[::-1], "ftm"))
    )
    assert result.ended_ns == 1_000_000 + request_ns + FLIGHT_NS + 7 * 200_000 + last_ns + FLIGHT_NS
    assert Counter(f.kind for f in frames) == {"ftm_request": 1, "ftm": 8, "ack": 9}


def test_concurrent_ranging_of_all_pairs_is_undisturbed():
    """56 sessions begin in one moment; the emulated channel, of 1 frame at a time, takes far longer."""
    swarm = Swarm(FORMATION, channel="ideal")
    for station in range(8):
        for peer in range(8):
            if peer != station:
                swarm.request(station, peer, 1_000)
    swarm.run(8_000)
    assert [item.status for _, item in swarm.received] == ["ok"] * 56
    assert {item.round_trips for _, item in swarm.received} == {7}


@pytest.mark.parametrize(("share", "in_range"), [(0.999, True), (1.001, False)])
def test_reception_depends_only_on_the_range(share, in_range):
    swarm = Swarm([(0.0, 0.0, -20.0), (share * REACH_M, 0.0, -20.0)], channel="ideal", **DISTURBED)
    for i in range(50):
        swarm.broadcast(0, 4_000 * i)
    swarm.unicast(0, 1, 204_000)
    swarm.request(0, 1, 212_000)
    swarm.run(400_000)
    received = [item for station, item in swarm.received if station == 1]
    sent, ranged = (item for station, item in swarm.received if station == 0)
    counters = swarm.emulator.counters
    if in_range:
        assert len(received) == 51
        assert (sent.status, sent.attempts, ranged.status) == ("acknowledged", 1, "ok")
        assert counters.broadcasts_delivered == (0, 50)
    else:
        assert received == []
        assert (sent.status, sent.attempts, ranged.status) == ("retry_limit", 7, "no_response")
        assert counters.broadcasts_lost_to_noise == (0, 50)


def test_attenuated_channel_is_cut_for_that_time():
    swarm = Swarm(FORMATION, channel="ideal")
    for i in range(75):
        swarm.broadcast(0, 4_000 * i + 1_000)
    for until_us, extra_db in ((100_000, 200.0), (200_000, 0.0), (300_000, 0.0)):
        swarm.run(until_us)
        swarm.emulator.links.set_extra_attenuation_db(extra_db)
    heard_us = sorted({item.received_ns // 4_000_000 * 4_000 for _, item in swarm.received})
    assert heard_us == [*range(0, 100_000, 4_000), *range(200_000, 300_000, 4_000)]
    assert len(swarm.received) == 50 * 7


def test_datagram_with_lost_acks_is_delivered_once():
    """The sender's power is 30 dB higher than the other's, whose ACK does not reach it."""
    swarm = Swarm(
        [(0.0, 0.0, -20.0), (2.0 * REACH_M, 0.0, -20.0)],
        channel="ideal",
        stations=(StationConfig(station=0, tx_power_dbm=46.0),),
    )
    seq = swarm.unicast(0, 1, 1_000)
    swarm.run(40_000)
    kinds = sorted((station, type(item), item.seq) for station, item in swarm.received if station == 1)
    assert kinds == [(1, Delivery, seq)]
    ((_, sent),) = [each for each in swarm.received if each[0] == 0]
    assert isinstance(sent, Sent)
    assert (sent.status, sent.attempts) == ("retry_limit", 7)


def everything(*, backwards=False, **settings):
    swarm = Swarm(FORMATION, channel="ideal", host_latency_us=50, host_jitter_us=100, **settings)
    stations = range(8)
    for station in reversed(stations) if backwards else stations:
        for i in range(10):
            swarm.broadcast(station, 10_000 * i)
            swarm.unicast(station, (station + 1 + i % 7) % 8, 10_000 * i + 3)
            swarm.request(station, (station + 1 + i % 7) % 8, 10_000 * i + 7)
    swarm.run(140_000)
    emulator = swarm.emulator
    return msgspec.msgpack.encode(
        [swarm.received, emulator.take_frames(), emulator.take_sessions(), emulator.counters]
    )


def test_results_depend_only_on_the_seed_without_disturbances():
    first = everything()
    assert first == everything(backwards=True)
    assert first == everything(**DISTURBED)
    assert first == everything(broadcast_rts=False, access="dcf", queue_frames=1, rts_threshold_bytes=0)
    assert first != everything(seed=2)


def test_the_medium_is_never_busy():
    swarm = Swarm(FORMATION, channel="ideal")
    for station in range(8):
        swarm.broadcast(station, 1_000)
    swarm.run(8_000)
    assert swarm.emulator.busy_ns == 0
    assert {station for station, _ in swarm.surveys} == set(range(8))
    assert {survey.busy_ns for _, survey in swarm.surveys} == {0}


def test_adaptive_rates_reach_the_fastest_mode():
    swarm = Swarm(PAIR, channel="ideal", data_mode="adaptive")
    for i in range(400):
        swarm.unicast(0, 1, 4_000 * i, b"x" * 1400)
    swarm.run(1_604_000)
    modes = [f.mode for f in swarm.emulator.take_frames() if f.kind == "data"]
    assert modes[-50:].count("vht_mcs9") > 35


@pytest.mark.parametrize("seed", range(4))
def test_every_item_has_exactly_one_outcome(seed):
    """Stations move, are silenced and lose contact; results of a silenced one are not delivered."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 10))
    swarm = Swarm(
        rng.uniform(-300.0, 300.0, (count, 3)).tolist(),
        channel="ideal",
        seed=seed,
        queue_lifetime_us=int(rng.choice([1_000, 500_000])),
        ftm=FtmConfig(responder_sessions=2, bursts_exponent=seed % 2, asap=bool(seed // 2)),
    )
    submitted, silent, datagrams = set(), set(), 0
    for _ in range(60):
        if rng.random() < 0.03:
            gone = int(rng.integers(count))
            silent.add(gone)
            swarm.emulator.set_silent(gone)
        for station in range(count):
            at_us = swarm.now_us + int(rng.integers(STEP_US))
            swarm.broadcast(station, at_us)
            if rng.random() < 0.3:
                submitted.add((station, swarm.request(station, int(rng.integers(count + 1)), at_us)))
            if rng.random() < 0.3:
                submitted.add((station, swarm.unicast(station, int(rng.integers(count + 1)), at_us)))
                datagrams += station not in silent
        if rng.random() < 0.05:
            swarm.emulator.links.set_extra_attenuation_db(float(rng.choice([0.0, 10.0, 200.0])))
        swarm.places = swarm.places + rng.normal(0.0, 5.0, (count, 3))
        swarm.run(swarm.now_us + STEP_US)
    swarm.run(swarm.now_us + 1_000_000)
    ended = [(to, item.seq) for to, item in swarm.received if isinstance(item, FtmResult | Sent)]
    assert len(ended) == len(set(ended))
    assert {each for each in submitted if each[0] not in silent} <= set(ended) <= submitted
    counters = swarm.emulator.counters
    assert counters.ftm.requested == counters.ftm.completed + sum(counters.ftm.failed.values())
    assert sum(counters.unicasts.values()) == datagrams
    assert swarm.emulator.next_event_us == NOTHING_PENDING_US
