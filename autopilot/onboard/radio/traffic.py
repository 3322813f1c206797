"""What one application says on the radio and what it makes of what it hears: beacons and distances.

Keeps no position: the beacon's content is handed in, and what was heard or measured is handed back.
"""

import math
from collections.abc import Callable
from itertools import chain, repeat
from operator import itemgetter

import numpy as np

from autopilot.onboard.formation.commands import NEVER_US
from autopilot.onboard.formation.own_state import OwnState
from autopilot.onboard.formation.phases import FlightPhase
from autopilot.onboard.radio import beacon as wire
from autopilot.onboard.radio.neighbour_table import WAIT_US, NeighbourTable
from autopilot.onboard.radio.neighbourhood import Neighbourhood
from autopilot.onboard.radio.ranging import RangingPolicy, RangingSchedule, VarianceOf
from autopilot.onboard.radio.scheduled_ranging import ScheduledRanging
from autopilot.parameters.config import Devices, OnboardConfig
from netsim.wire.messages import Broadcast, FtmRequest, FtmResult, Survey, TxItem

BEACON_JITTER = 0.02
"""Half width of each beacon's random shift, in periods: two UAVs that tick together do not go on doing so."""
_DRAWS = 256
PRIOR_TRIPS = 8
"""How many round trips' evidence the device's stated accuracy is worth beside a session's own few."""


