"""The filter's arithmetic in compiled code: strapdown integration, covariance prediction, updates.

Nominal state ``x`` (16,): q_ned_frd wxyz, velocity NED, position NED, gyro bias FRD, accelerometer bias FRD.
Error state (15,): rotation vector in NED, then the differences of velocity, position and the two biases,
always true minus estimated, with q_true = exp(rotation) * q_estimated. With the attitude error in NED, the
covariance's attitude block is the uncertainty of tilt and heading, and no attitude is singular.
Equations: J. Sola, arXiv 1711.02508, section 7 (global angular errors).

Magnetic field and wind are not states. Without airspeed or a drag model the wind is not observable on a
multicopter, and states of the field would be separable from heading only in long flights with many turns. The
site's field is a setting; a compass error is visible in the heading's innovations and in ``yaw_gsf``.

Arrays are written in place where a docstring states it. Without numba's compiler (NUMBA_DISABLE_JIT=1) the
same code runs as plain Python.
"""

import math

import numpy as np
from numba import njit

from autopilot.estimation.atmosphere import GRAVITY_M_S2
from foundation.geometry.rotations import (
    Vector,
    from_rotation_vector,
    multiply,
    normalise,
    quat_to_dcm,
    rotate,
)
from foundation.types import Array

STATES = 16
ERRORS = 15
# slices of the nominal state; an additive error has the index of its state less one
VEL = 4
POS = 7
GYRO_BIAS = 10
ACCEL_BIAS = 13
GYRO_MAX_RAD_S = 100.0
"""Greater readings are faults: 1.4 times the range of the widest gyro (TDK ICM-45686, 4000 deg/s)."""
ACCEL_MAX_M_S2 = 1000.0
"""Likewise, 2.5 times that of the widest accelerometer (Analog Devices ADIS16497, 40 g). Simulated sensors
have no range, and a touch-down at 3 m/s, the maximum of MPC_LAND_SPEED, that ends within a step of 4 ms is
750 m/s^2."""


class ProcessNoise:
    """Record: power spectral densities per axis, and those of the biases' random walks."""

    gyro_psd: float
    """rad^2/s"""
    accel_psd: float
    """m^2/s^3"""
    gyro_bias_psd: float
    """rad^2/s^3"""
    accel_bias_psd: float
    """m^2/s^5"""


@njit(cache=True)
def all_finite(values: Array) -> bool:
    """Return whether all elements of an (n,) array are finite."""
    for value in values:  # noqa: SIM110 - the loop is fastest in compiled code
        if not math.isfinite(value):
            return False
    return True


@njit(cache=True)
def is_plausible(gyro_frd_rad_s: Array, accel_frd_m_s2: Array) -> bool:
    """Return whether an inertial sample, (3,) each, is within the range of sensors; not-a-number is not."""
    for i in range(3):
        if not (abs(gyro_frd_rad_s[i]) <= GYRO_MAX_RAD_S and abs(accel_frd_m_s2[i]) <= ACCEL_MAX_M_S2):
            return False
    return True


@njit(cache=True)
def integrate(x: Array, gyro_frd_rad_s: Array, accel_frd_m_s2: Array, dt_s: float) -> Vector:
    """Advance ``x`` in place over one sample; return the mean acceleration over ground, NED, m/s^2.

    The specific force is rotated by the attitude at mid-interval, which is correct to second order in the
    rotation of one interval (including sculling); coning within an interval is not compensated.
    """
    half_s = 0.5 * dt_s
    half_turn = from_rotation_vector(
        (
            half_s * (gyro_frd_rad_s[0] - x[GYRO_BIAS]),
            half_s * (gyro_frd_rad_s[1] - x[GYRO_BIAS + 1]),
            half_s * (gyro_frd_rad_s[2] - x[GYRO_BIAS + 2]),
        )
    )
    force_frd_m_s2 = (
        accel_frd_m_s2[0] - x[ACCEL_BIAS],
        accel_frd_m_s2[1] - x[ACCEL_BIAS + 1],
        accel_frd_m_s2[2] - x[ACCEL_BIAS + 2],
    )
    q_mid = multiply((x[0], x[1], x[2], x[3]), half_turn)
    north, east, down = rotate(q_mid, force_frd_m_s2)
    acc_ned_m_s2 = (north, east, down + GRAVITY_M_S2)
    x[0], x[1], x[2], x[3] = normalise(multiply(q_mid, half_turn))
    for i in range(3):
        x[POS + i] += dt_s * (x[VEL + i] + half_s * acc_ned_m_s2[i])
        x[VEL + i] += dt_s * acc_ned_m_s2[i]
    return acc_ned_m_s2


