"""Errors of the tag have the statistics of its settings. 3 s."""

import math

import numpy as np
import pytest
from world_models import sensor_of, state_of

from foundation.extensions import ExtensionError
from foundation.geometry.rotations import quat_from_euler
from harness.world.obstacles import Box

ANCHORS = [[0.0, 0.0, -1.0], [30.0, 0.0, -1.0]]
EXACT = {"noise_std_m": 0.0, "bias_std_m": 0.0, "loss_fraction": 0.0, "obstructed_loss_fraction": 0.0}
PLACES = [(0.0, 0.0, -5.0), (3.0, 4.0, -5.0), (0.0, 12.0, -5.0)]
WALL = Box(from_ned_m=(15.0, -50.0, -30.0), to_ned_m=(15.3, 50.0, 0.0))
SAMPLES = 4000


def sampled(settings, count=SAMPLES, **world):
    tag = sensor_of("uwb_tag", {"anchors_ned_m": ANCHORS, **settings}, **world)
    state = state_of(PLACES)
    return np.array([tag.sample(state) for _ in range(count)])


def test_ranges_are_those_to_the_anchors_and_then_to_the_others():
    tag = sensor_of("uwb_tag", {"anchors_ned_m": ANCHORS, "vehicles": True} | EXACT, vehicle=1)
    assert tag.columns == ("anchor_0_m", "anchor_1_m", "uav_0_m", "uav_2_m")
    expected_m = (math.sqrt(41.0), math.sqrt(27.0**2 + 32.0), 5.0, math.hypot(3.0, 8.0))
    assert tag.sample(state_of(PLACES, vehicle=1)) == pytest.approx(expected_m)


def test_the_antenna_turns_with_the_vehicle():
    tag = sensor_of("uwb_tag", {"anchors_ned_m": ANCHORS, "position_frd_m": [2.0, 0.0, 0.0]} | EXACT)
    state = state_of([(10.0, 0.0, -1.0)] * 3, q_ned_frd=quat_from_euler(0.0, 0.0, math.pi))
    assert tag.sample(state) == pytest.approx((8.0, 22.0))


def test_white_noise_and_losses_have_their_settings():
    ranges_m = sampled({"noise_std_m": 0.2, "bias_std_m": 0.0, "loss_fraction": 0.1})
    missing = np.isnan(ranges_m)
    assert missing.mean(axis=0) == pytest.approx((0.1, 0.1), abs=4 * math.sqrt(0.09 / SAMPLES))
    assert np.nanstd(ranges_m, axis=0) == pytest.approx((0.2, 0.2), rel=4 / math.sqrt(2 * 0.9 * SAMPLES))
    both = (missing[:, 0] & missing[:, 1]).mean()
    assert both == pytest.approx(0.01, abs=4 * math.sqrt(0.01 / SAMPLES))  # independent


def test_the_constant_error_differs_between_pairs_and_stays():
    one = sampled({"noise_std_m": 0.0, "bias_std_m": 0.3, "loss_fraction": 0.0}, count=5)
    assert (one == one[0]).all()
    errors_m = [
        sampled({"noise_std_m": 0.0, "bias_std_m": 0.3, "loss_fraction": 0.0}, count=1, seed=seed)[0]
        - (4.0, math.sqrt(916.0))
        for seed in range(200)
    ]
    assert np.std(errors_m) == pytest.approx(0.3, rel=4 / math.sqrt(800))
    assert abs(np.corrcoef(np.array(errors_m).T)[0, 1]) < 4 / math.sqrt(200)


def test_a_wall_adds_an_exponential_excess_to_the_ranges_behind_it_only():
    settings = EXACT | {"obstructed_excess_m": 0.8, "obstructed_loss_fraction": 0.4}
    ranges_m = sampled(settings, boxes=[WALL])
    assert ranges_m[:, 0] == pytest.approx(4.0)
    excess_m = ranges_m[:, 1] - math.sqrt(916.0)
    assert np.isnan(excess_m).mean() == pytest.approx(0.4, abs=4 * math.sqrt(0.24 / SAMPLES))
    assert np.nanmin(excess_m) >= -1e-9
    share = 4 / math.sqrt(0.6 * SAMPLES)
    assert np.nanmean(excess_m) == pytest.approx(0.8, rel=share)
    assert np.nanstd(excess_m) == pytest.approx(0.8, rel=2 * share)


def test_a_wall_does_not_shift_the_draws_of_other_ranges():
    open_m, walled_m = sampled({}, count=50), sampled({}, count=50, boxes=[WALL])
    np.testing.assert_array_equal(open_m[:, 0], walled_m[:, 0])


def test_ranges_beyond_the_greatest_and_to_lost_vehicles_are_missing():
    tag = sensor_of("uwb_tag", {"anchors_ned_m": ANCHORS, "vehicles": True, "max_m": 29.0} | EXACT)
    found = tag.sample(state_of(PLACES, lost=[1]))
    assert [math.isnan(value) for value in found] == [False, True, True, False]


def test_a_tag_that_measures_nothing_is_refused():
    with pytest.raises(ExtensionError, match="settings: anchors_ned_m: expected anchors, or vehicles = true"):
        sensor_of("uwb_tag", {})
