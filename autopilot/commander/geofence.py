"""Geofence: where the vehicle is allowed to fly, and its distance from the border.

The rule is PX4's (src/modules/navigator/geofence.cpp): inside every inclusion and outside every exclusion,
nearer to home than GF_MAX_HOR_DIST and lower above it than GF_MAX_VER_DIST. A limit of 0 is disabled; without
a home position both limits are ignored. A point on a border is outside the fence. MAVLink's inclusion groups,
of which the vehicle has to be inside only one, are not supported, as in PX4. Shapes are unlimited in height.
Failsafes act on a breach.
"""

from collections.abc import Iterator, Sequence
from enum import Enum
from math import hypot, isfinite, sqrt
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from foundation.geometry.geodesy import geodetic_to_ned, ned_to_geodetic
from foundation.types import Array

EXTENT_MAX_M = 100_000.0
"""Greatest extent of a shape from its centre or first vertex, for which a plane approximates the earth."""
VERTICES_MAX = 1_000
SAME_PLACE_M = 0.01
"""The resolution of MAVLink's degE7."""
PATH_SAMPLES = 64
"""Steps in which a braking path is sampled; where it is safe they are longer."""

Vertex = tuple[float, float]
Vector = Array | Sequence[float]
_Ned = tuple[float, float, float]


class GeofenceParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits relative to home."""

    max_horizontal_m: Annotated[float, Meta(ge=0.0, le=10_000.0)] = 0.0
    """GF_MAX_HOR_DIST: greatest horizontal distance from home; 0: no limit"""
    max_vertical_m: Annotated[float, Meta(ge=0.0, le=10_000.0)] = 0.0
    """GF_MAX_VER_DIST: greatest height above home; 0: no limit"""
    predict: Annotated[int, Meta(ge=0, le=1)] = 0
    """GF_PREDICT: 1 checks the braking path, 0 only the present position"""


class Origin(NamedTuple):
    """Geodetic origin of a local NED frame."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class FenceCircle(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="circle"):
    """Circular fence. Raises ValueError if position or radius is invalid."""

    lat_deg: float
    lon_deg: float
    radius_m: float
    inclusion: bool

    def __post_init__(self) -> None:
        _require_place(self.lat_deg, self.lon_deg, "centre")
        if not 0.0 < self.radius_m <= EXTENT_MAX_M:
            raise ValueError(f"a fence's radius of {self.radius_m:g} m is outside 0 .. {EXTENT_MAX_M:g} m")

    @classmethod
    def of_site(
        cls, north_m: float, east_m: float, radius_m: float, *, inclusion: bool, site: Origin
    ) -> "FenceCircle":
        """Return a circle whose centre is in metres from the site's origin."""
        ((lat_deg, lon_deg),) = _geodetic([(north_m, east_m)], site)
        return cls(lat_deg=lat_deg, lon_deg=lon_deg, radius_m=radius_m, inclusion=inclusion)


class FencePolygon(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag="polygon"):
    """Simple polygonal fence. Raises ValueError if it is not a simple polygon, with vertices counted from 0.

    The border closes from the last to the first vertex; either orientation is valid. It may contain the
    antimeridian or a pole.
    """

    vertices: tuple[Vertex, ...]
    """Latitude and longitude, degrees"""
    inclusion: bool

    def __post_init__(self) -> None:
        if not 3 <= len(self.vertices) <= VERTICES_MAX:
            raise ValueError(f"a fence of {len(self.vertices)} vertices: 3 .. {VERTICES_MAX} make a polygon")
        for i, (lat_deg, lon_deg) in enumerate(self.vertices):
            _require_place(lat_deg, lon_deg, f"vertex {i}")
        # in the plane at the first vertex neither the antimeridian nor a pole is a special case
        fault = _polygon_fault(_local_m(self.vertices, Origin(*self.vertices[0], 0.0)))
        if fault is not None:
            raise ValueError(f"a fence's {fault}")

    @classmethod
    def of_site(cls, vertices_m: Sequence[Vertex], *, inclusion: bool, site: Origin) -> "FencePolygon":
        """Return a polygon of (north, east) vertices in metres from the site's origin."""
        return cls(vertices=tuple(_geodetic(vertices_m, site)), inclusion=inclusion)


FenceShape = FenceCircle | FencePolygon


class BreachKind(Enum):
    """Kind of the violated limit."""

    MAX_DISTANCE = "too far from home"
    MAX_ALTITUDE = "too high above home"
    LEFT_INCLUSION = "outside inclusion fence"
    ENTERED_EXCLUSION = "inside exclusion fence"


