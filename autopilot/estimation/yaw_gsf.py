"""Heading from inertial sensors and GPS velocity only: a second estimate that detects a wrong compass.

After PX4's EKF-GSF: five small filters of horizontal velocity and heading start with headings spread over the
circle. Each rotates the accelerometer's velocity changes by its own heading, and the GPS velocity weights
them. The weights are those of a Gaussian sum; mean and variance of the sum are the result. It requires
horizontal acceleration; in steady flight and at rest the variance stays large.

PX4 has one complementary attitude filter for each of the five. They differ only by a rotation about down, so
this module has a single one, in a level frame of arbitrary azimuth, and each model estimates the azimuth of
that frame. The acceleration between two fixes is integrated to one velocity change, so the five run at the
GPS rate.

Equations of the models: a state (north, east velocity; azimuth), predicted by v += R(azimuth) dv.
"""

import math

import numpy as np
from numba import njit

from autopilot.estimation.atmosphere import GRAVITY_M_S2
from foundation.geometry.rotations import (
    conjugate,
    from_rotation_vector,
    multiply,
    normalise,
    quat_conjugate,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
    rotate,
)
from foundation.types import Array

MODELS = 5
TILT_GAIN_1_S = 0.2
"""From tilt error to rate: a time constant of 5 s, longer than a manoeuvre."""
GYRO_BIAS_GAIN_1_S = 0.04
GYRO_BIAS_LIMIT_RAD_S = 0.05
"""Limit of the complementary filter's correction to the bias at rest, per axis."""
STILL_RATE_RAD_S = math.radians(10.0)
ACCEL_LOW_PASS = 10.0
"""The cutoff of the accelerometer's low-pass is this multiple of the tilt gain."""
GRAVITY_TOLERANCE = 0.5
"""Fraction of gravity by which the force may differ before it is not used to correct the tilt."""
VELOCITY_PSD_M2_S3 = 2.0**2 * 0.01
AZIMUTH_PSD_RAD2_S = 0.1**2 * 0.01
"""PX4's 2 m/s^2 and 0.1 rad/s per 10 ms, which include the tilt error."""
LEAST_ACCELERATION_M_S2 = 0.3
"""A smaller acceleration can be a tilt error (2 degrees); using it would reduce the variance at rest."""
LONGEST_GAP_S = 2.0
"""After a longer gap between fixes the velocities are initialised again; the headings are kept."""
BIAS_SHARE = 0.002
"""Fraction of the filter's gyro bias that each fix transfers; gravity does not make the one about down
observable."""
CLIPPED_SIGMA = 5.0
LEAST_WEIGHT = 1e-5
LEAST_VARIANCE = 1e-6
VELOCITY_VAR_MAX_M2_S2 = 1e12
"""Exceeds that of any flight: a covariance beyond it is invalid."""
AZIMUTH_VAR_MAX_RAD2 = math.pi**2
"""The greatest meaningful variance of a heading; a greater one would only cost precision."""

# the complementary filter
Q = 0
"""(4,) attitude in the level frame, wxyz"""
FORCE = 4
"""(3,) low-passed specific force, FRD"""
BIAS = 7
"""(3,) initial gyro bias, FRD"""
BIAS_CHANGE = 10
"""(3,) change of the bias since then"""
DELTA_VEL = 13
"""(2,) velocity change in the level frame since the last update of the models"""
ELAPSED = 15
TILT = 16


def level_start(q_ned_frd: Array, gyro_bias_rad_s: Array) -> Array:
    """Return the complementary filter (TILT,) of a vehicle at rest with known attitude and gyro bias."""
    tilt = np.zeros(TILT)
    tilt[Q : Q + 4] = q_ned_frd
    tilt[FORCE : FORCE + 3] = quat_rotate(quat_conjugate(q_ned_frd), np.array([0.0, 0.0, -GRAVITY_M_S2]))
    tilt[BIAS : BIAS + 3] = gyro_bias_rad_s
    return tilt


