"""Fixtures of the estimator's tests, which use the simulated flights of `studies.vehicle.sensor_flights`."""

import numpy as np

from autopilot.estimation.params import EstimatorParams
from autopilot.estimation.yaw_gsf import LevelFilter, start_level
from foundation.kernels.records import new_record
from foundation.types import Array
from studies.vehicle.estimation import MATCHED_PARAMS
from studies.vehicle.sensor_flights import (
    FIELD_NED_GAUSS,
    SITE,
    STEP_S,
    Errors,
    Noise,
    circle,
    errors,
    figure_eight,
    ramp,
    replay,
    rest,
    simulate,
)

__all__ = [
    "FIELD_NED_GAUSS",
    "MATCHED_PARAMS",
    "SITE",
    "STEP_S",
    "Errors",
    "EstimatorParams",
    "Noise",
    "circle",
    "errors",
    "figure_eight",
    "level_start",
    "replay",
    "rest",
    "rms",
    "simulate",
    "step",
    "straight",
]


def rms(values: Array) -> float:
    """Return the root mean square of the lengths of rows."""
    return float(np.sqrt(np.mean(np.sum(np.atleast_2d(values) ** 2, axis=-1))))


def straight(time_s: Array) -> tuple[Array, Array]:
    """Fly north at 5 m/s."""
    distance_m = 5.0 * ramp(time_s)
    return np.stack((distance_m, 0.0 * distance_m, 0.0 * distance_m), axis=-1), np.full(time_s.size, 0.7)


def step(time_s: float) -> int:
    """Return the index of the step that ends at a time."""
    return round(time_s / STEP_S) - 1


def level_start(q_ned_frd: Array, gyro_bias_rad_s: Array) -> LevelFilter:
    """Return the complementary filter of a vehicle at rest."""
    level = new_record(LevelFilter)
    start_level(level, q_ned_frd, gyro_bias_rad_s)
    return level