@njit(cache=True, inline="always")
def error_transition(x: Array, accel_frd_m_s2: Array, dt_s: float) -> tuple[Array, Array]:
    """Return the two nonzero blocks of the error's transition matrix F, apart from identity and dt velocity.

    The first, (3, 3), is minus dt times the rotation, which maps either bias into NED (attitude from gyro
    bias, velocity from accelerometer bias). The second, (3, 3), is minus dt times the cross matrix of the
    specific force in NED (velocity from attitude). ``x`` is the state at the start of the interval.
    """
    from_bias = quat_to_dcm(x[:4])
    vel_from_attitude = np.empty((3, 3))
    for i in range(3):
        vel_from_attitude[i, i] = 0.0
        for j in range(3):
            from_bias[i, j] *= -dt_s
    force_ned_m_s2 = rotate(
        (x[0], x[1], x[2], x[3]),
        (
            accel_frd_m_s2[0] - x[ACCEL_BIAS],
            accel_frd_m_s2[1] - x[ACCEL_BIAS + 1],
            accel_frd_m_s2[2] - x[ACCEL_BIAS + 2],
        ),
    )
    vel_from_attitude[0, 1] = dt_s * force_ned_m_s2[2]
    vel_from_attitude[0, 2] = -dt_s * force_ned_m_s2[1]
    vel_from_attitude[1, 0] = -dt_s * force_ned_m_s2[2]
    vel_from_attitude[1, 2] = dt_s * force_ned_m_s2[0]
    vel_from_attitude[2, 0] = dt_s * force_ned_m_s2[1]
    vel_from_attitude[2, 1] = -dt_s * force_ned_m_s2[0]
    return from_bias, vel_from_attitude


@njit(cache=True, inline="always")
def predict_covariance(
    cov: Array, from_bias: Array, vel_from_attitude: Array, noise: ProcessNoise, dt_s: float
) -> None:
    """Replace ``cov`` (15, 15) by F cov F' + Q dt in place, keeping it symmetric.

    F has 30 entries besides the identity: rows of F cov first, then columns times F', both in an order that
    reads each block before it is overwritten.
    """
    for j in range(ERRORS):
        for i in range(3):
            cov[6 + i, j] += dt_s * cov[3 + i, j]
        for i in range(3):
            velocity = cov[3 + i, j]
            for k in range(3):
                velocity += vel_from_attitude[i, k] * cov[k, j] + from_bias[i, k] * cov[12 + k, j]
            cov[3 + i, j] = velocity
        for i in range(3):
            attitude = cov[i, j]
            for k in range(3):
                attitude += from_bias[i, k] * cov[9 + k, j]
            cov[i, j] = attitude
    for j in range(ERRORS):
        for i in range(3):
            cov[j, 6 + i] += dt_s * cov[j, 3 + i]
        for i in range(3):
            velocity = cov[j, 3 + i]
            for k in range(3):
                velocity += vel_from_attitude[i, k] * cov[j, k] + from_bias[i, k] * cov[j, 12 + k]
            cov[j, 3 + i] = velocity
        for i in range(3):
            attitude = cov[j, i]
            for k in range(3):
                attitude += from_bias[i, k] * cov[j, 9 + k]
            cov[j, i] = attitude
    for i in range(3):
        cov[i, i] += noise.gyro_psd * dt_s
        cov[3 + i, 3 + i] += noise.accel_psd * dt_s
        cov[9 + i, 9 + i] += noise.gyro_bias_psd * dt_s
        cov[12 + i, 12 + i] += noise.accel_bias_psd * dt_s
    for i in range(ERRORS):
        for j in range(i):
            mean = 0.5 * (cov[i, j] + cov[j, i])
            cov[i, j] = mean
            cov[j, i] = mean


