"""Uncertainty of shape and distances, from the covariance of the localisation (`kernels`)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.kernels import STATES, Array, Times
from autopilot.onboard.localisation.members import Members

Flags = NDArray[np.bool_]
SEEN = np.dtype(
    [
        ("pos_ned_m", "f8", 3),  # site NED
        ("vel_ned_m_s", "f8", 3),
        ("std_m", "f8"),  # one sigma of the horizontal position relative to the own UAV, along the line
        ("fresh", "?"),  # located, with a recent beacon
    ],
    align=True,
)
"""Estimate that one UAV has of another one, or of itself, at present."""
Others = NDArray[np.void]
"""(N,) array of `SEEN`: one UAV's estimates of all UAVs, in their order, including itself."""


@njit(cache=True)
def relative_variance(cov: Array, i: int, j: int, line_m: Array) -> float:
    """Return the variance, m^2, of UAV i's offset minus that of j along ``line_m`` (3,) of any length > 0."""
    bi, bj = STATES * i, STATES * j
    total = 0.0
    for a in range(3):
        for b in range(3):
            block = cov[bi + a, bi + b] + cov[bj + a, bj + b] - cov[bi + a, bj + b] - cov[bj + a, bi + b]
            total += line_m[a] * line_m[b] * block
    length_m2 = line_m[0] * line_m[0] + line_m[1] * line_m[1] + line_m[2] * line_m[2]
    variance: float = max(total, 0.0) / length_m2
    return variance


@njit(cache=True)
def variance_between(cov: Array, i: int, j: int, members: Members, state: Array) -> float:
    """Return the variance, m^2, of the distance between UAVs i and j of ``members``, along their line."""
    line_m = np.empty(3)
    here, there = members[i]["newest"], members[j]["newest"]
    for a in range(3):
        line_m[a] = here[a] - there[a] + (state[STATES * i + a] - state[STATES * j + a])
    if line_m[0] == 0.0 and line_m[1] == 0.0 and line_m[2] == 0.0:
        line_m[0] = 1.0
    return relative_variance(cov, i, j, line_m)


@njit(cache=True)
def seen_from(
    own: int, now_us: int, members: Members, longest_s: float, state: Array, cov: Array, since_us: int,
    added_m2: float, shift_n_m: float, shift_e_m: float, others: Others,
) -> None:  # fmt: skip
    """Fill ``others`` with the present position of all UAVs and its uncertainty relative to UAV ``own``.

    Odometry is extrapolated by velocity for ``longest_s`` at most. A located UAV with odometry since
    ``since_us`` is fresh; std_m is that of `relative_stds`, 0 for a UAV that is not fresh. ``added_m2`` is
    added to each variance, and the shift to each position.
    """
    pos_ned_m, std_m = np.empty((members.size, 3)), np.empty(members.size)
    fresh = np.empty(members.size, np.bool_)
    for j in range(members.size):
        member = members[j]
        newest = member["newest"]
        age_s = min((now_us - member["newest_us"]) * 1e-6, longest_s)
        for a in range(3):
            pos_ned_m[j, a] = newest[a] + newest[3 + a] * age_s + state[STATES * j + a]
        fresh[j] = member["located"] != 0 and member["newest_us"] >= since_us
    relative_stds(cov, own, pos_ned_m, fresh, added_m2, std_m)
    for j in range(members.size):
        other = others[j]
        other["pos_ned_m"][0] = pos_ned_m[j, 0] + shift_n_m
        other["pos_ned_m"][1] = pos_ned_m[j, 1] + shift_e_m
        other["pos_ned_m"][2] = pos_ned_m[j, 2]
        for a in range(3):
            other["vel_ned_m_s"][a] = members[j]["newest"][3 + a]
        other["std_m"], other["fresh"] = std_m[j], fresh[j]


@njit(cache=True, inline="always")
def relative_stds(
    cov: Array, own: int, pos_ned_m: Array, chosen: Flags, added_m2: float, out_m: Array
) -> None:
    """Fill out_m (N,) with one sigma of each position relative to UAV ``own``, along their horizontal line.

    pos_ned_m is (N, 3); added_m2 is added to each variance. UAVs not ``chosen`` (N,) and the own one get 0.
    """
    line_m = np.zeros(3)
    out_m[:] = 0.0
    for j in range(pos_ned_m.shape[0]):
        if j == own or not chosen[j]:
            continue
        line_m[0], line_m[1] = pos_ned_m[own, 0] - pos_ned_m[j, 0], pos_ned_m[own, 1] - pos_ned_m[j, 1]
        if line_m[0] == 0.0 and line_m[1] == 0.0:
            line_m[0] = 1.0
        out_m[j] = np.sqrt(relative_variance(cov, own, j, line_m) + added_m2)


