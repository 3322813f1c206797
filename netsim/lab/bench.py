"""Test bench of the emulator in one process, with stations at rest."""

from collections.abc import Sequence
from math import cos, pi, sin

import msgspec
import numpy as np

from foundation.types import Vector
from netsim.emulator.emulator import Emulator
from netsim.model.config import RadioConfig
from netsim.uwb.config import UwbConfig
from netsim.wire.messages import RxItem, TxBatch, TxItem

HEIGHT_M = 10.0
CLOSE_M = 0.4
"""Radius of a ring on which all received powers are equal: path loss is constant below 1 m."""


def ring_ned_m(stations: int, radius_m: float) -> list[Vector]:
    """Return the positions of stations on a circle at height `HEIGHT_M`."""
    angles = [2.0 * pi * i / stations for i in range(stations)]
    return [(radius_m * cos(angle), radius_m * sin(angle), -HEIGHT_M) for angle in angles]


def validated(config: RadioConfig) -> RadioConfig:
    """Return settings made in Python after the range checks of a settings file. Raises ValueError."""
    return msgspec.convert(msgspec.to_builtins(config), RadioConfig)


class RadioBench:
    """Emulator with stations at fixed positions.

    Raises ValueError for settings that are out of range or inconsistent.
    """

    def __init__(
        self, config: RadioConfig, places_ned_m: Sequence[Vector], seed: int, uwb: UwbConfig | None = None
    ) -> None:
        self.emulator = Emulator(
            config=validated(config),
            stations=len(places_ned_m),
            seed=np.random.SeedSequence([seed]),
            uwb=None if uwb is None else msgspec.convert(msgspec.to_builtins(uwb), UwbConfig),
        )
        self.now_us = 0
        self._places_ned_m = np.array(places_ned_m)
        self._still = np.zeros_like(self._places_ned_m)
        self._seqs = [0] * len(places_ned_m)

    def next_seq(self, station: int) -> int:
        """Return the sequence number of a station's next item."""
        self._seqs[station] += 1
        return self._seqs[station]

    def submit(self, station: int, *items: TxItem) -> None:
        """Submit items to a station's radio."""
        self.emulator.submit(TxBatch(station=station, now_us=self.now_us, items=items))

    def run(self, until_us: int) -> list[tuple[int, RxItem]]:
        """Simulate up to a time; return (station, item), ordered by station and arrival."""
        arrived = self.emulator.advance(
            to_us=until_us, at_us=self.now_us, pos_ned_m=self._places_ned_m, vel_ned_m_s=self._still
        )
        self.now_us = until_us
        return [(station, item) for station, items in arrived.items() for item in items]
