"""The geofence against independent geometry: winding numbers, half planes, borders sampled as points. 5 s."""

from math import atan2, cos, hypot, inf, pi, radians, sin

import msgspec
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from autopilot.commander.geofence import (
    PATH_SAMPLES,
    Breach,
    BreachKind,
    FenceCircle,
    FencePolygon,
    FenceShape,
    Geofence,
    GeofenceParams,
    Origin,
    _Polygon,
    _polygon_fault,
)
from foundation.geometry.geodesy import SEMI_MAJOR_AXIS_M, geodetic_to_ned, ned_to_geodetic

SITE = Origin(47.397742, 8.545594, 488.0)
HOME = (0.0, 0.0, 0.0)
NO_LIMITS = GeofenceParams()
SQUARE_M = ((-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0))

metres = st.floats(-300.0, 300.0)
points = st.tuples(metres, metres)


@st.composite
def stars(draw, *, most=9):
    """Simple polygons, possibly not convex: vertices around a centre, in the order of their bearing."""
    count = draw(st.integers(3, most))
    turns = draw(st.lists(st.floats(0.1, 1.0), min_size=count, max_size=count))
    bearings = np.cumsum(turns) / sum(turns) * 2.0 * pi
    assume(np.diff(np.append(bearings, bearings[0] + 2.0 * pi)).max() < 0.95 * pi)  # the centre is inside
    radii = [draw(st.floats(20.0, 200.0)) for _ in range(count)]
    north_m, east_m = draw(st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)))
    vertices = [(north_m + r * cos(b), east_m + r * sin(b)) for r, b in zip(radii, bearings, strict=True)]
    return tuple(vertices[::-1] if draw(st.booleans()) else vertices)


@st.composite
def convex_polygons(draw):
    """Vertices on a circle."""
    count = draw(st.integers(3, 8))
    turns = draw(st.lists(st.floats(0.2, 1.0), min_size=count, max_size=count))
    bearings = np.cumsum(turns) / sum(turns) * 2.0 * pi
    radius_m = draw(st.floats(10.0, 250.0))
    return tuple((radius_m * cos(b), radius_m * sin(b)) for b in bearings.tolist())


def winding(point, vertices):
    """Sum of the angles subtended by the edges, in turns."""
    total = 0.0
    for (a_n, a_e), (b_n, b_e) in zip(vertices, (*vertices[1:], vertices[0]), strict=True):
        a_n, a_e, b_n, b_e = a_n - point[0], a_e - point[1], b_n - point[0], b_e - point[1]
        total += atan2(a_n * b_e - a_e * b_n, a_n * b_n + a_e * b_e)
    return total / (2.0 * pi)


def distance_in_points_m(point, vertices, spacing_m):
    """Distance to the border sampled as points: too large by up to half the spacing."""
    nearest = inf
    for (a_n, a_e), (b_n, b_e) in zip(vertices, (*vertices[1:], vertices[0]), strict=True):
        shares = np.linspace(0.0, 1.0, 2 + int(hypot(b_n - a_n, b_e - a_e) / spacing_m))
        nearest = min(
            nearest,
            float(
                np.hypot(a_n + shares * (b_n - a_n) - point[0], a_e + shares * (b_e - a_e) - point[1]).min()
            ),
        )
    return nearest


def fence(*shapes, **params):
    return Geofence(GeofenceParams(**params), shapes)


def polygon(vertices_m, *, inclusion=True):
    return FencePolygon.of_site(vertices_m, inclusion=inclusion, site=SITE)


def circle(north_m, east_m, radius_m, *, inclusion=True):
    return FenceCircle.of_site(north_m, east_m, radius_m, inclusion=inclusion, site=SITE)


def margin_of(geofence, place, home, origin):
    """Return the distance to the nearest limit, infinite without a fence."""
    nearest = geofence.nearest(place, home, origin)
    return inf if nearest is None else nearest.margin_m


def at(north_m, east_m=0.0, up_m=10.0):
    return np.array((north_m, east_m, -up_m))


# ---- geometry


@settings(max_examples=400, deadline=None)
@given(stars(), points)
def test_inside_means_a_nonzero_winding_number(vertices, point):
    margin_m = margin_of(fence(polygon(vertices)), at(*point), HOME, SITE)
    if abs(margin_m) > 1e-3:
        assert (margin_m > 0.0) == (round(winding(point, vertices)) != 0)


