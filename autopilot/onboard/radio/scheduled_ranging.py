"""Ranging that respects the airtime: each pair once, in slots, when the channel has room and it is worth it.

Who. A distance is the same from both ends, so each pair is measured by one of them, its `owner`; everybody
hears the result in the owner's beacons. On a ring each station owns the pairs with the half of the others
that follows it, so nobody owns more than one pair more than anybody else.

When. The shared clock is cut into slots, numbered from its zero. Pair p of P, which are N (N - 1) / 2 unless
only neighbours range, has the slots whose number is p modulo P, and its session begins a little after the
slot's beginning. As long as a session of one burst fits a slot and the clocks agree within the guard, no
session ever contends with another. Pairs are numbered round by round as in a round-robin tournament
(`pair_number`), whose rounds are disjoint pairs; consecutive slots then share no station, so that one which
overruns its slot does not meet a radio that it occupies itself. (With fewer than six stations no cyclic order
does that: for five, the pairs' graph is Petersen's, which has no Hamiltonian cycle. Where only neighbours
range, rounds are shorter and still disjoint, but the last pair of one may share a station with the first of
the next.)

Whether. The owner uses its slot if the distance is worth the price. Worth is the information that a
measurement of variance r adds to a distance known with variance p, 0.5 log(1 + p / r) nats, and for one not
measured for `CHECK_US` it rises with time whatever the filter says: a fault, or a variance that is wrongly
small, does not go unnoticed. A distance that the filter does not know at all is worth any price, but once per
`UNKNOWN_PERIOD_US`, which is enough to find a place for its ends.

The price is set by each station from what its own radio measures of the channel, whatever occupies it: per
`WINDOW_NS` the ratio x = p / r that is just worth it, exp(2 price) - 1, is multiplied by
exp(`PRICE_GAIN` (occupancy / wanted occupancy - 1)). Where p grows at a rate q between measurements, from
r x / (1 + x) after one to r x before the next, airtime is in proportion to q (1 + x) / (r x^2): its
elasticity is 1 to 2, so the loop's gain is 0.5 to 1, and less with others' load. The error is linear in the
occupancy for its mean to become the wanted one even if pairs come in bunches. All who hear the same channel
arrive at the same price, so the most valuable distances of the formation are measured, not of a station. The
price never falls below `LEAST_PRICE_NATS`, for what adds next to nothing is worth nothing on an empty channel
either. Above `MOST_PRICE_NATS` it would bar distances known from GPS alone. The slots set a limit of their
own: one session each, whatever occupancy is wanted.

A station that is not heard, and so may be gone, is not ranged to. The other end of a pair does not take over
for a silent owner: it would have nobody to measure to. Sessions that fail are tried again in the next slot,
then after pauses that double.
"""

import math

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.radio.ranging import Outstanding, Reachable, VarianceOf
from autopilot.parameters.config import SESSION_S

GUARD = 0.125
"""Share of a slot that passes before its session begins, for clocks that disagree."""
LEAST_PRICE_NATS = -0.5 * math.log(1.0 - 0.05)
"""Of a measurement that takes 5 % off the variance."""
MOST_PRICE_NATS = 3.0
"""Of one that takes the standard deviation to a twentieth: from 1.2 m, as of GPS, to 0.06 m."""
FIRST_PRICE_NATS = 0.5 * math.log(2.0)
"""Of a measurement as good as what is known; before the channel has been measured."""
PRICE_GAIN = 0.5
MOST_LOG_STEP = 1.0
"""The ratio rises by no more than a factor of e per window."""
WINDOW_NS = 500_000_000
"""Over which the occupancy is averaged, of a hundred sessions or so."""
CHECK_US = 3_000_000
CHECK_LATEST_US = 5_000_000
"""At the highest price a distance is measured again after this time, at the lowest after `CHECK_US`."""
CHECK_SPREAD = 0.25
"""Up to this share of `CHECK_US` earlier, which differs from pair to pair: else pairs that were measured
together at the beginning would be so ever after."""
UNKNOWN_PERIOD_US = 500_000
_CHECK_NATS_US = MOST_PRICE_NATS / (CHECK_LATEST_US - CHECK_US)
_LONG_AGO_US = -(1 << 62)


