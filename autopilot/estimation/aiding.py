"""Innovations, test ratios and rejections of one kind of measurement."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from foundation.types import Array


@dataclass(slots=True)
class Aiding:
    """State of one kind of measurement."""

    innovation: Array
    """Of the last measurement: measured minus estimated, in the measurement's unit."""
    innovation_var: Array
    """Predicted variance of the innovation, before the measurement was fused."""
    test_ratio: float = 0.0
    """Of the last measurement: greatest |innovation| divided by its gate; rejected at 1 or more."""
    refused: int = 0
    """Number of rejected measurements since the start."""
    measured_us: int | None = None
    """Time that the last measurement refers to, accepted or not."""
    accepted_us: int | None = None
    """Time that the last accepted measurement refers to."""

    @classmethod
    def of(cls, axes: int) -> Self:
        """Return the initial state of a measurement with this number of components."""
        return cls(np.zeros(axes), np.zeros(axes))

    def record(self, test_ratio: float, measured_us: int) -> bool:
        """Record a measurement; return whether its ratio passes the gate."""
        if test_ratio >= 1.0 or math.isnan(test_ratio):
            self.refuse(test_ratio, measured_us)
            return False
        self.test_ratio = test_ratio
        self.measured_us = self.accepted_us = measured_us
        return True

    def refuse(self, test_ratio: float, measured_us: int) -> None:
        """Record a rejected measurement, independent of its ratio."""
        self.test_ratio = test_ratio
        self.measured_us = measured_us
        self.refused += 1

    def absent(self, horizon_us: int, timeout_us: int) -> bool:
        """Return whether no measurement was accepted within the time-out before the horizon."""
        return self.accepted_us is None or horizon_us - self.accepted_us > timeout_us
