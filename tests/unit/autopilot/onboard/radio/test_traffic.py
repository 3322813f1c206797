"""Radio traffic of one station: beacons, their reception, and ranging requests.

Run time: 1 s.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from beacons import Beacon, decode, encode
from onboard_apps import CollectingTraffic

from autopilot.onboard.client.own_state import Fix, OwnState
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.localisation.model import SILENCE_US
from autopilot.onboard.radio import beacon as wire
from autopilot.onboard.radio.neighbour_table import (
    RECEIVED,
    REFUSED,
    RESTARTED,
    SHIFTS,
    WAIT_US,
    receive_beacon,
)
from autopilot.onboard.radio.scheduled_ranging import CHECK_LATEST_US, CHECK_US, UNKNOWN_PERIOD_US, owner
from autopilot.parameters.config import SESSION_S, Devices, Site
from autopilot.parameters.onboard_config import OnboardConfig
from netsim.wire.messages import Broadcast, FtmRequest, FtmResult

STATIONS = 200
STEP_US = 4_000
SCHEDULED = OnboardConfig(ranging="scheduled")


def traffic_of(station=0, stations=8, *, config=None):
    return CollectingTraffic(
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
    return Beacon(
        station=station, seq=seq, time_us=time_us, phase=FlightPhase.JOINING,
        odometry_ned_m=(0.0, 0.0, 0.0), vel_ned_m_s=(0.0, 0.0, 0.0),
    )  # fmt: skip


def take(table, beacon, now_us, *, source=None):
    """Receive a beacon from its station or from ``source``; returns the outcome of `receive_beacon`."""
    pages = wire.BeaconBuffer(1)
    pages.put(beacon.station if source is None else source, encode(beacon))
    return receive_beacon(pages.rows[0], now_us, table.listener, table.stations, table.rows)


def received(times_and_numbers, *, config=None):
    """Receive beacons at times in s; returns whether each indicates a restarted sender, and the table."""
    traffic, restarted = traffic_of(config=config), []
    for time_s, seq in times_and_numbers:
        now_us = round(time_s * 1e6)
        beacon = beacon_of(1, seq=seq % wire.SEQ_MODULUS, time_us=now_us)
        found = take(traffic.table, beacon, now_us)
        assert found in {RECEIVED, RESTARTED}
        restarted.append(found == RESTARTED)
    return restarted, traffic.table


def test_a_restarted_sender_is_distinguished_from_lost_beacons():
    """Beacons every 100 ms: lost beacons have used sequence numbers, a restarted application starts over."""
    assert received([(4.0, 39), (25.0, 39 + 210), (225.0, 39 + 2210)])[0] == [False, False, False]
    # Silent from 4 s on; restarted at 19 s, first received at 25 s, with a lower, the same and a higher
    # number.
    for seq in (10, 39, 60):
        restarted, table = received([(4.0, 39), (25.0, seq), (25.1, seq + 1)])
        assert restarted == [False, True, False]
        assert table.beacons_missed == 0
    # A wrap of the sequence numbers is not a restart.
    assert received([(1.0, -2), (1.3, 1), (31.3, 301)])[0] == [False, False, False]


@pytest.mark.parametrize("leap_us", [3 * WAIT_US, 10**15])
def test_after_a_clock_jump_one_beacon_is_due_with_the_number_of_its_time(leap_us):
    traffic = traffic_of()

    def numbers(now_us):
        items = traffic.due(own_state(now_us), now_us, now_us + STEP_US, ranging=False)
        return [decode(item.payload).seq for item in items if isinstance(item, Broadcast)]

    period_us = OnboardConfig().beacon_period_ms * 1_000
    before = [seq for now_us in range(0, 10 * period_us, STEP_US) for seq in numbers(now_us)]
    ((seq,), later) = numbers(leap_us), numbers(leap_us + STEP_US)
    assert later == []
    assert (
        abs((seq - before[-1]) % wire.SEQ_MODULUS - (leap_us / period_us - 10) % wire.SEQ_MODULUS) <= SHIFTS
    )
    gaps = np.diff([seq, *(seq for k in range(2, 500) for seq in numbers(leap_us + k * STEP_US))])
    assert set(gaps % wire.SEQ_MODULUS) == {1}


@pytest.mark.parametrize("period_ms", [10, 100, 1_000])
def test_channel_access_delay_is_not_taken_for_a_restart(period_ms):
    """Each beacon waits up to `WAIT_US` (in order), is shifted by 2 % of a period, and 30 % are lost."""
    rng, config = np.random.default_rng(1), OnboardConfig(beacon_period_ms=period_ms)
    period_s, received_s, sequence = 1e-3 * period_ms, 0.0, []
    for seq in range(2_000):
        due_s = 1.0 + (seq + rng.uniform(-0.02, 0.02)) * period_s
        received_s = max(received_s, due_s + rng.choice((0.0, 1e-6 * WAIT_US)))
        if rng.uniform() < 0.7:
            sequence.append((received_s, seq))
    restarted, table = received(sequence, config=config)
    assert not any(restarted)
    assert table.beacons_missed == sequence[-1][1] - sequence[0][1] + 1 - len(sequence)


def test_an_overtaken_beacon_is_not_taken_for_a_restart():
    table, found = traffic_of().table, []
    for now_ms, seq, time_ms in ((1_000, 7, 1_000), (1_200, 9, 1_200), (1_210, 8, 1_100), (1_300, 10, 1_300)):
        beacon = beacon_of(1, seq=seq, time_us=1_000 * time_ms)
        found.append(take(table, beacon, 1_000 * now_ms))
    assert found == 4 * [RECEIVED]
    assert table.beacons_missed == 1


def test_a_sequence_gap_beyond_the_delay_tolerance_is_a_restart():
    for gap, restarted in ((100 + 10 + SHIFTS, False), (100 + 10 + SHIFTS + 1, True)):
        assert received([(1.0, 0), (11.0, gap)])[0] == [False, restarted]
    for gap, restarted in ((100 - 10 - SHIFTS, False), (100 - 10 - SHIFTS - 1, True)):
        assert received([(1.0, 0), (11.0, gap)])[0] == [False, restarted]


@dataclass
class Flight:
    """A station that receives its neighbours every 100 ms, and whose sessions succeed after 4 ms."""

    traffic: CollectingTraffic
    neighbours: tuple
    now_us: int = 0
    silent: int | None = None
    """Station that no session reaches."""

    def run(self, seconds, *, variance_m2=None, busy=0.0):
        """Run for some time; returns the requests."""
        requests, own = [], own_state()
        for now_us in range(self.now_us, self.now_us + round(seconds * 1e6), STEP_US):
            if now_us % 100_000 == 0:
                for station in self.neighbours:
                    take(self.traffic.table, beacon_of(station, time_us=now_us), now_us)
            self.traffic.ranging.on_survey(now_us * 1_000, round(busy * now_us * 1_000))
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
    beacon = decode(broadcast.payload)
    assert beacon is not None
    assert {item.peer for item in beacon.distances} == set(range(STATIONS - wire.MAX_RANGES, STATIONS))


def test_beacons_are_numbered_and_carry_the_given_content():
    traffic, own = traffic_of(3), own_state(5_000_000)
    own.fix = Fix(4_800, (1.0, 2.0, 3.0), 1.5, 2.5)
    errors = iter([None, wire.GpsError((0.5, -0.25, 0.0), 0.5)])
    broadcasts = traffic.due(
        own, 5_000_000, 5_200_000, ranging=False,
        phase=FlightPhase.ON_STATION, motion_start_ms=9_000, gps_error=lambda: next(errors),
    )  # fmt: skip
    first, second = (decode(item.payload) for item in broadcasts)
    assert (first.seq, second.seq) == (0, 1)
    assert (first.gps_error, second.gps_error) == (None, wire.GpsError((0.5, -0.25, 0.0), 0.5))
    for beacon in (first, second):
        assert (beacon.station, beacon.phase, beacon.motion_start_ms) == (3, FlightPhase.ON_STATION, 9_000)
        assert beacon.fix == own.fix


def test_the_gps_error_is_requested_once_per_beacon_and_not_in_every_step():
    traffic, own, requested = traffic_of(), own_state(), []
    beacons = 0
    for now_us in range(0, 10_000_000, STEP_US):
        items = traffic.due(
            own, now_us, now_us + STEP_US, ranging=False, gps_error=lambda t=now_us: requested.append(t)
        )
        beacons += len(items)
    assert len(requested) == beacons
    assert abs(beacons - 100) <= 1


def test_gaps_in_the_sequence_numbers_count_as_missed_beacons():
    numbers = [5, 6, 9, 9, 10, 12]
    _, table = received((0.1 * seq, seq) for seq in numbers)
    assert table.beacons_missed == 2 + 1  # 7, 8 and 11
    take(table, beacon_of(2, seq=100), 0)
    assert table.beacons_missed == 3


@pytest.mark.parametrize(
    ("beacon", "source"),
    [
        (beacon_of(1), 2),  # from another station
        (beacon_of(0), 0),  # with the receiver's own number
        (beacon_of(8), 8),  # not in the formation
        (beacon_of(1, time_us=20_000), 1),  # from the future
    ],
)
def test_an_invalid_beacon_is_counted_and_changes_nothing(beacon, source):
    table = traffic_of(0).table
    before = table.stations.copy()
    assert take(table, beacon, 0, source=source) == REFUSED
    assert table.bad_beacons == 1
    assert np.array_equal(table.stations, before)


# ---- ranging


def test_the_scenario_chooses_the_policy():
    # All pairs requests each of the seven others once per second; scheduled owns three or four pairs.
    all_pairs = Flight(traffic_of(0), tuple(range(1, 8))).run(5.0)
    assert {item.peer for item in all_pairs} == set(range(1, 8))
    scheduled = Flight(traffic_of(0, config=SCHEDULED), tuple(range(1, 8))).run(5.0)
    assert {item.peer for item in scheduled} == {j for j in range(1, 8) if owner(0, j, 8) == 0}


@pytest.mark.parametrize("config", [OnboardConfig(), SCHEDULED])
def test_only_stations_with_recent_beacons_are_ranged_to(config):
    flight = Flight(traffic_of(0, config=config), (1, 2))
    assert {item.peer for item in flight.run(9.0)} == {1, 2}
    silent_us = flight.now_us
    flight.neighbours = (1,)
    requests = flight.run(12.0)
    assert max(item.at_us for item in requests if item.peer == 2) < silent_us + SILENCE_US
    assert max(item.at_us for item in requests if item.peer == 1) > silent_us + SILENCE_US


@pytest.mark.parametrize("busy", [0.0, 1.0])
@pytest.mark.parametrize(
    "config", [OnboardConfig(), OnboardConfig(ftm_period_s=0.1), SCHEDULED], ids=["1s", "100ms", "scheduled"]
)
def test_the_gap_between_distances_is_below_the_silence_time(config, busy):
    # For any channel load and any variance: each owned pair, including one lost session.
    flight = Flight(traffic_of(0, config=config), tuple(range(1, 8)))
    times_us = {}
    for item in flight.run(40.0, variance_m2=lambda _: 0.0, busy=busy):
        times_us.setdefault(item.peer, []).append(item.at_us)
    gaps_us = [np.diff(times).max() for times in times_us.values()]
    assert max(gaps_us) < flight.traffic.ranging.silence_us
    if config.ranging == "scheduled":
        assert max(gaps_us) > (CHECK_US if busy else 0.7 * CHECK_US)
        assert flight.traffic.ranging.silence_us < CHECK_LATEST_US + 2_000_000


@pytest.mark.parametrize("config", [OnboardConfig(), OnboardConfig(ftm_period_s=4.0), SCHEDULED])
def test_each_pair_is_requested_twice_within_the_gathering_time(config):
    """Eight stations, one of which does not answer."""
    flight = Flight(traffic_of(0, config=config), tuple(range(1, 8)), silent=1)
    requests = flight.run(flight.traffic.ranging.gather_s - SESSION_S)
    for peer in (j for j in range(1, 8) if config is not SCHEDULED or owner(0, j, 8) == 0):
        assert sum(item.peer == peer for item in requests) >= 2
    if config is SCHEDULED:
        assert flight.traffic.ranging.gather_s < 2.0


def test_a_busy_channel_leaves_only_the_valuable_distances():
    # After 20 s at full occupancy the price is at its limit of 3 nats: p / r = exp(6) - 1 = 402, and r is
    # that of `measured` for 7 round trips, below (0.08^2 + 0.05^2) m2.
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


def test_a_failed_session_has_no_distance_and_a_good_one_has_a_standard_deviation():
    traffic = traffic_of()
    assert traffic.measured(result(1, 0, status="timeout")) is None
    assert traffic.measured(result(9, 0)) is None
    distance = traffic.measured(result(1, 0, std_m=Devices().ftm_trip_std_m))
    # The scatter equals the device's: a mean of 7 trips.
    assert distance.std_m == pytest.approx(Devices().ftm_trip_std_m / math.sqrt(7))


def test_requests_and_beacons_share_one_increasing_number():
    traffic, own, numbers = traffic_of(0, config=SCHEDULED), own_state(), []
    take(traffic.table, beacon_of(1), 0)
    for now_us in range(0, 2_000_000, STEP_US):
        numbers += [item.seq for item in traffic.due(own, now_us, now_us + STEP_US, ranging=True)]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > 20


def test_a_station_that_owns_no_pair_has_beacon_deadlines_only():
    traffic, own = traffic_of(1, 2, config=SCHEDULED), own_state()
    traffic.due(own, 0, STEP_US, ranging=True)
    deadline_us = traffic.next_deadline_us(ranging=True)
    assert deadline_us == traffic.next_deadline_us(ranging=False) > 0
