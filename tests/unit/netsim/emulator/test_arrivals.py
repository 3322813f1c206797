"""Losses in hosts and range offsets, and that they change nothing else. 6 s."""

from math import sqrt

import numpy as np
import pytest
from netsim_swarm import Swarm

from netsim.model.config import FtmConfig
from netsim.wire.messages import Delivery, FtmResult, Sent

FORMATION = [(2.5 * (i // 4), 8.5 * (i % 4), -20.0) for i in range(8)]
ROUNDS = 100
CHANNELS = pytest.mark.parametrize("channel", ["ideal", "emulated"])


def swarm_of(drop_fraction, *, channel="ideal", offsets_m=None):
    """Run beacons and rangings of all stations, 20 ms apart."""
    swarm = Swarm(FORMATION[:4], channel=channel, drop_fraction=drop_fraction, ftm=FtmConfig(clock_ppm=5.0))
    swarm.emulator.range_offsets_m = offsets_m or {}
    for i in range(ROUNDS):
        for station in range(4):
            swarm.broadcast(station, 40_000 * i + 2_000 * station)
            swarm.unicast(station, (station + 1) % 4, 40_000 * i + 2_000 * station + 1_000)
            swarm.request(station, (station + 1 + i % 3) % 4, 40_000 * i + 5_000 * station + 12_000)
    swarm.run(40_000 * ROUNDS + 120_000)
    return swarm


@pytest.fixture(scope="module")
def lossless():
    return {channel: swarm_of(0.0, channel=channel) for channel in ("ideal", "emulated")}


def by_key(swarm, kind):
    """Items of a kind, by station, the other's number and seq."""
    return {
        (station, item.source if isinstance(item, Delivery) else item.peer, item.seq): item
        for station, item in swarm.received
        if isinstance(item, kind)
    }


@CHANNELS
def test_fraction_of_losses_is_the_configured_one(lossless, channel):
    """Within 4 sigma of the binomial; and two receivers of one broadcast lose independently of each other."""
    share = 0.3
    all_of, some = lossless[channel], swarm_of(share, channel=channel)
    for kind in (Delivery, FtmResult):
        before, after = by_key(all_of, kind), by_key(some, kind)
        sound = [key for key, item in before.items() if kind is Delivery or item.status == "ok"]
        kept = sum(key in after and (kind is Delivery or after[key].status == "ok") for key in sound)
        count = len(sound)
        assert count > 350
        assert 1.0 - kept / count == pytest.approx(share, abs=4 * sqrt(share * (1.0 - share) / count))
    # both receivers of a broadcast of station 3 lose it in the square of the share
    before, after = by_key(all_of, Delivery), by_key(some, Delivery)
    to_both = [key[1:] for key in before if key[:2] == (1, 3) and (2, *key[1:]) in before]
    lost_by_both = np.mean([(1, *key) not in after and (2, *key) not in after for key in to_both])
    sigma = sqrt(share**2 * (1.0 - share**2) / len(to_both))
    assert len(to_both) > 80
    assert lost_by_both == pytest.approx(share**2, abs=4 * sigma)


@CHANNELS
def test_host_losses_do_not_change_other_results(lossless, channel):
    """Remaining items are bit-identical to those without losses; each lost result has its time."""
    all_of, some = lossless[channel], swarm_of(0.4, channel=channel)
    before, after = by_key(all_of, Delivery), by_key(some, Delivery)
    assert 0 < len(after) < len(before)
    assert after.items() <= before.items()
    assert some.emulator.counters.lost_by_hosts == len(before) - len(after)
    assert all_of.emulator.counters.lost_by_hosts == 0
    before, after = by_key(all_of, FtmResult), by_key(some, FtmResult)
    assert before.keys() == after.keys()
    lost = {key for key, item in after.items() if item.status == "lost"}
    assert 0 < len(lost) < len(before)
    for key, item in after.items():
        if key in lost:
            assert before[key].status == "ok"
            assert (item.ended_ns, item.measured_ns) == (before[key].ended_ns, before[key].ended_ns)
            assert (item.distance_m, item.distance_std_m, item.rssi_dbm, item.round_trips) == (0, 0, 0, 0)
        else:
            assert item == before[key]
    assert some.emulator.counters.ftm.failed["lost"] == len(lost)
    assert len(after) > 350
    assert some.emulator.take_frames() == all_of.emulator.take_frames()
    reports = [[each for each in swarm.received if isinstance(each[1], Sent)] for swarm in (all_of, some)]
    assert reports[0] == reports[1]


def test_a_host_may_lose_everything():
    swarm = swarm_of(1.0)
    assert by_key(swarm, Delivery) == {}
    assert {item.status for item in by_key(swarm, FtmResult).values()} == {"lost"}
    assert swarm.emulator.counters.broadcasts_delivered == (3 * ROUNDS,) * 4


@CHANNELS
def test_range_offset_applies_only_to_sessions_of_the_initiator(lossless, channel):
    """Station 1's own distances grow by 5 m and station 2's shrink by 0.5 m; others' do not."""
    offsets_m = {1: 5.0, 2: -0.5}
    wrong = swarm_of(0.0, channel=channel, offsets_m=offsets_m)
    before, after = by_key(lossless[channel], FtmResult), by_key(wrong, FtmResult)
    assert before.keys() == after.keys()
    for key, item in after.items():
        if item.status == "ok":
            offset_m = offsets_m.get(key[0], 0.0)
            assert item.distance_m - before[key].distance_m == pytest.approx(offset_m, abs=1e-9)
    errors_m = {station: [] for station in range(4)}
    for session in wrong.emulator.take_sessions():
        if session.status == "ok":
            errors_m[session.initiator].append(session.distance_m - session.true_distance_m)
    for station, errors in errors_m.items():
        # a mean of 7 round trips has 0.031 m
        bound_m = 4 * 0.031 / sqrt(len(errors))
        assert np.mean(errors) == pytest.approx(offsets_m.get(station, 0.0), abs=bound_m)


def test_offsets_are_valid_until_replaced():
    swarm = Swarm(FORMATION[:2], channel="ideal", ftm=FtmConfig(round_trip_std_ps=0.0))
    errors_m = []
    for offsets_m in ({}, {0: 100.0}, {1: 7.0}, {0: -3.0, 1: 1.0}, {}):
        swarm.emulator.range_offsets_m = offsets_m
        swarm.request(0, 1, swarm.now_us)
        ((_, item),) = swarm.run(swarm.now_us + 8_000)
        errors_m.append(item.distance_m - 8.5)
    # what remains is the noise of arrivals without its floor, of some millimetres at 34 dB
    assert errors_m == pytest.approx([0.0, 100.0, 0.0, -3.0, 0.0], abs=0.02)
