"""What the filter thinks of its measurements: innovations, test ratios, refusals, covariance."""

from dataclasses import dataclass

from autopilot.types import Array


@dataclass(slots=True)
class Aiding:
    """The record of one kind of measurement."""

    innovation: Array
    """Of the last measurement: measured less estimated, in the measurement's unit."""
    test_ratio: float = 0.0
    """Of the last measurement: greatest |innovation| over its gate; at 1 or more it was refused."""
    refused: int = 0
    """How many measurements were, since the start."""
    accepted_us: int | None = None
    """The moment that the last measurement taken describes."""

    def record(self, test_ratio: float, measured_us: int) -> bool:
        """Note what became of a measurement; return whether it was taken."""
        self.test_ratio = test_ratio
        if test_ratio < 1.0:
            self.accepted_us = measured_us
            return True
        self.refused += 1
        return False

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
    """Magnetometer, innovation (1,) rad"""
    dead_reckoning: bool
    """No horizontal measurement was taken for a second."""
    position_held: bool
    """Dead reckoning went on too long: the last position is held loosely to keep the attitude."""
    x: Array
    """(16,) nominal state, laid out as in ``kernels``"""
    covariance: Array
    """(15, 15) of the error state, laid out as in ``kernels``"""
