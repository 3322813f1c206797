"""Motion of free bodies: Bullet's integration scheme for all vehicles at once, in compiled code.

Bullet has one call per vehicle and scattered data, so for a swarm of free bodies the calls would take longer
than the integration. Bullet's scheme for a free body is short: semi-implicit Euler, and the exponential map
for the attitude. It is reproduced here from btMultiBody.cpp, 3.2.7
(computeAccelerationsArticulatedBodyAlgorithmMultiDof, applyDeltaVeeMultiDof and stepPositionsMultiDof of a
body without joints), so both give the same motion except for rounding. `harness.world.physics.bullet` steps
the vehicles near something.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from foundation.types import Array
from harness.world.physics.rotation import in_frd, in_ned

MOST_RATE = 100.0
"""Bullet's limit of every component of velocity, m/s, and angular rate, rad/s."""
MOST_TURN_RAD = 0.25 * math.pi
"""Bullet's limit of the attitude's change in one step."""
SMALL_RATE_RAD_S = 1e-3
"""Below this rate Bullet uses a series instead of the sine."""
SERIES = 0.020833333333
"""Coefficient of the series, 1/48 as in Bullet's source."""


@njit(cache=True)
def coast(
    mass_kg: Array,
    inertia_kg_m2: Array,
    gravity_m_s2: float,
    step_s: float,
    before: NDArray[np.void],
    applied: Array,
    after: NDArray[np.void],
) -> None:
    """Step free bodies from rows ``before`` (n,) of `bodies.BODY` to ``after`` (n,).

    ``applied`` (n, 2, 3) are force and torque, NED, without gravity; ``mass_kg`` is (n,), ``inertia_kg_m2``
    (n, 3) diagonal.
    """
    for i in range(len(before)):
        was, now, mass = before[i], after[i], mass_kg[i]
        ix, iy, iz = inertia_kg_m2[i, 0], inertia_kg_m2[i, 1], inertia_kg_m2[i, 2]
        force_ned, torque_ned, q = applied[i, 0], applied[i, 1], was["q_ned_frd"]
        now["vel_ned_m_s"][0] = _limited(was["vel_ned_m_s"][0] + step_s * (force_ned[0] / mass))
        now["vel_ned_m_s"][1] = _limited(was["vel_ned_m_s"][1] + step_s * (force_ned[1] / mass))
        now["vel_ned_m_s"][2] = _limited(
            was["vel_ned_m_s"][2] + step_s * (force_ned[2] / mass + gravity_m_s2)
        )
        omega_ned = was["omega_ned_rad_s"]
        roll, pitch, yaw = in_frd(q, omega_ned[0], omega_ned[1], omega_ned[2])
        tx, ty, tz = in_frd(q, torque_ned[0], torque_ned[1], torque_ned[2])
        faster_ned = in_ned(
            q,
            (tx - (iz - iy) * pitch * yaw) / ix,
            (ty - (ix - iz) * yaw * roll) / iy,
            (tz - (iy - ix) * roll * pitch) / iz,
        )
        for axis in range(3):
            now["omega_ned_rad_s"][axis] = _limited(omega_ned[axis] + step_s * faster_ned[axis])
            now["pos_ned_m"][axis] = was["pos_ned_m"][axis] + step_s * now["vel_ned_m_s"][axis]
        _turn(now["omega_ned_rad_s"], q, step_s, now["q_ned_frd"])


@njit(cache=True)
def _limited(rate: float) -> float:
    return min(max(rate, -MOST_RATE), MOST_RATE)


@njit(cache=True)
def _turn(omega_ned_rad_s: Array, q_ned_frd: Array, step_s: float, turned: Array) -> None:
    """Write to ``turned`` (4,) the attitude (4,) after a step at the rate (3,)."""
    x, y, z = omega_ned_rad_s[0], omega_ned_rad_s[1], omega_ned_rad_s[2]
    rate_rad_s = math.sqrt(x * x + y * y + z * z)
    if rate_rad_s * step_s > MOST_TURN_RAD:
        rate_rad_s = MOST_TURN_RAD / step_s
    if rate_rad_s < SMALL_RATE_RAD_S:
        per_rate = 0.5 * step_s - step_s * step_s * step_s * SERIES * rate_rad_s * rate_rad_s
    else:
        per_rate = math.sin(0.5 * rate_rad_s * step_s) / rate_rad_s
    w, x, y, z = math.cos(0.5 * rate_rad_s * step_s), per_rate * x, per_rate * y, per_rate * z
    a, b, c, d = q_ned_frd[0], q_ned_frd[1], q_ned_frd[2], q_ned_frd[3]
    turned[0] = w * a - x * b - y * c - z * d
    turned[1] = w * b + x * a + y * d - z * c
    turned[2] = w * c - x * d + y * a + z * b
    turned[3] = w * d + x * c - y * b + z * a
    length = math.sqrt(
        turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2] + turned[3] * turned[3]
    )
    for k in range(4):
        turned[k] /= length
