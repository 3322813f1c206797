"""Quaternion functions for the numerical kernels of estimation and control.

Hamilton's convention, wxyz, float64 arrays; ``q_ab`` maps a vector's components in frame b into frame a, so
``quat_rotate(q_ned_frd, v_frd)`` is ``v_ned`` and ``quat_multiply(q_ab, q_bc)`` is ``q_ac``. Angles: radians.
All functions expect unit quaternions unless stated otherwise. Functions ``quat_...`` return new arrays;
`multiply` and the four after it do the same on tuples, for inner loops, where creating small arrays would
dominate the cost. Equations: J. Sola, "Quaternion kinematics for the error-state Kalman filter", 2017 (arXiv
1711.02508).
"""

import math

import numpy as np
from numba import njit

from foundation.types import Array

SMALL_ANGLE_RAD = 1e-6
"""Angle below which a series replaces sin(x)/x; its truncation error is 1e-26."""


Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]


@njit(cache=True)
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product a b."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@njit(cache=True)
def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    return q[0], -q[1], -q[2], -q[3]


@njit(cache=True)
def normalise(q: Quaternion) -> Quaternion:
    """Return the quaternion normalised to length 1; NaN for the zero quaternion."""
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] / length, q[1] / length, q[2] / length, q[3] / length


@njit(cache=True)
def rotate(q_ab: Quaternion, v_b: Vector) -> Vector:
    """Return the components in frame a of a vector in frame b: v + 2 w (u x v) + 2 u x (u x v)."""
    w, x, y, z = q_ab
    tx = 2.0 * (y * v_b[2] - z * v_b[1])
    ty = 2.0 * (z * v_b[0] - x * v_b[2])
    tz = 2.0 * (x * v_b[1] - y * v_b[0])
    return (
        v_b[0] + w * tx + y * tz - z * ty,
        v_b[1] + w * ty + z * tx - x * tz,
        v_b[2] + w * tz + x * ty - y * tx,
    )


@njit(cache=True)
def from_rotation_vector(rotation_rad: Vector) -> Quaternion:
    """Return the quaternion of a rotation vector (axis times angle, any length): the exponential map."""
    x, y, z = rotation_rad
    angle_rad = math.sqrt(x * x + y * y + z * z)
    if angle_rad < SMALL_ANGLE_RAD:
        half_sinc = 0.5 - angle_rad * angle_rad / 48.0
    else:
        half_sinc = math.sin(0.5 * angle_rad) / angle_rad
    return math.cos(0.5 * angle_rad), half_sinc * x, half_sinc * y, half_sinc * z


@njit(cache=True)
def quat_multiply(a: Array, b: Array) -> Array:
    """Return the Hamilton product a b, (4,)."""
    product = np.empty(4)
    product[0], product[1], product[2], product[3] = multiply(
        (a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3])
    )
    return product


@njit(cache=True)
def quat_conjugate(q: Array) -> Array:
    """Return the inverse rotation (4,)."""
    conjugate = np.empty(4)
    conjugate[0] = q[0]
    conjugate[1] = -q[1]
    conjugate[2] = -q[2]
    conjugate[3] = -q[3]
    return conjugate


@njit(cache=True)
def quat_rotate(q_ab: Array, v_b: Array) -> Array:
    """Return the components (3,) in frame a of a vector in frame b."""
    v_a = np.empty(3)
    v_a[0], v_a[1], v_a[2] = rotate((q_ab[0], q_ab[1], q_ab[2], q_ab[3]), (v_b[0], v_b[1], v_b[2]))
    return v_a


@njit(cache=True)
def quat_rotate_inverse(q_ab: Array, v_a: Array) -> Array:
    """Return the components (3,) in frame b of a vector in frame a."""
    return quat_rotate(quat_conjugate(q_ab), v_a)


@njit(cache=True)
def quat_to_dcm(q_ab: Array) -> Array:
    """Return the rotation matrix R_ab (3, 3) with v_a = R_ab v_b."""
    w, x, y, z = q_ab[0], q_ab[1], q_ab[2], q_ab[3]
    dcm_ab = np.empty((3, 3))
    dcm_ab[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    dcm_ab[0, 1] = 2.0 * (x * y - w * z)
    dcm_ab[0, 2] = 2.0 * (x * z + w * y)
    dcm_ab[1, 0] = 2.0 * (x * y + w * z)
    dcm_ab[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    dcm_ab[1, 2] = 2.0 * (y * z - w * x)
    dcm_ab[2, 0] = 2.0 * (x * z - w * y)
    dcm_ab[2, 1] = 2.0 * (y * z + w * x)
    dcm_ab[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return dcm_ab


@njit(cache=True)
def quat_from_dcm(dcm_ab: Array) -> Array:
    """Return the quaternion (4,) of a rotation matrix (3, 3), w >= 0.

    Shepperd's method (J. Guidance and Control, 1978): divides by the largest component, safe at half turns.
    """
    trace = dcm_ab[0, 0] + dcm_ab[1, 1] + dcm_ab[2, 2]
    q = np.empty(4)
    if trace > 0.0:
        scale = 2.0 * math.sqrt(1.0 + trace)
        q[0] = 0.25 * scale
        q[1] = (dcm_ab[2, 1] - dcm_ab[1, 2]) / scale
        q[2] = (dcm_ab[0, 2] - dcm_ab[2, 0]) / scale
        q[3] = (dcm_ab[1, 0] - dcm_ab[0, 1]) / scale
    else:
        i = 0
        if dcm_ab[1, 1] > dcm_ab[0, 0]:
            i = 1
        if dcm_ab[2, 2] > dcm_ab[i, i]:
            i = 2
        j = (i + 1) % 3
        k = (i + 2) % 3
        scale = 2.0 * math.sqrt(1.0 + dcm_ab[i, i] - dcm_ab[j, j] - dcm_ab[k, k])
        q[0] = (dcm_ab[k, j] - dcm_ab[j, k]) / scale
        q[1 + i] = 0.25 * scale
        q[1 + j] = (dcm_ab[j, i] + dcm_ab[i, j]) / scale
        q[1 + k] = (dcm_ab[k, i] + dcm_ab[i, k]) / scale
        if q[0] < 0.0:
            for n in range(4):
                q[n] = -q[n]
    return q


@njit(cache=True)
def quat_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """Return q_ned_frd (4,) of the aerospace sequence: yaw, pitch about the new y, roll about the new x."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    q = np.empty(4)
    q[0] = cr * cp * cy + sr * sp * sy
    q[1] = sr * cp * cy - cr * sp * sy
    q[2] = cr * sp * cy + sr * cp * sy
    q[3] = cr * cp * sy - sr * sp * cy
    return q


@njit(cache=True)
def quat_to_euler(q_ned_frd: Array) -> Array:
    """Return roll, pitch, yaw (3,); at pitch +-pi/2 only roll -+ yaw is defined."""
    w, x, y, z = q_ned_frd[0], q_ned_frd[1], q_ned_frd[2], q_ned_frd[3]
    euler_rad = np.empty(3)
    euler_rad[0] = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    euler_rad[1] = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    euler_rad[2] = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return euler_rad


@njit(cache=True)
def quat_from_rotation_vector(rotation_rad: Array) -> Array:
    """Return the quaternion (4,) of a rotation vector (3,) (axis times angle): the exponential map."""
    q = np.empty(4)
    q[0], q[1], q[2], q[3] = from_rotation_vector((rotation_rad[0], rotation_rad[1], rotation_rad[2]))
    return q
