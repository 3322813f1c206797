"""Diagnostics of the filter: innovations, test ratios, rejected measurements, covariance."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorDiagnostics:
    """Diagnostics for ESTIMATOR_STATUS, logs and tests; all values refer to the filter's delayed horizon."""

    horizon_us: int
    velocity: Aiding
    """GPS velocity, innovation (3,) NED m/s"""
    position: Aiding
    """GPS position, innovation (2,) north and east m"""
    height: Aiding
    """Barometer, innovation (1,) down m"""
    heading: Aiding
    """Magnetometer, innovation (1,) rad; also recorded while it is not used"""
    dead_reckoning: bool
    """No horizontal measurement was accepted for one second."""
    position_held: bool
    """After long dead reckoning: the last position is fused with large noise, to bound the attitude error."""
    navigation_failed: bool
    """See `EstimatorState`."""
    numerical_failure: bool
    """The filter state is no longer finite; requires `Estimator.restart`."""
    compass_disturbed: bool
    """The last magnetic field differs from the site's."""
    compass_faulty: bool
    """GPS contradicted the compass: it is not used until landing or until it has been consistent for a
    while."""
    barometer_stuck: bool
    """The same reading repeats while the vehicle climbs or descends."""
    accelerometer_bad: bool
    """GPS and barometer contradict it vertically; its process noise is increased."""
    gsf_turn_rad: float
    """Heading of the yaw emergency estimator minus the filter's, at the last fix"""
    gsf_std_rad: float
    """One standard deviation of the former; infinite before the second fix."""
    x: Array
    """(16,) nominal state, with the layout of ``kernels``"""
    covariance: Array
    """(15, 15) of the error state, with the layout of ``kernels``"""
