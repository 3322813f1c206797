"""Wind as the article has it: a force on every vehicle, whatever its motion, of a mean and gusts."""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from autopilot.types import Array

VERTICAL_GUST_RATIO = 0.3
"""rms of the gusts' down component over that of each horizontal one."""


class WindConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[wind]`` table."""

    mean_n: Annotated[float, Meta(ge=0.0, le=100.0)] = 5.0
    """Magnitude of the mean force."""
    direction_deg: Annotated[float, Meta(ge=-360.0, le=360.0)] = 45.0
    """Where the force points to, clockwise from north."""
    vertical_fraction: Annotated[float, Meta(ge=-1.0, le=1.0)] = 0.0
    """Down component of the mean over its magnitude."""
    gust_rms_fraction: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.2
    """rms of each horizontal component of the gusts over the mean's magnitude."""
    gust_time_constant_s: Annotated[float, Meta(gt=0.0)] = 2.0
    correlation: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.8
    """Of the gusts at any two vehicles."""


class GustyWind:
    """Mean force plus gusts: for each axis and vehicle a stationary first-order Gauss-Markov process.

    A gust is ``sqrt(c)`` times a process that all vehicles share plus ``sqrt(1 - c)`` times one of the
    vehicle's own, c being the correlation. The processes start in their stationary distribution.
    """

    def __init__(self, config: WindConfig, vehicles: int, rng: np.random.Generator) -> None:
        direction_rad = math.radians(config.direction_deg)
        horizontal_n = config.mean_n * math.sqrt(1.0 - config.vertical_fraction**2)
        self._mean_ned_n = np.array(
            [
                horizontal_n * math.cos(direction_rad),
                horizontal_n * math.sin(direction_rad),
                config.mean_n * config.vertical_fraction,
            ]
        )
        gust_rms_n = config.mean_n * config.gust_rms_fraction
        self._gust_rms_ned_n = gust_rms_n * np.array([1.0, 1.0, VERTICAL_GUST_RATIO])
        self._time_constant_s = config.gust_time_constant_s
        self._shared_weight = math.sqrt(config.correlation)
        self._own_weight = math.sqrt(1.0 - config.correlation)
        self._rng = rng
        # row 0 is shared, row 1 + i belongs to vehicle i; of unit variance
        self._unit_gusts = rng.standard_normal((1 + vehicles, 3))

    def step(self, dt_s: float) -> Array:
        """Force (n, 3) in newtons, NED, ``dt_s`` seconds after the last call (exact for any interval)."""
        kept = math.exp(-dt_s / self._time_constant_s)
        fresh = self._rng.standard_normal(self._unit_gusts.shape)
        self._unit_gusts = kept * self._unit_gusts + math.sqrt(1.0 - kept * kept) * fresh
        gusts = self._shared_weight * self._unit_gusts[0] + self._own_weight * self._unit_gusts[1:]
        force_ned_n: Array = self._mean_ned_n + self._gust_rms_ned_n * gusts
        return force_ned_n