@njit(cache=True)
def shape_variance(pos_ned_m: Array, cov: Array, members: Times) -> float:
    """Return the expected mean squared horizontal shape error of members (m,), m^2, after the best alignment.

    It is the trace of the covariance of all horizontal positions minus its parts along the two translations
    and the rotation about the vertical axis, which a rigid alignment removes to first order.
    """
    m = members.shape[0]
    centre_n, centre_e = 0.0, 0.0
    for j in members:
        centre_n += pos_ned_m[j, 0] / m
        centre_e += pos_ned_m[j, 1] / m
    spread = 0.0
    for j in members:
        arm_n, arm_e = pos_ned_m[j, 0] - centre_n, pos_ned_m[j, 1] - centre_e
        spread += arm_n * arm_n + arm_e * arm_e
    total = 0.0
    shift_n, shift_e, turn = 0.0, 0.0, 0.0
    for i in members:
        bi = STATES * i
        total += cov[bi, bi] + cov[bi + 1, bi + 1]
        turn_n, turn_e = -(pos_ned_m[i, 1] - centre_e), pos_ned_m[i, 0] - centre_n
        for j in members:
            bj = STATES * j
            shift_n += cov[bi, bj] / m
            shift_e += cov[bi + 1, bj + 1] / m
            other_n, other_e = -(pos_ned_m[j, 1] - centre_e), pos_ned_m[j, 0] - centre_n
            turn += turn_n * (cov[bi, bj] * other_n + cov[bi, bj + 1] * other_e)
            turn += turn_e * (cov[bi + 1, bj] * other_n + cov[bi + 1, bj + 1] * other_e)
    if spread > 0.0:
        total -= turn / spread
    mean: float = max(total - shift_n - shift_e, 0.0) / m
    return mean


@njit(cache=True)
def bend(
    reference_ne_m: Array, pos_ne_m: Array, cov: Array, members: Times, out_m: Array, out_var_m2: Array
) -> None:
    """Fill the second-order effect of an unknown bending of the shape on distances.

    Let the relative position of two UAVs across the line between them be estimated as b with standard
    deviation sigma, at a distance d. The true distance then exceeds that of the estimates by sigma^2 / 2 d on
    average, the second-order term of the distance. The variance of this term is sigma^4 / 2 d^2, plus
    b^2 sigma^2 / d^2 because the derivative is taken at a reference that does not contain b. A turn of the
    whole formation lengthens no distance, so its part is removed from sigma. The effect matters in a line,
    where distances do not observe positions across it.

    The derivatives are taken at the reference (N, 2); the positions (N, 2) are the estimates, turned to its
    heading; ``members`` (m,) are the indices of the UAVs to include. The mean lengthening and its variance
    (N, N) are filled.
    """
    m = members.shape[0]
    out_m[:] = 0.0
    out_var_m2[:] = 0.0
    centre_n, centre_e = 0.0, 0.0
    for j in members:
        centre_n += reference_ne_m[j, 0] / m
        centre_e += reference_ne_m[j, 1] / m
    spread = 0.0
    for j in members:
        arm_n, arm_e = reference_ne_m[j, 0] - centre_n, reference_ne_m[j, 1] - centre_e
        spread += arm_n * arm_n + arm_e * arm_e
    if spread < 1e-6:
        return
    # Covariance of each position with the turn of the whole formation, and the variance of the turn.
    with_turn = np.zeros((out_m.shape[0], 2))
    turn_rad2 = 0.0
    for i in members:
        for a in range(2):
            row = cov[STATES * i + a]
            for j in members:
                with_turn[i, a] -= row[STATES * j] * (reference_ne_m[j, 1] - centre_e) / spread
                with_turn[i, a] += row[STATES * j + 1] * (reference_ne_m[j, 0] - centre_n) / spread
        turn_rad2 -= with_turn[i, 0] * (reference_ne_m[i, 1] - centre_e) / spread
        turn_rad2 += with_turn[i, 1] * (reference_ne_m[i, 0] - centre_n) / spread
    across = np.zeros(3)
    for i in members:
        for j in members:
            across[0] = reference_ne_m[j, 1] - reference_ne_m[i, 1]
            across[1] = reference_ne_m[i, 0] - reference_ne_m[j, 0]
            apart_m = np.hypot(across[0], across[1])
            if i == j or apart_m < 0.1:
                continue
            turned = 0.0
            for a in range(2):
                turned += across[a] * (with_turn[i, a] - with_turn[j, a])
            variance = relative_variance(cov, i, j, across) - 2.0 * turned + apart_m * apart_m * turn_rad2
            bent_m = across[0] * (pos_ne_m[i, 0] - pos_ne_m[j, 0])
            bent_m += across[1] * (pos_ne_m[i, 1] - pos_ne_m[j, 1])
            bent_m /= apart_m
            variance = max(variance, 0.0)
            out_m[i, j] = variance / (2.0 * apart_m)
            out_var_m2[i, j] = variance * (0.5 * variance + bent_m * bent_m) / (apart_m * apart_m)
