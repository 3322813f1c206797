"""What is known of everybody's GPS receiver, and what its fixes do to the localisation's filter.

Fixes count by means of some: what is slow in their errors makes single ones worth no more than their mean. A
receiver that states a worse accuracy than the model's is taken at its word. One whose error is estimated
beyond what it states is taken to have errors of that size, and after a step of it they are estimated anew.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.onboard.localisation.kernels import BIAS, STATES, Array, fuse_fix, relearn_bias
from autopilot.onboard.localisation.members import Filter, Members
from autopilot.onboard.localisation.model import LocalisationModel

GROUP_US = 800_000
"""Fixes of this time make a mean. Within it GPS bias moves by more than what is white in it."""
MISFIT_WEIGHT = 0.2
"""A measurement that gets less weight than this fits badly: beyond about 4.6 sigma."""
STEP_FIXES = 3
"""So many means of fixes in succession that fit badly are a step of GPS."""
BIAS_SIGMAS = 2.0
"""A GPS bias that is estimated beyond this has a larger spread than its receiver states."""


@njit(cache=True)
def add_fix(
    members: Members, row: int, time_us: int, pos_ned_m: Array, odometry_ned_m: Array,
    at_once: bool,  # noqa: FBT001  # numba knows no keyword-only arguments
) -> bool:  # fmt: skip
    """Take a fix (3,) and the odometry (3,) of its time; whether that makes a mean.

    It does when fixes since the last mean span `GROUP_US`, or ``at_once``.
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


@njit(cache=True)
def take_stated(
    members: Members, row: int, std_h_m: float, std_v_m: float, cov: Array, filter_row: Filter
) -> None:
    """Take what a receiver states with its newest fix at its word, when it is worse than the model.

    What it states beyond the worst of late, its bias may have changed by at once.
    """
    member, own = members[row], filter_row[0]
    since_s = max(member["fix_us"] - member["stated_us"], 0) * 1e-6
    member["stated_us"] = member["fix_us"]
    vertical_m = max(own["gps_bias_vertical_std_m"], std_v_m)
    member["vertical_var_m2"] = vertical_m * vertical_m
    level_m = max(own["gps_bias_std_m"], std_h_m)
    variance_m2 = level_m * level_m
    # A bias has forgotten what it was when the worst was stated as its own correlation says.
    kept = math.exp(-2.0 * since_s / own["gps_bias_time_constant_s"])
    stated_m2 = member["stated_var_m2"]
    worst_m2 = stated_m2 + kept * (member["worst_var_m2"] - stated_m2)
    member["worst_var_m2"] = max(worst_m2, variance_m2)
    member["stated_var_m2"] = variance_m2
    added_m2 = variance_m2 - worst_m2
    if added_m2 > 0.0:
        member["bias_var_m2"] = max(member["bias_var_m2"], variance_m2)
        if member["active"]:
            # No further than to the new variance, for what was added before may not be learned yet.
            for at in range(STATES * row + BIAS, STATES * row + STATES):
                cov[at, at] += max(min(added_m2, variance_m2 - cov[at, at]), 0.0)


@njit(cache=True)
def rate(members: Members, row: int, state: Array) -> None:
    """Take the spread of a GPS bias from its estimate where that is beyond what the receiver stated."""
    bias_n_m, bias_e_m = state[STATES * row + BIAS], state[STATES * row + BIAS + 1]
    seen_m2 = max(bias_n_m * bias_n_m, bias_e_m * bias_e_m) / (BIAS_SIGMAS * BIAS_SIGMAS)
    members[row]["bias_var_m2"] = max(members[row]["worst_var_m2"], seen_m2)


@njit(cache=True)
def fuse_mean(
    members: Members, row: int, state: Array, cov: Array, time_us: int, filter_row: Filter
) -> float:
    """Fuse the newest mean into the filter, which is at ``time_us``.

    Gives 0, or the variance that was taken for each horizontal axis if the GPS has made a step: for the UAV
    is located, and so many in succession have fitted badly. Its bias is then to be learned anew.
    """
    member, own = members[row], filter_row[0]
    # The mean is as old as its middle, since when both odometry and bias have moved on.
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
    """GPS receivers of N UAVs; state (5N,) and cov (5N, 5N), laid out as `kernels` says, are the filter's.

    Attributes:
        newest_us: (N,) when the newest fix of each was that was taken; -1 before the first.
        less_odometry_ned_m: (N, 3) each one's newest mean of fixes, less the odometry of their time.
        stated_var_m2: (N,) of the bias, per horizontal axis: what the receiver states, or the model if worse.
        bias_var_m2: (N,) the same as taken now: not below what is stated.

    """

    def __init__(self, members: Members, model: LocalisationModel) -> None:
        for name in ("stated_var_m2", "worst_var_m2", "bias_var_m2"):
            members[name] = model.gps_bias_std_m**2
        members["vertical_var_m2"] = model.gps_bias_vertical_std_m**2
        self.newest_us: NDArray[np.int64] = members["fix_us"]
        self.less_odometry_ned_m: Array = members["less_odometry_ned_m"]
        self.stated_var_m2: Array = members["stated_var_m2"]
        self.bias_var_m2: Array = members["bias_var_m2"]
        self._members = members
        self._model = model

    def learn_anew(self, row: int, state: Array, cov: Array, variance_m2: float) -> None:
        """Forget the bias of a receiver that has made a step; ``variance_m2`` is what `fuse_mean` gave."""
        self._members["misfits"][row] = 0
        relearn_bias(state, cov, row, self.less_odometry_ned_m[row], variance_m2)
        rate(self._members, row, state)

    def rate(self, row: int, state: Array) -> None:
        """Take the spread of a GPS bias from its estimate where that is beyond what the receiver stated."""
        rate(self._members, row, state)

    def unrate(self, row: int) -> None:
        """Take a receiver at its word again, whatever its bias was estimated to be."""
        self.bias_var_m2[row] = self.stated_var_m2[row]

    def begin(self, row: int, state: Array, cov: Array) -> None:
        """Fill in a UAV by its GPS: offset = fix - bias - noise, the bias at its stationary spread."""
        base = STATES * row
        bias_var_m2 = self.stated_var_m2[row]
        clear(row, state, cov)
        for a in range(2):
            state[base + a] = self.less_odometry_ned_m[row, a]
            cov[base + a, base + a] = bias_var_m2 + self._model.gps_white_std_m**2
            cov[base + BIAS + a, base + BIAS + a] = bias_var_m2
            cov[base + a, base + BIAS + a] = cov[base + BIAS + a, base + a] = -bias_var_m2
        cov[base + 2, base + 2] = self._model.height_std_m**2

    def drop_fixes(self, row: int) -> None:
        """Forget the fixes of which there is no mean yet: their odometry is that of before."""
        self._members["fixes"][row] = 0

    def forget(self, row: int) -> None:
        """Forget the fixes of a UAV that is taken out, and how they have fitted."""
        self.drop_fixes(row)
        self._members["misfits"][row] = 0


def clear(row: int, state: Array, cov: Array) -> None:
    """Take all that is known of a UAV out of state and cov."""
    own = slice(STATES * row, STATES * (row + 1))
    state[own] = 0.0
    cov[own, :] = cov[:, own] = 0.0
