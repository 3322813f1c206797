"""Agreement on the motion start over a lossy radio, and its robustness. Run time: 5 s."""

import numpy as np
import pytest

from autopilot.onboard.formation.motion import LEAD_US, MOST_LEADS, OLDEST_US, MotionStart
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation.model import SILENCE_US

BEACON_US = 100_000
STEP_US = 50_000
ON = FlightPhase.ON_STATION


def first_of_four(now_us=0):
    """Return one of four UAVs, which proposes first as all others are on station, and its proposal."""
    motion = MotionStart(0, 4)
    there = dict.fromkeys((1, 2, 3), (ON, None, now_us))
    return motion, motion.update(now_us, on_station=True, neighbours=there)


def fly(seed, *, loss, stations, dead=(), latecomer=None, until_us=9_000_000):
    """Simulate the agreement; returns the start times held over time, (T, N) with -1 for none.

    Also returns the times of arrival and of failure. Each UAV arrives at its place within 3 s and sends
    beacons every 100 ms at its own phase; losses are independent. ``dead``: stations that become silent
    within those 3 s, some on station, some not. ``latecomer``: a station that neither sends nor receives
    until 6 s.
    """
    rng = np.random.default_rng(seed)
    arrives_us = rng.integers(0, 3_000_000, stations)
    dies_us = {station: int(rng.integers(0, 3_000_000)) for station in dead}
    offset_us = rng.integers(0, BEACON_US, stations)
    motions = [MotionStart(k, stations) for k in range(stations)]
    received = [
        dict.fromkeys(set(range(stations)) - {k}, (FlightPhase.JOINING, None, 0)) for k in range(stations)
    ]
    held = []
    for now_us in range(0, until_us, STEP_US):
        row = []
        for k, motion in enumerate(motions):
            if now_us < dies_us.get(k, until_us):
                on_station = bool(now_us >= arrives_us[k])
                motion.update(now_us, on_station=on_station, neighbours=received[k])
            row.append(-1 if motion.start_us is None else motion.start_us)
        held.append(row)
        for k, motion in enumerate(motions):
            due = (now_us - offset_us[k]) % BEACON_US < STEP_US
            if not due or now_us >= dies_us.get(k, until_us):
                continue
            phase = ON if now_us >= arrives_us[k] else FlightPhase.JOINING
            for j in range(stations):
                cut = latecomer in {j, k} and now_us < 6_000_000
                if j != k and not cut and rng.random() >= loss:
                    received[j][k] = (phase, motion.start_us, now_us + 2_000)
    return np.array(held), arrives_us, dies_us


def begun(held):
    """Return (T, N) the start times in the past at their row, else -1."""
    now_us = np.arange(len(held))[:, None] * STEP_US
    return np.where((held >= 0) & (held <= now_us), held, -1)


@pytest.mark.parametrize("loss", [0.0, 0.3, 0.6])
def test_all_agree_despite_losses(loss):
    """200 formations each: one value, after the last arrival by at most a lead and some beacons."""
    for seed in range(200):
        stations = (2, 3, 5, 8)[seed % 4]
        held, arrives_us, _ = fly(seed, loss=loss, stations=stations)
        assert len(set(held[-1])) == 1
        start_us = held[-1, 0]
        assert arrives_us.max() + LEAD_US <= start_us <= arrives_us.max() + LEAD_US + 1_500_000
        for column in begun(held).T:
            assert set(column) <= {-1, start_us}  # none ever started at another time


def test_failed_uavs_do_not_block_the_agreement_of_the_others():
    for seed in range(60):
        dead = (1,) if seed % 2 else (1, 4)
        held, _, dies_us = fly(seed, loss=0.3, stations=6, dead=dead, until_us=12_000_000)
        living = [k for k in range(6) if k not in dead]
        assert len(set(held[-1, living])) == 1
        assert 0 <= held[-1, 0] <= max(dies_us.values()) + SILENCE_US + LEAD_US + 1_500_000


def test_a_latecomer_adopts_the_start_of_the_others():
    for seed in range(40):
        held, _, _ = fly(seed, loss=0.3, stations=5, latecomer=2, until_us=10_000_000)
        assert len(set(held[-1])) == 1
        assert len(set(held[:120, 2])) == 1  # it never starts by itself
    motion = MotionStart(2, 5)
    assert motion.update(9_000_000, on_station=False, neighbours={0: (ON, 6_000_000, 8_950_000)}) == 6_000_000


def test_it_waits_for_all_uavs_on_the_way():
    motion = MotionStart(0, 4)
    for phase in (
        FlightPhase.WAITING,
        FlightPhase.LOCALISING,
        FlightPhase.ARMING,
        FlightPhase.TAKE_OFF,
        FlightPhase.JOINING,
    ):
        assert (
            motion.update(10_000, on_station=True, neighbours={1: (ON, None, 0), 2: (phase, None, 0)}) is None
        )
    assert motion.update(20_000, on_station=False, neighbours={1: (ON, None, 0)}) is None
    # A UAV that has landed or yielded is not on its way.
    away = {
        1: (FlightPhase.LANDED, None, 20_000),
        2: (FlightPhase.YIELDED, None, 20_000),
        3: (ON, None, 20_000),
    }
    assert motion.update(20_999, on_station=True, neighbours=away) == 20_000 + LEAD_US


