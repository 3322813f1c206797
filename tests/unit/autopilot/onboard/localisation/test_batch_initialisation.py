"""Batch initialisation: the shape is found for any GPS errors, or no UAV joins."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from autopilot.onboard.localisation.batch_initialisation import InitialisationProblem, Range, badly_fitting
from autopilot.onboard.localisation.kernels import STATES
from autopilot.onboard.localisation.members import new_members
from autopilot.onboard.localisation.model import LocalisationModel
from autopilot.onboard.localisation.receivers import Receivers
from studies.codesign.bounds import aligned_error_m

MODEL = LocalisationModel()
RANGE_STD_M = np.hypot(0.03, MODEL.range_floor_std_m)
SHAPES = {
    "two at 1.25 m": [(0.0, 0.0), (0.0, 1.25)],
    "two at 2.5 m": [(0.0, 0.0), (0.0, 2.5)],
    "triangle of 1.04 m": [(0.0, 0.0), (0.0, 1.04), (0.9, 0.52)],
    "2x2 at 0.8 m": [(0.0, 0.0), (0.0, 0.8), (0.8, 0.0), (0.8, 0.8)],
}
LINES_M = (0.9, 2.5, 4.0, 8.5)


def line(spacing_m):
    return [(0.0, 0.0), (0.0, spacing_m), (0.0, 2.0 * spacing_m)]


def drawn(places_ne_m, seed):
    """Return an `InitialisationProblem` of UAVs at their places with random GPS errors, and all distances.

    Odometry is exact, so the states are errors: the true offsets are 0.
    """
    rng = np.random.default_rng(seed)
    count = len(places_ne_m)
    places = np.column_stack((np.asarray(places_ne_m, float), np.full(count, -10.0)))
    receivers = Receivers(new_members(count), MODEL)
    receivers.less_odometry_ned_m[:, :2] = rng.normal(0.0, MODEL.gps_bias_std_m, (count, 2))
    state, cov = np.zeros(STATES * count), np.zeros((STATES * count, STATES * count))
    for station in range(count):
        receivers.begin(station, state, cov)
    all_uavs = np.ones(count, bool)
    problem = InitialisationProblem(
        state=state, cov=cov, time_us=1_000_000, active=all_uavs, located=~all_uavs,
        places_ned_m=places, odometry_ned_m=places, drift_m2_s=MODEL.odometry_drift_m_sqrt_s**2,
        bias_var_m2=receivers.stated_var_m2,
    )  # fmt: skip
    held = []
    for i, j in permutations(range(count), 2):
        between_m = places[i] - places[j]
        distance_m = float(np.linalg.norm(between_m) + rng.normal(0.0, RANGE_STD_M))
        held.append(Range(i, j, 1_000_000, distance_m, RANGE_STD_M**2, between_m))
    return problem, held


def found_ne_m(problem, solution):
    return problem.odometry_ned_m[:, :2] + solution.state.reshape(-1, STATES)[:, :2]


@pytest.mark.parametrize("places", SHAPES.values(), ids=SHAPES)
def test_small_formations_are_located_for_any_gps_errors(places):
    """GPS shows pairs at 1 m as up to 8 m apart. The worst of a thousand errors is within 4 sigma.

    Each pair is measured twice. The error of a position is at most sqrt(2) times that of one pair's distance.
    """
    for seed in range(60):
        problem, held = drawn(places, seed)
        joined = problem.join(held)
        assert joined is not None
        assert joined.joining.all()
        assert not joined.faulty
        error_m = aligned_error_m(found_ne_m(problem, joined.solution), problem.places_ned_m[:, :2])
        assert np.linalg.norm(error_m, axis=1).max() < 4.0 * RANGE_STD_M


@pytest.mark.parametrize("spacing_m", LINES_M)
def test_a_line_is_located_with_a_consistent_variance_across_it(spacing_m):
    """Exact along the line; the bend across it is within the limits of the distances and its variance.

    The bow b (1, -2, 1) / sqrt(6) lengthens the distance of neighbours by 3 b^2 / 4 d, which is at most the
    error of the distances; the outer two are the worst of a hundred. Distances do not observe its sign, so
    its standard deviation is that of GPS, of one bias.
    """
    bow = np.array((1.0, -2.0, 1.0)) / np.sqrt(6.0)
    for seed in range(60):
        problem, held = drawn(line(spacing_m), seed)
        joined = problem.join(held)
        assert joined is not None
        assert joined.joining.all()
        assert not joined.faulty
        found_m = found_ne_m(problem, joined.solution)
        along = (found_m[2] - found_m[0]) / np.linalg.norm(found_m[2] - found_m[0])
        across = np.array((along[1], -along[0]))
        assert np.abs(np.diff(found_m @ along) - spacing_m).max() < 4.0 * RANGE_STD_M
        assert 0.75 * (bow @ found_m @ across) ** 2 / spacing_m < 4.0 * RANGE_STD_M
        row = np.zeros(len(problem.state))
        row.reshape(-1, STATES)[:, :2] = np.outer(bow, across)
        assert np.sqrt(row @ joined.solution.cov @ row) > 0.99 * MODEL.gps_bias_std_m


@pytest.mark.parametrize("heading_rad", [0.3, -1.0, 2.0, -2.5, 3.0])
def test_two_uavs_have_the_heading_of_gps_at_any_gps_distance(heading_rad):
    """GPS shows 1 m as 8 m. Least squares place both on the GPS line, about the GPS midpoint."""
    problem, _ = drawn([(0.0, -0.5), (0.0, 0.5)], 1)
    ends_m = 4.0 * np.outer((-1.0, 1.0), (np.sin(heading_rad), np.cos(heading_rad)))
    state = np.zeros(len(problem.state))
    state.reshape(-1, STATES)[:, :2] = ends_m - problem.odometry_ned_m[:, :2]
    between_m = problem.odometry_ned_m[1] - problem.odometry_ned_m[0]
    # With such wide biases no GPS is an outlier on one axis only.
    problem = replace(problem, state=state, bias_var_m2=np.full(2, 1e6))
    joined = problem.join([Range(1, 0, 1_000_000, 1.0, RANGE_STD_M**2, between_m)])
    assert joined is not None
    found_m = found_ne_m(problem, joined.solution)
    assert found_m == pytest.approx(ends_m / 8.0, abs=0.02)


def test_no_uav_joins_without_consistent_distances():
    """Three UAVs with distances that form no triangle: none of them joins."""
    for seed in range(40):
        problem, held = drawn(line(2.5), seed)
        spoilt = [
            replace(item, distance_m=item.distance_m + 7.0 * ({item.initiator, item.responder} == {0, 2}))
            for item in held
        ]
        assert problem.join(spoilt) is None


def test_a_uav_linked_only_to_excluded_ones_is_excluded():
    """Of four UAVs, 3 is linked to 0 only and is dropped; 0, 1 and 2 then lack their third link."""
    problem, held = drawn(SHAPES["2x2 at 0.8 m"], 1)
    fewer = [item for item in held if {item.initiator, item.responder} not in ({1, 3}, {2, 3})]
    assert problem.join(fewer) is None
    joined = problem.join(held)
    assert joined is not None
    assert joined.joining.all()


@pytest.mark.parametrize("field", ["distance_m", "variance_m2"])
def test_nan_lets_no_uav_join(field):
    problem, held = drawn(SHAPES["triangle of 1.04 m"], 1)
    for k in range(len(held)):
        spoilt = [replace(item, **{field: float("nan")}) if item is held[k] else item for item in held]
        joined = problem.join(spoilt)
        assert joined is None or np.isfinite(joined.solution.state).all()
    state = problem.state.copy()
    state[0] = np.nan
    assert replace(problem, state=state).join(held) is None


def test_a_nan_weight_is_a_misfit():
    _, held = drawn(SHAPES["two at 2.5 m"], 1)
    assert badly_fitting(held, [float("nan"), 1.0], 2)[:, 0].tolist() == [0.5, 0.5]