class Breach(NamedTuple):
    """A violated limit; of several, the one with the greatest depth."""

    kind: BreachKind
    shape: int | None
    """Index of the shape; None for the limits about home"""
    depth_m: float
    """Distance beyond the border, not negative"""

    @property
    def text(self) -> str:
        """Text for messages."""
        return self.kind.value if self.shape is None else f"{self.kind.value} {self.shape}"


class Margin(NamedTuple):
    """Distance to one limit."""

    margin_m: float
    """Distance to the border, negative outside the fence"""
    kind: BreachKind
    shape: int | None


class Geofence:
    """Geofence of one vehicle, for checks at 10 Hz. Positions are NED, metres, from ``origin``."""

    def __init__(self, params: GeofenceParams, shapes: Sequence[FenceShape] = ()) -> None:
        self.params = params
        self.shapes = tuple(shapes)
        self._origin: Origin | None = None
        self._local: tuple[_Circle | _Polygon, ...] = ()
        """The shapes in metres from ``_origin``."""

    def set_params(self, params: GeofenceParams) -> None:
        """Change the settings, in effect from the next check."""
        self.params = params

    def set_shapes(self, shapes: Sequence[FenceShape]) -> None:
        """Replace all shapes."""
        self.shapes = tuple(shapes)
        self._origin = None

    @property
    def has_limits(self) -> bool:
        """Return whether there is any limit."""
        params = self.params
        return bool(self.shapes) or max(params.max_horizontal_m, params.max_vertical_m) > 0.0

    def check(self, pos_ned_m: Vector, home_pos_ned_m: Vector | None, origin: Origin) -> Breach | None:
        """Return the breach at a finite position, or None."""
        return _breach(self.nearest(_floats(pos_ned_m), _home(home_pos_ned_m), origin))

    def first_beyond(
        self, places: Sequence[Vertex], down_m: Array, home_pos_ned_m: Vector, origin: Origin
    ) -> int | None:
        """Return the index of the first place at which a vehicle is not allowed, or None.

        Input: n latitudes and longitudes in degrees and ``down_m`` (n,) from the origin. The result for a
        place exactly on a polygon's border is unspecified.
        """
        params, home_m = self.params, _floats(home_pos_ned_m)
        north_m, east_m = np.ascontiguousarray(_local_m(places, origin).T)
        beyond = np.zeros(len(places), bool)
        if params.max_horizontal_m > 0.0:
            beyond |= np.hypot(north_m - home_m[0], east_m - home_m[1]) >= params.max_horizontal_m
        if params.max_vertical_m > 0.0:
            beyond |= home_m[2] - down_m >= params.max_vertical_m
        self._localise(origin)
        for shape, local in zip(self.shapes, self._local, strict=True):
            beyond |= local.contains(north_m, east_m) != shape.inclusion
        return int(beyond.argmax()) if beyond.any() else None

    def check_braking(
        self,
        pos_ned_m: Vector,
        vel_ned_m_s: Vector,
        home_pos_ned_m: Vector | None,
        origin: Origin,
        *,
        deceleration_m_s2: float,
        reaction_s: float = 0.0,
    ) -> Breach | None:
        """Return the breach on the path of a vehicle that brakes in a straight line after ``reaction_s``.

        The margin changes by at most the flown distance, so the path is sampled in steps of the margin.
        Overlaps shorter than the path divided by `PATH_SAMPLES` may be missed.
        """
        place_m, home_m = _floats(pos_ned_m), _home(home_pos_ned_m)
        vel_m_s = _floats(vel_ned_m_s)
        speed_m_s = sqrt(sum(v * v for v in vel_m_s))
        length_m = speed_m_s * reaction_s + speed_m_s**2 / (2.0 * deceleration_m_s2)
        flown_m = 0.0
        while True:
            share_s = flown_m / speed_m_s if speed_m_s > 0.0 else 0.0
            north_m, east_m, down_m = (p + v * share_s for p, v in zip(place_m, vel_m_s, strict=True))
            worst = self.nearest((north_m, east_m, down_m), home_m, origin)
            if worst is None or worst.margin_m <= 0.0:
                return _breach(worst)
            if flown_m >= length_m:
                return None
            flown_m = min(flown_m + max(worst.margin_m, length_m / PATH_SAMPLES), length_m)

    def nearest(self, pos_ned_m: _Ned, home_ned_m: _Ned | None, origin: Origin) -> Margin | None:
        """Return the margin to the nearest limit, or None without a fence."""
        return min(self._margins(pos_ned_m, home_ned_m, origin), key=lambda margin: margin[0], default=None)

    def _margins(self, pos_ned_m: _Ned, home_ned_m: _Ned | None, origin: Origin) -> Iterator[Margin]:
        north_m, east_m, down_m = pos_ned_m
        params = self.params
        if home_ned_m is not None:
            if params.max_horizontal_m > 0.0:
                distance_m = hypot(north_m - home_ned_m[0], east_m - home_ned_m[1])
                yield Margin(params.max_horizontal_m - distance_m, BreachKind.MAX_DISTANCE, None)
            if params.max_vertical_m > 0.0:
                height_m = home_ned_m[2] - down_m
                yield Margin(params.max_vertical_m - height_m, BreachKind.MAX_ALTITUDE, None)
        self._localise(origin)
        for i, (shape, local) in enumerate(zip(self.shapes, self._local, strict=True)):
            inside_m = local.inside_m(north_m, east_m)
            if shape.inclusion:
                yield Margin(inside_m, BreachKind.LEFT_INCLUSION, i)
            else:
                yield Margin(-inside_m, BreachKind.ENTERED_EXCLUSION, i)

    def _localise(self, origin: Origin) -> None:
        if origin != self._origin:
            self._origin = origin
            self._local = tuple(_localise(shape, origin) for shape in self.shapes)


