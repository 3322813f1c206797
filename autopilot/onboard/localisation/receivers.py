"""GPS receivers of all UAVs: averaging and fusing of their fixes, and the variance of their biases.

Fixes are averaged over `GROUP_US` before they are fused: their errors are slow, so that single fixes hold no
more information than their mean.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.kernels import BIAS, STATES, Array, fuse_fix
from autopilot.onboard.localisation.members import Filter, Members
from autopilot.onboard.localisation.model import LocalisationModel

GROUP_US = 800_000
"""Time span of the fixes in a mean. Within it the GPS bias moves by more than the white part of its error."""
MISFIT_WEIGHT = 0.2
"""A measurement of less weight than this is a misfit: beyond about 4.6 sigma."""
STEP_FIXES = 3
"""Number of consecutive misfitting means that indicate a step of the GPS error."""
BIAS_SIGMAS = 2.0
"""A GPS bias beyond this many stated standard deviations raises its variance."""


@njit(cache=True, inline="always")
def add_fix(
    members: Members, row: int, time_us: int, pos_ned_m: Array, odometry_ned_m: Array,
    at_once: bool,  # noqa: FBT001  # numba has no keyword-only arguments
) -> bool:  # fmt: skip
    """Add a fix (3,) and the odometry (3,) of its time; returns whether a mean is complete.

    It is complete if the fixes since the last mean span `GROUP_US`, or if ``at_once``.
    """
    member = members[row]
    total_m, mean_m = member["sum_ned_m"], member["less_odometry_ned_m"]
    if member["fixes"] == 0:
        member["first_us"], member["late_us"] = time_us, 0
        for a in range(3):
            total_m[a] = 0.0
    member["fixes"] += 1
    member["late_us"] += time_us - member["first_us"]
    for a in range(3):
        total_m[a] += pos_ned_m[a] - odometry_ned_m[a]
    count, span_us = member["fixes"], time_us - member["first_us"]
    if not at_once and span_us < GROUP_US:
        return False
    for a in range(3):
        mean_m[a] = total_m[a] / count
    member["mean_us"] = member["first_us"] + member["late_us"] // count
    member["mean_fixes"], member["span_us"] = count, span_us
    member["fixes"] = 0
    return True


@njit(cache=True, inline="always")
def take_stated(
    members: Members, row: int, std_h_m: float, std_v_m: float, cov: Array, filter_row: Filter
) -> None:
    """Process the accuracy that a receiver states with its newest fix; the model's is the lower limit.

    If it exceeds the recent worst, the bias may have changed at once by the excess: its variance is raised.
    """
    member, own = members[row], filter_row[0]
    since_s = max(member["fix_us"] - member["stated_us"], 0) * 1e-6
    member["stated_us"] = member["fix_us"]
    vertical_m = max(own["gps_bias_vertical_std_m"], std_v_m)
    member["vertical_var_m2"] = vertical_m * vertical_m
    level_m = max(own["gps_bias_std_m"], std_h_m)
    variance_m2 = level_m * level_m
    # The worst stated variance decays to the stated one with the correlation of the bias.
    kept = math.exp(-2.0 * since_s / own["gps_bias_time_constant_s"])
    stated_m2 = member["stated_var_m2"]
    worst_m2 = stated_m2 + kept * (member["worst_var_m2"] - stated_m2)
    member["worst_var_m2"] = max(worst_m2, variance_m2)
    member["stated_var_m2"] = variance_m2
    added_m2 = variance_m2 - worst_m2
    if added_m2 > 0.0:
        member["bias_var_m2"] = max(member["bias_var_m2"], variance_m2)
        if member["active"]:
            # At most to the new variance, as earlier additions may not have been reduced by measurements yet.
            for at in range(STATES * row + BIAS, STATES * row + STATES):
                cov[at, at] += max(min(added_m2, variance_m2 - cov[at, at]), 0.0)


@njit(cache=True)
def rate(members: Members, row: int, state: Array) -> None:
    """Raise the variance of a GPS bias to its estimate if that exceeds the stated accuracy."""
    bias_n_m, bias_e_m = state[STATES * row + BIAS], state[STATES * row + BIAS + 1]
    seen_m2 = max(bias_n_m * bias_n_m, bias_e_m * bias_e_m) / (BIAS_SIGMAS * BIAS_SIGMAS)
    members[row]["bias_var_m2"] = max(members[row]["worst_var_m2"], seen_m2)


@njit(cache=True)
def fuse_mean(
    members: Members, row: int, state: Array, cov: Array, time_us: int, filter_row: Filter
) -> float:
    """Fuse the newest mean into the filter, which is at ``time_us``.

    Returns 0, or the variance used for each horizontal axis if the UAV is located and the last `STEP_FIXES`
    means were misfits, so that the bias must be reset.
    """
    member, own = members[row], filter_row[0]
    # The mean has the age of its mean time; odometry and bias have drifted since.
    age_s = (time_us - member["mean_us"]) * 1e-6
    moved_m2_s = own["drift_m2_s"] + 2.0 * member["bias_var_m2"] / own["gps_bias_time_constant_s"]
    variance_m2 = own["gps_white_var_m2"] / member["mean_fixes"] + moved_m2_s * age_s
    periods = 2.0e6 * own["gps_bias_time_constant_s"] / max(member["span_us"], GROUP_US)
    height_m2 = member["vertical_var_m2"] * max(periods, 1.0)
    weight = fuse_fix(state, cov, row, member["less_odometry_ned_m"], variance_m2, height_m2)
    member["misfits"] = member["misfits"] + 1 if weight < MISFIT_WEIGHT else 0
    rate(members, row, state)
    return variance_m2 if member["misfits"] >= STEP_FIXES and member["located"] else 0.0


class Receivers:
    """GPS receivers of N UAVs; state (5N,) and cov (5N, 5N) have the layout of `kernels`."""

    def __init__(self, members: Members, model: LocalisationModel) -> None:
        for name in ("stated_var_m2", "worst_var_m2", "bias_var_m2"):
            members[name] = model.gps_bias_std_m**2
        members["vertical_var_m2"] = model.gps_bias_vertical_std_m**2
        self.newest_us: NDArray[np.int64] = members["fix_us"]
        """(N,) time of the newest fix used of each receiver; -1 before the first."""
        self.less_odometry_ned_m: Array = members["less_odometry_ned_m"]
        """(N, 3) newest mean of fixes of each, minus the odometry of their times."""
        self.stated_var_m2: Array = members["stated_var_m2"]
        """(N,) variance of the bias, per horizontal axis: as stated, but not below the model's."""
        self._members = members
        self._model = model

    def reset_bias(self, row: int, state: Array, cov: Array, variance_m2: float) -> None:
        """Reset the bias of a receiver that has made a step to the newest mean minus the offset, which stays.

        ``variance_m2`` is the result of `fuse_mean`.
        """
        self._members["misfits"][row] = 0
        for a in range(2):
            off = STATES * row + a
            bias = off + BIAS
            state[bias] = self.less_odometry_ned_m[row, a] - state[off]
            cov[bias, :] = -cov[off, :]
            cov[:, bias] = -cov[:, off]
            cov[bias, bias] = cov[off, off] + variance_m2
        rate(self._members, row, state)

    def begin(self, row: int, state: Array, cov: Array) -> None:
        """Initialise a UAV by its GPS: offset = fix - bias - noise, the bias with its stationary variance."""
        base = STATES * row
        bias_var_m2 = self.stated_var_m2[row]
        clear(row, state, cov)
        for a in range(2):
            state[base + a] = self.less_odometry_ned_m[row, a]
            cov[base + a, base + a] = bias_var_m2 + self._model.gps_white_std_m**2
            cov[base + BIAS + a, base + BIAS + a] = bias_var_m2
            cov[base + a, base + BIAS + a] = cov[base + BIAS + a, base + a] = -bias_var_m2
        cov[base + 2, base + 2] = self._model.height_std_m**2


def clear(row: int, state: Array, cov: Array) -> None:
    """Set a UAV's entries of state and cov to zero."""
    own = slice(STATES * row, STATES * (row + 1))
    state[own] = 0.0
    cov[own, :] = cov[:, own] = 0.0