def test_a_silent_uav_is_not_waited_for():
    motion = MotionStart(0, 2)
    neighbours = {1: (FlightPhase.JOINING, None, 1_000_000)}
    assert motion.update(1_000_000 + SILENCE_US - 1, on_station=True, neighbours=neighbours) is None
    assert motion.update(1_000_000 + SILENCE_US, on_station=True, neighbours=neighbours) is not None


def test_the_latest_proposal_wins_until_the_start():
    motion, first_us = first_of_four()
    assert first_us == LEAD_US
    at = {"on_station": True}
    assert motion.update(50_000, neighbours={1: (ON, 1_500_000, 50_000)}, **at) == first_us
    assert motion.update(100_000, neighbours={1: (ON, 2_050_000, 100_000)}, **at) == 2_050_000
    later = {1: (ON, 3_000_000, 2_060_000), 2: (ON, 2_000_000, 2_060_000)}
    assert motion.update(2_060_000, neighbours=later, **at) == 2_050_000


def test_a_start_in_the_past_has_priority_over_a_proposal():
    motion, _ = first_of_four(1_000_000)
    started = {1: (ON, 1_200_000, 1_300_000), 2: (ON, 3_100_000, 1_300_000), 3: (ON, 1_200_000, 1_280_000)}
    assert motion.update(1_300_000, on_station=True, neighbours=started) == 1_200_000
    # An old beacon does not prove a start: its sender may have adopted a later time since.
    motion, own_us = first_of_four(1_000_000)
    stale = {1: (ON, 1_200_000, 1_190_000)}
    assert motion.update(1_300_000, on_station=True, neighbours=stale) == own_us


@pytest.mark.parametrize("wrong_us", [-5, 2**62, 5_000_000 + LEAD_US + 20_000, None])
def test_impossible_start_times_are_ignored(wrong_us):
    motion = MotionStart(0, 4)
    neighbours = {1: (FlightPhase.JOINING, wrong_us, 5_000_000)}
    assert motion.update(5_000_000, on_station=True, neighbours=neighbours) is None
    old = {1: (FlightPhase.JOINING, 7_000, OLDEST_US + 10_000)}
    assert motion.update(OLDEST_US + 10_000, on_station=True, neighbours=old) is None


def test_unknown_stations_and_the_own_number_are_ignored():
    motion = MotionStart(0, 2)
    strange = {
        0: (FlightPhase.JOINING, 2_000, 1_000),
        4: (FlightPhase.JOINING, 2_000, 1_000),
        250: (ON, 2_100, 1_000),
    }
    assert motion.update(1_000, on_station=True, neighbours=strange) == 1_000 + LEAD_US


def test_repeated_later_proposals_delay_by_three_leads():
    motion, first_us = first_of_four()
    held_us = []
    for now_us in range(0, 9_000_000, STEP_US):
        neighbours = {1: (ON, now_us + LEAD_US, now_us), 2: (ON, None, now_us), 3: (ON, None, now_us)}
        held_us.append(motion.update(now_us, on_station=True, neighbours=neighbours))
    assert held_us[-1] == first_us + MOST_LEADS * LEAD_US
    assert motion.start_us < 9_000_000


def test_a_uav_that_receives_less_than_half_does_not_start():
    motion = MotionStart(0, 5)
    assert motion.update(9_000_000, on_station=True, neighbours={}) is None
    assert motion.update(9_000_000, on_station=True, neighbours={1: (ON, None, 9_000_000)}) is None
    two = {1: (ON, None, 9_000_000), 2: (ON, None, 9_000_000)}
    assert motion.update(9_000_000, on_station=True, neighbours=two) == 9_000_000 + LEAD_US


def test_a_single_report_of_many_starts_no_uav():
    """A start time in the past counts if two report it, or the only one there is, and they are on station."""
    reports = {
        1: (ON, 5_000_000, 9_000_000),
        2: (ON, None, 9_000_000),
        3: (FlightPhase.JOINING, None, 9_000_000),
    }
    assert MotionStart(0, 4).update(9_000_000, on_station=True, neighbours=reports) is None
    reports[2] = (FlightPhase.JOINING, 5_000_000, 9_000_000)
    assert MotionStart(0, 4).update(9_000_000, on_station=True, neighbours=reports) is None
    reports[2] = (ON, 5_000_000, 9_000_000)
    assert MotionStart(0, 4).update(9_000_000, on_station=True, neighbours=reports) == 5_000_000


def test_halves_with_different_starts_converge():
    """Eight UAVs: two groups of four receive only each other until both have started."""
    motions = [MotionStart(k, 8) for k in range(8)]
    for now_us in range(0, 9_000_000, STEP_US):
        held = [motion.start_us for motion in motions]
        for k, motion in enumerate(motions):
            if k >= 4 and now_us < 1_000_000:
                continue
            neighbours = {
                j: (ON, held[j], now_us)
                for j in range(8)
                if j != k and (now_us >= 6_000_000 or j // 4 == k // 4) and (j < 4 or now_us > 1_000_000)
            }
            motion.update(now_us, on_station=True, neighbours=neighbours)
        starts = {motion.start_us for motion in motions}
        if now_us == 5_000_000:
            assert len(starts) == 2
    assert len({motion.start_us for motion in motions}) == 1
