"""Scheduled ranging: one session per pair, in TDMA slots, used if the distance is worth the airtime.

Ownership: one end measures a distance, the `owner` of the pair; all others receive the result in its beacons.
Stations form a ring, and each owns the pairs with the half of the others that follows it, so the numbers of
owned pairs differ by at most one.

Slots: the shared clock is divided into slots, numbered from time zero. There are P pairs, N (N - 1) / 2
unless only neighbours range. Pair p has the slots with number p modulo P, and its session begins shortly
after the beginning of the slot. If a session of one burst fits a slot and the clocks agree within the guard
time, sessions never contend with each other. Pairs are numbered round by round as in a round-robin tournament
(`pair_number`). The pairs of a round are disjoint, and consecutive slots share no station, so a session that
overruns its slot does not occupy a radio of the next one. (With fewer than six stations no cyclic order has
this property: for five, the graph of disjoint pairs is Petersen's, which has no Hamiltonian cycle. If only
neighbours range, rounds are shorter and still disjoint, but the last pair of a round may share a station with
the first of the next.)

Worth and price: the owner uses its slot if the worth of the distance is at least the price. The worth is the
information that a measurement of variance r adds to a distance of variance p, 0.5 log(1 + p / r) nats. If the
distance has not been measured for `CHECK_US`, its worth rises with time regardless of the filter, so that
faults and wrongly small variances are detected. A distance that the filter has not estimated is worth any
price, but only once per `UNKNOWN_PERIOD_US`, which is enough to locate its ends.

Each station sets the price from the channel occupancy that its own radio measures, from any source. Per
`WINDOW_NS` the ratio x = p / r at which worth equals price, exp(2 price) - 1, is multiplied by
exp(`PRICE_GAIN` (occupancy / target occupancy - 1)). If p grows at a rate q between measurements, from r x /
(1 + x) after one to r x before the next, the airtime is proportional to q (1 + x) / (r x^2). Its elasticity
is 1 to 2, so the loop gain is 0.5 to 1, and less with other load. The error is linear in the occupancy, so
that the mean occupancy reaches the target even if sessions come in bunches. All stations on the same channel
arrive at the same price, so the most valuable distances of the whole formation are measured. A distance below
`LEAST_PRICE_NATS` is not measured on an empty channel either; above `MOST_PRICE_NATS` the price would exclude
distances known from GPS alone. The slots are a further limit: one session each, at any target occupancy.

A station without recent beacons is not ranged to, and the other end of a pair does not replace a silent
owner. Failed sessions are repeated in the next slot, then after pauses that double.
"""

import math

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.radio.ranging import Outstanding, Reachable, VarianceOf
from autopilot.parameters.config import SESSION_S

GUARD = 0.125
"""Share of a slot before its session begins, as a margin for clock differences."""
LEAST_PRICE_NATS = -0.5 * math.log(1.0 - 0.05)
"""Worth of a measurement that reduces the variance by 5 %."""
MOST_PRICE_NATS = 3.0
"""Worth of one that reduces the standard deviation to a twentieth: from 1.2 m, as of GPS, to 0.06 m."""
FIRST_PRICE_NATS = 0.5 * math.log(2.0)
"""Initial price: worth of a measurement with the variance of the estimate."""
PRICE_GAIN = 0.5
MOST_LOG_STEP = 1.0
"""Limit of the ratio's rise per window: a factor of e."""
WINDOW_NS = 500_000_000
"""Window over which the occupancy is averaged: about a hundred sessions."""
CHECK_US = 3_000_000
CHECK_LATEST_US = 5_000_000
"""Time after which a distance is measured again at the highest price; at the lowest it is `CHECK_US`."""
CHECK_SPREAD = 0.25
"""Each pair is checked earlier by its own share of `CHECK_US` up to this one, so that pairs measured together
at the beginning do not stay synchronised."""
UNKNOWN_PERIOD_US = 500_000
_CHECK_NATS_US = MOST_PRICE_NATS / (CHECK_LATEST_US - CHECK_US)
_LONG_AGO_US = -(1 << 62)


