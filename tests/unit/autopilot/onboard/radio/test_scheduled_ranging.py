"""Scheduled ranging: ownership of pairs, disjoint slots, and the selection of distances by price.

Run time: 5 s.
"""

import itertools
import math
from collections import Counter
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.onboard.radio.ranging import GIVE_UP_US, MAX_OUTSTANDING
from autopilot.onboard.radio.scheduled_ranging import (
    CHECK_LATEST_US,
    CHECK_SPREAD,
    CHECK_US,
    FIRST_PRICE_NATS,
    GUARD,
    LEAST_PRICE_NATS,
    MOST_PRICE_NATS,
    UNKNOWN_PERIOD_US,
    WINDOW_NS,
    ScheduledRanging,
    owner,
    pair_number,
)

SLOT_US = 4_000
STEP_US = 4_000
SESSION_US = 1_500
"""Airtime: 8 measurement frames at 80 MHz."""
MEASUREMENT_VAR_M2 = 0.05**2 + 0.03**2
SIZES = range(2, 41)


def policy(station=0, stations=8, *, airtime=0.3, slot_us=SLOT_US):
    return ScheduledRanging(
        station=station,
        stations=stations,
        slot_us=slot_us,
        airtime=airtime,
        measurement_var_m2=MEASUREMENT_VAR_M2,
    )


def run(schedule, *, until_us, start_us=0, variance_m2=None, reachable=None, answer_us=2_500):
    """List the requests (at_us, peer); each has a good result ``answer_us`` later, or none if None."""
    requests, open_sessions = [], []
    for now_us in range(start_us, until_us, STEP_US):
        for at_us, peer in [item for item in open_sessions if item[0] <= now_us]:
            schedule.on_result(peer, ended_us=at_us, variance_m2=MEASUREMENT_VAR_M2)
        open_sessions = [item for item in open_sessions if item[0] > now_us]
        peers = (range(64) if reachable is None else reachable).__contains__
        due = schedule.due(now_us, now_us + STEP_US, peers, variance_m2)
        assert all(now_us <= at_us < now_us + STEP_US for at_us, _ in due)
        requests += due
        if answer_us is not None:
            open_sessions += [(at_us + answer_us, peer) for at_us, peer in due]
    return requests


# ---- ownership and slots


@pytest.mark.parametrize("stations", SIZES)
def test_the_pairs_are_numbered_without_a_gap(stations):
    numbers = [pair_number(i, j, stations) for i, j in itertools.combinations(range(stations), 2)]
    assert sorted(numbers) == list(range(len(numbers)))
    assert numbers == [pair_number(j, i, stations) for i, j in itertools.combinations(range(stations), 2)]


@pytest.mark.parametrize("stations", range(6, 41))
def test_consecutive_slots_share_no_station(stations):
    # For 3 and 4 any order of pairs breaks this, and for 5 any cyclic one.
    pairs = {pair_number(i, j, stations): {i, j} for i, j in itertools.combinations(range(stations), 2)}
    for number, pair in pairs.items():
        assert not pair & pairs[(number + 1) % len(pairs)]


@pytest.mark.parametrize("stations", SIZES)
def test_each_pair_has_one_owner_and_each_station_its_share(stations):
    owners = Counter()
    for i, j in itertools.combinations(range(stations), 2):
        assert owner(i, j, stations) == owner(j, i, stations)
        assert owner(i, j, stations) in {i, j}
        owners[owner(i, j, stations)] += 1
    assert all(abs(owners[i] - (stations - 1) / 2) <= 0.5 for i in range(stations))


