"""Consistency of the filter: normalised errors and white innovations over 20 Monte Carlo runs.

The campaigns of seeds 1, 2 and 3, each of 20 flights of 60 s, serve all tests of this file (11 s).
"""

import numpy as np
import pytest

from studies.vehicle.estimation import (
    MEASUREMENTS,
    STATES,
    Consistency,
    consistency,
    outage_drift_m,
    pooled,
    whiteness,
)

RUNS = 20


@pytest.fixture(scope="module")
def campaign():
    return pooled([consistency(runs=RUNS, duration_s=60.0, seed=seed) for seed in (1, 2, 3)])


def white(rng, *, memory=0.0, scale=1.0, runs=10, count=300, axes=3):
    """Series of a first-order process of unit variance, times ``scale``."""
    series = []
    for _ in range(runs):
        noise = rng.standard_normal((count, axes))
        for k in range(1, count):
            noise[k] = memory * noise[k - 1] + np.sqrt(1.0 - memory**2) * noise[k]
        series.append(scale * noise)
    return series


@pytest.mark.parametrize("group", ["velocity", "position"])
def test_normalised_errors_of_the_last_epoch_are_within_their_band(campaign, group):
    """The simplest form: 60 independent runs at one time, 180 degrees of freedom, 95 % band [0.80, 1.22]."""
    low, high = campaign.band()
    assert (low, high) == pytest.approx((0.804, 1.217), abs=1e-3)
    assert low < campaign.mean(group)[-1] < high


@pytest.mark.parametrize("group", ["velocity", "position"])
def test_normalised_errors_over_all_epochs_are_within_their_band(campaign, group):
    """5400 epochs are not independent: the band is that of the effective number by their autocorrelation.

    That is some 1200 for velocity and 210 for position, whose errors last for seconds.
    """
    mean, (low, high) = campaign.overall(group)
    assert low < mean < high
    assert high - low < 0.25


@pytest.mark.parametrize("group", STATES)
def test_single_epochs_are_inside_their_band_as_often_as_expected(campaign, group):
    """95 % on average; the fraction of 90 epochs worth 10 to 40 has a deviation of 0.07 to 0.04."""
    assert campaign.inside(group) > 0.85


def test_no_measurement_without_fault_is_rejected(campaign):
    """Gates of 5 sigma: one of 1.7 million."""
    assert campaign.refused == 0


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_innovations_are_white_and_have_the_predicted_variance(campaign, name):
    """Autocorrelations at lags 1 to 20, averaged over axes and runs: the greatest, and the power."""
    seen = whiteness(campaign.innovations[name])
    assert seen.greatest < seen.greatest_limit
    low, high = seen.mean_square_band
    assert low < seen.mean_square < high


def test_the_tests_of_whiteness_can_fail():
    rng = np.random.default_rng(3)
    good = whiteness(white(rng))
    assert good.greatest < good.greatest_limit
    coloured = whiteness(white(rng, memory=0.2))
    assert coloured.greatest > 2.0 * coloured.greatest_limit
    assert coloured.inside < good.inside
    loud = whiteness(white(rng, scale=1.1))
    assert loud.mean_square > loud.mean_square_band[1]


def test_the_test_of_normalised_errors_can_fail():
    """Detects a position covariance that is a fifth too small, and correlated errors."""
    rng = np.random.default_rng(4)

    def of(square):
        return Consistency(time_s=np.arange(90.0), nees={"position": square}, innovations={}, refused=0)

    errors = rng.standard_normal((RUNS, 90, 3))
    honest = of((errors**2).sum(axis=2))
    mean, (low, high) = honest.overall("position")
    assert low < mean < high
    assert honest.inside("position") > 0.85
    proud = of((errors**2).sum(axis=2) / 0.8**2)
    mean, (low, high) = proud.overall("position")
    assert mean > high
    assert proud.inside("position") < 0.6
    # identical values in all epochs count as one epoch: the band is that of one
    lasting = of(np.repeat((errors[:, :1] ** 2).sum(axis=2), 90, axis=1))
    _, (low, high) = lasting.overall("position")
    assert high - low > 0.5


def test_ten_seconds_without_gps_in_calm_hover_drift_less_than_five_metres():
    """The Iris's noises and biases, a GPS with errors of metres: ten flights."""
    drifts_m = [outage_drift_m(seed) for seed in range(10)]
    assert max(drifts_m) < 5.0