@settings(max_examples=150, deadline=None)
@given(stars(), points)
def test_the_margin_is_the_distance_to_the_border(vertices, point):
    margin_m = margin_of(fence(polygon(vertices)), at(*point), HOME, SITE)
    assert distance_in_points_m(point, vertices, 0.2) == pytest.approx(abs(margin_m), abs=0.11)


@settings(max_examples=200, deadline=None)
@given(convex_polygons(), points)
def test_inside_a_convex_polygon_the_margin_is_that_of_the_nearest_half_plane(vertices, point):
    """Vertices are ordered from north to east: the inside is on the right of every edge."""
    depths = []
    for (a_n, a_e), (b_n, b_e) in zip(vertices, (*vertices[1:], vertices[0]), strict=True):
        to_n, to_e = b_n - a_n, b_e - a_e
        depths.append((to_n * (point[1] - a_e) - to_e * (point[0] - a_n)) / hypot(to_n, to_e))
    margin_m = margin_of(fence(polygon(vertices)), at(*point), HOME, SITE)
    if min(depths) > 0.0:
        assert margin_m == pytest.approx(min(depths), abs=1e-3)
    else:
        assert margin_m <= 1e-3


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=3, max_size=7, unique=True),
    st.tuples(st.integers(-4, 4), st.integers(-4, 4)),
)
def test_a_ray_through_vertices_counts_them_once(vertices, point):
    """On a grid the ray to the north often meets vertices and runs along edges."""
    corners_m = np.array(vertices, float)
    assume(_polygon_fault(corners_m) is None)
    inside_m = _Polygon(corners_m).inside_m(*point)
    if inside_m != 0.0:
        assert (inside_m > 0.0) == (round(winding(point, vertices)) != 0)


@settings(max_examples=200, deadline=None)
@given(stars(), points)
def test_an_exclusion_is_the_opposite_of_an_inclusion(vertices, point):
    place = at(*point)
    including = margin_of(fence(polygon(vertices)), place, HOME, SITE)
    assert margin_of(fence(polygon(vertices, inclusion=False)), place, HOME, SITE) == -including


@settings(max_examples=200, deadline=None)
@given(points, points, st.floats(1.0, 200.0))
def test_circles_are_plane_geometry_on_the_site(centre, point, radius_m):
    margin_m = margin_of(fence(circle(*centre, radius_m)), at(*point), HOME, SITE)
    distance_m = hypot(point[0] - centre[0], point[1] - centre[1])
    assert margin_m == pytest.approx(radius_m - distance_m, abs=1e-4)


@settings(max_examples=150, deadline=None)
@given(stars(), points, points)
def test_the_margin_changes_by_at_most_the_distance_flown(vertices, one, other):
    """The predicted braking path relies on this."""
    both = fence(polygon(vertices), circle(0.0, 100.0, 50.0, inclusion=False), max_horizontal_m=200.0)
    change_m = abs(margin_of(both, at(*one), HOME, SITE) - margin_of(both, at(*other), HOME, SITE))
    assert change_m <= hypot(one[0] - other[0], one[1] - other[1]) + 1e-6


# ---- on the earth


@settings(max_examples=100, deadline=None)
@given(
    st.floats(-80.0, 80.0),
    st.floats(-180.0, 180.0),
    stars(),
    points,
    st.tuples(st.floats(-2000.0, 2000.0), st.floats(-2000.0, 2000.0), st.floats(-50.0, 50.0)),
)
def test_the_margin_does_not_depend_on_the_estimators_origin(lat_deg, lon_deg, vertices, point, offset_ned_m):
    """Planes 3 km apart are tilted by 0.5 mrad: a height of 50 m shifts by 2.5 cm, positions by far less."""
    site = Origin(lat_deg, lon_deg, 100.0)
    there = [float(value) for value in ned_to_geodetic(offset_ned_m, **origin_of(site))]
    other = Origin(*there)
    shape = FencePolygon.of_site(vertices, inclusion=True, site=site)
    place = np.array((*point, 0.0))
    shapes = fence(shape)
    from_other = geodetic_to_ned(*ned_to_geodetic(place, **origin_of(site)), **origin_of(other))
    one = margin_of(shapes, place, HOME, site)
    assert margin_of(shapes, from_other, HOME, other) == pytest.approx(one, abs=0.05)
    assert margin_of(shapes, place, HOME, site) == one


