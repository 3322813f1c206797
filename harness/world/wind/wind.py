"""The whole wind of a scenario: force or velocity, plus deterministic gusts."""

import math
from typing import NamedTuple

import numpy as np

from foundation.types import Array
from harness.world.wind.config import GustConfig, WindConfig, direction_ned
from harness.world.wind.force import GustyWind
from harness.world.wind.velocity import MovingAir


class GustProfiles:
    """The sum of ``config.gusts``, in N or m/s by the wind's kind, equal for all vehicles."""

    def __init__(self, config: WindConfig) -> None:
        self._gusts = tuple(
            (gust, _peak_ned(gust, config.direction_deg), round(gust.start_s * 1e6)) for gust in config.gusts
        )

    def at(self, time_us: int) -> Array | None:
        """Return the sum (3,) NED at a simulated time; None without a gust."""
        total: Array | None = None
        for gust, peak_ned, start_us in self._gusts:
            fraction = rise(gust, time_us - start_us)
            if fraction > 0.0:
                part = fraction * peak_ned
                total = part if total is None else total + part
        return total


def rise(gust: GustConfig, since_us: int) -> float:
    """Return the fraction of its peak that a gust has ``since_us`` after its start."""
    rise_us = round(gust.rise_s * 1e6)
    left_us = math.inf if gust.duration_s is None else round(gust.duration_s * 1e6) - since_us
    if since_us < 0 or left_us <= 0:
        return 0.0
    nearest_us = min(since_us, left_us)  # the fall mirrors the rise
    if nearest_us >= rise_us:
        return 1.0
    part = nearest_us / rise_us
    return 0.5 * (1.0 - math.cos(math.pi * part)) if gust.shape == "one_minus_cosine" else part


def _peak_ned(gust: GustConfig, wind_direction_deg: float) -> Array:
    peak = gust.peak_n if gust.peak_n is not None else gust.peak_m_s
    direction_deg = wind_direction_deg if gust.direction_deg is None else gust.direction_deg
    return np.asarray((peak or 0.0) * direction_ned(direction_deg, gust.vertical_fraction))


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
