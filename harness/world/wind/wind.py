"""All of a scenario's wind in one object: of either kind, with the gusts that are written down."""

from typing import NamedTuple

import numpy as np

from foundation.types import Array
from harness.world.wind.config import WindConfig
from harness.world.wind.force import GustyWind
from harness.world.wind.gusts import GustProfiles
from harness.world.wind.velocity import MovingAir


class WindNow(NamedTuple):
    """What n vehicles meet over a step; not to be written to."""

    force_ned_n: Array
    """(n, 3); zeros where wind is a velocity"""
    air_vel_ned_m_s: Array
    """(n, 3); zeros where wind is a force"""


class Wind:
    """Wind of a scenario at ``vehicles`` vehicles; all its randomness is ``rng``'s.

    Turbulence is that of ``formation_height_m`` above the ground unless the scenario says another height.
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
        """Wind of the step of ``dt_s`` that begins at ``time_us``, at heights (n,) above the ground."""
        if isinstance(self._source, GustyWind):
            wind_ned = self._source.step(dt_s)
        else:
            wind_ned = self._source.step(dt_s, height_m)
        if self._gusts is not None and (gust_ned := self._gusts.at(time_us)) is not None:
            wind_ned = wind_ned + gust_ned
        if isinstance(self._source, GustyWind):
            return WindNow(wind_ned, self._nothing)
        return WindNow(self._nothing, wind_ned)
