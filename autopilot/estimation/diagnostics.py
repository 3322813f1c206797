"""What the filter thinks of its measurements: innovations, test ratios, refusals, covariance."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from foundation.types import Array


@dataclass(slots=True)
class Aiding:
    """The record of one kind of measurement."""

    innovation: Array
    """Of the last measurement: measured less estimated, in the measurement's unit."""
    innovation_var: Array
    """What the filter expected of its square, taken before the measurement was fused."""
    test_ratio: float = 0.0
    """Of the last measurement: greatest |innovation| over its gate; at 1 or more it was refused."""
    refused: int = 0
    """How many measurements were, since the start."""
    measured_us: int | None = None
    """The moment that the last measurement describes, whatever became of it."""
    accepted_us: int | None = None
    """The moment that the last measurement taken describes."""

    @classmethod
    def of(cls, axes: int) -> Self:
        """Begin the record of a measurement of so many numbers."""
        return cls(np.zeros(axes), np.zeros(axes))

    def record(self, test_ratio: float, measured_us: int) -> bool:
        """Note what became of a measurement; return whether it was taken."""
        if test_ratio >= 1.0 or math.isnan(test_ratio):
            self.refuse(test_ratio, measured_us)
            return False
        self.test_ratio = test_ratio
        self.measured_us = self.accepted_us = measured_us
        return True

    def refuse(self, test_ratio: float, measured_us: int) -> None:
        """Note a measurement that was not taken, whatever its ratio."""
        self.test_ratio = test_ratio
        self.measured_us = measured_us
        self.refused += 1

    def absent(self, horizon_us: int, timeout_us: int) -> bool:
        """Whether nothing was taken for longer than the time-out, or ever."""
        return self.accepted_us is None or horizon_us - self.accepted_us > timeout_us


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorDiagnostics:
    """For ESTIMATOR_STATUS, logs and tests; everything is of the filter's delayed horizon."""

    horizon_us: int
    velocity: Aiding
    """GPS velocity, innovation (3,) NED m/s"""
    position: Aiding
    """GPS position, innovation (2,) north and east m"""
    height: Aiding
    """Barometer, innovation (1,) down m"""
    heading: Aiding
    """Magnetometer, innovation (1,) rad; recorded also while it is not used"""
    dead_reckoning: bool
    """No horizontal measurement was taken for a second."""
    position_held: bool
    """Dead reckoning went on too long: the last position is held loosely to keep the attitude."""
    navigation_failed: bool
    """See `EstimatorState`."""
    numerical_failure: bool
    """The arithmetic broke down; only `Estimator.restart` mends it."""
    compass_disturbed: bool
    """The last magnetic field is not the site's."""
    compass_faulty: bool
    """GPS contradicted the compass: it is not used until landed or consistent for a while."""
    barometer_stuck: bool
    """It repeats one reading while the vehicle climbs or sinks."""
    accelerometer_bad: bool
    """GPS and barometer contradict it vertically; its noise is taken for large."""
    gsf_turn_rad: float
    """Heading of the yaw emergency estimator less the filter's, at the last fix"""
    gsf_std_rad: float
    """One sigma of the former; infinite before the second fix."""
    x: Array
    """(16,) nominal state, laid out as in ``kernels``"""
    covariance: Array
    """(15, 15) of the error state, laid out as in ``kernels``"""
