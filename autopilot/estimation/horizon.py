"""The filter at its delayed horizon, and the prediction from there to the newest inertial sample.

A GPS fix describes the past by ``gps_delay_us``. As in PX4's EKF2, the filter runs that much behind and
inertial samples wait in a ring, so every measurement is fused at the moment that it describes, whatever was
flown since. EKF2 carries a second, complementary filter to the present; here the waiting samples are
integrated anew from the corrected state whenever a measurement was fused (30 samples, a few microseconds).
That is the exact prediction, has no time constant to tune, and needs no special case for resets.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.estimation.kernels import error_transition, integrate, predict_covariance
from autopilot.types import Array

SHORTEST_SAMPLE_US = 1_000
"""The ring holds the delay's worth of samples this close; faster ones shorten the horizon, nothing else."""


@njit(cache=True)
def advance(
    x: Array,
    cov: Array,
    now: Array,
    samples: Array,
    times_us: NDArray[np.int64],
    cursor: NDArray[np.int64],
    time_us: int,
    horizon_limit_us: int,
    gyro_frd_rad_s: Array,
    accel_frd_m_s2: Array,
    dt_s: float,
    noise_psd: Array,
    acc_ned_m_s2: Array,
) -> None:
    """Put a sample into the ring and move ``x`` and ``cov`` on to the newest not after the limit.

    ``samples`` rows are gyro, accelerometer and interval; ``cursor`` is (oldest, waiting, horizon_us). The
    state ``now`` moves by the new sample, whose acceleration goes to ``acc_ned_m_s2``.
    """
    capacity = times_us.size
    slot = (cursor[0] + cursor[1]) % capacity
    samples[slot, 0:3] = gyro_frd_rad_s
    samples[slot, 3:6] = accel_frd_m_s2
    samples[slot, 6] = dt_s
    times_us[slot] = time_us
    cursor[1] += 1
    while cursor[1] > 0 and (times_us[cursor[0]] <= horizon_limit_us or cursor[1] == capacity):
        sample = samples[cursor[0]]
        from_bias, vel_from_attitude = error_transition(x, sample[3:6], sample[6])
        integrate(x, sample[0:3], sample[3:6], sample[6])
        predict_covariance(cov, from_bias, vel_from_attitude, noise_psd, sample[6])
        cursor[2] = times_us[cursor[0]]
        cursor[0] = (cursor[0] + 1) % capacity
        cursor[1] -= 1
    acc_ned_m_s2[:] = integrate(now, gyro_frd_rad_s, accel_frd_m_s2, dt_s)


@njit(cache=True)
def predict_now(x: Array, now: Array, samples: Array, cursor: NDArray[np.int64], acc_ned_m_s2: Array) -> None:
    """Set ``now`` to ``x`` moved by all waiting samples; the last one's acceleration is written too."""
    now[:] = x
    for waiting in range(cursor[1]):
        sample = samples[(cursor[0] + waiting) % samples.shape[0]]
        acc_ned_m_s2[:] = integrate(now, sample[0:3], sample[3:6], sample[6])


class DelayedHorizon:
    """State and covariance at the horizon, the samples that wait, and the state now."""

    def __init__(self, x: Array, cov: Array, *, time_us: int, delay_us: int, noise_psd: Array) -> None:
        self.x = x
        """(16,) nominal state at the horizon"""
        self.cov = cov
        """(15, 15) its covariance"""
        self.now = x.copy()
        """(16,) nominal state at ``time_us``"""
        self.acc_ned_m_s2 = np.zeros(3)
        self.time_us = time_us
        self._delay_us = delay_us
        self._noise_psd = noise_psd
        capacity = delay_us // SHORTEST_SAMPLE_US + 2
        self._samples = np.zeros((capacity, 7))
        self._times_us = np.zeros(capacity, dtype=np.int64)
        self._cursor = np.array([0, 0, time_us], dtype=np.int64)

    @property
    def horizon_us(self) -> int:
        """Simulated time that ``x`` and ``cov`` describe."""
        return int(self._cursor[2])

    def add(self, time_us: int, gyro_frd_rad_s: Array, accel_frd_m_s2: Array) -> None:
        """Take the sample of the interval that ends at ``time_us``, which must be after the last one's."""
        dt_s = (time_us - self.time_us) * 1e-6
        self.time_us = time_us
        advance(
            self.x,
            self.cov,
            self.now,
            self._samples,
            self._times_us,
            self._cursor,
            time_us,
            time_us - self._delay_us,
            gyro_frd_rad_s,
            accel_frd_m_s2,
            dt_s,
            self._noise_psd,
            self.acc_ned_m_s2,
        )

    def corrected(self) -> None:
        """Carry a change of ``x`` to ``now``."""
        predict_now(self.x, self.now, self._samples, self._cursor, self.acc_ned_m_s2)

    def reset(self, first: int, values: Array, variances: Array) -> None:
        """Set ``x[first : first + n]`` (velocity or position) and drop its correlations with the rest."""
        self.x[first : first + values.size] = values
        self.reset_covariance(first - 1, variances)

    def reset_covariance(self, first: int, variances: Array) -> None:
        """Give the errors from ``first`` on these variances (n,) and no correlations."""
        errors = slice(first, first + variances.size)
        self.cov[errors, :] = 0.0
        self.cov[:, errors] = 0.0
        self.cov[errors, errors] = np.diag(variances)