def pair_number(i: int, j: int, stations: int) -> int:
    """Return the number of a pair among all, 0 to N (N - 1) / 2 - 1, by the circle method.

    Among an odd number m of stations, round r pairs (r - k, r + k) mod m. Station r is left over; it is
    paired with the last station if their number is even.
    """
    ring = stations - 1 + stations % 2
    if stations % 2 == 0 and max(i, j) == stations - 1:
        return min(i, j) * (stations // 2)
    # r is half the sum of the two, and (m + 1) / 2 is the inverse of 2 modulo m.
    turn = (i + j) * (ring + 1) // 2 % ring
    k = min((i - turn) % ring, (turn - i) % ring)
    return turn * (ring // 2) + k - 1 if stations % 2 else turn * (stations // 2) + k


def owner(i: int, j: int, stations: int) -> int:
    """Return the end that measures the distance: the one that the other follows by less than half the ring.

    Of two exactly half the ring apart it is the one with the smaller number.
    """
    ahead = 2 * ((j - i) % stations)
    if ahead == stations:
        return min(i, j)
    return i if ahead < stations else j


class ScheduledRanging:
    """Ranging policy of one station; see this module and `ranging.RangingPolicy`.

    Args:
        station, stations: the own number, and the number of stations.
        slot_us: length of a slot.
        airtime: target occupancy of the channel, 0..1.
        measurement_var_m2: expected variance of a distance, until one to the peer has been measured.
        linked: (N, N), symmetric, whether a pair is measured at all; None: all pairs.

    """

    def __init__(
        self, *, station: int, stations: int, slot_us: int, airtime: float, measurement_var_m2: float,
        linked: NDArray[np.bool_] | None = None,
    ) -> None:  # fmt: skip
        pairs = [(i, j) for j in range(stations) for i in range(j) if linked is None or linked[i, j]]
        pairs.sort(key=lambda pair: pair_number(pair[0], pair[1], stations))
        self._slots = [
            (slot * slot_us, i + j - station)
            for slot, (i, j) in enumerate(pairs)
            if station in {i, j} and owner(i, j, stations) == station
        ]
        """(begin within the cycle in us, peer) of the own slots."""
        self._cycle_us = max(len(pairs), 1) * slot_us
        self._check_us = [CHECK_US] * stations
        for begin_us, peer in self._slots:
            self._check_us[peer] -= round(CHECK_SPREAD * CHECK_US * begin_us / self._cycle_us)
        self._guard_us = round(GUARD * slot_us)
        self._slot = 0
        self._cycle_begin_us = 0
        self.next_us = float(self._slots[0][0] + self._guard_us) if self._slots else math.inf
        self.silence_us = CHECK_LATEST_US + 2 * self._cycle_us + 1_000_000
        # Unknown distances are requested in every slot, but peers that do not answer delay the others.
        self.gather_s = 2e-6 * (UNKNOWN_PERIOD_US + self._cycle_us) + SESSION_S
        self.price_nats = FIRST_PRICE_NATS
        """Least worth of a distance that is measured."""
        self._airtime = airtime
        self._survey: tuple[int, int] | None = None
        self._outstanding = Outstanding()
        self._measurement_var_m2 = [measurement_var_m2] * stations
        self._measured_us = [_LONG_AGO_US] * stations
        self._failures = [0] * stations
        self._resume_us = [_LONG_AGO_US] * stations

    def due(
        self, now_us: int, until_us: int, reachable: Reachable, variance_m2: VarianceOf | None = None
    ) -> list[tuple[int, int]]:
        """See `RangingPolicy`."""
        if not self._slots:
            return []
        if self.next_us < now_us:  # a missed slot is skipped, as its time may be another pair's slot
            self._seek(now_us)
        self._outstanding.forget_old(now_us)
        requests = []
        while self.next_us < until_us:
            at_us, peer = int(self.next_us), self._slots[self._slot][1]
            if (
                reachable(peer)
                and not self._outstanding.full
                and peer not in self._outstanding
                and at_us >= self._resume_us[peer]
                and self.worth_nats(peer, at_us, variance_m2(peer) if variance_m2 is not None else None)
                >= self.price_nats
            ):
                self._outstanding[peer] = at_us
                requests.append((at_us, peer))
            self._slot += 1
            if self._slot == len(self._slots):
                self._slot = 0
                self._cycle_begin_us += self._cycle_us
            self._set_next()
        return requests

    def worth_nats(self, peer: int, at_us: int, variance_m2: float | None) -> float:
        """Return the worth of measuring a peer's distance at a time, given the variance of its estimate."""
        age_us = at_us - self._measured_us[peer]
        if variance_m2 is None or not variance_m2 >= 0.0:  # also for NaN
            return math.inf if age_us >= UNKNOWN_PERIOD_US else 0.0
        information_nats = 0.5 * math.log1p(variance_m2 / self._measurement_var_m2[peer])
        return max(information_nats, (age_us - self._check_us[peer]) * _CHECK_NATS_US)

    def on_result(
        self, peer: int, *, ended_us: int = 0, variance_m2: float | None = None, retry_after_us: int = 0
    ) -> None:
        """Record that the session with this peer has ended; ``variance_m2`` None: it failed."""
        self._outstanding.pop(peer, None)
        if not 0 <= peer < len(self._failures):
            return
        if variance_m2 is not None and variance_m2 > 0.0:
            self._measurement_var_m2[peer] = variance_m2
            self._measured_us[peer] = ended_us
            self._failures[peer] = 0
            return
        pause_us = max(((1 << min(self._failures[peer], 16)) - 1) * self._cycle_us, retry_after_us)
        self._failures[peer] += 1
        self._resume_us[peer] = ended_us + min(pause_us, CHECK_US)

    def on_survey(self, ended_ns: int, busy_ns: int) -> None:
        """Update the price from the occupancy of the channel, given its counter of busy time."""
        if self._survey is None:
            self._survey = (ended_ns, busy_ns)
            return
        elapsed_ns, window_busy_ns = ended_ns - self._survey[0], busy_ns - self._survey[1]
        if 0 <= elapsed_ns < WINDOW_NS:
            return
        self._survey = (ended_ns, busy_ns)
        if not 0 <= window_busy_ns <= elapsed_ns:  # the counter was reset
            return
        log_step = min(PRICE_GAIN * (window_busy_ns / elapsed_ns / self._airtime - 1.0), MOST_LOG_STEP)
        ratio = math.expm1(2.0 * self.price_nats) * math.exp(log_step)
        price_nats = 0.5 * math.log1p(ratio)
        self.price_nats = min(max(price_nats, LEAST_PRICE_NATS), MOST_PRICE_NATS)

    def _seek(self, now_us: int) -> None:
        """Select the first own slot whose session begins at or after ``now_us``."""
        since_us = now_us - self._guard_us
        self._cycle_begin_us = since_us // self._cycle_us * self._cycle_us
        offset_us = since_us - self._cycle_begin_us
        self._slot = next((k for k, slot in enumerate(self._slots) if slot[0] >= offset_us), 0)
        if self._slots[self._slot][0] < offset_us:
            self._cycle_begin_us += self._cycle_us
        self._set_next()

    def _set_next(self) -> None:
        self.next_us = float(self._cycle_begin_us + self._slots[self._slot][0] + self._guard_us)
