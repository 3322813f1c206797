"""The filter at its delayed horizon, and the prediction from there to the newest inertial sample.

A GPS fix is delayed by ``gps_delay_us``. As in PX4's EKF2, the filter runs with this delay and inertial
samples wait in a ring buffer, so every measurement is fused at the time that it refers to. EKF2 predicts to
the present with a second, complementary filter; here the waiting samples are integrated again from the
corrected state after each fusion (30 samples, a few microseconds). This is the exact prediction: it has no
time constant to tune and no special case for resets.
"""

import math
from typing import Annotated

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.estimation.kernels import (
    ERRORS,
    GYRO_BIAS,
    STATES,
    ProcessNoise,
    error_transition,
    integrate,
    is_plausible,
    predict_covariance,
)
from autopilot.estimation.yaw_gsf import LevelFilter, carry_level, start_level
from foundation.kernels.records import Records, new_records
from foundation.types import Array

SHORTEST_SAMPLE_US = 1_000
"""The ring buffer holds samples of the delay at this spacing; faster samples only shorten the delay."""

# The estimate: all outputs of a step in one array. It begins with the present nominal state.
ACC = STATES
"""Acceleration over ground, (3,) NED"""
OMEGA = ACC + 3
"""Body rates minus gyro bias, (3,) FRD"""
STD = OMEGA + 3
STDS = 9
"""Standard deviations at the horizon: attitude, velocity, position, (3,) each"""
ESTIMATE = STD + STDS

NOT_FINITE = -1
"""Returned for a sample that is not finite or not plausible."""


class Horizon:
    """Record: state of the filter except the waiting samples.

    Kernels pass its vectors on as whole slices (``here.x[:]``), which have the type of the arrays that Python
    passes: each kernel is compiled once.
    """

    x: Annotated[Array, STATES]
    cov: Annotated[Array, (ERRORS, ERRORS)]
    estimate: Annotated[Array, ESTIMATE]
    level: LevelFilter
    noise: ProcessNoise
    oldest: int
    """Index of the first waiting sample in the ring buffer."""
    waiting: int
    """Number of waiting samples."""
    horizon_us: int
    delay_us: int


class Sample:
    """Record: a waiting sample."""

    gyro_frd_rad_s: Annotated[Array, 3]
    accel_frd_m_s2: Annotated[Array, 3]
    dt_s: float
    """Length of its interval."""
    time_us: int
    """End of its interval."""


@njit(cache=True)
def describe(cov: Array, gyro_frd_rad_s: Array, estimate: Array) -> None:
    """Write body rates and standard deviations into the estimate."""
    for i in range(3):
        estimate[OMEGA + i] = gyro_frd_rad_s[i] - estimate[GYRO_BIAS + i]
    for i in range(STDS):
        estimate[STD + i] = math.sqrt(max(cov[i, i], 0.0))


@njit(cache=True)
def advance(
    block: Records, samples: Records, time_us: int, dt_s: float, gyro_frd_rad_s: Array, accel_frd_m_s2: Array
) -> int:
    """Append a sample to the ring buffer and advance the filter to the newest sample outside the delay.

    The sample's interval of length ``dt_s`` > 0 begins at the time of the last sample and ends at
    ``time_us``. ``block`` (1,) of `Horizon`; its estimate is advanced by the new sample; ``samples``
    (capacity,) of `Sample`. Returns the horizon's time, or NOT_FINITE for a rejected sample, which changes
    nothing.
    """
    if not is_plausible(gyro_frd_rad_s, accel_frd_m_s2):
        return NOT_FINITE
    here: Horizon = block[0]
    x, cov, estimate = here.x[:], here.cov[:], here.estimate[:]
    capacity = samples.size
    newest: Sample = samples[(here.oldest + here.waiting) % capacity]
    for i in range(3):
        newest.gyro_frd_rad_s[i] = gyro_frd_rad_s[i]
        newest.accel_frd_m_s2[i] = accel_frd_m_s2[i]
    newest.dt_s = dt_s
    newest.time_us = time_us
    here.waiting += 1
    limit_us = time_us - here.delay_us
    while here.waiting > 0 and (samples[here.oldest].time_us <= limit_us or here.waiting == capacity):
        sample: Sample = samples[here.oldest]
        gyro, accel, over_s = sample.gyro_frd_rad_s[:], sample.accel_frd_m_s2[:], sample.dt_s
        from_bias, vel_from_attitude = error_transition(x, accel, over_s)
        integrate(x, gyro, accel, over_s)
        predict_covariance(cov, from_bias, vel_from_attitude, here.noise, over_s)
        carry_level(here.level, gyro, accel, over_s)
        here.horizon_us = sample.time_us
        here.oldest = (here.oldest + 1) % capacity
        here.waiting -= 1
    acc = integrate(estimate[:STATES], gyro_frd_rad_s, accel_frd_m_s2, dt_s)
    estimate[ACC], estimate[ACC + 1], estimate[ACC + 2] = acc
    describe(cov, gyro_frd_rad_s, estimate)
    return int(here.horizon_us)


