"""What one station says on the radio, and what it makes of what it hears.

Costs 1 s.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from autopilot.onboard.formation.own_state import OwnState
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation.localisation import SILENCE_US
from autopilot.onboard.radio import beacon as wire
from autopilot.onboard.radio.neighbour_table import BEGUN_ANEW, HEARD, REFUSED, SHIFTS, WAIT_US, hear
from autopilot.onboard.radio.scheduled_ranging import CHECK_LATEST_US, CHECK_US, UNKNOWN_PERIOD_US, owner
from autopilot.onboard.radio.traffic import Traffic
from autopilot.parameters.config import SESSION_S, Devices, OnboardConfig, Site
from netsim.wire.messages import Broadcast, FtmRequest, FtmResult, Survey

STATIONS = 200
STEP_US = 4_000
SCHEDULED = OnboardConfig(ranging="scheduled")


def traffic_of(station=0, stations=8, *, config=None):
    return Traffic(
        station=station, stations=stations, config=config or OnboardConfig(), devices=Devices(),
        rng=np.random.default_rng((1, station)),
    )  # fmt: skip


def own_state(time_us=0):
    own = OwnState(site=Site(), gps_delay_s=0.12)
    own.time_us = time_us
    return own


def result(peer, at_us, *, status="ok", std_m=0.1, retry_after_s=0):
    good = status == "ok"
    return FtmResult(
        peer=peer, seq=peer, status=status, measured_ns=at_us * 1_000, ended_ns=(at_us + 1_000) * 1_000,
        distance_m=10.0 if good else 0.0, distance_std_m=std_m, rssi_dbm=-60.0,
        round_trips=7 if good else 0, measurements=8, retry_after_s=retry_after_s,
    )  # fmt: skip


def beacon_of(station, *, seq=0, time_us=0):
    return wire.Beacon(
        station=station, seq=seq, time_us=time_us, phase=FlightPhase.JOINING,
        odometry_ned_m=(0.0, 0.0, 0.0), vel_ned_m_s=(0.0, 0.0, 0.0),
    )  # fmt: skip


def take(hearing, beacon, now_us, *, source=None):
    """Hear a beacon, sent in its own name or in that of another; gives as what it was heard."""
    pages = wire.BeaconBuffer(1)
    pages.put(beacon.station if source is None else source, wire.encode(beacon))
    return hear(pages.rows[0], now_us, hearing.listener, hearing.stations, hearing.rows)


def heard(times_and_numbers, *, config=None):
    """Hear beacons at times in s, of those times: whether each is of a new sender, and the hearing."""
    traffic, new = traffic_of(config=config), []
    for time_s, seq in times_and_numbers:
        now_us = round(time_s * 1e6)
        beacon = beacon_of(1, seq=seq % wire.SEQ_MODULUS, time_us=now_us)
        found = take(traffic.hearing, beacon, now_us)
        assert found in {HEARD, BEGUN_ANEW}
        new.append(found == BEGUN_ANEW)
    return new, traffic.hearing


def test_a_sender_that_begins_anew_is_told_from_one_whose_beacons_are_lost():
    """Beacons each 100 ms: what was lost has been numbered, what another application sent has not."""
    assert heard([(4.0, 39), (25.0, 39 + 210), (225.0, 39 + 2210)])[0] == [False, False, False]
    # Silent from 4 s on; begun anew at 19 s, first heard at 25 s, with fewer numbers, the same, and more.
    for seq in (10, 39, 60):
        new, hearing = heard([(4.0, 39), (25.0, seq), (25.1, seq + 1)])
        assert new == [False, True, False]
        assert hearing.beacons_missed == 0
    # The numbers go round, and do so without a beginning.
    assert heard([(1.0, -2), (1.3, 1), (31.3, 301)])[0] == [False, False, False]


@pytest.mark.parametrize("leap_us", [3 * WAIT_US, 10**15])
def test_after_a_leap_of_the_clock_one_beacon_is_due_with_the_number_of_its_time(leap_us):
    traffic = traffic_of()

    def said(now_us):
        items = traffic.due(own_state(now_us), now_us, now_us + STEP_US, ranging=False)
        return [wire.decode(item.payload).seq for item in items if isinstance(item, Broadcast)]

    period_us = OnboardConfig().beacon_period_ms * 1_000
    before = [seq for now_us in range(0, 10 * period_us, STEP_US) for seq in said(now_us)]
    ((seq,), later) = said(leap_us), said(leap_us + STEP_US)
    assert later == []
    assert (
        abs((seq - before[-1]) % wire.SEQ_MODULUS - (leap_us / period_us - 10) % wire.SEQ_MODULUS) <= SHIFTS
    )
    gaps = np.diff([seq, *(seq for k in range(2, 500) for seq in said(leap_us + k * STEP_US))])
    assert set(gaps % wire.SEQ_MODULUS) == {1}


@pytest.mark.parametrize("period_ms", [10, 100, 1_000])
def test_a_beacon_that_waits_for_the_channel_is_of_no_new_sender(period_ms):
    """Each waits up to `WAIT_US` (in order), is shifted by 2 % of a period, and three in ten are lost."""
    rng, config = np.random.default_rng(1), OnboardConfig(beacon_period_ms=period_ms)
    period_s, heard_s, sequence = 1e-3 * period_ms, 0.0, []
    for seq in range(2_000):
        due_s = 1.0 + (seq + rng.uniform(-0.02, 0.02)) * period_s
        heard_s = max(heard_s, due_s + rng.choice((0.0, 1e-6 * WAIT_US)))
        if rng.uniform() < 0.7:
            sequence.append((heard_s, seq))
    new, hearing = heard(sequence, config=config)
    assert not any(new)
    assert hearing.beacons_missed == sequence[-1][1] - sequence[0][1] + 1 - len(sequence)


def test_a_beacon_that_was_overtaken_is_of_no_new_sender():
    hearing, found = traffic_of().hearing, []
    for now_ms, seq, time_ms in ((1_000, 7, 1_000), (1_200, 9, 1_200), (1_210, 8, 1_100), (1_300, 10, 1_300)):
        beacon = beacon_of(1, seq=seq, time_us=1_000 * time_ms)
        found.append(take(hearing, beacon, 1_000 * now_ms))
    assert found == 4 * [HEARD]
    assert (hearing.beacons_heard, hearing.beacons_missed) == (4, 1)


def test_a_sender_is_new_beyond_what_waiting_explains_to_either_side():
    for gap, is_new in ((100 + 10 + SHIFTS, False), (100 + 10 + SHIFTS + 1, True)):
        assert heard([(1.0, 0), (11.0, gap)])[0] == [False, is_new]
    for gap, is_new in ((100 - 10 - SHIFTS, False), (100 - 10 - SHIFTS - 1, True)):
        assert heard([(1.0, 0), (11.0, gap)])[0] == [False, is_new]


@dataclass
class Flight:
    """A station whose neighbours are heard every 100 ms, and whose sessions succeed after 4 ms."""

    traffic: Traffic
    heard: tuple
    now_us: int = 0
    silent: int | None = None
    """Whom no session reaches."""

    def run(self, seconds, *, variance_m2=None, busy=0.0):
        """Fly on; returns the requests."""
        requests, own = [], own_state()
        for now_us in range(self.now_us, self.now_us + round(seconds * 1e6), STEP_US):
            if now_us % 100_000 == 0:
                for station in self.heard:
                    take(self.traffic.hearing, beacon_of(station, time_us=now_us), now_us)
            self.traffic.take_survey(Survey(ended_ns=now_us * 1_000, busy_ns=round(busy * now_us * 1_000)))
            own.time_us = now_us
            deadline_us = self.traffic.next_deadline_us(ranging=True)
            items = self.traffic.due(own, now_us, now_us + STEP_US, ranging=True, variance_m2=variance_m2)
            assert not items or deadline_us < now_us + STEP_US
            for item in items:
                if isinstance(item, FtmRequest):
                    requests.append(item)
                    status = "timeout" if item.peer == self.silent else "ok"
                    self.traffic.measured(result(item.peer, item.at_us, status=status))
        self.now_us += round(seconds * 1e6)
        return requests


# ---- beacons


def test_a_beacon_of_a_large_swarm_carries_the_newest_distances():
    traffic = traffic_of(stations=STATIONS)
    for peer in range(1, STATIONS):
        assert traffic.measured(result(peer, 1_000_000 + 1_000 * peer)) is not None
    (broadcast,) = traffic.due(own_state(1_200_000), 1_200_000, 1_300_000, ranging=False)
    assert isinstance(broadcast, Broadcast)
    beacon = wire.decode(broadcast.payload)
    assert beacon is not None
    assert {item.peer for item in beacon.distances} == set(range(STATIONS - wire.MAX_RANGES, STATIONS))


def test_beacons_are_numbered_and_say_what_they_are_given():
    traffic, own = traffic_of(3), own_state(5_000_000)
    own.fix = wire.Fix(4_800, (1.0, 2.0, 3.0), 1.5, 2.5)
    errors = iter([None, wire.GpsError((0.5, -0.25, 0.0), 0.5)])
    broadcasts = traffic.due(
        own, 5_000_000, 5_200_000, ranging=False,
        phase=FlightPhase.ON_STATION, motion_start_ms=9_000, gps_error=lambda: next(errors),
    )  # fmt: skip
    first, second = (wire.decode(item.payload) for item in broadcasts)
    assert (first.seq, second.seq) == (0, 1)
    assert (first.gps_error, second.gps_error) == (None, wire.GpsError((0.5, -0.25, 0.0), 0.5))
    for beacon in (first, second):
        assert (beacon.station, beacon.phase, beacon.motion_start_ms) == (3, FlightPhase.ON_STATION, 9_000)
        assert beacon.fix == own.fix


def test_the_gps_error_is_asked_for_when_there_is_a_beacon_and_not_in_every_step():
    traffic, own, asked = traffic_of(), own_state(), []
    beacons = 0
    for now_us in range(0, 10_000_000, STEP_US):
        items = traffic.due(
            own, now_us, now_us + STEP_US, ranging=False, gps_error=lambda t=now_us: asked.append(t)
        )
        beacons += len(items)
    assert len(asked) == beacons
    assert abs(beacons - 100) <= 1


def test_what_is_missing_from_the_numbers_heard_has_been_missed():
    numbers = [5, 6, 9, 9, 10, 12]
    _, hearing = heard((0.1 * seq, seq) for seq in numbers)
    assert hearing.beacons_missed == 2 + 1  # 7, 8 and 11
    assert hearing.beacons_heard == len(numbers)
    take(hearing, beacon_of(2, seq=100), 0)
    assert hearing.beacons_missed == 3


@pytest.mark.parametrize(
    ("beacon", "source"),
    [
        (beacon_of(1), 2),  # in another's name
        (beacon_of(0), 0),  # in one's own
        (beacon_of(8), 8),  # of nobody in the formation
        (beacon_of(1, time_us=20_000), 1),  # from the future
    ],
)
def test_a_beacon_that_contradicts_itself_is_counted_and_not_believed(beacon, source):
    hearing = traffic_of(0).hearing
    before = hearing.stations.copy()
    assert take(hearing, beacon, 0, source=source) == REFUSED
    assert (hearing.bad_beacons, hearing.beacons_heard) == (1, 0)
    assert np.array_equal(hearing.stations, before)


# ---- ranging


def test_the_scenario_chooses_the_policy():
    # Of the seven others all pairs asks each once per second; scheduled owns three or four of them.
    everybody = Flight(traffic_of(0), tuple(range(1, 8))).run(5.0)
    assert {item.peer for item in everybody} == set(range(1, 8))
    scheduled = Flight(traffic_of(0, config=SCHEDULED), tuple(range(1, 8))).run(5.0)
    assert {item.peer for item in scheduled} == {j for j in range(1, 8) if owner(0, j, 8) == 0}


@pytest.mark.parametrize("config", [OnboardConfig(), SCHEDULED])
def test_only_who_is_heard_is_ranged_to_until_it_has_been_silent(config):
    flight = Flight(traffic_of(0, config=config), (1, 2))
    assert {item.peer for item in flight.run(9.0)} == {1, 2}
    silent_us = flight.now_us
    flight.heard = (1,)
    requests = flight.run(12.0)
    assert max(item.at_us for item in requests if item.peer == 2) < silent_us + SILENCE_US
    assert max(item.at_us for item in requests if item.peer == 1) > silent_us + SILENCE_US


@pytest.mark.parametrize("busy", [0.0, 1.0])
@pytest.mark.parametrize(
    "config", [OnboardConfig(), OnboardConfig(ftm_period_s=0.1), SCHEDULED], ids=["1s", "100ms", "scheduled"]
)
def test_distances_come_more_often_than_what_counts_as_silence(config, busy):
    # Whatever the channel and however well everything is known: each owned pair, once lost included.
    flight = Flight(traffic_of(0, config=config), tuple(range(1, 8)))
    times_us = {}
    for item in flight.run(40.0, variance_m2=lambda _: 0.0, busy=busy):
        times_us.setdefault(item.peer, []).append(item.at_us)
    gaps_us = [np.diff(times).max() for times in times_us.values()]
    assert max(gaps_us) < flight.traffic.range_silence_us
    if config.ranging == "scheduled":
        assert max(gaps_us) > (CHECK_US if busy else 0.7 * CHECK_US)
        assert flight.traffic.range_silence_us < CHECK_LATEST_US + 2_000_000


@pytest.mark.parametrize("config", [OnboardConfig(), OnboardConfig(ftm_period_s=4.0), SCHEDULED])
def test_while_distances_are_gathered_each_pair_is_asked_for_twice(config):
    """Of eight of whom one does not answer."""
    flight = Flight(traffic_of(0, config=config), tuple(range(1, 8)), silent=1)
    requests = flight.run(flight.traffic.gather_s - SESSION_S)
    for peer in (j for j in range(1, 8) if config is not SCHEDULED or owner(0, j, 8) == 0):
        assert sum(item.peer == peer for item in requests) >= 2
    if config is SCHEDULED:
        assert flight.traffic.gather_s < 2.0


def test_a_busy_channel_leaves_only_the_valuable_distances():
    # After 20 s at full occupancy the price is at its top of 3 nats: p / r = exp(6) - 1 = 402, and r is what
    # `measured` makes of 7 round trips, below (0.08^2 + 0.05^2) m2.
    flight = Flight(traffic_of(0, config=SCHEDULED), (1, 2, 3))
    flight.run(20.0, variance_m2=lambda _: 0.01, busy=1.0)
    requests = flight.run(1.0, variance_m2=lambda peer: 4.0 if peer == 2 else 0.01, busy=1.0)
    counts = {peer: sum(item.peer == peer for item in requests) for peer in (1, 2, 3)}
    assert counts[2] >= 8  # of the 8.9 slots per second of a pair of 28
    assert counts[1] <= 1
    assert counts[3] <= 1


def test_without_a_filter_pairs_are_still_measured_at_an_even_pace():
    requests = Flight(traffic_of(0, config=SCHEDULED), (1,)).run(10.0)
    gaps_us = np.diff([item.at_us for item in requests])
    cycle_us = 28 * 4_000
    assert np.all((gaps_us >= UNKNOWN_PERIOD_US) & (gaps_us <= UNKNOWN_PERIOD_US + cycle_us + STEP_US))


def test_a_failed_session_gives_no_distance_and_a_good_one_its_error():
    traffic = traffic_of()
    assert traffic.measured(result(1, 0, status="timeout")) is None
    assert traffic.measured(result(9, 0)) is None
    distance = traffic.measured(result(1, 0, std_m=Devices().ftm_trip_std_m))
    # Scatter as expected of the device: a mean of 7 trips.
    assert distance.std_m == pytest.approx(Devices().ftm_trip_std_m / math.sqrt(7))


def test_requests_and_beacons_share_one_rising_number():
    traffic, own, numbers = traffic_of(0, config=SCHEDULED), own_state(), []
    take(traffic.hearing, beacon_of(1), 0)
    for now_us in range(0, 2_000_000, STEP_US):
        numbers += [item.seq for item in traffic.due(own, now_us, now_us + STEP_US, ranging=True)]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > 20


def test_who_owns_no_pair_is_woken_for_beacons_alone():
    traffic, own = traffic_of(1, 2, config=SCHEDULED), own_state()
    traffic.due(own, 0, STEP_US, ranging=True)
    deadline_us = traffic.next_deadline_us(ranging=True)
    assert deadline_us == traffic.next_deadline_us(ranging=False) > 0
