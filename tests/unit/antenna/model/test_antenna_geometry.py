import numpy as np
import pytest
from antenna_arrays import vertical_snapshot
from antenna_hertzian import gain_dbi

from antenna.model.clearance import check_apart, segment_distance_m
from antenna.model.elements import dipole
from antenna.model.excitation import end_fire
from antenna.model.geometry import ElementsTouch, Snapshot, along, grid


def test_article_grid_is_four_by_two_about_the_origin():
    places_m = grid(8, 4, 8.5, 2.5)
    np.testing.assert_allclose(places_m[:4, 0], [-12.75, -4.25, 4.25, 12.75])
    np.testing.assert_allclose(places_m[4:, 0], places_m[:4, 0])
    np.testing.assert_allclose(places_m[:, 1], [-1.25] * 4 + [1.25] * 4)
    np.testing.assert_array_equal(places_m[:, 2], 0.0)


def test_incomplete_grid_has_the_positions_of_the_complete_one():
    np.testing.assert_array_equal(grid(6, 4, 8.5, 2.5), grid(8, 4, 8.5, 2.5)[:6])


def test_longer_grid_grows_along_endfire():
    places_m = grid(64, 4, 8.5, 2.5)
    assert len(np.unique(places_m.round(9), axis=0)) == 64
    assert np.ptp(places_m[:, 0]) == pytest.approx(3 * 8.5)
    assert np.ptp(places_m[:, 1]) == pytest.approx(15 * 2.5)
    np.testing.assert_allclose(places_m.mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize(("count", "columns"), [(0, 4), (4, 0)])
def test_empty_grid_is_rejected(count, columns):
    with pytest.raises(ValueError):
        grid(count, columns, 1.0, 1.0)


def test_endfire_feeds_lag_by_the_travel_time_along_y():
    voltages = end_fire(grid(8, 4, 8.5, 2.5), 10.0)
    np.testing.assert_allclose(np.abs(voltages), 1.0)
    np.testing.assert_allclose(np.angle(voltages[4:] / voltages[:4], deg=True), -90.0)
    np.testing.assert_allclose(voltages[:4], voltages[0])


def test_feeds_add_up_in_the_main_direction_and_cancel_behind():
    ideal = vertical_snapshot(grid(8, 4, 8.5, 2.5), 10.0)
    assert gain_dbi(ideal, 10.0, 90.0, 90.0) == pytest.approx(13.280, abs=0.001)
    assert gain_dbi(ideal, 10.0, 90.0, 270.0) < -100.0


def _segment(centre, direction, length=2.0):
    half = 0.5 * length * np.array(direction) / np.linalg.norm(direction)
    return np.array(centre) - half, np.array(centre) + half


@pytest.mark.parametrize(
    ("second", "distance_m"),
    [
        (_segment([0.0, 0.3, 0.0], [1.0, 0.0, 0.0]), 0.3),  # crossed
        (_segment([0.3, 0.0, 0.0], [0.0, 0.0, 1.0]), 0.3),  # beside
        (_segment([0.3, 0.4, 3.0], [0.0, 0.0, 1.0]), np.hypot(0.5, 1.0)),  # parallel, shifted past the end
        (_segment([0.0, 0.0, 2.5], [0.0, 0.0, 1.0]), 0.5),  # in line
        (_segment([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), 0.0),  # the same
        (_segment([3.0, 0.0, 1.0], [1.0, 0.0, 0.0]), 2.0),  # end towards end
        (_segment([0.0, 1.0, 2.0], [0.0, 1.0, 0.0]), 1.0),  # end over end
    ],
)
def test_segment_distance_of_known_cases(second, distance_m):
    first = _segment([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    assert segment_distance_m(*first, *second) == pytest.approx(distance_m, abs=1e-12)
    assert segment_distance_m(*second, *first) == pytest.approx(distance_m, abs=1e-12)


def test_segment_distance_is_that_of_the_nearest_of_many_points():
    rng = np.random.default_rng(5)
    part = np.linspace(0.0, 1.0, 301)[:, np.newaxis]
    for _ in range(30):
        a, b, c, d = rng.normal(size=(4, 3))
        first, second = a + part * (b - a), c + part * (d - c)
        sampled = np.linalg.norm(first[:, np.newaxis] - second, axis=-1).min()
        distance = segment_distance_m(a, b, c, d)
        assert distance <= sampled + 1e-12
        assert sampled - distance < 0.02


def test_touching_elements_are_reported():
    centres_m = grid(8, 4, 8.5, 2.5)
    centres_m[6] = centres_m[3] + [0.0001, 0.0, 0.03]
    snapshot = vertical_snapshot(centres_m, 10.0)
    with pytest.raises(ElementsTouch, match="elements 3 and 6 touch") as caught:
        check_apart(snapshot, dipole(0.05, 0.0002, 9), grounded=False)
    assert (caught.value.first, caught.value.second) == (3, 6)
    assert caught.value.distance_m == pytest.approx(0.0001)
    check_apart(snapshot, dipole(0.02, 0.0002, 9), grounded=False)  # shorter ones pass each other in height


def test_element_that_touches_the_ground_is_reported():
    places_m = grid(8, 4, 8.5, 2.5) + np.array([0.0, 0.0, 1.0])
    places_m[2, 2] = 0.02
    snapshot = vertical_snapshot(places_m, 10.0)
    with pytest.raises(
        ElementsTouch, match=r"element 2 touches the ground: its lowest point is at -0\.005 m"
    ):
        check_apart(snapshot, dipole(0.05, 0.0002, 9), grounded=True)
    check_apart(snapshot, dipole(0.05, 0.0002, 9), grounded=False)
    check_apart(snapshot, dipole(0.03, 0.0002, 9), grounded=True)


def test_rotations_along_axes_are_the_shortest_turns():
    rng = np.random.default_rng(6)
    axes = rng.normal(size=(50, 3))
    axes[:2] = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rotations = along(axes)
    np.testing.assert_allclose(rotations[:, :, 2], axes, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    # of a turn by alpha the trace is 1 + 2 cos alpha, and alpha is the angle between z and the axis
    np.testing.assert_allclose(np.trace(rotations, axis1=1, axis2=2), 1.0 + 2.0 * axes[:, 2], atol=1e-12)


def _good():
    return {
        "centres_m": np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
        "rotations": np.tile(np.eye(3), (2, 1, 1)),
        "voltages": np.ones(2, complex),
    }


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("centres_m", np.zeros((0, 3))),
        ("centres_m", np.zeros((3, 3))),
        ("centres_m", np.full((2, 3), np.nan)),
        ("rotations", np.ones((2, 3, 3))),
        ("rotations", np.tile(np.diag([1.0, 1.0, -1.0]), (2, 1, 1))),
        ("rotations", np.full((2, 3, 3), np.nan)),
        ("voltages", np.zeros(2, complex)),
        ("voltages", np.array([1.0, np.inf])),
    ],
)
def test_invalid_snapshots_are_rejected(field, value):
    Snapshot(**_good())
    with pytest.raises(ValueError):
        Snapshot(**(_good() | {field: value}))
