"""What is known of everybody's GPS receiver, and what its fixes do to the localisation's filter.

A receiver that states a worse accuracy than the model's is taken at its word. One whose error is estimated
beyond what it states is taken to have errors of that size, and after a step of it they are estimated anew.
"""

import math
from collections.abc import Sequence

import numpy as np

from autopilot.onboard.fixes import GROUP_US, FixGroup, FixMean
from autopilot.onboard.kernels import BIAS, STATES, Array, fuse_fix, relearn_bias
from autopilot.onboard.localisation_model import LocalisationModel

MISFIT_WEIGHT = 0.2
"""A measurement that gets less weight than this fits badly: beyond about 4.6 sigma."""
STEP_FIXES = 3
"""So many means of fixes in succession that fit badly are a step of GPS."""
BIAS_SIGMAS = 2.0
"""A GPS bias that is estimated beyond this has a larger spread than its receiver states."""


class Receivers:
    """GPS receivers of N UAVs; state (5N,) and cov (5N, 5N), laid out as `kernels` says, are the filter's.

    Attributes:
        newest_us: when the newest fix of each was that was taken; -1 before the first.
        less_odometry_ned_m: (N, 3) each one's newest mean of fixes, less the odometry of their time.
        stated_var_m2: (N,) of the bias, per horizontal axis: what the receiver states, or the model if worse.
        bias_var_m2: (N,) the same as taken now: not below what is stated.

    """

    def __init__(self, count: int, model: LocalisationModel) -> None:
        self.newest_us = [-1] * count
        self.less_odometry_ned_m = np.zeros((count, 3))
        self.stated_var_m2 = np.full(count, model.gps_bias_std_m**2)
        self.bias_var_m2 = self.stated_var_m2.copy()
        self._worst_var_m2 = self.stated_var_m2.copy()
        """Of the bias: the worst that was stated, brought to what is stated now by its time constant."""
        self._stated_us = [-1] * count
        self._stated_vertical_var_m2 = np.full(count, model.gps_bias_vertical_std_m**2)
        self._model = model
        self._drift_m2_s = model.odometry_drift_m_sqrt_s**2
        self._fixes = [FixGroup() for _ in range(count)]
        self._bad_fixes = [0] * count

    def add(
        self,
        station: int,
        time_us: int,
        pos_ned_m: Sequence[float],
        odometry_ned_m: Sequence[float],
        *,
        at_once: bool,
    ) -> FixMean | None:
        """Take a fix and the odometry of its time; gives a mean as `FixGroup.add` does."""
        mean = self._fixes[station].add(time_us, pos_ned_m, odometry_ned_m, at_once=at_once)
        if mean is not None:
            self.less_odometry_ned_m[station] = mean.less_odometry_ned_m
        return mean

    def take_stated(self, station: int, std_h_m: float, std_v_m: float, cov: Array, *, active: bool) -> None:
        """Take what a receiver states with its newest fix at its word, when it is worse than the model.

        What it states beyond the worst of late, its bias may have changed by at once.
        """
        model = self._model
        time_us = self.newest_us[station]
        since_s = max(time_us - self._stated_us[station], 0) * 1e-6
        self._stated_us[station] = time_us
        self._stated_vertical_var_m2[station] = max(model.gps_bias_vertical_std_m, std_v_m) ** 2
        variance_m2 = max(model.gps_bias_std_m, std_h_m) ** 2
        # A bias has forgotten what it was when the worst was stated as its own correlation says.
        kept = math.exp(-2.0 * since_s / model.gps_bias_time_constant_s)
        stated_m2 = self.stated_var_m2.item(station)
        worst_m2 = stated_m2 + kept * (self._worst_var_m2.item(station) - stated_m2)
        self._worst_var_m2[station] = max(worst_m2, variance_m2)
        self.stated_var_m2[station] = variance_m2
        added_m2 = variance_m2 - worst_m2
        if added_m2 > 0.0:
            self.bias_var_m2[station] = max(self.bias_var_m2[station], variance_m2)
            if active:
                # No further than to the new variance, for what was added before may not be learned yet.
                for at in range(STATES * station + BIAS, STATES * station + STATES):
                    cov[at, at] += max(min(added_m2, variance_m2 - cov[at, at]), 0.0)

    def fuse(
        self, station: int, mean: FixMean, state: Array, cov: Array, time_us: int, *, located: bool
    ) -> bool:
        """Fuse the newest mean into the filter, which is at ``time_us``; gives whether GPS has made a step.

        Only a UAV that is ``located`` can tell a step: its bias is then estimated anew.
        """
        model = self._model
        difference_m = self.less_odometry_ned_m[station]
        # The mean is as old as its middle, since when both odometry and bias have moved on.
        age_s = (time_us - mean.time_us) * 1e-6
        moved_m2_s = self._drift_m2_s + 2.0 * self.bias_var_m2.item(station) / model.gps_bias_time_constant_s
        variance_m2 = model.gps_white_std_m**2 / mean.count + moved_m2_s * age_s
        periods = 2.0e6 * model.gps_bias_time_constant_s / max(mean.span_us, GROUP_US)
        height_m2 = self._stated_vertical_var_m2.item(station) * max(periods, 1.0)
        weight = fuse_fix(state, cov, station, difference_m, variance_m2, height_m2)
        self._bad_fixes[station] = self._bad_fixes[station] + 1 if weight < MISFIT_WEIGHT else 0
        step = self._bad_fixes[station] >= STEP_FIXES and located
        if step:
            self._bad_fixes[station] = 0
            relearn_bias(state, cov, station, difference_m, variance_m2)
        self.rate(station, state)
        return step

    def rate(self, station: int, state: Array) -> None:
        """Take the spread of a GPS bias from its estimate where that is beyond what the receiver stated."""
        base = STATES * station
        bias_n_m, bias_e_m = state[base + BIAS : base + STATES].tolist()
        seen_m2 = max(bias_n_m**2, bias_e_m**2) / BIAS_SIGMAS**2
        self.bias_var_m2[station] = max(self._worst_var_m2[station], seen_m2)

    def unrate(self, station: int) -> None:
        """Take a receiver at its word again, whatever its bias was estimated to be."""
        self.bias_var_m2[station] = self.stated_var_m2[station]

    def begin(self, station: int, state: Array, cov: Array) -> None:
        """Fill in a UAV by its GPS: offset = fix - bias - noise, the bias at its stationary spread."""
        base = STATES * station
        bias_var_m2 = self.stated_var_m2[station]
        clear(station, state, cov)
        for a in range(2):
            state[base + a] = self.less_odometry_ned_m[station, a]
            cov[base + a, base + a] = bias_var_m2 + self._model.gps_white_std_m**2
            cov[base + BIAS + a, base + BIAS + a] = bias_var_m2
            cov[base + a, base + BIAS + a] = cov[base + BIAS + a, base + a] = -bias_var_m2
        cov[base + 2, base + 2] = self._model.height_std_m**2

    def drop_fixes(self, station: int) -> None:
        """Forget the fixes of which there is no mean yet: their odometry is that of before."""
        self._fixes[station] = FixGroup()

    def forget(self, station: int) -> None:
        """Forget the fixes of a UAV that is taken out, and how they have fitted."""
        self.drop_fixes(station)
        self._bad_fixes[station] = 0


def clear(station: int, state: Array, cov: Array) -> None:
    """Take all that is known of a UAV out of state and cov."""
    own = slice(STATES * station, STATES * (station + 1))
    state[own] = 0.0
    cov[own, :] = cov[:, own] = 0.0
