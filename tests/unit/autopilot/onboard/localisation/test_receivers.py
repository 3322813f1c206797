"""GPS receivers that state their accuracy: effect of a varying statement on the bias. Run time: 2 s."""

import math

import numpy as np
import pytest

from autopilot.onboard.localisation.kernels import BIAS
from autopilot.onboard.localisation.localisation import CooperativeLocalisation
from autopilot.onboard.localisation.members import new_filter, new_members
from autopilot.onboard.localisation.model import LocalisationModel
from autopilot.onboard.localisation.receivers import Receivers, take_stated

SQUARE = np.array(((0.0, 0.0, -10.0), (0.0, 8.0, -10.0), (8.0, 0.0, -10.0), (8.0, 8.0, -10.0)))
STILL = (0.0, 0.0, 0.0)


def bias_std_m(waver_m, *, until_s=40.0):
    """Return the errors of the GPS biases of four ranging UAVs with receivers that state 2 m +- waver_m."""
    rng, model = np.random.default_rng(1), LocalisationModel()
    filter_ = CooperativeLocalisation(own=0, places_ned_m=SQUARE, model=model)
    bias = 2.0 * rng.standard_normal((4, 2))
    keep = math.exp(-0.05 / model.gps_bias_time_constant_s)
    for k in range(round(until_s / 0.05)):
        now_us = 50_000 * (k + 1)
        bias = keep * bias + 2.0 * math.sqrt(1.0 - keep**2) * rng.standard_normal((4, 2))
        for i in range(4):
            filter_.on_odometry(i, now_us, SQUARE[i], STILL)
            if k % 4 == 0:
                fix = SQUARE[i] + (*(bias[i] + 0.1 * rng.standard_normal(2)), 0.0)
                filter_.on_fix(i, now_us, fix, 2.0 + waver_m * rng.standard_normal(), 3.0)
            for j in range(4):
                if i != j and (k + 3 * i + j) % 20 == 0:
                    apart_m = np.linalg.norm(SQUARE[i] - SQUARE[j]) + 0.05 * rng.standard_normal()
                    filter_.on_range(i, j, now_us, float(apart_m), 0.05, now_us=now_us)
        filter_.update(now_us)
    assert filter_.located.all()
    filter_.advance(now_us)
    return np.array([filter_.gps_error(i)[1] for i in range(4)])


def test_a_bias_is_estimated_with_a_varying_statement():
    """The statement varies by 5 %; the worst of 200 is 3 sigma, a spread of 2.3 m instead of 2 m."""
    steady_m, wavering_m = bias_std_m(0.0), bias_std_m(0.1)
    assert (steady_m < 1.25).all()
    assert (wavering_m < 2.3 / 2.0 * steady_m).all()


def test_a_varying_statement_lies_between_the_constant_ones():
    """For a lone UAV only time separates bias and offset; the error never exceeds the worst stated one."""
    found_m = []
    for stated_m in ((1.6, 1.6), (1.6, 3.0), (3.0, 3.0)):
        filter_ = CooperativeLocalisation(own=0, places_ned_m=SQUARE, model=LocalisationModel())
        for k in range(600):
            filter_.on_odometry(0, 200_000 * k, STILL, STILL)
            filter_.on_fix(0, 200_000 * k, (0.1, 0.0, 0.0), stated_m[k % 2], 3.0)
            assert filter_.gps_error(0)[1] <= 3.0 + 1e-9
        found_m.append(filter_.gps_error(0)[1])
    assert found_m[0] < found_m[1] < found_m[2]


def test_a_rise_has_effect_at_once_and_again_after_the_worst_has_decayed():
    """From 2 m to 3 m the variance rises by 5 m2, and later by the decayed share of it."""
    model = LocalisationModel(gps_bias_time_constant_s=60.0)
    members, filter_row, cov = new_members(1), new_filter(0, model), np.zeros((5, 5))
    Receivers(members, model)
    members["active"] = 1

    def state(time_s, std_m):
        before_m2 = cov[BIAS, BIAS]
        members["fix_us"] = round(time_s * 1e6)
        take_stated(members, 0, std_m, 3.0, cov, filter_row)
        added_m2 = cov[BIAS, BIAS] - before_m2
        cov[BIAS, BIAS] = cov[BIAS + 1, BIAS + 1] = 0.5  # reduced, so that the next rise is not limited
        return added_m2

    assert state(0.0, 2.0) == pytest.approx(4.0 - model.gps_bias_std_m**2)
    assert state(1.0, 3.0) == pytest.approx(5.0)
    assert state(2.0, 2.0) == 0.0
    assert state(3.0, 3.0) == pytest.approx(5.0 * (1.0 - math.exp(-2.0 * 1.0 / 60.0)))
    assert state(4.0, 2.0) == 0.0
    assert state(304.0, 3.0) == pytest.approx(5.0 * (1.0 - math.exp(-2.0 * 300.0 / 60.0)))