@njit(cache=True)
def inject_error(x: Array, error: Array, bias_limits: Array) -> None:
    """Correct ``x`` in place by an estimated error (15,); biases are limited to +-(gyro, accelerometer).

    The covariance's change of tangent point is second order in the correction and neglected, as in PX4.
    """
    turn = from_rotation_vector((error[0], error[1], error[2]))
    x[0], x[1], x[2], x[3] = normalise(multiply(turn, (x[0], x[1], x[2], x[3])))
    for i in range(VEL, STATES):
        x[i] += error[i - 1]
    for i in range(3):
        x[GYRO_BIAS + i] = min(bias_limits[0], max(-bias_limits[0], x[GYRO_BIAS + i]))
        x[ACCEL_BIAS + i] = min(bias_limits[1], max(-bias_limits[1], x[ACCEL_BIAS + i]))


@njit(cache=True)
def update(
    x: Array, cov: Array, cross_cov: Array, innovation: float, innovation_var: float, bias_limits: Array
) -> None:
    """Kalman update by one scalar, in place; ``cross_cov`` (15,) is cov H'.

    With the optimal gain, Joseph's form reduces to cov - (cov H')(cov H')' / s, which is exactly symmetric.
    """
    error = np.empty(ERRORS)
    for i in range(ERRORS):
        gain = cross_cov[i] / innovation_var
        error[i] = gain * innovation
        for j in range(i + 1):
            value = cov[i, j] - gain * cross_cov[j]
            cov[i, j] = value
            cov[j, i] = value
    inject_error(x, error, bias_limits)


@njit(cache=True)
def fuse_direct(
    x: Array, cov: Array, first: int, measured: Array, variance: Array, gate: float, bias_limits: Array,
    innovation: Array, innovation_var: Array,
) -> float:  # fmt: skip
    """Fuse a measurement (n,) of ``x[first : first + n]`` completely or not at all; return the test ratio.

    The ratio is the greatest |innovation| / (gate x its standard deviation). At 1 or more only ``innovation``
    (n,), measured minus estimated, and its variance (n,) are written.
    """
    ratio = 0.0
    for i in range(measured.size):
        innovation[i] = measured[i] - x[first + i]
        innovation_var[i] = cov[first - 1 + i, first - 1 + i] + variance[i]
        ratio = max(ratio, abs(innovation[i]) / (gate * math.sqrt(innovation_var[i])))
    if ratio < 1.0:
        cross_cov = np.empty(ERRORS)
        for i in range(measured.size):
            for j in range(ERRORS):
                cross_cov[j] = cov[j, first - 1 + i]
            # relative to the state after the previous axes: sequential updates equal a joint one
            residual = measured[i] - x[first + i]
            update(x, cov, cross_cov, residual, cross_cov[first - 1 + i] + variance[i], bias_limits)
    return ratio


@njit(cache=True, inline="always")
def heading_jacobian(field_ned: Array) -> Vector:
    """Return the derivative of the heading innovation by the attitude error (field (3,) in any unit).

    A tilt error rotates the field's vertical part into the horizontal, which has the effect of a heading
    error.
    """
    horizontal_squared = field_ned[0] * field_ned[0] + field_ned[1] * field_ned[1]
    return (
        -field_ned[0] * field_ned[2] / horizontal_squared,
        -field_ned[1] * field_ned[2] / horizontal_squared,
        1.0,
    )


