"""Boxes of a scenario that rays meet: walls, buildings, roofs. Vehicles fly through them.

A box is a cuboid along north, east and down. Rays are intersected by the slab method (Kay and Kajiya, "Ray
tracing complex scenes", SIGGRAPH 1986): along each axis the ray is within the box between two distances, and
the box is met where the three intervals overlap.
"""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from foundation.types import Array

Metres = Annotated[float, Meta(ge=-100_000.0, le=100_000.0)]


class Box(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A cuboid that range finders measure and that obstructs lines of sight of tags; one of ``boxes``."""

    from_ned_m: tuple[Metres, Metres, Metres]
    """A corner, from the site's origin: the least coordinates."""
    to_ned_m: tuple[Metres, Metres, Metres]
    """The opposite corner: the greatest coordinates."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if not all(least < most for least, most in zip(self.from_ned_m, self.to_ned_m, strict=True)):
            raise ValueError("to_ned_m: expected coordinates greater than those of from_ned_m")


class Hit(NamedTuple):
    """Where a ray meets the ground or a box."""

    distance_m: float
    """From the origin of the ray; infinity: it meets nothing."""
    incidence_cos: float
    """Cosine of the angle between the ray and the surface's normal, 0 to 1."""


NOTHING = Hit(math.inf, 0.0)
WITHIN = Hit(0.0, 1.0)


class Obstacles:
    """The ground, which is down = 0, and the scenario's boxes."""

    def __init__(self, boxes: Sequence[Box] = ()) -> None:
        self._least_ned_m = np.array([box.from_ned_m for box in boxes], float).reshape(-1, 3)
        self._most_ned_m = np.array([box.to_ned_m for box in boxes], float).reshape(-1, 3)

    def ray(self, from_ned_m: Array, direction_ned: Array) -> Hit:
        """Return where a ray from a position (3,) meets the ground or the nearest box.

        ``direction_ned`` (3,) is a unit vector. The distance is 0 within a box and below the ground.
        """
        height_m, down = -float(from_ned_m[2]), float(direction_ned[2])
        if height_m < 0.0:
            return WITHIN
        ground = Hit(height_m / down, down) if down > 0.0 else NOTHING
        return min(ground, self._box(from_ned_m, direction_ned), key=lambda hit: hit.distance_m)

    def is_between(self, first_ned_m: Array, second_ned_m: Array) -> bool:
        """Return whether a box is on the straight line between two positions (3,)."""
        line_m = second_ned_m - first_ned_m
        length_m = float(np.linalg.norm(line_m))
        return length_m > 0.0 and self._box(first_ned_m, line_m / length_m).distance_m < length_m

    def _box(self, from_ned_m: Array, direction_ned: Array) -> Hit:
        """Return where a ray meets the nearest box."""
        if not len(self._least_ned_m):
            return NOTHING
        with np.errstate(divide="ignore", invalid="ignore"):  # parallel to sides of a box
            first_m = (self._least_ned_m - from_ned_m) / direction_ned
            second_m = (self._most_ned_m - from_ned_m) / direction_ned
        in_side = np.isnan(first_m) | np.isnan(second_m)  # 0 / 0: in the plane of a side
        enters_m = np.where(in_side, -math.inf, np.minimum(first_m, second_m))
        leaves_m = np.where(in_side, math.inf, np.maximum(first_m, second_m)).min(axis=1)
        axes, begins_m = enters_m.argmax(axis=1), enters_m.max(axis=1)
        met = (begins_m <= leaves_m) & (leaves_m >= 0.0)
        if not met.any():
            return NOTHING
        nearest = int(np.argmin(np.where(met, begins_m, math.inf)))
        if begins_m[nearest] <= 0.0:
            return WITHIN
        return Hit(float(begins_m[nearest]), abs(float(direction_ned[axes[nearest]])))
