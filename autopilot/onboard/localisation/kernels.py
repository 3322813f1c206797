"""Numerics of the cooperative localisation: a Kalman filter over a whole formation.

State of UAV j, at `STATES` * j: offset (north, east, down), GPS bias (north, east). The true position at
time t is ``odometry_j(t) + offset_j`` with known odometry. A delayed measurement is therefore compared with
the odometry of its own time stamp, and nothing has to be propagated back. Horizontal offsets are random walks
(error of the autopilot's velocity). The vertical offset (error of the barometer) and the GPS biases are
first-order Gauss-Markov processes.

The vertical GPS bias has no state. Its spectral density at zero frequency, 2 sigma^2 tau, equals that of
white noise of variance sigma^2 2 tau / T every T seconds, and it is fused as such. A state would cost 40 %
more time and change the height by less than 1 % of its error.

Every measurement is scalar with a sparse row h: with s = h P h' + r and g = P h' / sqrt(s), the update
P - g g' is bitwise symmetric, because both triangles are the same products. Outliers: a measurement with a
squared normalised innovation d2 is fused with variance r / w, w = min(1, (nu + 1) / (nu + d2)), the weight of
a Student-t likelihood (Lange, Little and Taylor, "Robust statistical modeling using the t distribution",
1989). Its influence falls with its size, so the effect of a wrong measurement is bounded.

Compiled and interpreted kernels give bitwise equal results (tested). They therefore use products for squares,
`math.exp` for exponentials and `np.hypot` for lengths: the interpreter's powers, NumPy's exponentials and
`math.hypot` round differently.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.members import Members

Array = NDArray[np.float64]
Times = NDArray[np.int64]

STATES = 5
BIAS = 3
"""Index of the GPS bias within a UAV's states."""
STUDENT_NU = 4.0
"""Degrees of freedom of the likelihood: nearly Gaussian below two sigma, nearly flat beyond six."""
NEAR_COSINE = 0.87
"""Cosine of 30 degrees: the reference direction replaces the estimated one up to this angle between them."""


@njit(cache=True)
def predict(
    state: Array, cov: Array, members: Members, drift_m2: float, decay_s: float, height_var_m2: float,
    height_tau_s: float, bias_tau_s: float,
) -> None:  # fmt: skip
    """Propagate state (5N,) and cov (5N, 5N) of ``members`` (N,).

    The random walk of the offsets adds the variance ``drift_m2`` to 2 N diagonal elements. The exactly
    discretised Gauss-Markov processes change every element, so they may be propagated in longer strides
    ``decay_s``; 0 skips them.
    """
    size = state.shape[0]
    for j in range(members.size):
        if members[j]["active"]:
            cov[STATES * j, STATES * j] += drift_m2
            cov[STATES * j + 1, STATES * j + 1] += drift_m2
    if decay_s <= 0.0:
        return
    height_decay = math.exp(-decay_s / height_tau_s)
    bias_decay = math.exp(-decay_s / bias_tau_s)
    factor = np.empty(size)
    for j in range(members.size):
        factor[STATES * j] = factor[STATES * j + 1] = 1.0
        factor[STATES * j + 2] = height_decay
        factor[STATES * j + BIAS] = bias_decay
        factor[STATES * j + BIAS + 1] = bias_decay
    for i in range(size):
        state[i] *= factor[i]
        for k in range(size):
            cov[i, k] *= factor[i] * factor[k]
    for j in range(members.size):
        if members[j]["active"]:
            base = STATES * j
            for a in range(BIAS, STATES):
                cov[base + a, base + a] += members[j]["bias_var_m2"] * (1.0 - bias_decay * bias_decay)
            cov[base + 2, base + 2] += height_var_m2 * (1.0 - height_decay * height_decay)


@njit(cache=True, inline="always")
def student_weight(normalised_squared: float) -> float:
    """Return the weight 0..1 of a measurement with this squared normalised innovation."""
    return min(1.0, (STUDENT_NU + 1.0) / (STUDENT_NU + normalised_squared))


@njit(cache=True, inline="always")
def _scalar_update(state: Array, cov: Array, gain_row: Array, variance: float, innovation: float) -> None:
    """Fuse a scalar measurement; ``gain_row`` is P h' and is overwritten."""
    scale = innovation / variance
    root = 1.0 / np.sqrt(variance)
    for i in range(state.shape[0]):
        state[i] += gain_row[i] * scale
        gain_row[i] *= root
    for i in range(state.shape[0]):
        own = gain_row[i]
        for k in range(state.shape[0]):
            cov[i, k] -= own * gain_row[k]


