"""Neighbourhoods of a large formation, and their common frame."""

import numpy as np
import pytest
from onboard_world import SwarmWorld, rms, shape_errors_m

from autopilot.onboard.localisation.common_frame import MISFIT_M, laid_onto
from autopilot.onboard.predicted_shape import linked
from autopilot.onboard.radio.neighbourhood import Neighbourhood
from autopilot.onboard.radio.scheduled_ranging import ScheduledRanging
from autopilot.parameters.onboard_config import OnboardConfig


def grid_ned_m(rows, columns, row_m=5.0, column_m=6.0):
    return np.array([(row_m * r, column_m * c, -10.0) for r in range(rows) for c in range(columns)])


def ring_ned_m(count, radius_m=30.0):
    angle = np.arange(count) * 2.0 * np.pi / count
    return np.column_stack((radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(count, -10.0)))


LAYOUTS = {
    "grid": grid_ned_m(8, 8),
    "article's spacing": grid_ned_m(8, 8, 2.5, 8.5),
    "line": grid_ned_m(1, 16),
    "ring": ring_ned_m(32),
    "anyhow": np.random.default_rng(0).uniform(0.0, 60.0, (64, 3)),
}


@pytest.mark.parametrize("nearest", [0, 7, 20])
def test_all_are_neighbours_in_a_small_formation(nearest):
    near = Neighbourhood(3, grid_ned_m(2, 4), nearest)
    assert near.whole
    assert near.rows == list(range(8))
    assert near.members.tolist() == list(range(8))
    assert near.own == 3


def test_neighbours_are_the_nearest_and_the_relation_is_symmetric():
    places = grid_ned_m(1, 6) * (1.0, 1.0, 0.0)
    places[5, 1] = 100.0  # far from all, but two are its nearest
    found = linked(places, 2)
    assert [np.flatnonzero(row).tolist() for row in found] == [
        [1, 2], [0, 2], [0, 1, 3, 4], [2, 4, 5], [2, 3, 5], [3, 4],
    ]  # fmt: skip
    near = Neighbourhood(3, places, 2)
    assert not near.whole
    assert near.members.tolist() == [2, 3, 4, 5]
    assert near.rows == [None, None, 0, 1, 2, 3]
    assert near.own == 1


@pytest.mark.parametrize("places", LAYOUTS.values(), ids=LAYOUTS)
def test_all_compute_the_same_neighbours(places):
    found = linked(places, 6)
    assert (found == found.T).all()
    assert not found.diagonal().any()
    assert found.sum(axis=1).min() >= 6
    for station in range(len(places)):
        assert Neighbourhood(station, places, 6).linked.tolist() == found.tolist()


@pytest.mark.parametrize("stations", [9, 16])
def test_each_slot_belongs_to_one_pair_of_neighbours(stations):
    found = linked(grid_ned_m(stations // 3, 3)[:stations] if stations == 9 else grid_ned_m(4, 4), 4)
    policies = [
        ScheduledRanging(
            station=i, stations=stations, slot_us=4_000, airtime=0.1, measurement_var_m2=0.01, linked=found
        )
        for i in range(stations)
    ]
    pairs = int(found.sum()) // 2
    requests = [
        (at_us // 4_000, frozenset({i, peer}))
        for i, policy in enumerate(policies)
        for at_us, peer in policy.due(0, pairs * 4_000, range(stations).__contains__)
        if not policy.on_result(peer, ended_us=at_us)
    ]
    slots = [slot for slot, _ in requests]
    assert len(set(slots)) == len(slots)  # no two stations in one
    assert {pair for _, pair in requests} <= {frozenset(p) for p in np.argwhere(found).tolist()}
    assert max(slots) < pairs
    assert len(requests) >= pairs // 2  # at most two sessions of a station are open at once


@pytest.mark.parametrize("places", LAYOUTS.values(), ids=LAYOUTS)
@pytest.mark.parametrize("nearest", [6, 12])
def test_a_round_reduces_all_but_rigid_motions_of_the_whole(places, nearest):
    """A round is linear in all positions: all but three eigenvalues are inside the unit circle."""
    there_m = places[:, :2]
    count = len(there_m)
    found = linked(places, nearest)
    step = np.zeros((2 * count, 2 * count))
    for column, moved_m in enumerate(1e-3 * np.eye(2 * count).reshape(-1, count, 2)):
        for station in range(count):
            rows = [*np.flatnonzero(found[station]), station]
            step[2 * station : 2 * station + 2, column] = 1e3 * np.array(
                laid_onto(there_m[rows], moved_m[rows])
            )
    sizes = np.sort(np.abs(np.linalg.eigvals(step)))[::-1]
    np.testing.assert_allclose(sizes[:3], 1.0, atol=1e-6)
    assert sizes[3] < 0.999


def test_alignment_to_the_neighbours_is_exact_and_robust_to_a_misfit():
    pos_m = grid_ned_m(3, 4)[:, :2]
    turned_m = 0.02 * (pos_m - pos_m[4])[:, ::-1] * (-1.0, 1.0) + (3.0, -2.0)
    np.testing.assert_allclose(laid_onto(pos_m, turned_m), turned_m[-1], atol=1e-9)
    turned_m[2] += (1e4, 0.0)
    assert np.linalg.norm(np.subtract(laid_onto(pos_m, turned_m), turned_m[-1])) < MISFIT_M


def fly(places, **config):
    w = SwarmWorld(places_ned_m=places, seed=1, config=OnboardConfig(ranging="scheduled", **config))
    w.run_until(lambda w: w.formed(), limit_s=40.0)
    since_s = w.now_us * 1e-6
    w.run(10.0)
    return w, since_s


def test_a_formation_of_neighbourhoods_keeps_its_shape():
    places = grid_ned_m(4, 6)
    w, since_s = fly(places, neighbours=6, ranging_airtime=0.3)
    assert max(app.application.localisation.count for app in w.apps) < 14
    truth, estimates = w.flown(since_s=since_s)
    assert rms([shape_errors_m(row, places) for row in truth]) < 0.25
    assert rms([shape_errors_m(*rows) for rows in zip(estimates, truth, strict=True)]) < 0.2
    assert w.least_distance_m > 3.0
    # The whole follows the mean of all GPS positions with a lag.
    missed_m = (w.pos - places)[:, :2].mean(axis=0) + w.bias.mean(axis=0)
    assert np.linalg.norm(missed_m) < 0.5
