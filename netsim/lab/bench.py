"""The emulator alone: stations that stand still, no flight, no processes."""

from collections.abc import Sequence
from math import cos, pi, sin

import msgspec
import numpy as np

from netsim.emulator.emulator import Emulator
from netsim.model.config import RadioConfig
from netsim.phy.propagation import Vector
from netsim.wire.messages import RxItem, TxBatch, TxItem

HEIGHT_M = 10.0
CLOSE_M = 0.4
"""Radius of a ring whose stations all hear each other equally well: link budgets begin at 1 m."""


def ring_ned_m(stations: int, radius_m: float) -> list[Vector]:
    """Places of stations on a circle above the site."""
    angles = [2.0 * pi * i / stations for i in range(stations)]
    return [(radius_m * cos(angle), radius_m * sin(angle), -HEIGHT_M) for angle in angles]


def validated(config: RadioConfig) -> RadioConfig:
    """Give settings that were made in Python, held to the ranges of a file's. Raises ValueError."""
    return msgspec.convert(msgspec.to_builtins(config), RadioConfig)


class RadioBench:
    """Stations without hosts' latencies: what is submitted is in the radio's queue at its ``at_us``.

    Raises ValueError for settings out of range, or that contradict each other.
    """

    def __init__(self, config: RadioConfig, places_ned_m: Sequence[Vector], seed: int) -> None:
        self.emulator = Emulator(
            config=validated(config), stations=len(places_ned_m), seed=np.random.SeedSequence([seed])
        )
        self.now_us = 0
        self._places_ned_m = np.array(places_ned_m)
        self._still = np.zeros_like(self._places_ned_m)
        self._seqs = [0] * len(places_ned_m)

    def next_seq(self, station: int) -> int:
        """Sequence number of a station's next item."""
        self._seqs[station] += 1
        return self._seqs[station]

    def submit(self, station: int, *items: TxItem) -> None:
        """Hand items to a station's radio."""
        self.emulator.submit(TxBatch(station=station, now_us=self.now_us, items=items))

    def run(self, until_us: int) -> list[tuple[int, RxItem]]:
        """Simulate up to a time; returns (station, item) by station and in order of arrival."""
        arrived = self.emulator.advance(
            to_us=until_us, at_us=self.now_us, pos_ned_m=self._places_ned_m, vel_ned_m_s=self._still
        )
        self.now_us = until_us
        return [(station, item) for station, items in arrived.items() for item in items]