class Traffic:
    """One station's beacons and ranging sessions.

    Args:
        station: this station.
        stations: how many there are.
        config: settings.
        devices: what the UAV knows of its radio.
        rng: source of phases and jitters.
        near: to whom it ranges, and of whose beacons it looks at the distances; None: everybody.

    Attributes:
        hearing: what others say.
        range_silence_us: distances older than this are news to nobody.
        gather_s: within this each station has ranged to all its peers that can be, one loss included.

    """

    def __init__(
        self,
        *,
        station: int,
        stations: int,
        config: OnboardConfig,
        devices: Devices,
        rng: np.random.Generator,
        near: Neighbourhood | None = None,
    ) -> None:
        self._station, self._stations = station, stations
        self._trip_std_m = devices.ftm_trip_std_m
        self._range_floor_var_m2 = config.range_floor_std_m**2
        self._ranging = self._policy(config, near, rng)
        # In blocks, for a draw costs many times as much as the next of a list; the policy has drawn by now.
        self._draws = chain.from_iterable(rng.random(size).tolist() for size in repeat(_DRAWS))
        """Of the slots' phase and jitters, 0 to 1."""
        self.range_silence_us = self._ranging.silence_us
        self.gather_s = self._ranging.gather_s
        self._told: dict[int, tuple[int, bytes]] = {}
        """Newest distance to each peer, as beacons tell it: when it was measured, ms, and its bytes."""
        self._seq = 0
        self._beacon_seq = 0
        self._period_us = config.beacon_period_ms * 1_000
        self.hearing = NeighbourTable(
            station=station, stations=stations, period_us=self._period_us, gps_std_m=config.gps_bias_std_m,
            near=near,
        )  # fmt: skip
        self._slot_us: float | None = None
        self._beacon_us = 0

    def begin_anew(self) -> None:
        """Number the next beacon so that whoever hears it takes its odometry for a new one."""
        self._beacon_seq = (self._beacon_seq + wire.SEQ_MODULUS // 2) % wire.SEQ_MODULUS

    def measured(self, item: FtmResult) -> wire.Distance | None:
        """Distance that a session gave, with its error; None if it failed."""
        ended_us = item.ended_ns // 1_000
        if item.status != "ok" or item.round_trips < 1 or item.peer >= self._stations:
            self._ranging.on_result(
                item.peer, ended_us=ended_us, retry_after_us=item.retry_after_s * 1_000_000
            )
            return None
        # Few trips tell their own scatter badly, so it is pooled with what the device is expected to have (a
        # scaled inverse chi-square prior).
        degrees = item.round_trips - 1
        trip_var_m2 = (PRIOR_TRIPS * self._trip_std_m**2 + degrees * item.distance_std_m**2) / (
            PRIOR_TRIPS + degrees
        )
        var_m2 = trip_var_m2 / item.round_trips
        self._ranging.on_result(item.peer, ended_us=ended_us, variance_m2=var_m2 + self._range_floor_var_m2)
        std_m = math.sqrt(var_m2)
        distance = wire.Distance(item.peer, item.measured_ns // 1_000_000, item.distance_m, std_m)
        self._told[item.peer] = (distance.time_ms, wire.encode_distance(distance))
        return distance

    def take_survey(self, item: Survey) -> None:
        """Take the radio's count of how long it has found the medium busy."""
        self._ranging.on_survey(item.ended_ns, item.busy_ns)

    def due(
        self,
        own: OwnState,
        now_us: int,
        until_us: int,
        *,
        ranging: bool,
        variance_m2: VarianceOf | None = None,
        phase: FlightPhase = FlightPhase.WAITING,
        motion_start_ms: int | None = None,
        gps_error: Callable[[], wire.GpsError | None] | None = None,
    ) -> tuple[TxItem, ...]:
        """All to hand to the radio in [now, until): beacons, and if ``ranging`` requests.

        ``variance_m2`` tells how well the distance to a peer is known and is asked when a request could be
        made, ``gps_error`` the own receiver's error when a beacon is made; the rest goes into beacons as is.
        """
        items: list[TxItem] = []
        if self._slot_us is None:
            self._slot_us = now_us + next(self._draws) * self._period_us
            self._beacon_us = int(self._slot_us)
        if (
            now_us - self._slot_us > WAIT_US
        ):  # the clock has leapt, and what was not said by then counts as lost
            missed = (now_us - self._slot_us) // self._period_us
            self._beacon_seq = (self._beacon_seq + int(missed)) % wire.SEQ_MODULUS
            self._slot_us += missed * self._period_us
            self._beacon_us = int(self._slot_us)
        while self._beacon_us < until_us:
            payload = wire.encode_with(
                self._newest_told(now_us), self._station, self._beacon_seq, own.time_us, phase,
                own.odometry_ned_m, own.vel_ned_m_s, motion_start_ms, own.fix,
                None if gps_error is None else gps_error(),
            )  # fmt: skip
            self._beacon_seq = (self._beacon_seq + 1) % wire.SEQ_MODULUS
            items.append(Broadcast(seq=self._next_seq(), at_us=max(self._beacon_us, now_us), payload=payload))
            self._slot_us += self._period_us
            self._beacon_us = int(
                self._slot_us + (2.0 * BEACON_JITTER * next(self._draws) - BEACON_JITTER) * self._period_us
            )
        if ranging and self._ranging.next_us < until_us:
            requests = self._ranging.due(
                now_us, until_us, lambda peer: self.hearing.reaches(peer, now_us), variance_m2
            )
            items += [FtmRequest(seq=self._next_seq(), at_us=at_us, peer=peer) for at_us, peer in requests]
        return tuple(items)

    def next_deadline_us(self, *, ranging: bool) -> int:
        """When `due` next has something to say."""
        return int(min(self._beacon_us, self._ranging.next_us if ranging else NEVER_US))

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

    def _newest_told(self, now_us: int) -> list[bytes]:
        """Bytes of the distances that may be news to somebody, as many as a beacon holds."""
        oldest_ms = (now_us - self.range_silence_us) // 1_000
        fresh = [octets for time_ms, octets in self._told.values() if time_ms >= oldest_ms]
        if len(fresh) <= wire.MAX_RANGES:
            return fresh
        newest = sorted(self._told.values(), key=itemgetter(0))[-wire.MAX_RANGES :]
        return [octets for _, octets in newest]

    def _next_seq(self) -> int:
        self._seq += 1
        return self._seq - 1