def _floats(vector: Vector) -> _Ned:
    return float(vector[0]), float(vector[1]), float(vector[2])


def _home(vector: Vector | None) -> _Ned | None:
    return None if vector is None else _floats(vector)


def _breach(worst: Margin | None) -> Breach | None:
    if worst is None or worst.margin_m > 0.0:
        return None
    return Breach(worst.kind, worst.shape, -worst.margin_m)


def _require_place(lat_deg: float, lon_deg: float, what: str) -> None:
    if not (isfinite(lat_deg) and isfinite(lon_deg) and abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        raise ValueError(f"a fence's {what}: {lat_deg:g}, {lon_deg:g} is not a valid latitude and longitude")


# ---- shapes in the plane


class _Circle(NamedTuple):
    north_m: float
    east_m: float
    radius_m: float

    def inside_m(self, north_m: float, east_m: float) -> float:
        """Return the distance to the border, negative outside."""
        return self.radius_m - hypot(north_m - self.north_m, east_m - self.east_m)

    def contains(self, north_m: Array, east_m: Array) -> NDArray[np.bool_]:
        """Return for each place, (n,), whether it is inside; on the border is outside."""
        return np.asarray(np.hypot(north_m - self.north_m, east_m - self.east_m) < self.radius_m)


class _Polygon:
    """Edges of a polygon as arrays, each (n,): begin, direction and length."""

    def __init__(self, vertices_m: Array) -> None:
        """Compute the edges of (n, 2) north and east."""
        self._north_m, self._east_m = np.ascontiguousarray(vertices_m.T)
        edges_m = np.roll(vertices_m, -1, axis=0) - vertices_m
        self._to_north_m, self._to_east_m = np.ascontiguousarray(edges_m.T)
        self._length_squared_m2 = self._to_north_m**2 + self._to_east_m**2
        self._eastward = self._to_east_m > 0.0
        self._end_east_m = np.roll(self._east_m, -1)

    def inside_m(self, north_m: float, east_m: float) -> float:
        """Return the distance to the border, negative outside.

        A place is outside if a ray to the north crosses the border an even number of times.
        """
        from_north_m, from_east_m = north_m - self._north_m, east_m - self._east_m
        along = (from_north_m * self._to_north_m + from_east_m * self._to_east_m) / self._length_squared_m2
        along = np.minimum(np.maximum(along, 0.0), 1.0)
        off_north_m = from_north_m - along * self._to_north_m
        off_east_m = from_east_m - along * self._to_east_m
        distance_m = sqrt(float((off_north_m**2 + off_east_m**2).min()))
        # the border is north of the point where it crosses the point's meridian
        passes = (self._east_m <= east_m) != (self._end_east_m <= east_m)
        south_of = (from_north_m * self._to_east_m < from_east_m * self._to_north_m) == self._eastward
        inside = int(np.count_nonzero(passes & south_of)) % 2 == 1
        return distance_m if inside else -distance_m

    def contains(self, north_m: Array, east_m: Array) -> NDArray[np.bool_]:
        """Return for each place, (n,), whether it is inside, by the same ray test; loops over edges."""
        inside = np.zeros(len(north_m), bool)
        edges = zip(
            self._north_m.tolist(), self._east_m.tolist(), self._to_north_m.tolist(),
            self._to_east_m.tolist(), self._end_east_m.tolist(), self._eastward.tolist(), strict=True,
        )  # fmt: skip
        for from_north_m, from_east_m, to_north_m, to_east_m, end_east_m, eastward in edges:
            passes = (from_east_m <= east_m) != (end_east_m <= east_m)
            south_of = (north_m - from_north_m) * to_east_m < (east_m - from_east_m) * to_north_m
            inside ^= passes & (south_of == eastward)
        return inside


def _localise(shape: FenceShape, origin: Origin) -> _Circle | _Polygon:
    if isinstance(shape, FencePolygon):
        return _Polygon(_local_m(shape.vertices, origin))
    ((north_m, east_m),) = _local_m([(shape.lat_deg, shape.lon_deg)], origin).tolist()
    return _Circle(north_m, east_m, shape.radius_m)


def _local_m(places: Sequence[Vertex], origin: Origin) -> Array:
    """Return north and east, (n, 2), of geodetic places in the local plane.

    In NED the horizontal distance of places beyond the horizon decreases again. Here it is scaled to the
    distance in space: nearby places stay unchanged (3 mm at 10 km), and a distant fence stays distant.
    """
    lat_deg, lon_deg = np.array(places, float).T
    ned_m = geodetic_to_ned(
        lat_deg,
        lon_deg,
        np.full(len(places), origin.alt_m),
        origin_lat_deg=origin.lat_deg,
        origin_lon_deg=origin.lon_deg,
        origin_alt_m=origin.alt_m,
    )
    in_plane_m, in_space_m = np.hypot(ned_m[:, 0], ned_m[:, 1]), np.sqrt((ned_m**2).sum(axis=1))
    stretch = np.divide(in_space_m, in_plane_m, out=np.ones_like(in_space_m), where=in_plane_m > 0.0)
    local_m: Array = ned_m[:, :2] * stretch[:, None]
    return local_m


def _geodetic(places_m: Sequence[Vertex], site: Origin) -> list[Vertex]:
    """Return latitude and longitude, degrees, of (north, east) in metres on the site's plane."""
    ned_m = np.zeros((len(places_m), 3))
    ned_m[:, :2] = places_m
    lat_deg, lon_deg, _ = ned_to_geodetic(
        ned_m, origin_lat_deg=site.lat_deg, origin_lon_deg=site.lon_deg, origin_alt_m=site.alt_m
    )
    return list(zip(lat_deg.tolist(), lon_deg.tolist(), strict=True))


def _polygon_fault(vertices_m: Array) -> str | None:
    """Return why (n, 2) vertices are not a simple polygon, or None if they are."""
    begin, end = vertices_m, np.roll(vertices_m, -1, axis=0)
    count = len(begin)
    if np.hypot(*begin.T).max() > EXTENT_MAX_M:
        return f"vertices are more than {EXTENT_MAX_M / 1000.0:g} km apart"
    edges = end - begin
    length_m = np.hypot(*edges.T)
    if length_m[-1] < SAME_PLACE_M:
        return "last vertex repeats the first, but a polygon closes by itself"
    if length_m.min() < SAME_PLACE_M:
        first = int(length_m.argmin())
        return f"vertices {first} and {first + 1} are the same place"
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    folded = (np.abs(turn) <= 1e-9 * length_m * np.roll(length_m, -1)) & (
        (edges * following).sum(axis=1) < 0.0
    )
    if folded.any():
        return f"border folds back at vertex {(int(folded.argmax()) + 1) % count}"
    crossings = np.argwhere(_edges_meet(begin, end))
    if len(crossings):
        i, j = sorted(crossings[0].tolist())
        return (
            f"border crosses itself: from vertex {i} to {(i + 1) % count} and from {j} to {(j + 1) % count}"
        )
    return None


def _edges_meet(begin: Array, end: Array) -> NDArray[np.bool_]:
    """Return for each pair of edges, (n, n), whether they are not neighbours and have a common point."""
    count = len(begin)

    def side(point: Array) -> Array:
        """Return on which side of edge i point j is, (n, n)."""
        along, to = (end - begin)[:, None, :], point[None, :, :] - begin[:, None, :]
        return np.sign(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0])

    parted = side(begin) * side(end) <= 0.0
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    boxes_meet = ((low[:, None, :] <= high[None, :, :]) & (low[None, :, :] <= high[:, None, :])).all(axis=2)
    steps = np.subtract.outer(np.arange(count), np.arange(count)) % count
    return np.asarray(parted & parted.T & boxes_meet & (steps > 1) & (steps < count - 1))
