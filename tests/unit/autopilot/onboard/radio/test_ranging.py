"""All-pairs ranging: every peer once per period, evenly, at random phases, slowed by a full channel."""

import numpy as np

from autopilot.onboard.radio.ranging import GIVE_UP_US, MAX_OUTSTANDING, RangingSchedule

STEP_US = 4_000
PERIOD_US = 1_000_000


def run(schedule, *, until_us, start_us=0, answer_after_us=12_000, reachable=None):
    """List the requests (at_us, peer) of a schedule whose sessions take ``answer_after_us``."""
    requests, open_sessions = [], []
    for now_us in range(start_us, until_us, STEP_US):
        for item in [item for item in open_sessions if item[0] <= now_us]:
            schedule.on_result(item[1])
            open_sessions.remove(item)
        peers = range(8) if reachable is None else reachable
        due = schedule.due(now_us, now_us + STEP_US, peers.__contains__)
        requests += due
        if answer_after_us is not None:
            open_sessions += [(at_us + answer_after_us, peer) for at_us, peer in due]
    return requests


def schedule_of(station, seed, stations=8, period_us=PERIOD_US):
    rng = np.random.default_rng((seed, station))
    return RangingSchedule(station=station, stations=stations, period_us=period_us, rng=rng)


def test_every_peer_is_requested_once_per_period():
    requests = run(schedule_of(3, 1), until_us=10 * PERIOD_US)
    first_us = requests[0][0]
    for k in range(9):
        period = [p for at_us, p in requests if first_us <= at_us - k * PERIOD_US + 1 < first_us + PERIOD_US]
        assert sorted(period) == [0, 1, 2, 4, 5, 6, 7]


def test_requests_are_a_seventh_of_the_period_apart_and_lie_in_their_step():
    requests = run(schedule_of(0, 2), until_us=5 * PERIOD_US)
    gaps_us = np.diff([at_us for at_us, _ in requests])
    assert np.all(np.abs(gaps_us - PERIOD_US / 7) <= 1)


def test_stations_are_not_in_step():
    # 8 phases uniform over a slot of 142.9 ms: all within a quarter of it by chance has probability 8 *
    # 0.25^7 < 0.0005.
    firsts_us = np.array([run(schedule_of(i, 3), until_us=200_000)[0][0] for i in range(8)])
    assert np.ptp(firsts_us) > PERIOD_US / 7 / 4
    assert len({at_us % STEP_US for at_us in firsts_us}) == 8


def test_a_silent_peer_is_not_requested_and_the_others_keep_their_times():
    all_requests = run(schedule_of(0, 4), until_us=3 * PERIOD_US)
    without = run(schedule_of(0, 4), until_us=3 * PERIOD_US, reachable={1, 2, 3, 4, 6, 7})
    assert without == [item for item in all_requests if item[1] != 5]


def test_at_most_two_requests_are_outstanding_and_lost_results_do_not_block_for_ever():
    requests = run(schedule_of(0, 5), until_us=GIVE_UP_US + PERIOD_US, answer_after_us=None)
    before = [at_us for at_us, _ in requests if at_us <= GIVE_UP_US]
    assert len(before) == MAX_OUTSTANDING
    assert len(requests) > MAX_OUTSTANDING


def test_a_full_channel_slows_the_round_and_is_not_followed_by_a_burst():
    schedule = schedule_of(0, 6, period_us=100_000)
    slow = run(schedule, until_us=2_000_000, answer_after_us=100_000)
    assert len(slow) <= 2 * 2_000_000 / 100_000 + 2  # two sessions of 100 ms at any time
    for peer in range(8):
        schedule.on_result(peer)
    after = run(schedule, start_us=2_000_000, until_us=2_500_000)
    assert np.min(np.diff([at_us for at_us, _ in after])) >= 100_000 / 7 - 1


def test_a_clock_jump_causes_no_burst_and_no_long_search():
    for leap_us in (3 * GIVE_UP_US, 10**15):
        schedule = schedule_of(0, 8)
        before = run(schedule, until_us=PERIOD_US)
        after = run(schedule, start_us=leap_us, until_us=leap_us + 10 * PERIOD_US)
        gaps_us = np.diff([at_us for at_us, _ in after])
        assert np.all(gaps_us[1:] >= PERIOD_US / 7 - 1)  # the first one may be late by less than a slot
        assert len(after) in {70, 71}
        assert before


def test_a_lone_station_sends_no_requests():
    assert run(schedule_of(0, 7, stations=1), until_us=PERIOD_US) == []