@njit(cache=True)
def heading_innovation(x: Array, field_frd: Array, field_ned: Array) -> float:
    """Return the angle about down, in [-pi, pi], from the measured field's horizontal part to the site's."""
    seen_ned = rotate((x[0], x[1], x[2], x[3]), (field_frd[0], field_frd[1], field_frd[2]))
    return math.atan2(
        seen_ned[0] * field_ned[1] - seen_ned[1] * field_ned[0],
        seen_ned[0] * field_ned[0] + seen_ned[1] * field_ned[1],
    )


@njit(cache=True)
def fuse_heading(
    x: Array, cov: Array, innovation: float, field_ned: Array, variance: float, gate: float,
    bias_limits: Array, take: bool,  # noqa: FBT001 - compiled code takes no keyword-only arguments
) -> tuple[float, float]:  # fmt: skip
    """Fuse an angle of ``heading_innovation`` unless its test ratio is 1 or more or ``take`` is false.

    Return the ratio and the innovation's variance.
    """
    jacobian = heading_jacobian(field_ned)
    cross_cov, innovation_var = np.empty(ERRORS), variance
    for i in range(ERRORS):
        cross_cov[i] = jacobian[0] * cov[i, 0] + jacobian[1] * cov[i, 1] + jacobian[2] * cov[i, 2]
    for i in range(3):
        innovation_var += jacobian[i] * cross_cov[i]
    ratio: float = abs(innovation) / (gate * math.sqrt(innovation_var))
    if take and ratio < 1.0:
        update(x, cov, cross_cov, innovation, innovation_var, bias_limits)
    return ratio, innovation_var


@njit(cache=True)
def field_disturbed(q_ned_frd: Array, field_frd: Array, field_ned: Array, off_max: Array) -> bool:
    """Return whether a magnetic field differs from the expected one, (3,) each, in strength or inclination.

    ``off_max`` (2,): tolerances, in the fields' unit and in radians.
    """
    x, y, z = field_ned[0], field_ned[1], field_ned[2]
    a, b, c = field_frd[0], field_frd[1], field_frd[2]
    expected = math.sqrt(x * x + y * y + z * z)
    seen = math.sqrt(a * a + b * b + c * c)
    if abs(seen - expected) > off_max[0]:
        return True
    if seen == 0.0:
        return False
    _, _, down = rotate((q_ned_frd[0], q_ned_frd[1], q_ned_frd[2], q_ned_frd[3]), (a, b, c))
    apart_rad = math.asin(max(-1.0, min(1.0, down / seen))) - math.asin(z / expected)
    return bool(abs(apart_rad) > off_max[1])


@njit(cache=True)
def fuse_field(
    x: Array, cov: Array, field_frd: Array, field_ned: Array, off_max: Array, variance: float, gate: float,
    bias_limits: Array, compass_used: bool,  # noqa: FBT001 - kernels take positions
) -> tuple[float, float, float, bool]:  # fmt: skip
    """Fuse the heading of a magnetic field (3,) if the field is not disturbed and the compass is used.

    Return the innovation, its variance, the test ratio, and whether the field is disturbed.
    """
    disturbed = field_disturbed(x[:4], field_frd, field_ned, off_max)
    innovation = heading_innovation(x, field_frd, field_ned)
    ratio, innovation_var = fuse_heading(
        x, cov, innovation, field_ned, variance, gate, bias_limits, compass_used and not disturbed
    )
    return innovation, innovation_var, ratio, disturbed


@njit(cache=True)
def is_sound(x: Array, cov: Array) -> bool:
    """Return whether the state is finite and all variances are finite and not negative."""
    if not all_finite(x):
        return False
    for i in range(ERRORS):  # noqa: SIM110 - the loop is fastest in compiled code
        if not (math.isfinite(cov[i, i]) and cov[i, i] >= 0.0):
            return False
    return True
