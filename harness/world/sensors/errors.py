"""Error process of a sensor: the sum of a constant, a slow and a white part."""

import math

import numpy as np

from foundation.types import Array
from harness.world.gauss_markov import STEPS_AHEAD, gauss_markov_path
from harness.world.sensors.config import SensorErrorModel


class SensorError:
    """Errors of one kind of sensor in n vehicles, for samples ``interval_s`` apart.

    ``shape`` is that of a sample: (n,) or (n, 3). The drift starts in its stationary distribution and is
    discretised exactly. Every value of a sample uses two normal draws, so that random streams do not depend
    on the model's parameters; draws are made for many samples at once.
    """

    def __init__(
        self, model: SensorErrorModel, *, shape: tuple[int, ...], interval_s: float, rng: np.random.Generator
    ) -> None:
        self._rng = rng
        self._kept = math.exp(-interval_s / model.drift_time_constant_s)
        drift_std = np.asarray(model.drift_std)
        self._drift_step_std = np.broadcast_to(
            drift_std * math.sqrt(1.0 - self._kept * self._kept), shape
        ).copy()
        self._white_std = model.white_std
        turn_on, drift = rng.standard_normal((2, *shape))
        self._turn_on = model.turn_on_std * turn_on
        self._drift: Array = drift_std * drift
        self._before = self._drift
        """Drift before the samples that are drawn."""
        self._drifts = self._errors = np.empty((0, *shape))
        self._taken = 0

    def next(self) -> Array:
        """Return the error of the next sample; do not write to it."""
        self.draw_ahead()
        error: Array = self._errors[self._taken]
        self._taken += 1
        return error

    def draw_ahead(self) -> None:
        """Prepare the next sample's error, so that `next` is fast. Changes no sample."""
        if self._taken < len(self._errors):
            return
        draws = self._rng.standard_normal((STEPS_AHEAD, 2, *self._turn_on.shape))
        # contiguous: the kernel is compiled for one memory layout only
        drift, white = np.ascontiguousarray(draws[:, 0]), draws[:, 1]
        drifts = gauss_markov_path(self._drift, self._kept, self._drift_step_std, drift)
        self._before, self._drift, self._drifts = self._drift, drifts[-1].copy(), drifts
        self._errors = self._turn_on + drifts + self._white_std * white
        self._taken = 0

    def discard_drawn(self) -> None:
        """Discard what was drawn in advance: the next errors come from the generator's present state.

        The drift continues from the last sample; the constant part stays.
        """
        self._drift = self._drifts[self._taken - 1].copy() if self._taken else self._before
        self._drifts = self._errors = self._errors[:0]
        self._before, self._taken = self._drift, 0