@njit(cache=True, inline="always")
def carry_level(tilt: Array, gyro_frd_rad_s: Array, accel_frd_m_s2: Array, dt_s: float) -> None:
    """Advance the complementary filter (TILT,) by one inertial sample, in place (Mahony et al., 2008)."""
    share = min(1.0, ACCEL_LOW_PASS * TILT_GAIN_1_S * dt_s)
    force_squared = 0.0
    rate_squared = 0.0
    for i in range(3):
        tilt[FORCE + i] += share * (accel_frd_m_s2[i] - tilt[FORCE + i])
        force_squared += tilt[FORCE + i] * tilt[FORCE + i]
        rate_rad_s = gyro_frd_rad_s[i] - tilt[BIAS + i] - tilt[BIAS_CHANGE + i]
        rate_squared += rate_rad_s * rate_rad_s
    force_m_s2 = math.sqrt(force_squared)
    deviation = abs(force_m_s2 / GRAVITY_M_S2 - 1.0) / GRAVITY_TOLERANCE
    w, x, y, z = tilt[Q], tilt[Q + 1], tilt[Q + 2], tilt[Q + 3]
    down_x = 2.0 * (x * z - w * y)
    down_y = 2.0 * (y * z + w * x)
    down_z = 1.0 - 2.0 * (x * x + y * y)
    gain = 0.0
    if deviation < 1.0:
        agreement = 1.0 - deviation
        gain = TILT_GAIN_1_S * agreement * agreement / force_m_s2
    correction = (
        gain * (down_y * tilt[FORCE + 2] - down_z * tilt[FORCE + 1]),
        gain * (down_z * tilt[FORCE] - down_x * tilt[FORCE + 2]),
        gain * (down_x * tilt[FORCE + 1] - down_y * tilt[FORCE]),
    )
    if rate_squared < STILL_RATE_RAD_S**2:
        for i in range(3):
            change = tilt[BIAS_CHANGE + i] - GYRO_BIAS_GAIN_1_S * dt_s * correction[i]
            tilt[BIAS_CHANGE + i] = min(GYRO_BIAS_LIMIT_RAD_S, max(-GYRO_BIAS_LIMIT_RAD_S, change))
    half_s = 0.5 * dt_s
    half_turn = from_rotation_vector(
        (
            half_s * (gyro_frd_rad_s[0] - tilt[BIAS] - tilt[BIAS_CHANGE] + correction[0]),
            half_s * (gyro_frd_rad_s[1] - tilt[BIAS + 1] - tilt[BIAS_CHANGE + 1] + correction[1]),
            half_s * (gyro_frd_rad_s[2] - tilt[BIAS + 2] - tilt[BIAS_CHANGE + 2] + correction[2]),
        )
    )
    q_mid = multiply((tilt[Q], tilt[Q + 1], tilt[Q + 2], tilt[Q + 3]), half_turn)
    force_level_m_s2 = rotate(q_mid, (accel_frd_m_s2[0], accel_frd_m_s2[1], accel_frd_m_s2[2]))
    tilt[Q], tilt[Q + 1], tilt[Q + 2], tilt[Q + 3] = normalise(multiply(q_mid, half_turn))
    tilt[DELTA_VEL] += dt_s * force_level_m_s2[0]
    tilt[DELTA_VEL + 1] += dt_s * force_level_m_s2[1]
    tilt[ELAPSED] += dt_s


@njit(cache=True)
def azimuth_of(q_ned_frd: Array, tilt: Array) -> float:
    """Return the azimuth of the level frame implied by an attitude: the rotation about down between them."""
    q_frd_level = conjugate((tilt[Q], tilt[Q + 1], tilt[Q + 2], tilt[Q + 3]))
    between = multiply((q_ned_frd[0], q_ned_frd[1], q_ned_frd[2], q_ned_frd[3]), q_frd_level)
    return 2.0 * math.atan2(between[3], between[0])


@njit(cache=True)
def start_models(models: Array, covs: Array, weights: Array, vel_ne_m_s: Array, vel_var: float) -> None:
    """Initialise the models with headings spread over the circle, each with the variance of the spacing."""
    spacing_rad = 2.0 * math.pi / MODELS
    covs[:] = 0.0
    for i in range(MODELS):
        models[i, 0] = vel_ne_m_s[0]
        models[i, 1] = vel_ne_m_s[1]
        models[i, 2] = (i + 0.5) * spacing_rad - math.pi
        covs[i, 0, 0] = vel_var
        covs[i, 1, 1] = vel_var
        covs[i, 2, 2] = 0.25 * spacing_rad * spacing_rad
        weights[i] = 1.0 / MODELS