def origin_of(origin):
    return {
        "origin_lat_deg": origin.lat_deg,
        "origin_lon_deg": origin.lon_deg,
        "origin_alt_m": origin.alt_m,
    }


@settings(max_examples=100, deadline=None)
@given(st.floats(-75.0, 75.0), st.floats(-170.0, 170.0), points)
def test_the_antimeridian_is_no_special_case(lat_deg, lon_deg, point):
    """By symmetry a fence that is rotated about the earth's axis keeps its margins."""
    margins = []
    for centre_deg in (180.0, lon_deg):
        vertices = [
            (lat_deg + 0.001 * north, (centre_deg + 0.001 * east + 180.0) % 360.0 - 180.0)
            for north, east in ((-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0))
        ]
        shape = FencePolygon(vertices=tuple(vertices), inclusion=True)
        margins.append(margin_of(fence(shape), at(*point), HOME, Origin(lat_deg, centre_deg, 0.0)))
    assert margins[0] == pytest.approx(margins[1], abs=1e-5)


def test_a_fence_around_the_pole_contains_it():
    """At 89.99 degrees a square about the pole has corners 1117 m and sides 790 m away from it."""
    shape = FencePolygon(
        vertices=tuple((89.99, lon_deg) for lon_deg in (0.0, 90.0, 180.0, -90.0)), inclusion=True
    )
    margin_m = margin_of(fence(shape), (0.0, 0.0, 0.0), HOME, Origin(90.0, 0.0, 0.0))
    polar_radius_m = SEMI_MAJOR_AXIS_M / (1.0 - 1.0 / 298.257223563)  # of curvature, a^2 / b
    assert margin_m == pytest.approx(polar_radius_m * radians(0.01) / 2.0**0.5, rel=1e-4)


@pytest.mark.parametrize("away_deg", [5.0, 60.0, 90.0, 120.0, 179.0, 180.0])
def test_a_distant_fence_stays_distant_in_the_local_plane(away_deg):
    """The antipode of the site also has north and east of 0."""
    lat_deg = SITE.lat_deg - away_deg
    lat_deg, lon_deg = (
        (lat_deg, SITE.lon_deg) if lat_deg >= -90.0 else (-180.0 - lat_deg, SITE.lon_deg - 180.0)
    )
    far = FenceCircle(lat_deg=lat_deg, lon_deg=lon_deg, radius_m=1_000.0, inclusion=True)
    chord_m = 2.0 * SEMI_MAJOR_AXIS_M * sin(radians(away_deg) / 2.0)
    margin_m = margin_of(fence(far), (0.0, 0.0, 0.0), HOME, SITE)
    assert margin_m == pytest.approx(1_000.0 - chord_m, rel=0.01)


# ---- the rule


def test_every_limit_has_its_breach():
    limits = GeofenceParams(max_horizontal_m=100.0, max_vertical_m=50.0)
    shapes = (circle(0.0, 0.0, 80.0), circle(30.0, 0.0, 5.0, inclusion=False), polygon(SQUARE_M))
    home = (5.0, 0.0, 2.0)

    def breach(north_m, up_m=10.0):
        found = Geofence(limits, shapes).check(at(north_m, 0.0, up_m), home, SITE)
        return found and (found.kind, found.shape, pytest.approx(found.depth_m, abs=1e-4))

    assert breach(0.0) is None
    assert breach(0.0, 49.0) == (BreachKind.MAX_ALTITUDE, None, 1.0)  # home is 2 m lower than the origin
    assert breach(28.0) == (BreachKind.ENTERED_EXCLUSION, 1, 3.0)
    assert breach(60.0) == (BreachKind.LEFT_INCLUSION, 2, 10.0)
    # every inclusion must contain the vehicle: at 90 m north the square is exceeded by 40 m, the circle by 10
    # m
    assert breach(90.0) == (BreachKind.LEFT_INCLUSION, 2, 40.0)
    far = Geofence(limits).check(at(-97.0), home, SITE)
    assert far == (BreachKind.MAX_DISTANCE, None, 2.0)
    assert far.text == "too far from home"
    assert Breach(BreachKind.LEFT_INCLUSION, 2, 0.0).text == "outside inclusion fence 2"


