"""Feeds of an end-fire array with position noise: phases and rows."""

from itertools import islice

import numpy as np
import pytest
from msgspec import structs

from antenna.lab.formations import Disorder, draws
from antenna.model.config import AntennaConfig
from antenna.model.excitation import end_fire, hansen_woodyard
from antenna.model.geometry import grid
from antenna.solvers.ports import feed
from harness.report.flown_array import antenna_snapshot

LAMBDA_M = 10.0
K_RAD_M = 2.0 * np.pi / LAMBDA_M
ROWS, APART_M = 4, 2.5
PLACES_M = grid(2 * ROWS, 2, 8.5, APART_M)
TRUTH = AntennaConfig(wavelength_m=LAMBDA_M, excitation="hansen_woodyard", feeds_for="truth")


def _expected(positions_m, rows, apart_m):
    """Phases that lag by k and 2.92 / N a row for every metre along y; the first row's is all elements'."""
    return np.exp(-1j * (K_RAD_M + 2.92 / (rows * apart_m)) * positions_m[:, 1])


def _equal_up_to_a_phase(found, expected):
    ratio = found / expected
    np.testing.assert_allclose(np.abs(ratio), 1.0, atol=1e-12)
    np.testing.assert_allclose(ratio, ratio[0], atol=1e-9)


def test_end_fire_contributions_add_up_along_y():
    moved_m = PLACES_M + np.random.default_rng(1).normal(0.0, 1.0, PLACES_M.shape)
    along_y = np.exp(1j * K_RAD_M * moved_m[:, 1]) @ end_fire(moved_m, LAMBDA_M)
    assert along_y == pytest.approx(len(moved_m))


def test_hansen_woodyard_phases_lag_per_row():
    _equal_up_to_a_phase(hansen_woodyard(PLACES_M, LAMBDA_M), _expected(PLACES_M, ROWS, APART_M))


@pytest.mark.parametrize("sigma_m", [0.01, 0.5, 2.0])
def test_position_noise_does_not_change_the_rows(sigma_m):
    """Rows are the formation's, and their lag is taken where each vehicle is, not where it should be.

    Without the places eight vehicles 0.5 m off would be up to eight rows.
    """
    moved_m = PLACES_M + np.random.default_rng(2).normal(0.0, sigma_m, PLACES_M.shape)
    expected = _expected(moved_m, ROWS, APART_M)
    _equal_up_to_a_phase(hansen_woodyard(moved_m, LAMBDA_M, PLACES_M), expected)
    _equal_up_to_a_phase(feed(moved_m, TRUTH, places_m=PLACES_M), expected)


def test_position_noise_does_not_make_a_single_row_end_fire():
    row_m = grid(4, 4, 8.5, 0.0)
    moved_m = row_m + np.random.default_rng(3).normal(0.0, 2.0, row_m.shape)
    with pytest.raises(ValueError, match="two rows or more"):
        feed(moved_m, TRUTH, places_m=row_m)
    with pytest.raises(ValueError, match="two rows or more"):
        next(draws(row_m, TRUTH, Disorder(sigma_m=2.0)))


def test_random_formations_keep_the_nominal_rows():
    for one in islice(draws(PLACES_M, TRUTH, Disorder(sigma_m=0.7)), 5):
        _equal_up_to_a_phase(one.voltages, _expected(one.centres_m, ROWS, APART_M))


@pytest.mark.parametrize("feeds_for", ["truth", "estimates"])
def test_flown_formation_keeps_the_nominal_rows(feeds_for):
    """North is +y of a formation that heads there, east +x."""
    rng = np.random.default_rng(4)
    places_ned_m = np.stack([PLACES_M[:, 1], PLACES_M[:, 0], np.full(len(PLACES_M), -10.0)], axis=1)
    true_ned_m, believed_ned_m = (places_ned_m + rng.normal(0.0, 0.7, PLACES_M.shape) for _ in range(2))
    config = structs.replace(TRUTH, feeds_for=feeds_for)
    upright_q = np.tile([1.0, 0.0, 0.0, 0.0], (len(PLACES_M), 1))
    snapshot = antenna_snapshot(
        true_ned_m, upright_q, places_ned_m, 0.0, config, believed_pos_ned_m=believed_ned_m
    )
    fed_ned_m = true_ned_m if feeds_for == "truth" else believed_ned_m
    _equal_up_to_a_phase(snapshot.voltages, _expected(fed_ned_m[:, [1, 0, 2]], ROWS, APART_M))
