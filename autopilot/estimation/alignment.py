"""Initial alignment: attitude, biases, height reference and covariance from one second at rest.

Tilt and horizontal accelerometer bias are not separately observable at rest. The covariance represents this
as a correlation, so that the first turn or manoeuvre in flight resolves both.
"""

import math
from dataclasses import dataclass

import numpy as np

from autopilot.estimation import kernels
from autopilot.estimation.atmosphere import GRAVITY_M_S2
from autopilot.estimation.health import field_disturbed
from autopilot.estimation.params import EstimatorParams
from foundation.geometry.rotations import quat_from_euler, quat_to_dcm
from foundation.types import Array, ImuSample

WINDOW_US = 1_000_000
MIN_SAMPLES = 10
"""Of each sensor in a window."""
MAX_ACCEL_STD_M_S2 = 0.5
MAX_GYRO_STD_RAD_S = 0.1
"""A greater spread, on any axis, counts as motion; the Iris has noises of 0.1 m/s^2 and 0.014 rad/s."""
MAX_GRAVITY_ERROR_M_S2 = 0.6
INIT_VEL_STD_M_S = 0.1
INIT_POS_STD_M = 0.1
FLAT_HEADING_VAR_RAD2 = 10.0
"""Uninformative prior of the heading, before the magnetometer's heading is fused."""


@dataclass(frozen=True, slots=True)
class Aligned:
    """Initial state of the filter, at the end of the window."""

    x: Array
    """(16,) nominal state"""
    cov: Array
    """(15, 15)"""
    baro_altitude_m: float
    """Pressure altitude of the ground."""


class Alignment:
    """Collects windows of one second until one is at rest and contains every sensor."""

    def __init__(self, params: EstimatorParams) -> None:
        self._params = params
        self._start_us: int | None = None
        self._accels_m_s2: list[Array] = []
        self._gyros_rad_s: list[Array] = []
        self._fields_gauss: list[Array] = []
        self._altitudes_m: list[float] = []

    def _clear(self) -> None:
        self._start_us = None
        for samples in (self._accels_m_s2, self._gyros_rad_s, self._fields_gauss, self._altitudes_m):
            samples.clear()

    def set_params(self, params: EstimatorParams) -> None:
        """Change the settings, also for the present window."""
        self._params = params

    def add_mag(self, field_frd_gauss: Array) -> None:
        """Add a magnetometer sample, (3,)."""
        self._fields_gauss.append(field_frd_gauss.copy())

    def add_baro(self, altitude_m: float) -> None:
        """Add a pressure altitude."""
        self._altitudes_m.append(altitude_m)

    def add_imu(self, sample: ImuSample) -> Aligned | None:
        """Add an inertial sample; return the result once the alignment is complete."""
        if self._start_us is None:
            self._start_us = sample.time_us
        self._accels_m_s2.append(np.array(sample.accel_frd_m_s2))
        self._gyros_rad_s.append(np.array(sample.gyro_frd_rad_s))
        window_us = sample.time_us - self._start_us
        if window_us < WINDOW_US:
            return None
        aligned = self._align(window_us * 1e-6)
        if aligned is None:
            self._clear()
        return aligned

    def _align(self, window_s: float) -> Aligned | None:
        counts = (len(self._accels_m_s2), len(self._fields_gauss), len(self._altitudes_m))
        if min(counts) < MIN_SAMPLES:
            return None
        accel_m_s2 = np.mean(self._accels_m_s2, axis=0)
        gyro_rad_s = np.mean(self._gyros_rad_s, axis=0)
        force_m_s2 = float(np.linalg.norm(accel_m_s2))
        at_rest = (
            np.std(self._accels_m_s2, axis=0).max() < MAX_ACCEL_STD_M_S2
            and np.std(self._gyros_rad_s, axis=0).max() < MAX_GYRO_STD_RAD_S
            and abs(force_m_s2 - GRAVITY_M_S2) < MAX_GRAVITY_ERROR_M_S2
            and np.abs(gyro_rad_s).max() < self._params.gyro_bias_limit_rad_s
        )
        if not at_rest:
            return None
        field_frd = np.mean(self._fields_gauss, axis=0)
        x, cov = align_at_rest(self._params, accel_m_s2, gyro_rad_s, field_frd, window_s)
        if field_disturbed(self._params, x[:4], field_frd):
            return None
        return Aligned(x, cov, float(np.mean(self._altitudes_m)))


def align_at_rest(
    params: EstimatorParams,
    accel_frd_m_s2: Array,
    gyro_frd_rad_s: Array,
    field_frd_gauss: Array,
    window_s: float,
) -> tuple[Array, Array]:
    """Return state (16,) and covariance (15, 15) at rest, from the sensors' means over ``window_s``.

    Along gravity the accelerometer bias is observable, across it only the sum of bias and tilt.
    """
    x = np.zeros(kernels.STATES)
    force_m_s2 = float(np.linalg.norm(accel_frd_m_s2))
    roll_rad = math.atan2(-accel_frd_m_s2[1], -accel_frd_m_s2[2])
    pitch_rad = math.atan2(accel_frd_m_s2[0], math.hypot(accel_frd_m_s2[1], accel_frd_m_s2[2]))
    field_ned = np.array(params.magnetic_field_ned_gauss)
    x[:4] = quat_from_euler(roll_rad, pitch_rad, 0.0)
    x[:4] = quat_from_euler(roll_rad, pitch_rad, kernels.heading_innovation(x, field_frd_gauss, field_ned))
    dcm_ned_frd = quat_to_dcm(x[:4])
    limit_m_s2 = params.accel_bias_limit_m_s2
    bias_down_m_s2 = min(limit_m_s2, max(-limit_m_s2, GRAVITY_M_S2 - force_m_s2))
    x[kernels.GYRO_BIAS : kernels.ACCEL_BIAS] = gyro_frd_rad_s
    x[kernels.ACCEL_BIAS :] = bias_down_m_s2 * dcm_ned_frd[2]

    # errors of attitude and accelerometer bias (NED) due to the true horizontal bias and the noise of the
    # mean
    sources = np.zeros((6, 5))
    sources[0, [1, 3]] = 1.0 / GRAVITY_M_S2
    sources[1, [0, 2]] = -1.0 / GRAVITY_M_S2
    sources[3, 0] = sources[4, 1] = 1.0
    sources[5, 4] = -1.0
    sources[3:] = dcm_ned_frd.T @ sources[3:]
    gyro_psd, accel_psd, _, _ = params.process_noise_psd
    accel_mean_var = accel_psd / window_s
    source_var = np.array([params.accel_bias_init_m_s2**2] * 2 + [accel_mean_var] * 3)
    attitude_and_bias = np.array([0, 1, 2, 12, 13, 14])
    cov = np.zeros((kernels.ERRORS, kernels.ERRORS))
    cov[np.ix_(attitude_and_bias, attitude_and_bias)] = (sources * source_var) @ sources.T
    cov[2, 2] = FLAT_HEADING_VAR_RAD2
    np.fill_diagonal(cov[3:6, 3:6], INIT_VEL_STD_M_S**2)
    np.fill_diagonal(cov[6:9, 6:9], INIT_POS_STD_M**2)
    np.fill_diagonal(cov[9:12, 9:12], gyro_psd / window_s)
    # the heading is from the mean field, so its innovation is zero; the update correlates it with tilt
    variance_rad2 = params.heading_noise_rad**2
    kernels.fuse_heading(x, cov, 0.0, field_ned, variance_rad2, 1.0, np.full(2, np.inf), take=True)
    return x, cov
