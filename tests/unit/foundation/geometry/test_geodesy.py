"""WGS 84 against values that do not come from the code under test."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foundation.geometry.geodesy import geodetic_to_ned, ned_to_geodetic, place_ned_m

ZURICH = {"origin_lat_deg": 47.397742, "origin_lon_deg": 8.545594, "origin_alt_m": 488.0}


def test_a_degree_of_arc_has_the_ellipsoids_length():
    # meridian radius of curvature at the equator a(1 - e^2) = 6 335 439.327 m, the equator's 6 378 137 m
    step_deg = 1e-3
    north = geodetic_to_ned(step_deg, 0.0, 0.0, origin_lat_deg=0.0, origin_lon_deg=0.0, origin_alt_m=0.0)
    east = geodetic_to_ned(0.0, step_deg, 0.0, origin_lat_deg=0.0, origin_lon_deg=0.0, origin_alt_m=0.0)
    assert north[0] == pytest.approx(6_335_439.327 * np.radians(step_deg), abs=1e-6)
    assert east[1] == pytest.approx(6_378_137.0 * np.radians(step_deg), abs=1e-6)


def test_the_tangent_plane_leaves_the_ground_by_the_earths_curvature():
    # a point 1 km away at the same altitude lies d^2 / 2R below the tangent plane: 78 mm
    lat_deg, lon_deg, _ = ned_to_geodetic([1000.0, 0.0, 0.0], **ZURICH)
    down_m = geodetic_to_ned(lat_deg, lon_deg, 488.0, **ZURICH)[2]
    assert down_m == pytest.approx(1000.0**2 / (2 * 6.37e6), rel=0.01)


@given(
    st.floats(-89.9, 89.9),
    st.floats(-180.0, 180.0),
    st.floats(-500.0, 9000.0),
    st.tuples(*[st.floats(-1000.0, 1000.0)] * 3),
)
def test_round_trip_is_within_a_millimetre_anywhere(lat_deg, lon_deg, alt_m, pos_ned_m):
    origin = {"origin_lat_deg": lat_deg, "origin_lon_deg": lon_deg, "origin_alt_m": alt_m}
    back = geodetic_to_ned(*ned_to_geodetic(pos_ned_m, **origin), **origin)
    assert np.abs(back - pos_ned_m).max() < 1e-6


def test_arrays_and_scalars_have_equal_results():
    points = np.random.default_rng(1).uniform(-500.0, 500.0, (4, 2, 3))
    lat_deg, lon_deg, alt_m = ned_to_geodetic(points, **ZURICH)
    assert lat_deg.shape == (4, 2)
    ned = geodetic_to_ned(lat_deg, lon_deg, alt_m, **ZURICH)
    one = geodetic_to_ned(float(lat_deg[3, 1]), float(lon_deg[3, 1]), float(alt_m[3, 1]), **ZURICH)
    assert ned.shape == (4, 2, 3)
    assert np.allclose(one, points[3, 1], atol=1e-6, rtol=0.0)
    assert np.allclose(ned, points, atol=1e-6, rtol=0.0)


@settings(deadline=None)  # the first one loads the kernel
@given(
    st.floats(-90.0, 90.0), st.floats(-180.0, 180.0), st.floats(-500.0, 9000.0),
    st.tuples(*[st.floats(-3000.0, 3000.0)] * 3),
)  # fmt: skip
def test_single_point_matches_the_array_function(lat_deg, lon_deg, alt_m, pos_ned_m):
    """But for rounding, which at the size of the earth comes to nanometres."""
    origin = {"origin_lat_deg": lat_deg, "origin_lon_deg": lon_deg, "origin_alt_m": alt_m}
    point = [float(number) for number in ned_to_geodetic(pos_ned_m, **origin)]
    alone = place_ned_m(*point, lat_deg, lon_deg, alt_m)
    assert np.abs(np.subtract(alone, geodetic_to_ned(*point, **origin))).max() < 2e-8
    interpreted = getattr(place_ned_m, "py_func", place_ned_m)
    assert alone == interpreted(*point, lat_deg, lon_deg, alt_m)


def test_directions():
    lat_deg, lon_deg, alt_m = ned_to_geodetic([10.0, 20.0, -30.0], **ZURICH)
    assert lat_deg > ZURICH["origin_lat_deg"]
    assert lon_deg > ZURICH["origin_lon_deg"]
    assert alt_m == pytest.approx(518.0, abs=1e-3)
