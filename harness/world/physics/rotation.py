"""Rotation of vectors in the kernels of the physics, on scalars.

The equations are those of `foundation.geometry.rotations`, in the same order, so the results are
bit-identical. There every vector is a new array, allocated some thirty times per vehicle and step, which took
half of the kernels' time.
"""

import math

from numba import njit

from foundation.geometry.rotations import SMALL_ANGLE_RAD
from foundation.types import Array

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@njit(cache=True)
def in_ned(q_ned_frd: Array, x: float, y: float, z: float) -> Vector:
    """Transform a vector from FRD to NED: v + 2 w (u x v) + 2 u x (u x v)."""
    return _rotated(q_ned_frd[0], q_ned_frd[1], q_ned_frd[2], q_ned_frd[3], x, y, z)


@njit(cache=True)
def in_frd(q_ned_frd: Array, x: float, y: float, z: float) -> Vector:
    """Transform a vector from NED to FRD."""
    return _rotated(q_ned_frd[0], -q_ned_frd[1], -q_ned_frd[2], -q_ned_frd[3], x, y, z)


@njit(cache=True)
def _rotated(w: float, i: float, j: float, k: float, x: float, y: float, z: float) -> Vector:
    tx = 2.0 * (j * z - k * y)
    ty = 2.0 * (k * x - i * z)
    tz = 2.0 * (i * y - j * x)
    return x + w * tx + j * tz - k * ty, y + w * ty + k * tx - i * tz, z + w * tz + i * ty - j * tx


@njit(cache=True)
def turned(rotation_x: float, rotation_y: float, rotation_z: float, q: Array) -> Quaternion:
    """Rotate a quaternion ``q`` (4,) by a rotation vector, in radians and in the frame that it maps to."""
    angle_rad = math.sqrt(rotation_x * rotation_x + rotation_y * rotation_y + rotation_z * rotation_z)
    if angle_rad < SMALL_ANGLE_RAD:
        half_sinc = 0.5 - angle_rad * angle_rad / 48.0
    else:
        half_sinc = math.sin(0.5 * angle_rad) / angle_rad
    w = math.cos(0.5 * angle_rad)
    x, y, z = half_sinc * rotation_x, half_sinc * rotation_y, half_sinc * rotation_z
    return (
        w * q[0] - x * q[1] - y * q[2] - z * q[3],
        w * q[1] + x * q[0] + y * q[3] - z * q[2],
        w * q[2] - x * q[3] + y * q[0] + z * q[1],
        w * q[3] + x * q[2] - y * q[1] + z * q[0],
    )