@njit(cache=True)
def fuse_fix(
    state: Array, cov: Array, j: int, fix_less_odometry_m: Array, variance_m2: float,
    height_variance_m2: float,
) -> float:  # fmt: skip
    """Fuse a GPS position of UAV j: z_a = odometry_a + offset_a + bias_a + noise; no bias state vertically.

    variance_m2 is that of the white part of each horizontal axis, height_variance_m2 that of the whole
    vertical error. Returns the smaller weight of the two horizontal axes.
    """
    least = 1.0
    for a in range(3):
        off = STATES * j + a
        row = cov[off].copy()
        innovation = fix_less_odometry_m[a] - state[off]
        noise = height_variance_m2
        prior = row[off]
        if a < 2:
            bias = STATES * j + BIAS + a
            for k in range(row.size):
                row[k] += cov[bias, k]
            innovation -= state[bias]
            noise = variance_m2
            prior = row[off] + row[bias]
        weight = student_weight(innovation * innovation / (prior + noise))
        if a < 2:
            least = min(least, weight)
        _scalar_update(state, cov, row, prior + noise / weight, innovation)
    return least


@njit(cache=True)
def fuse_range(
    state: Array, cov: Array, linearised_at: Array, reference_ne_m: Array, i: int, j: int,
    odometry_between_m: Array, distance_m: float, variance_m2: float, weight_width_m2: float, trust: float,
) -> float:  # fmt: skip
    """Fuse a distance between UAVs i and j: z = |odometry_i - odometry_j + offset_i - offset_j| + noise.

    Distances do not observe the heading of the formation as a whole. In a filter that linearises at its
    newest estimate the unobservable direction turns with the estimate, and the heading variance shrinks
    spuriously: the filter becomes certain of a heading that drifts, differently at each UAV. Linearisation at
    a fixed geometry avoids that (Huang, Mourikis and Roumeliotis, "Observability-based rules for designing
    consistent EKF SLAM estimators", IJRR 2010). The horizontal direction of the derivative is therefore that
    between the reference positions, if it is near the estimated one; its elevation and the expected distance
    are those of the estimate.

    The fixed geometry is reference_ne_m (N, 2); all zero: none. The linearisation point (5N,) is the state
    itself in the running filter, another point in the passes of a Gauss-Newton iteration. odometry_between_m
    (3,) is the odometry of i minus that of j at the measurement's time. With weight_width_m2 below 0 the
    weight follows from the innovation; otherwise from the residual at the linearisation point, with this
    variance added to that of the measurement. A ``trust`` of 0 changes nothing.

    Returns the weight, 0..1; 0 if the two are nearer than 0.1 m, where the direction is undefined.
    """
    bi, bj = STATES * i, STATES * j
    direction = np.empty(3)
    for a in range(3):
        direction[a] = odometry_between_m[a] + linearised_at[bi + a] - linearised_at[bj + a]
    level_m = np.hypot(direction[0], direction[1])
    expected_m = np.hypot(level_m, direction[2])
    if expected_m < 0.1:
        return 0.0
    north_m = reference_ne_m[i, 0] - reference_ne_m[j, 0]
    east_m = reference_ne_m[i, 1] - reference_ne_m[j, 1]
    between_m = np.hypot(north_m, east_m)
    if direction[0] * north_m + direction[1] * east_m > NEAR_COSINE * level_m * between_m:
        direction[0] = level_m * north_m / between_m
        direction[1] = level_m * east_m / between_m
    residual_m = distance_m - expected_m
    innovation_m = residual_m
    for a in range(3):
        direction[a] /= expected_m
        innovation_m -= direction[a] * (state[bi + a] - linearised_at[bi + a])
        innovation_m += direction[a] * (state[bj + a] - linearised_at[bj + a])
    row = np.empty(state.shape[0])
    d0, d1, d2 = direction
    for k in range(state.shape[0]):
        row[k] = (
            d0 * (cov[bi, k] - cov[bj, k])
            + d1 * (cov[bi + 1, k] - cov[bj + 1, k])
            + d2 * (cov[bi + 2, k] - cov[bj + 2, k])
        )
    prior_m2 = 0.0
    for a in range(3):
        prior_m2 += direction[a] * (row[bi + a] - row[bj + a])
    if weight_width_m2 < 0.0:
        weight = student_weight(innovation_m * innovation_m / (prior_m2 + variance_m2))
    else:
        weight = student_weight(residual_m * residual_m / (weight_width_m2 + variance_m2))
    if trust > 0.0:
        _scalar_update(state, cov, row, prior_m2 + variance_m2 / weight, innovation_m)
    return weight