def pair_number(i: int, j: int, stations: int) -> int:
    """Number of a pair among all: 0 to N (N - 1) / 2 - 1, by the circle method.

    Among an odd number m of stations on a ring, round r pairs those at equal distances k to both sides of r:
    (r - k, r + k) mod m. Station r is left over; it is paired with the last station if their number is even.
    """
    ring = stations - 1 + stations % 2
    if stations % 2 == 0 and max(i, j) == stations - 1:
        return min(i, j) * (stations // 2)
    # r is half the sum of the two, and (m + 1) / 2 is the inverse of 2 modulo m.
    turn = (i + j) * (ring + 1) // 2 % ring
    k = min((i - turn) % ring, (turn - i) % ring)
    return turn * (ring // 2) + k - 1 if stations % 2 else turn * (stations // 2) + k


def owner(i: int, j: int, stations: int) -> int:
    """Which end measures the distance of a pair: that which the other follows by less than half the ring.

    Of two that are exactly half of it apart, the one with the smaller number.
    """
    ahead = 2 * ((j - i) % stations)
    if ahead == stations:
        return min(i, j)
    return i if ahead < stations else j


class ScheduledRanging:
    """Policy of one station: see this module and `ranging.RangingPolicy`.

    Args:
        station, stations: the own number, and how many there are.
        slot_us: length of a slot.
        airtime: occupancy of the channel that the price aims at, 0..1.
        measurement_var_m2: variance to expect of a measured distance, until each peer's last one tells.
        linked: (N, N) symmetric, whose distances are measured at all; None: everybody's.

    Attributes:
        price_nats: what a distance has to be worth.

    """

    def __init__(
        self,
        *,
        station: int,
        stations: int,
        slot_us: int,
        airtime: float,
        measurement_var_m2: float,
        linked: NDArray[np.bool_] | None = None,
    ) -> None:
        pairs = [(i, j) for j in range(stations) for i in range(j) if linked is None or linked[i, j]]
        pairs.sort(key=lambda pair: pair_number(pair[0], pair[1], stations))
        self._slots = [
            (slot * slot_us, i + j - station)
            for slot, (i, j) in enumerate(pairs)
            if station in {i, j} and owner(i, j, stations) == station
        ]
        """(begin in the cycle in us, peer)"""
        self._cycle_us = max(len(pairs), 1) * slot_us
        self._check_us = [CHECK_US] * stations
        for begin_us, peer in self._slots:
            self._check_us[peer] -= round(CHECK_SPREAD * CHECK_US * begin_us / self._cycle_us)
        self._guard_us = round(GUARD * slot_us)
        self._slot = 0
        self._cycle_begin_us = 0
        self.next_us = float(self._slots[0][0] + self._guard_us) if self._slots else math.inf
        self.silence_us = CHECK_LATEST_US + 2 * self._cycle_us + 1_000_000
        # What nothing is known of is asked for in every slot, but those who do not answer hold up the others.
        self.gather_s = 2e-6 * (UNKNOWN_PERIOD_US + self._cycle_us) + SESSION_S
        self.price_nats = FIRST_PRICE_NATS
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
        """List the requests to hand over in [now, until): (at_us, peer), of peers that are ``reachable``."""
        if not self._slots:
            return []
        if self.next_us < now_us:  # a slot that was missed is not used late, when it is another's
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
                self._outstanding.add(peer, at_us)
                requests.append((at_us, peer))
            self._slot += 1
            if self._slot == len(self._slots):
                self._slot = 0
                self._cycle_begin_us += self._cycle_us
            self._set_next()
        return requests

    def worth_nats(self, peer: int, at_us: int, variance_m2: float | None) -> float:
        """Worth of measuring the distance to a peer that is known with this variance, at a time."""
        age_us = at_us - self._measured_us[peer]
        if variance_m2 is None or not variance_m2 >= 0.0:  # nor is not-a-number knowledge
            return math.inf if age_us >= UNKNOWN_PERIOD_US else 0.0
        information_nats = 0.5 * math.log1p(variance_m2 / self._measurement_var_m2[peer])
        return max(information_nats, (age_us - self._check_us[peer]) * _CHECK_NATS_US)

    def on_result(
        self, peer: int, *, ended_us: int = 0, variance_m2: float | None = None, retry_after_us: int = 0
    ) -> None:
        """Note that the session with this peer has ended; ``variance_m2`` None: in vain."""
        self._outstanding.discard(peer)
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
        """Let the price follow the occupancy of the channel, which the counter of busy time tells."""
        if self._survey is None:
            self._survey = (ended_ns, busy_ns)
            return
        elapsed_ns, window_busy_ns = ended_ns - self._survey[0], busy_ns - self._survey[1]
        if 0 <= elapsed_ns < WINDOW_NS:
            return
        self._survey = (ended_ns, busy_ns)
        if not 0 <= window_busy_ns <= elapsed_ns:  # the counter began anew
            return
        log_step = min(PRICE_GAIN * (window_busy_ns / elapsed_ns / self._airtime - 1.0), MOST_LOG_STEP)
        ratio = math.expm1(2.0 * self.price_nats) * math.exp(log_step)
        price_nats = 0.5 * math.log1p(ratio)
        self.price_nats = min(max(price_nats, LEAST_PRICE_NATS), MOST_PRICE_NATS)

    def _seek(self, now_us: int) -> None:
        """Go to the first own slot that begins at or after ``now_us``."""
        since_us = now_us - self._guard_us
        self._cycle_begin_us = since_us // self._cycle_us * self._cycle_us
        offset_us = since_us - self._cycle_begin_us
        self._slot = next((k for k, slot in enumerate(self._slots) if slot[0] >= offset_us), 0)
        if self._slots[self._slot][0] < offset_us:
            self._cycle_begin_us += self._cycle_us
        self._set_next()

    def _set_next(self) -> None:
        self.next_us = float(self._cycle_begin_us + self._slots[self._slot][0] + self._guard_us)