@njit(cache=True, inline="always")
def predict_model(model: Array, cov: Array, dvel_x: float, dvel_y: float, dt_s: float) -> None:
    """Predict one model (3,) and its covariance (3, 3) over the time between two fixes, in place."""
    cos, sin = math.cos(model[2]), math.sin(model[2])
    model[0] += cos * dvel_x - sin * dvel_y
    model[1] += sin * dvel_x + cos * dvel_y
    by_azimuth = (-sin * dvel_x - cos * dvel_y, cos * dvel_x - sin * dvel_y)
    for j in range(3):
        for i in range(2):
            cov[i, j] += by_azimuth[i] * cov[2, j]
    for j in range(3):
        for i in range(2):
            cov[j, i] += by_azimuth[i] * cov[j, 2]
    cov[0, 0] += VELOCITY_PSD_M2_S3 * dt_s
    cov[1, 1] += VELOCITY_PSD_M2_S3 * dt_s
    cov[2, 2] += AZIMUTH_PSD_RAD2_S * dt_s


@njit(cache=True, inline="always")
def update_model(model: Array, cov: Array, vel_ne_m_s: Array, vel_var: float) -> float:
    """Fuse a velocity (2,) into one model, in place; return the measurement's likelihood.

    An innovation of more than 5 sigma is clipped to 5 sigma, so that one outlier does not eliminate a
    hypothesis. If the innovation's covariance is numerically invalid nothing is fused, and the likelihood is
    zero.
    """
    s_nn, s_ee, s_ne = cov[0, 0] + vel_var, cov[1, 1] + vel_var, cov[0, 1]
    if not (s_nn < VELOCITY_VAR_MAX_M2_S2 and s_ee < VELOCITY_VAR_MAX_M2_S2):  # also not-a-number
        return 0.0
    determinant = s_nn * s_ee - s_ne * s_ne
    if not determinant >= 0.5 * vel_var * vel_var:  # exact arithmetic gives at least vel_var^2
        return 0.0
    north, east = vel_ne_m_s[0] - model[0], vel_ne_m_s[1] - model[1]
    squared = (s_ee * north * north - 2.0 * s_ne * north * east + s_nn * east * east) / determinant
    if squared > CLIPPED_SIGMA**2:
        shorter = CLIPPED_SIGMA / math.sqrt(squared)
        north, east, squared = shorter * north, shorter * east, CLIPPED_SIGMA**2
    gain = np.empty((3, 2))
    for i in range(3):
        gain[i, 0] = (cov[i, 0] * s_ee - cov[i, 1] * s_ne) / determinant
        gain[i, 1] = (cov[i, 1] * s_nn - cov[i, 0] * s_ne) / determinant
    before = cov.copy()
    for i in range(3):
        model[i] += gain[i, 0] * north + gain[i, 1] * east
        for j in range(3):
            cov[i, j] = before[i, j] - gain[i, 0] * before[0, j] - gain[i, 1] * before[1, j]
    for i in range(3):
        cov[i, i] = max(cov[i, i], LEAST_VARIANCE)
        for j in range(i):
            cov[i, j] = cov[j, i] = 0.5 * (cov[i, j] + cov[j, i])
    return math.exp(-0.5 * squared) / (2.0 * math.pi * math.sqrt(determinant))


