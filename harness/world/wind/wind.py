"""The whole wind of a scenario: force or velocity, plus deterministic gusts."""

from typing import NamedTuple

import numpy as np

from foundation.types import Array
from harness.world.wind.config import WindConfig
from harness.world.wind.force import GustyWind
from harness.world.wind.gusts import GustProfiles
from harness.world.wind.velocity import MovingAir


class WindNow(NamedTuple):
    """Wind at n vehicles in a step; do not write to it."""

    force_ned_n: Array
    """(n, 3); zero if the wind is a velocity"""
    air_vel_ned_m_s: Array
    """(n, 3); zero if the wind is a force"""


class Wind:
    """Wind of a scenario at n vehicles; all random numbers are drawn from ``rng``.

    Turbulence is that of ``formation_height_m`` above the ground unless the scenario sets another height.
    """

    def __init__(
        self, config: WindConfig, vehicles: int, rng: np.random.Generator, *, formation_height_m: float
    ) -> None:
        self._source: GustyWind | MovingAir
        if config.kind == "force":
            self._source = GustyWind(config, vehicles, rng)
        else:
            self._source = MovingAir(config, vehicles, rng, formation_height_m=formation_height_m)
        self._gusts = GustProfiles(config) if config.gusts else None
        self._nothing = np.zeros((vehicles, 3))

    def step(self, dt_s: float, *, time_us: int, height_m: Array) -> WindNow:
        """Return the wind of the step of ``dt_s`` from ``time_us`` on, at heights (n,) above the ground."""
        if isinstance(self._source, GustyWind):
            wind_ned = self._source.step(dt_s)
        else:
            wind_ned = self._source.step(dt_s, height_m)
        if self._gusts is not None and (gust_ned := self._gusts.at(time_us)) is not None:
            wind_ned = wind_ned + gust_ned
        if isinstance(self._source, GustyWind):
            return WindNow(wind_ned, self._nothing)
        return WindNow(self._nothing, wind_ned)