@njit(cache=True)
def predict_now(block: Records, samples: Records) -> None:
    """Set the estimate to the filter's state advanced by all waiting samples; arguments as in `advance`."""
    here: Horizon = block[0]
    estimate, oldest, count = here.estimate[:], here.oldest, here.waiting
    for i in range(STATES):
        estimate[i] = here.x[i]
    capacity = samples.size
    for waiting in range(count):
        sample: Sample = samples[(oldest + waiting) % capacity]
        gyro, accel = sample.gyro_frd_rad_s[:], sample.accel_frd_m_s2[:]
        acc = integrate(estimate[:STATES], gyro, accel, sample.dt_s)
        estimate[ACC], estimate[ACC + 1], estimate[ACC + 2] = acc
    newest: Sample = samples[(oldest + count - 1) % capacity]
    describe(here.cov[:], newest.gyro_frd_rad_s[:], estimate)


class DelayedHorizon:
    """State and covariance at the horizon, the waiting samples, and the present estimate."""

    def __init__(self, x: Array, cov: Array, *, time_us: int, delay_us: int) -> None:
        """Start at ``time_us``, the time of the last sample before those to be added."""
        self.block = new_records(Horizon)
        """Of `Horizon`; the following attributes except the samples are views of it"""
        self.samples = new_records(Sample, delay_us // SHORTEST_SAMPLE_US + 2)
        """Ring buffer of `Sample`"""
        here: Horizon = self.block[0]
        self.x = here.x
        """(16,) nominal state at the horizon"""
        self.cov = here.cov
        """(15, 15) its covariance"""
        self.estimate = here.estimate
        self.now: Array = self.estimate[:STATES]
        """(16,) nominal state at the newest sample"""
        self.acc_ned_m_s2: Array = self.estimate[ACC:OMEGA]
        self.noise = here.noise
        """Process noise; may be written at any time"""
        self.level = here.level
        """Complementary filter of ``yaw_gsf`` at the horizon"""
        self._horizon_us: NDArray[np.int64] = self.block["horizon_us"]
        self.x[:] = x
        self.cov[:] = cov
        self.now[:] = x
        start_level(self.level, x[:4], x[GYRO_BIAS : GYRO_BIAS + 3])
        self.block["horizon_us"], self.block["delay_us"] = time_us, delay_us
        describe(self.cov, np.zeros(3), self.estimate)

    @property
    def horizon_us(self) -> int:
        """Time that ``x`` and ``cov`` refer to."""
        return self._horizon_us.item()

    def corrected(self) -> None:
        """Propagate a change of ``x`` and ``cov`` to the present estimate."""
        predict_now(self.block, self.samples)

    def reset(self, first: int, values: Array, variances: Array) -> None:
        """Set ``x[first : first + n]`` (velocity or position) and remove its correlations."""
        self.x[first : first + values.size] = values
        self.reset_covariance(first - 1, variances)

    def reset_covariance(self, first: int, variances: Array) -> None:
        """Set the variances (n,) of the errors starting at ``first`` and remove their correlations."""
        errors = slice(first, first + variances.size)
        self.cov[errors, :] = 0.0
        self.cov[:, errors] = 0.0
        self.cov[errors, errors] = np.diag(variances)
