"""The predicted error of a formation's shape: that of the filter, for places of any form."""

import numpy as np
import pytest

from autopilot.onboard.localisation.kernels import STATES
from autopilot.onboard.localisation.uncertainty import shape_variance
from autopilot.onboard.predicted_shape import SHAPE_STD_M, linked, predicted_shape_std_m, width_m

GPS_M, DISTANCE_M = 1.5, 0.05


def predicted(places, nearest=0):
    places_m = np.array(places, float)
    near = linked(places_m, nearest)
    return predicted_shape_std_m(places_m, near, gps_std_m=GPS_M, distance_std_m=DISTANCE_M)


def line(count, spacing_m=8.5, heading_rad=0.0):
    along_m = spacing_m * np.arange(count)
    return np.stack([along_m * np.cos(heading_rad), along_m * np.sin(heading_rad), np.full(count, -10.0)], 1)


def grid(columns, rows):
    return np.array([(2.5 * row, 8.5 * column, -10.0) for row in range(rows) for column in range(columns)])


def ring(count, radius_m=6.0):
    angle_rad = 2.0 * np.pi * np.arange(count) / count
    return radius_m * np.stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros(count)], 1)


def updated_cov(places_m):
    """Return the filter's covariance (5N, 5N) after one distance of each pair, by scalar Kalman updates."""
    count = len(places_m)
    cov = np.eye(STATES * count) * GPS_M**2
    for i in range(count):
        for j in range(i):
            way_m = places_m[i] - places_m[j]
            slopes = np.zeros(STATES * count)
            slopes[STATES * i : STATES * i + 2] = way_m[:2] / np.linalg.norm(way_m)
            slopes[STATES * j : STATES * j + 2] = -way_m[:2] / np.linalg.norm(way_m)
            gain = cov @ slopes / (slopes @ cov @ slopes + DISTANCE_M**2)
            cov -= np.outer(gain, slopes @ cov)
    return cov


@pytest.mark.parametrize(
    "places_m", [line(2), line(4), grid(2, 2), grid(4, 2), ring(5), np.vstack([line(3), [[3.0, 1.0, -14.0]]])]
)
def test_it_is_the_shape_error_that_the_filters_covariance_gives(places_m):
    among = np.arange(len(places_m))
    by_filter_m2 = shape_variance.py_func(places_m, updated_cov(places_m), among)
    assert predicted(places_m) == pytest.approx(np.sqrt(by_filter_m2), rel=1e-6)


@pytest.mark.parametrize("count", [3, 4, 8, 20])
@pytest.mark.parametrize("heading_rad", [0.0, 0.7])
def test_on_a_line_the_errors_across_it_are_those_of_gps(count, heading_rad):
    """Of N errors across it a shift and a turn remove two."""
    places_m = line(count, heading_rad=heading_rad)
    assert predicted(places_m) == pytest.approx(GPS_M * np.sqrt((count - 2) / count), rel=2e-3)
    assert predicted(places_m) > SHAPE_STD_M
    assert width_m(places_m) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("spacing_m", [2.0, 8.5, 50.0])
def test_the_error_falls_with_the_distance_from_a_line(spacing_m):
    errors_m = []
    for off in (0.0, 0.01, 0.03, 0.1, 0.3, 1.0):
        places_m = line(3, spacing_m)
        places_m[1, 1] += off * spacing_m
        errors_m.append(predicted(places_m))
        assert width_m(places_m) <= off * spacing_m + 1e-9
    assert np.all(np.diff(errors_m) < 0.0)
    assert errors_m[0] > SHAPE_STD_M > errors_m[-1]


@pytest.mark.parametrize(
    "places_m", [line(1), line(2), grid(2, 1), ring(3), ring(12), grid(2, 2), grid(4, 2)]
)
def test_one_two_and_wide_formations_are_determined(places_m):
    assert predicted(places_m) < 0.1


def test_a_vertical_plane_is_a_line_from_above():
    """Its heights are known from the barometer; across it distances observe nothing."""
    wall_m = np.array([(0.0, 5.0 * column, -10.0 - 4.0 * row) for row in range(2) for column in range(4)])
    assert predicted(wall_m) > SHAPE_STD_M
    assert width_m(wall_m) == pytest.approx(0.0, abs=1e-9)


def test_of_two_uavs_one_above_the_other_nothing_horizontal_is_determined():
    assert predicted([(0.0, 0.0, -5.0), (0.0, 0.0, -9.0)]) == pytest.approx(GPS_M)


def test_position_and_heading_of_the_formation_have_no_influence():
    c, s = np.cos(0.4), np.sin(0.4)
    places_m = grid(4, 2)[:5]
    turned_m = places_m @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + (300.0, -40.0, 0.0)
    assert predicted(turned_m) == pytest.approx(predicted(places_m))
    assert width_m(turned_m) == pytest.approx(width_m(places_m))


def test_too_few_distances_determine_no_grid():
    assert predicted(grid(4, 2), nearest=2) > SHAPE_STD_M > predicted(grid(4, 2), nearest=4)
