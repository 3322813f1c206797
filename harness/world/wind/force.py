"""Wind as a force on every vehicle, as in the article: a mean plus gusts, independent of the motion."""

import math

import numpy as np

from foundation.types import Array
from harness.world.gauss_markov import STEPS_AHEAD, gauss_markov_path
from harness.world.wind.config import WindConfig

VERTICAL_GUST_RATIO = 0.3
"""RMS of the gusts' down component over that of each horizontal one."""


class GustyWind:
    """Mean force plus gusts: for each axis and vehicle a stationary first-order Gauss-Markov process.

    A vehicle's gust is ``sqrt(c)`` times a common process plus ``sqrt(1 - c)`` times its own process, with
    correlation c. The processes start in their stationary distribution. ``config`` is of kind "force"; its
    deterministic gusts are added by `harness.world.wind.Wind`. Raises ValueError.
    """

    def __init__(self, config: WindConfig, vehicles: int, rng: np.random.Generator) -> None:
        if config.kind != "force":
            raise ValueError(f'wind of kind "{config.kind}" is no force')
        model = config.force_model()
        direction_rad = math.radians(config.direction_deg)
        horizontal_n = model.mean_n * math.sqrt(1.0 - config.vertical_fraction**2)
        self._mean_ned_n = np.array(
            [
                horizontal_n * math.cos(direction_rad),
                horizontal_n * math.sin(direction_rad),
                model.mean_n * config.vertical_fraction,
            ]
        )
        gust_rms_n = model.mean_n * model.gust_rms_fraction
        self._gust_rms_ned_n = gust_rms_n * np.array([1.0, 1.0, VERTICAL_GUST_RATIO])
        self._time_constant_s = model.gust_time_constant_s
        self._shared_weight = math.sqrt(model.correlation)
        self._own_weight = math.sqrt(1.0 - model.correlation)
        self._rng = rng
        # row 0 is shared, row 1 + i belongs to vehicle i; of unit variance
        self._unit_gusts = rng.standard_normal((1 + vehicles, 3))
        self._dt_s = math.nan
        self._fresh = self._path = np.empty((0, 1 + vehicles, 3))
        self._forces_ned_n = np.empty((0, vehicles, 3))
        self._taken = 0

    def step(self, dt_s: float) -> Array:
        """Return the force (n, 3) in N, NED, ``dt_s`` seconds after the last call (exact for any interval).

        Do not write to it. Computed for many steps ahead, on the assumption of a constant interval.
        """
        if dt_s != self._dt_s or self._taken == len(self._forces_ned_n):
            self._look_ahead(dt_s)
        force_ned_n: Array = self._forces_ned_n[self._taken]
        self._taken += 1
        return force_ned_n

    def discard_drawn(self) -> None:
        """Discard what was drawn in advance: the next gusts come from the generator's present state."""
        if self._taken:
            self._unit_gusts = self._path[self._taken - 1]
        self._fresh, self._forces_ned_n, self._taken = self._fresh[:0], self._forces_ned_n[:0], 0

    def _look_ahead(self, dt_s: float) -> None:
        """Compute the forces of the next steps; reuses draws that were made for another interval."""
        if self._taken:
            self._unit_gusts = self._path[self._taken - 1]
        left = self._fresh[self._taken :]
        self._fresh = left if len(left) else self._rng.standard_normal((STEPS_AHEAD, *self._unit_gusts.shape))
        kept = math.exp(-dt_s / self._time_constant_s)
        self._path = gauss_markov_path(self._unit_gusts, kept, math.sqrt(1.0 - kept * kept), self._fresh)
        gusts = self._shared_weight * self._path[:, :1] + self._own_weight * self._path[:, 1:]
        self._forces_ned_n = self._mean_ned_n + self._gust_rms_ned_n * gusts
        self._dt_s, self._taken = dt_s, 0