@pytest.mark.parametrize("stations", SIZES)
def test_in_a_cycle_each_pair_has_one_session_in_its_own_slot(stations):
    # Everything is worth measuring at the beginning.
    cycle_us = stations * (stations - 1) // 2 * SLOT_US
    sessions = sorted(
        (at_us, i, j) for i in range(stations) for at_us, j in run(policy(i, stations), until_us=cycle_us)
    )
    slots = [divmod(at_us, SLOT_US) for at_us, _, _ in sessions]
    assert slots == [(number, round(GUARD * SLOT_US)) for number in range(cycle_us // SLOT_US)]
    assert [number for number, _ in slots] == [pair_number(i, j, stations) for _, i, j in sessions]


@given(
    stations=st.integers(2, 20),
    data=st.data(),
    steps_us=st.lists(st.integers(1_000, 20_000), min_size=1, max_size=30),
    start_us=st.integers(0, 10**9),
)
def test_a_request_lies_in_its_step_and_in_a_slot_of_its_pair_for_any_steps(
    stations, data, steps_us, start_us
):
    station = data.draw(st.integers(0, stations - 1))
    schedule, now_us = policy(station, stations), start_us
    pairs = stations * (stations - 1) // 2
    for step_us in steps_us:
        before_us = schedule.next_us
        due = schedule.due(now_us, now_us + step_us, range(stations).__contains__, lambda _: 1e9)
        assert schedule.next_us >= now_us + step_us
        assert not due or before_us < now_us + step_us
        for at_us, peer in due:
            assert now_us <= at_us < now_us + step_us
            slot, into_us = divmod(at_us, SLOT_US)
            assert slot % pairs == pair_number(station, peer, stations)
            assert into_us == round(GUARD * SLOT_US)
            schedule.on_result(peer, ended_us=at_us, variance_m2=MEASUREMENT_VAR_M2)
        now_us += step_us
    # No own slot is skipped: the next one begins within a cycle.
    if schedule.next_us != math.inf:
        assert schedule.next_us < now_us + pairs * SLOT_US + 20_000


def test_missed_slots_are_skipped_after_a_pause():
    schedule = policy()
    schedule.due(0, STEP_US, range(8).__contains__, lambda _: 1e9)
    requests = run(schedule, start_us=60_000_000, until_us=60_112_000, variance_m2=lambda _: 1e9)
    owned = [j for j in range(1, 8) if owner(0, j, 8) == 0]
    assert sorted(peer for _, peer in requests) == owned


def test_a_station_without_owned_pairs_sends_no_requests_and_has_no_deadline():
    for schedule in (policy(0, 1), policy(1, 2)):
        assert run(schedule, until_us=100_000) == []
        assert schedule.next_us == math.inf


# ---- worth


def test_worth_is_the_information_that_a_measurement_adds():
    # p = r halves the variance: log(2) / 2. p = 3 r takes it to a quarter: log(2).
    schedule = policy()
    schedule.on_result(1, ended_us=0, variance_m2=0.01)
    assert schedule.worth_nats(1, 0, 0.01) == pytest.approx(0.5 * math.log(2.0))
    assert schedule.worth_nats(1, 0, 0.03) == pytest.approx(math.log(2.0))
    assert schedule.worth_nats(1, 0, 0.0) == 0.0
    # A peer whose distances are ten times as uncertain is worth less.
    schedule.on_result(2, ended_us=0, variance_m2=0.1)
    assert schedule.worth_nats(2, 0, 0.03) < schedule.worth_nats(1, 0, 0.03)


@pytest.mark.parametrize("unknown", [None, math.nan, -1.0])
def test_an_unknown_distance_has_infinite_worth_once_per_period(unknown):
    schedule = policy()
    schedule.price_nats = MOST_PRICE_NATS
    assert schedule.worth_nats(1, 0, unknown) == math.inf
    requests = run(schedule, until_us=10_000_000, variance_m2=lambda _: unknown)
    for peer, count in Counter(peer for _, peer in requests).items():
        assert owner(0, peer, 8) == 0
        times_us = [at_us for at_us, requested in requests if requested == peer]
        # The first own slot after the period, at most a cycle later, and a session.
        assert all(
            UNKNOWN_PERIOD_US <= b - a < UNKNOWN_PERIOD_US + 28 * SLOT_US + 2 * STEP_US
            for a, b in itertools.pairwise(times_us)
        )
        assert count > 15


def test_an_idle_channel_stays_nearly_unused_when_the_distances_are_known():
    # 3 % off the variance is less than the least price: each pair is only checked.
    schedule = policy()
    for k in range(100):
        schedule.on_survey(k * WINDOW_NS, 0)
    assert schedule.price_nats == LEAST_PRICE_NATS
    requests = run(schedule, until_us=30_000_000, variance_m2=lambda _: 0.03 * MEASUREMENT_VAR_M2)
    owned = sum(owner(0, j, 8) == 0 for j in range(1, 8))
    least_us = (1.0 - CHECK_SPREAD) * CHECK_US
    assert owned * 30_000_000 / CHECK_LATEST_US <= len(requests) <= owned * (30_000_000 / least_us + 1)
    # of 56 x 30 all-pairs requests in that time
    assert len(requests) * 8 < 0.3 * 56 * 30


@pytest.mark.parametrize("price_nats", [LEAST_PRICE_NATS, FIRST_PRICE_NATS, MOST_PRICE_NATS])
def test_no_pair_is_starved_at_any_price_by_a_variance_that_is_wrongly_small(price_nats):
    schedule = policy()
    schedule.price_nats = price_nats
    requests = run(schedule, until_us=60_000_000, variance_m2=lambda _: 0.0)
    for peer in (j for j in range(8) if j != 0 and owner(0, j, 8) == 0):
        times_us = [at_us for at_us, requested in requests if requested == peer]
        longest_us = max(b - a for a, b in itertools.pairwise(times_us))
        assert longest_us < CHECK_LATEST_US + 28 * SLOT_US + 2 * STEP_US
        assert longest_us < schedule.silence_us


def test_at_a_high_price_only_the_least_certain_distances_are_measured():
    schedule = policy(0, 16)
    schedule.price_nats = 1.0
    owned = [j for j in range(1, 16) if owner(0, j, 16) == 0]
    # Worth 0.5 log(1 + p / r) against 1: p / r = exp(2) - 1 = 6.39 divides them.
    ratios = dict(zip(owned, (1.0, 20.0, 6.3, 6.5, 0.1, 7.0, 3.0, 400.0), strict=True))
    run(schedule, until_us=480_000)  # all once, so that none is overdue
    requests = run(
        schedule, start_us=480_000, until_us=960_000,
        variance_m2=lambda peer: ratios[peer] * MEASUREMENT_VAR_M2,
    )  # fmt: skip
    assert {peer for _, peer in requests} == {peer for peer, ratio in ratios.items() if ratio > 6.39}


def test_a_silent_station_is_not_ranged_to_and_the_others_keep_their_slots():
    all_requests = run(policy(), until_us=2_000_000)
    without = run(policy(), until_us=2_000_000, reachable={0, 1, 2, 4, 5, 6, 7})
    assert without == [item for item in all_requests if item[1] != 3]
    assert len(without) < len(all_requests)


def test_a_peer_that_does_not_answer_is_retried_with_doubling_pauses():
    # Pauses of 0, 1, 3, 7, ... cycles after the first, second, ... failure, CHECK_US at the most.
    schedule, times_us = policy(), []
    cycle_us = 28 * SLOT_US
    for now_us in range(0, 40_000_000, STEP_US):
        for at_us, peer in schedule.due(now_us, now_us + STEP_US, {1}.__contains__, lambda _: None):
            times_us.append(at_us)
            schedule.on_result(peer, ended_us=at_us)
    gaps = [(b - a) / cycle_us for a, b in itertools.pairwise(times_us)]
    assert gaps[:5] == [1, 1, 3, 7, 15]
    assert all(CHECK_US <= gap * cycle_us < CHECK_US + cycle_us for gap in gaps[5:])
    schedule.on_result(1, ended_us=times_us[-1], variance_m2=MEASUREMENT_VAR_M2)
    schedule.on_result(1, ended_us=40_000_000)
    again = run(schedule, start_us=40_000_000, until_us=40_000_000 + cycle_us, reachable={1})
    assert len(again) == 1


def test_the_retry_time_of_a_responder_is_respected():
    schedule = policy()
    ((at_us, peer),) = run(schedule, until_us=28 * SLOT_US, reachable={1}, answer_us=None)
    schedule.on_result(peer, ended_us=at_us, retry_after_us=1_000_000)
    requests = run(schedule, start_us=28 * SLOT_US, until_us=3_000_000, reachable={1})
    assert at_us + 1_000_000 <= requests[0][0] < at_us + 1_000_000 + 29 * SLOT_US


def test_lost_results_neither_fill_the_queue_nor_block_it_for_ever():
    requests = run(policy(), until_us=GIVE_UP_US + 500_000, answer_us=None)
    assert len([at_us for at_us, _ in requests if at_us <= GIVE_UP_US]) == MAX_OUTSTANDING
    assert len(requests) > MAX_OUTSTANDING


# ---- the price


def test_the_price_rises_above_and_falls_below_the_target_occupancy_within_its_limits():
    schedule = policy(airtime=0.25)
    schedule.on_survey(0, 0)
    schedule.on_survey(WINDOW_NS, WINDOW_NS // 4)
    assert schedule.price_nats == pytest.approx(FIRST_PRICE_NATS)
    schedule.on_survey(2 * WINDOW_NS, WINDOW_NS // 4 + WINDOW_NS // 2)
    # Twice the target occupancy: the ratio, 1 to begin with, rises by exp(gain).
    assert schedule.price_nats == pytest.approx(0.5 * math.log1p(math.exp(0.5)))
    busy_ns = 3 * WINDOW_NS // 4
    for k in range(3, 30):
        busy_ns += WINDOW_NS
        schedule.on_survey(k * WINDOW_NS, busy_ns)
    assert schedule.price_nats == MOST_PRICE_NATS
    for k in range(30, 90):
        schedule.on_survey(k * WINDOW_NS, busy_ns)
    assert schedule.price_nats == LEAST_PRICE_NATS


@given(st.lists(st.tuples(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1)), max_size=20))
def test_the_price_stays_within_its_limits_for_any_counter_of_busy_time(surveys):
    schedule = policy(airtime=1e-6)
    for ended_ns, busy_ns in surveys:
        schedule.on_survey(ended_ns, busy_ns)
        assert LEAST_PRICE_NATS <= schedule.price_nats <= MOST_PRICE_NATS


def test_a_reset_of_the_busy_counter_is_ignored():
    schedule = policy()
    for ended_ns, busy_ns in ((0, 10**9), (WINDOW_NS, 5), (0, 5), (WINDOW_NS // 2, 5)):
        schedule.on_survey(ended_ns, busy_ns)
        assert schedule.price_nats == FIRST_PRICE_NATS


@dataclass
class Channel:
    """Stations that share a channel, which their sessions and an external load occupy.

    The variances of the distances grow by ``growth_m2_s`` and are reduced by measurements, as in a filter.
    """

    stations: int
    load: float
    growth_m2_s: float = 0.02
    policies: list = field(init=False)
    busy_us: float = 0.0
    sessions: Counter = field(default_factory=Counter)

    def __post_init__(self):
        self.policies = [policy(i, self.stations) for i in range(self.stations)]
        self._known = {}

    def variance_m2(self, i, j, now_us):
        since_us, var_m2 = self._known.get((i, j), (0, 2.0))
        return var_m2 + self.growth_m2_s * (now_us - since_us) * 1e-6

    def run(self, begin_s, end_s):
        """Run from ``begin_s`` to ``end_s``; returns the mean occupancy."""
        busy_before_us, reachable, ended = self.busy_us, range(self.stations).__contains__, []
        for now_us in range(round(begin_s * 1e6), round(end_s * 1e6), STEP_US):
            for at_us, i, j in ended:
                var_m2 = 1.0 / (1.0 / self.variance_m2(i, j, at_us) + 1.0 / MEASUREMENT_VAR_M2)
                self._known[i, j] = (at_us, var_m2)
                self.policies[i].on_result(j, ended_us=at_us, variance_m2=MEASUREMENT_VAR_M2)
            ended = []
            for i, schedule in enumerate(self.policies):
                schedule.on_survey(now_us * 1_000, round(self.busy_us * 1_000))
                if schedule.next_us < now_us + STEP_US:
                    due = schedule.due(
                        now_us,
                        now_us + STEP_US,
                        reachable,
                        lambda j, i=i, t=now_us: self.variance_m2(i, j, t),
                    )
                    ended += [(at_us, i, j) for at_us, j in due]
            self.sessions.update((i, j) for _, i, j in ended)
            self.busy_us += len(ended) * SESSION_US + self.load * STEP_US
        return (self.busy_us - busy_before_us) / ((end_s - begin_s) * 1e6)


@pytest.mark.parametrize("stations", [4, 8, 16])
@pytest.mark.parametrize("load", [0.0, 0.1, 0.2])
def test_the_occupancy_settles_at_the_target(stations, load):
    # The slots alone would occupy 1.5 / 4 = 0.375 of an empty channel.
    channel = Channel(stations=stations, load=load)
    channel.run(0.0, 6.0)
    assert channel.run(6.0, 16.0) == pytest.approx(0.3, rel=0.06)


@pytest.mark.parametrize("stations", [4, 8, 16])
@pytest.mark.parametrize("load", [0.4, 0.5])
def test_under_a_load_that_leaves_no_room_only_checks_remain(stations, load):
    # Variances that grow by 0.02 m2/s reach p / r = exp(6) - 1 = 402 in 68 s, so nothing is worth the highest
    # price, and each pair is measured again after CHECK_LATEST_US less up to CHECK_SPREAD * CHECK_US, in its
    # next slot.
    channel = Channel(stations=stations, load=load)
    channel.run(0.0, 20.0)
    channel.sessions.clear()
    occupancy = channel.run(20.0, 30.0)
    assert all(schedule.price_nats == MOST_PRICE_NATS for schedule in channel.policies)
    pairs = stations * (stations - 1) // 2
    assert len(channel.sessions) == pairs
    longest_us = CHECK_LATEST_US + pairs * SLOT_US + 2 * STEP_US
    least_us = CHECK_LATEST_US - CHECK_SPREAD * CHECK_US
    assert all(10e6 // longest_us <= n <= 10e6 // least_us + 1 for n in channel.sessions.values())
    assert occupancy == pytest.approx(load + channel.sessions.total() * SESSION_US / 10e6)


def test_pairs_of_equal_worth_are_measured_equally_often():
    channel = Channel(stations=8, load=0.2)
    channel.run(0.0, 6.0)
    channel.sessions.clear()
    channel.run(6.0, 16.0)
    assert len(channel.sessions) == 28
    assert max(channel.sessions.values()) <= 1.25 * min(channel.sessions.values())