def test_a_position_on_the_border_is_a_breach():
    limits = fence(max_horizontal_m=100.0)
    assert limits.check(at(100.0), HOME, SITE) == (BreachKind.MAX_DISTANCE, None, 0.0)
    assert limits.check(at(np.nextafter(100.0, 0.0)), HOME, SITE) is None


def test_without_a_fence_everything_is_allowed_and_without_home_its_limits_are_ignored():
    assert margin_of(fence(), at(1e6), HOME, SITE) == inf
    assert fence().check(at(1e6, 1e6, 1e6), HOME, SITE) is None
    limits = fence(max_horizontal_m=10.0, max_vertical_m=10.0)
    assert limits.check(at(1e6), None, SITE) is None
    assert limits.check(at(1e6), HOME, SITE).kind is BreachKind.MAX_DISTANCE


def test_changes_act_immediately():
    changing = fence(circle(0.0, 0.0, 80.0))
    assert changing.check(at(50.0), HOME, SITE) is None
    changing.params = GeofenceParams(max_horizontal_m=40.0)
    assert changing.check(at(50.0), HOME, SITE).kind is BreachKind.MAX_DISTANCE
    changing.params = NO_LIMITS
    changing.set_shapes([circle(0.0, 0.0, 20.0)])
    assert changing.check(at(50.0), HOME, SITE).kind is BreachKind.LEFT_INCLUSION
    changing.set_shapes([])
    assert changing.check(at(50.0), HOME, SITE) is None


# ---- braking


@settings(max_examples=200, deadline=None)
@given(st.floats(0.0, 20.0), st.floats(0.5, 8.0), st.floats(0.0, 2.0), st.floats(0.1, 49.0))
def test_the_braking_path_is_checked_to_its_end(speed_m_s, deceleration_m_s2, reaction_s, gap_m):
    """The vehicle stops after v t + v^2 / 2 a; the border is ``gap_m`` ahead."""
    way_m = speed_m_s * reaction_s + speed_m_s**2 / (2.0 * deceleration_m_s2)
    assume(abs(way_m - gap_m) > 1e-3)
    found = fence(polygon(SQUARE_M)).check_braking(
        at(50.0 - gap_m),
        (speed_m_s, 0.0, 0.0),
        HOME,
        SITE,
        deceleration_m_s2=deceleration_m_s2,
        reaction_s=reaction_s,
    )
    # within 50 - gap_m .. 50 the square's northern edge may not be the nearest, but it is the one ahead
    assert (found is not None) == (way_m > gap_m)


def test_the_braking_path_does_not_skip_an_exclusion():
    """20 m/s at 2 m/s^2 need 100 m; the wall from 40 to 42 m north is thicker than a step of the path."""
    wall_m = ((40.0, -30.0), (42.0, -30.0), (42.0, 30.0), (40.0, 30.0))
    assert 100.0 / PATH_SAMPLES < 2.0
    walled = fence(polygon(wall_m, inclusion=False))
    braking = {"home_pos_ned_m": HOME, "origin": SITE, "deceleration_m_s2": 2.0}
    assert walled.check(at(100.0), HOME, SITE) is None
    found = walled.check_braking(at(0.0), (20.0, 0.0, 0.0), **braking)
    assert found.kind is BreachKind.ENTERED_EXCLUSION
    assert walled.check_braking(at(0.0), (0.0, 20.0, 0.0), **braking) is None
    assert walled.check_braking(at(0.0), (0.0, 0.0, 0.0), **braking) is None
    # flying along a wall at a small distance is no breach, and takes a bounded number of steps
    assert walled.check_braking(at(39.9, -30.0), (0.0, 10.0, 0.0), **braking) is None


def test_climbing_is_predicted_too():
    limits = fence(max_vertical_m=50.0)
    braking = {"home_pos_ned_m": HOME, "origin": SITE, "deceleration_m_s2": 2.0}
    assert limits.check_braking(at(0.0, 0.0, 45.0), (0.0, 0.0, -4.0), **braking) is None  # 4 m
    assert (
        limits.check_braking(at(0.0, 0.0, 45.0), (0.0, 0.0, -5.0), **braking).kind is BreachKind.MAX_ALTITUDE
    )


# ---- at the door


