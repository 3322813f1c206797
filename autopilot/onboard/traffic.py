"""What one application says on the radio and what it makes of what it hears: beacons and distances.

Keeps no position: the beacon's content is handed in, and what was heard or measured is handed back.
"""

import math

import numpy as np

from autopilot.config import Devices, OnboardConfig
from autopilot.onboard import beacon as wire
from autopilot.onboard.commands import NEVER_US
from autopilot.onboard.localisation import CLOCK_TOLERANCE_US
from autopilot.onboard.own_state import OwnState
from autopilot.onboard.ranging import RangingSchedule
from netsim.wire.messages import Broadcast, Delivery, FtmRequest, FtmResult, TxItem

BEACON_JITTER = 0.02
"""Half width of each beacon's random shift, in periods: two UAVs that tick together do not go on doing so."""
SILENCE_US = 3_000_000
"""A neighbour not heard for this long is neither ranged to nor kept clear of."""
PRIOR_TRIPS = 8
"""How many round trips' evidence the device's stated accuracy is worth beside a session's own few."""


class Traffic:
    """One station's beacons and ranging sessions.

    Attributes:
        range_silence_us: distances older than this are news to nobody.
        bad_beacons: datagrams that were no beacon, or one that contradicts itself.

    """

    def __init__(
        self,
        *,
        station: int,
        stations: int,
        config: OnboardConfig,
        devices: Devices,
        rng: np.random.Generator,
    ) -> None:
        self.range_silence_us = round((2.0 * config.ftm_period_s + 1.0) * 1e6)
        self.bad_beacons = 0
        self._station, self._stations = station, stations
        self._trip_std_m = devices.ftm_trip_std_m
        self._rng = rng
        self._ranging = RangingSchedule(
            station=station, stations=stations, period_us=round(config.ftm_period_s * 1e6), rng=rng
        )
        self._distances: dict[int, wire.Distance] = {}
        self._heard_us: dict[int, int] = {}
        self._seq = 0
        self._period_us = config.beacon_period_ms * 1_000
        self._slot_us: float | None = None
        self._beacon_us = 0

    def hear(self, item: Delivery, now_us: int) -> wire.Beacon | None:
        """Beacon of a neighbour in a datagram; None, counted, if it holds none that can be believed."""
        beacon = wire.decode(item.payload)
        if (
            beacon is None
            or beacon.station != item.source
            or beacon.station >= self._stations
            or beacon.station == self._station
            or beacon.time_us > now_us + CLOCK_TOLERANCE_US
        ):
            self.bad_beacons += 1
            return None
        self._heard_us[beacon.station] = now_us
        return beacon

    def measured(self, item: FtmResult) -> wire.Distance | None:
        """Distance that a session gave, with its error; None if it failed."""
        self._ranging.on_result(item.peer)
        if item.status != "ok" or item.round_trips < 1 or item.peer >= self._stations:
            return None
        # Few trips tell their own scatter badly, so it is pooled with what the device is expected to have (a
        # scaled inverse chi-square prior).
        degrees = item.round_trips - 1
        trip_var_m2 = (PRIOR_TRIPS * self._trip_std_m**2 + degrees * item.distance_std_m**2) / (
            PRIOR_TRIPS + degrees
        )
        std_m = math.sqrt(trip_var_m2 / item.round_trips)
        distance = wire.Distance(item.peer, item.measured_ns // 1_000_000, item.distance_m, std_m)
        self._distances[item.peer] = distance
        return distance

    def due(self, own: OwnState, now_us: int, until_us: int, *, ranging: bool) -> tuple[TxItem, ...]:
        """All to hand to the radio in [now, until): beacons, and if ``ranging`` requests."""
        items: list[TxItem] = []
        if self._slot_us is None:
            self._slot_us = now_us + self._rng.uniform() * self._period_us
            self._beacon_us = int(self._slot_us)
        while self._beacon_us < until_us:
            payload = wire.encode(self._beacon(own, now_us))
            items.append(Broadcast(seq=self._next_seq(), at_us=max(self._beacon_us, now_us), payload=payload))
            self._slot_us += self._period_us
            self._beacon_us = int(
                self._slot_us + self._rng.uniform(-BEACON_JITTER, BEACON_JITTER) * self._period_us
            )
        if ranging and self._ranging.next_us < until_us:
            reachable = {peer for peer, heard_us in self._heard_us.items() if now_us - heard_us < SILENCE_US}
            items += [
                FtmRequest(seq=self._next_seq(), at_us=at_us, peer=peer)
                for at_us, peer in self._ranging.due(now_us, until_us, reachable)
            ]
        return tuple(items)

    def next_deadline_us(self, *, ranging: bool) -> int:
        """When `due` next has something to say."""
        return min(self._beacon_us, int(self._ranging.next_us) if ranging else NEVER_US)

    def _beacon(self, own: OwnState, now_us: int) -> wire.Beacon:
        oldest_ms = (now_us - self.range_silence_us) // 1_000
        fresh = [item for item in self._distances.values() if item.time_ms >= oldest_ms]
        if len(fresh) > wire.MAX_RANGES:
            fresh.sort(key=lambda item: item.time_ms)
        odo_n, odo_e, odo_d = own.odometry_ned_m.tolist()
        vel_n, vel_e, vel_d = own.vel_ned_m_s.tolist()
        return wire.Beacon(
            self._station, own.time_us, (odo_n, odo_e, odo_d), (vel_n, vel_e, vel_d), own.fix,
            tuple(fresh[-wire.MAX_RANGES:]),
        )  # fmt: skip

    def _next_seq(self) -> int:
        self._seq += 1
        return self._seq - 1