@njit(cache=True)
def fuse_velocity(
    tilt: Array, models: Array, covs: Array, weights: Array, vel_ne_m_s: Array, vel_var: float
) -> tuple[float, float]:
    """Update all models with a GPS velocity (2,); return azimuth and variance of the Gaussian sum."""
    dt_s = tilt[ELAPSED]
    dvel_x, dvel_y = tilt[DELTA_VEL], tilt[DELTA_VEL + 1]
    tilt[DELTA_VEL] = tilt[DELTA_VEL + 1] = tilt[ELAPSED] = 0.0
    dvel_m_s = math.hypot(dvel_x, dvel_y)
    significant = max(0.0, 1.0 - LEAST_ACCELERATION_M_S2 * dt_s / dvel_m_s) if dvel_m_s > 0.0 else 0.0
    total = 0.0
    for i in range(MODELS):
        if dt_s > LONGEST_GAP_S:
            covs[i, :2, :] = 0.0
            covs[i, :, :2] = 0.0
            covs[i, 0, 0] = covs[i, 1, 1] = vel_var
            covs[i, 2, 2] = min(covs[i, 2, 2] + AZIMUTH_PSD_RAD2_S * dt_s, AZIMUTH_VAR_MAX_RAD2)
            models[i, 0], models[i, 1] = vel_ne_m_s[0], vel_ne_m_s[1]
        else:
            predict_model(models[i], covs[i], significant * dvel_x, significant * dvel_y, dt_s)
            weights[i] *= update_model(models[i], covs[i], vel_ne_m_s, vel_var)
        total += weights[i]
    if total > 0.0:
        for i in range(MODELS):
            weights[i] /= total
    total = 0.0
    for i in range(MODELS):
        weights[i] = max(weights[i], LEAST_WEIGHT)
        total += weights[i]
    north, east = 0.0, 0.0
    for i in range(MODELS):
        weights[i] /= total
        north += weights[i] * math.cos(models[i, 2])
        east += weights[i] * math.sin(models[i, 2])
    azimuth_rad = math.atan2(east, north)
    variance = 0.0
    for i in range(MODELS):
        apart_rad = models[i, 2] - azimuth_rad
        apart_rad -= 2.0 * math.pi * round(apart_rad / (2.0 * math.pi))
        variance += weights[i] * (covs[i, 2, 2] + apart_rad * apart_rad)
    return azimuth_rad, variance


class YawBank:
    """The five models over a complementary filter (TILT,) that `horizon.advance` updates."""

    def __init__(self, tilt: Array) -> None:
        self.std_rad = math.inf
        """Standard deviation of the heading."""
        self.weights = np.zeros(MODELS)
        self._tilt = tilt
        self._models = np.zeros((MODELS, 3))
        self._covs = np.zeros((MODELS, 3, 3))
        self._azimuth_rad = 0.0
        self._started = False

    def fuse(self, vel_ne_m_s: Array, vel_std_m_s: float) -> None:
        """Update with a GPS velocity (2,) north and east, at the time of the complementary filter."""
        vel_var = vel_std_m_s**2
        if not self._started:
            start_models(self._models, self._covs, self.weights, vel_ne_m_s, vel_var)
            self._tilt[DELTA_VEL:TILT] = 0.0
            self._started = True
            return
        self._azimuth_rad, variance = fuse_velocity(
            self._tilt, self._models, self._covs, self.weights, vel_ne_m_s, vel_var
        )
        self.std_rad = math.sqrt(variance)

    def learn_gyro_bias(self, gyro_bias_rad_s: Array) -> None:
        """Track the filter's gyro bias (3,), slowly enough that a wrong one has no effect within seconds."""
        bias = self._tilt[BIAS : BIAS + 3]
        bias += BIAS_SHARE * (gyro_bias_rad_s - bias - self._tilt[BIAS_CHANGE : BIAS_CHANGE + 3])

    @property
    def gyro_bias_rad_s(self) -> Array:
        """Gyro bias (3,) of the complementary filter, FRD."""
        bias: Array = self._tilt[BIAS : BIAS + 3] + self._tilt[BIAS_CHANGE : BIAS_CHANGE + 3]
        return bias

    def turn_rad(self, q_ned_frd: Array) -> float:
        """Return the rotation about down, in [-pi, pi], from an attitude's heading to the bank's."""
        return math.remainder(self._azimuth_rad - azimuth_of(q_ned_frd, self._tilt), 2.0 * math.pi)

    def q_ned_frd(self) -> Array:
        """Return the attitude (4,): tilt of the complementary filter with the heading of the bank."""
        turn = quat_from_rotation_vector(np.array([0.0, 0.0, self._azimuth_rad]))
        return quat_multiply(turn, self._tilt[Q : Q + 4])