@settings(max_examples=200, deadline=None)
@given(convex_polygons(), st.data())
def test_a_polygon_with_two_vertices_exchanged_crosses_itself(vertices, data):
    """On a convex polygon of four or more vertices, exchanging neighbours makes their other edges cross."""
    assume(len(vertices) >= 4)
    i = data.draw(st.integers(0, len(vertices) - 1))
    mixed = list(vertices)
    mixed[i - 1], mixed[i] = mixed[i], mixed[i - 1]
    with pytest.raises(ValueError, match="border crosses itself"):
        polygon(mixed)


@pytest.mark.parametrize(
    ("vertices_m", "reason"),
    [
        (SQUARE_M[:2], "a fence of 2 vertices: 3 .. 1000 make a polygon"),
        (SQUARE_M + SQUARE_M[:1], "a fence's last vertex repeats the first, but a polygon closes by itself"),
        ((*SQUARE_M[:2], *SQUARE_M[1:]), "a fence's vertices 1 and 2 are the same place"),
        (((0, 0), (10, 0), (20, 0)), "a fence's border folds back at vertex"),
        (
            ((0, 0), (0, 10), (10, 0), (10, 10)),
            "a fence's border crosses itself: from vertex 1 to 2 and from 3 to 0",
        ),
        # the second notch ends on the first edge, so the inside has two parts
        (((0, 0), (0, 20), (20, 20), (0, 10), (20, 0)), "a fence's border crosses itself"),
        (((0, 0), (0, 10), (150_000, 0)), "a fence's vertices are more than 100 km apart"),
    ],
)
def test_a_polygon_that_is_not_simple_is_rejected_with_the_reason(vertices_m, reason):
    with pytest.raises(ValueError) as error:
        polygon(vertices_m)
    assert str(error.value).startswith(reason)


@pytest.mark.parametrize(
    ("vertices_m", "simple"),
    [
        (
            ((0, 0), (0, 10), (10, 10), (10, 20), (0, 20), (0, 30), (-20, 30), (-20, 0)),
            True,
        ),  # collinear edges
        (((0, 0), (0, 20), (20, 20), (0, 10), (20, 0)), False),  # a vertex on another edge
        (((0, 0), (0, 10), (10, 10), (0, 10), (0, 20), (-10, 10)), False),  # there and back, and on
        (((0, 0), (0, 30), (10, 30), (0, 20), (0, 10), (10, 0)), False),  # one edge along another
    ],
)
def test_touching_borders_differ_from_collinear_borders(vertices_m, simple):
    assert (_polygon_fault(np.array(vertices_m, float)) is None) == simple


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"lat_deg": 91.0}, "a fence's centre: 91, 8 is not a valid latitude and longitude"),
        ({"lon_deg": float("nan")}, "a fence's centre: 47, nan is not a valid latitude and longitude"),
        ({"radius_m": 0.0}, "a fence's radius of 0 m is outside 0 .. 100000 m"),
        ({"radius_m": float("nan")}, "a fence's radius of nan m is outside 0 .. 100000 m"),
        ({"radius_m": 1e9}, "a fence's radius of 1e+09 m is outside 0 .. 100000 m"),
    ],
)
def test_an_invalid_circle_is_rejected_with_the_reason(fields, reason):
    with pytest.raises(ValueError) as error:
        FenceCircle(**{"lat_deg": 47.0, "lon_deg": 8.0, "radius_m": 10.0, "inclusion": True, **fields})
    assert str(error.value) == reason


def test_shapes_are_read_from_a_file_with_errors_that_name_the_field():
    square = [[47.0, 8.0], [47.0, 8.01], [47.01, 8.01], [47.01, 8.0]]
    shape = msgspec.convert({"type": "polygon", "vertices": square, "inclusion": True}, FenceShape)
    assert isinstance(shape, FencePolygon)
    bad = {"type": "polygon", "vertices": [square[0], square[2], square[1], square[3]], "inclusion": True}
    with pytest.raises(msgspec.ValidationError, match=r"crosses itself.*\$\[0\]"):
        msgspec.convert([bad], list[FenceShape])


def test_a_thousand_vertices_are_checked_fast():
    bearings = np.linspace(0.0, 2.0 * pi, 1000, endpoint=False)
    ring = polygon([(200.0 * cos(b), 200.0 * sin(b)) for b in bearings])
    # the nearest points of a regular polygon's border are the midpoints of the edges: r cos(pi / n)
    assert margin_of(fence(ring), at(0.0), HOME, SITE) == pytest.approx(200.0 * cos(pi / 1000), abs=1e-3)
