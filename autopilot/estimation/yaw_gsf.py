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
from typing import Annotated

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


class LevelFilter:
    """Record: the complementary filter."""

    q_level_frd: Annotated[Array, 4]
    """Attitude in the level frame, wxyz."""
    force_frd_m_s2: Annotated[Array, 3]
    """Low-passed specific force."""
    bias_frd_rad_s: Annotated[Array, 3]
    """Initial gyro bias."""
    bias_change_frd_rad_s: Annotated[Array, 3]
    """Change of the bias since then."""
    vel_change_m_s: Annotated[Array, 2]
    """Velocity change in the level frame since the last update of the models."""
    elapsed_s: float
    """Time since then."""


def start_level(level: LevelFilter, q_ned_frd: Array, gyro_bias_rad_s: Array) -> None:
    """Initialise a filter of zeros for a vehicle at rest with known attitude (4,) and gyro bias (3,)."""
    level.q_level_frd[:] = q_ned_frd
    level.force_frd_m_s2[:] = quat_rotate(quat_conjugate(q_ned_frd), np.array([0.0, 0.0, -GRAVITY_M_S2]))
    level.bias_frd_rad_s[:] = gyro_bias_rad_s


@njit(cache=True, inline="always")
def carry_level(level: LevelFilter, gyro_frd_rad_s: Array, accel_frd_m_s2: Array, dt_s: float) -> None:
    """Advance the complementary filter by one inertial sample (Mahony et al., 2008)."""
    q, force = level.q_level_frd, level.force_frd_m_s2
    bias, change = level.bias_frd_rad_s, level.bias_change_frd_rad_s
    share = min(1.0, ACCEL_LOW_PASS * TILT_GAIN_1_S * dt_s)
    force_squared = 0.0
    rate_squared = 0.0
    for i in range(3):
        force[i] += share * (accel_frd_m_s2[i] - force[i])
        force_squared += force[i] * force[i]
        rate_rad_s = gyro_frd_rad_s[i] - bias[i] - change[i]
        rate_squared += rate_rad_s * rate_rad_s
    force_m_s2 = math.sqrt(force_squared)
    deviation = abs(force_m_s2 / GRAVITY_M_S2 - 1.0) / GRAVITY_TOLERANCE
    w, x, y, z = q[0], q[1], q[2], q[3]
    down_x = 2.0 * (x * z - w * y)
    down_y = 2.0 * (y * z + w * x)
    down_z = 1.0 - 2.0 * (x * x + y * y)
    gain = 0.0
    if deviation < 1.0:
        agreement = 1.0 - deviation
        gain = TILT_GAIN_1_S * agreement * agreement / force_m_s2
    correction = (
        gain * (down_y * force[2] - down_z * force[1]),
        gain * (down_z * force[0] - down_x * force[2]),
        gain * (down_x * force[1] - down_y * force[0]),
    )
    if rate_squared < STILL_RATE_RAD_S**2:
        for i in range(3):
            changed = change[i] - GYRO_BIAS_GAIN_1_S * dt_s * correction[i]
            change[i] = min(GYRO_BIAS_LIMIT_RAD_S, max(-GYRO_BIAS_LIMIT_RAD_S, changed))
    half_s = 0.5 * dt_s
    half_turn = from_rotation_vector(
        (
            half_s * (gyro_frd_rad_s[0] - bias[0] - change[0] + correction[0]),
            half_s * (gyro_frd_rad_s[1] - bias[1] - change[1] + correction[1]),
            half_s * (gyro_frd_rad_s[2] - bias[2] - change[2] + correction[2]),
        )
    )
    q_mid = multiply((q[0], q[1], q[2], q[3]), half_turn)
    force_level_m_s2 = rotate(q_mid, (accel_frd_m_s2[0], accel_frd_m_s2[1], accel_frd_m_s2[2]))
    q[0], q[1], q[2], q[3] = normalise(multiply(q_mid, half_turn))
    level.vel_change_m_s[0] += dt_s * force_level_m_s2[0]
    level.vel_change_m_s[1] += dt_s * force_level_m_s2[1]
    level.elapsed_s += dt_s


@njit(cache=True)
def azimuth_of(q_ned_frd: Array, q_level_frd: Array) -> float:
    """Return the azimuth of the level frame implied by an attitude: the rotation about down between them."""
    q_frd_level = conjugate((q_level_frd[0], q_level_frd[1], q_level_frd[2], q_level_frd[3]))
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
    level: LevelFilter, models: Array, covs: Array, weights: Array, vel_ne_m_s: Array, vel_var: float
) -> tuple[float, float]:
    """Update all models with a GPS velocity (2,); return azimuth and variance of the Gaussian sum."""
    dt_s = level.elapsed_s
    dvel_x, dvel_y = level.vel_change_m_s[0], level.vel_change_m_s[1]
    level.vel_change_m_s[0] = level.vel_change_m_s[1] = level.elapsed_s = 0.0
    dvel_m_s = math.hypot(dvel_x, dvel_y)
    significant = max(0.0, 1.0 - LEAST_ACCELERATION_M_S2 * dt_s / dvel_m_s) if dvel_m_s > 0.0 else 0.0
    total = 0.0
    for i in range(MODELS):
        if dt_s > LONGEST_GAP_S:
            for row in range(2):
                for column in range(3):
                    covs[i, row, column] = covs[i, column, row] = 0.0
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
    """The five models over a complementary filter that `horizon.advance` updates."""

    def __init__(self, level: LevelFilter) -> None:
        self.std_rad = math.inf
        """Standard deviation of the heading."""
        self.weights = np.zeros(MODELS)
        self._level = level
        self._models = np.zeros((MODELS, 3))
        self._covs = np.zeros((MODELS, 3, 3))
        self._azimuth_rad = 0.0
        self._started = False

    def fuse(self, vel_ne_m_s: Array, vel_std_m_s: float) -> None:
        """Update with a GPS velocity (2,) north and east, at the time of the complementary filter."""
        vel_var = vel_std_m_s**2
        if not self._started:
            start_models(self._models, self._covs, self.weights, vel_ne_m_s, vel_var)
            self._level.vel_change_m_s[:] = 0.0
            self._level.elapsed_s = 0.0
            self._started = True
            return
        self._azimuth_rad, variance = fuse_velocity(
            self._level, self._models, self._covs, self.weights, vel_ne_m_s, vel_var
        )
        self.std_rad = math.sqrt(variance)

    def learn_gyro_bias(self, gyro_bias_rad_s: Array) -> None:
        """Track the filter's gyro bias (3,), slowly enough that a wrong one has no effect within seconds."""
        bias = self._level.bias_frd_rad_s
        bias += BIAS_SHARE * (gyro_bias_rad_s - bias - self._level.bias_change_frd_rad_s)

    @property
    def gyro_bias_rad_s(self) -> Array:
        """Gyro bias (3,) of the complementary filter, FRD."""
        bias: Array = self._level.bias_frd_rad_s + self._level.bias_change_frd_rad_s
        return bias

    def turn_rad(self, q_ned_frd: Array) -> float:
        """Return the rotation about down, in [-pi, pi], from an attitude's heading to the bank's."""
        return math.remainder(
            self._azimuth_rad - azimuth_of(q_ned_frd, self._level.q_level_frd), 2.0 * math.pi
        )

    def q_ned_frd(self) -> Array:
        """Return the attitude (4,): tilt of the complementary filter with the heading of the bank."""
        turn = quat_from_rotation_vector(np.array([0.0, 0.0, self._azimuth_rad]))
        return quat_multiply(turn, self._level.q_level_frd)
