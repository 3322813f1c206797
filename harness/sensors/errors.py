"""The error process that every sensor shares: a constant, a slow and a white part."""

import math

import numpy as np

from autopilot.types import Array
from harness.sensors.config import ErrorModel


class SensorError:
    """Errors of one kind of sensor in n vehicles, sample after sample, ``interval_s`` apart.

    ``shape`` is that of a sample: (n,) or (n, 3). The drift begins in its stationary distribution and is
    discretised exactly. Two normal draws per value and sample, always, so that streams do not depend on the
    model's numbers.
    """

    def __init__(
        self, model: ErrorModel, *, shape: tuple[int, ...], interval_s: float, rng: np.random.Generator
    ) -> None:
        self._rng = rng
        self._kept = math.exp(-interval_s / model.drift_time_constant_s)
        drift_std = np.asarray(model.drift_std)
        self._drift_step_std = drift_std * math.sqrt(1.0 - self._kept * self._kept)
        self._white_std = model.white_std
        turn_on, drift = rng.standard_normal((2, *shape))
        self._turn_on = model.turn_on_std * turn_on
        self._drift: Array = drift_std * drift

    def next(self) -> Array:
        """Error of the next sample."""
        drift, white = self._rng.standard_normal((2, *self._turn_on.shape))
        self._drift = self._kept * self._drift + self._drift_step_std * drift
        error: Array = self._turn_on + self._drift + self._white_std * white
        return error
