"""Radio traffic of one application: sends beacons and ranging requests, and evaluates ranging results.

It stores no positions: the caller passes the content of the beacons and receives the measured distances.
"""

import math
from collections.abc import Callable
from itertools import chain, repeat
from operator import itemgetter

import numpy as np

from autopilot.onboard.client.commands import NEVER_US
from autopilot.onboard.client.own_state import OwnState
from autopilot.onboard.context import Radio
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.radio import beacon as wire
from autopilot.onboard.radio.neighbour_table import WAIT_US, NeighbourTable
from autopilot.onboard.radio.neighbourhood import Neighbourhood
from autopilot.onboard.radio.ranging import RangingPolicy, RangingSchedule, VarianceOf
from autopilot.onboard.radio.scheduled_ranging import ScheduledRanging
from autopilot.parameters.config import Devices
from autopilot.parameters.onboard_config import OnboardConfig
from netsim.wire.messages import FtmResult

BEACON_JITTER = 0.02
"""Half width of each beacon's random shift, in periods: it separates UAVs that send at the same time."""
_DRAWS = 256
PRIOR_TRIPS = 8
"""Weight of the device's stated accuracy, in round trips, when pooled with the scatter of a session."""


class Traffic:
    """One station's beacons and ranging sessions.

    ``rng`` gives phases and jitters. ``near`` is the neighbourhood to range to, and from which reported
    distances are used; None: all stations.
    """

    def __init__(
        self, *, radio: Radio, config: OnboardConfig, devices: Devices, rng: np.random.Generator,
        near: Neighbourhood | None = None,
    ) -> None:  # fmt: skip
        self._radio = radio
        self._station, self._stations = station, stations = radio.station, radio.stations
        self._trip_std_m = devices.ftm_trip_std_m
        self._range_floor_var_m2 = config.range_floor_std_m**2
        self.ranging = self._policy(config, near, rng)
        # Drawn in blocks, because a single draw costs far more than a list access.
        self._draws = chain.from_iterable(rng.random(size).tolist() for size in repeat(_DRAWS))
        """Random numbers 0..1 of the beacon phase and jitters."""
        self._encoded: dict[int, tuple[int, bytes]] = {}
        """Newest distance to each peer, encoded for beacons: its measurement time, ms, and its bytes."""
        self._beacon_seq = 0
        self._period_us = config.beacon_period_ms * 1_000
        self.table = NeighbourTable(
            station=station, stations=stations, period_us=self._period_us, gps_std_m=config.gps_bias_std_m,
            near=near,
        )  # fmt: skip
        self._slot_us: float | None = None
        self._beacon_us = 0

    def signal_restart(self) -> None:
        """Offset the sequence number of the next beacon, so that receivers discard the earlier odometry."""
        self._beacon_seq = (self._beacon_seq + wire.SEQ_MODULUS // 2) % wire.SEQ_MODULUS

    def measured(self, item: FtmResult) -> wire.Distance | None:
        """Return the distance of a session, with its standard deviation; None if the session failed."""
        ended_us = item.ended_ns // 1_000
        if item.status != "ok" or item.round_trips < 1 or item.peer >= self._stations:
            self.ranging.on_result(
                item.peer, ended_us=ended_us, retry_after_us=item.retry_after_s * 1_000_000
            )
            return None
        # The scatter of a few trips is a poor estimate of their variance, so it is pooled with the device's
        # (a scaled inverse chi-square prior).
        degrees = item.round_trips - 1
        trip_var_m2 = (PRIOR_TRIPS * self._trip_std_m**2 + degrees * item.distance_std_m**2) / (
            PRIOR_TRIPS + degrees
        )
        var_m2 = trip_var_m2 / item.round_trips
        self.ranging.on_result(item.peer, ended_us=ended_us, variance_m2=var_m2 + self._range_floor_var_m2)
        std_m = math.sqrt(var_m2)
        distance = wire.Distance(item.peer, item.measured_ns // 1_000_000, item.distance_m, std_m)
        self._encoded[item.peer] = (distance.time_ms, wire.encode_distance(distance))
        return distance

    def send(
        self, own: OwnState, now_us: int, until_us: int, *, ranging: bool,
        variance_m2: VarianceOf | None = None, phase: FlightPhase = FlightPhase.WAITING,
        motion_start_ms: int | None = None, gps_error: Callable[[], wire.GpsError | None] | None = None,
    ) -> None:  # fmt: skip
        """Pass the radio its items in [now, until): beacons, and ranging requests if ``ranging``.

        ``variance_m2`` is called for possible requests, ``gps_error`` once per beacon. ``phase`` and
        ``motion_start_ms`` are copied into beacons.
        """
        if self._slot_us is None:
            self._slot_us = now_us + next(self._draws) * self._period_us
            self._beacon_us = int(self._slot_us)
        if now_us - self._slot_us > WAIT_US:  # the clock has jumped: the beacons in between count as lost
            missed = (now_us - self._slot_us) // self._period_us
            self._beacon_seq = (self._beacon_seq + int(missed)) % wire.SEQ_MODULUS
            self._slot_us += missed * self._period_us
            self._beacon_us = int(self._slot_us)
        while self._beacon_us < until_us:
            payload = wire.encode_with(
                self._newest_distances(now_us), self._station, self._beacon_seq, own.time_us, phase,
                own.odometry_ned_m, own.vel_ned_m_s, motion_start_ms, own.fix,
                None if gps_error is None else gps_error(),
            )  # fmt: skip
            self._beacon_seq = (self._beacon_seq + 1) % wire.SEQ_MODULUS
            self._radio.broadcast(payload, at_us=max(self._beacon_us, now_us))
            self._slot_us += self._period_us
            self._beacon_us = int(
                self._slot_us + (2.0 * BEACON_JITTER * next(self._draws) - BEACON_JITTER) * self._period_us
            )
        if ranging and self.ranging.next_us < until_us:
            requests = self.ranging.due(
                now_us, until_us, lambda peer: self.table.reaches(peer, now_us), variance_m2
            )
            for at_us, peer in requests:
                self._radio.range_to(peer, at_us=at_us)

    def next_deadline_us(self, *, ranging: bool) -> int:
        """Return the time at which `send` next passes an item."""
        return int(min(self._beacon_us, self.ranging.next_us if ranging else NEVER_US))

    def _policy(
        self, config: OnboardConfig, near: Neighbourhood | None, rng: np.random.Generator
    ) -> RangingPolicy:
        if config.ranging == "scheduled":
            return ScheduledRanging(
                station=self._station, stations=self._stations, slot_us=config.ranging_slot_ms * 1_000,
                airtime=config.ranging_airtime,
                measurement_var_m2=self._trip_std_m**2 + self._range_floor_var_m2,
                linked=None if near is None else near.linked,
            )  # fmt: skip
        return RangingSchedule(
            station=self._station, stations=self._stations, period_us=round(config.ftm_period_s * 1e6),
            rng=rng, peers=None if near is None else near.members.tolist(),
        )  # fmt: skip

    def _newest_distances(self, now_us: int) -> list[bytes]:
        """Return the encoded distances to send: within the policy's silence time, and the newest that fit."""
        oldest_ms = (now_us - self.ranging.silence_us) // 1_000
        fresh = [octets for time_ms, octets in self._encoded.values() if time_ms >= oldest_ms]
        if len(fresh) <= wire.MAX_RANGES:
            return fresh
        newest = sorted(self._encoded.values(), key=itemgetter(0))[-wire.MAX_RANGES :]
        return [octets for _, octets in newest]
