"""How well distances determine the shape of a formation at its places, before any is measured.

The model is the filter's own, in the horizontal plane: positions have GPS errors, independent between UAVs
and axes, and every pair of neighbours has a distance. Heights are known from the barometer. A distance
observes one direction only, that between its ends, so no distance observes positions across a line.
"""

import numpy as np
from numpy.typing import NDArray

from autopilot.parameters.onboard_config import OnboardConfig
from foundation.types import Array

Flags = NDArray[np.bool_]
SHAPE_STD_M = 0.35
"""Expected error of the formation's shape below which it is localised, and take-off no longer waits."""
LOCALISE_TIMEOUT_US = 10_000_000
"""Longest time for which take-off waits for it."""
ACCURATE_STD_M = OnboardConfig().range_floor_std_m
"""One sigma of accurate distances: the least that the filter assumes by default."""
_ROUND_M = 3
"""Decimals of distances between places, so that ties in a grid are resolved by UAV number."""


def linked(places_ned_m: Array, nearest: int) -> Flags:
    """Return (N, N), symmetric: whether two UAVs are neighbours; none is its own neighbour.

    Two are neighbours if either is among the ``nearest`` of the other by places_ned_m (N, 3); 0: all are.
    """
    count = len(places_ned_m)
    if nearest == 0 or nearest >= count - 1:
        return ~np.eye(count, dtype=bool)
    found = np.zeros((count, count), bool)
    for station in range(count):
        way_m = places_ned_m - places_ned_m[station]
        apart_m = np.sqrt((way_m**2).sum(axis=1)).round(_ROUND_M)
        apart_m[station] = -1.0
        found[station, np.argsort(apart_m, kind="stable")[1 : nearest + 1]] = True
    return found | found.T


def predicted_shape_std_m(
    places_ned_m: Array, linked: Flags, *, gps_std_m: float, distance_std_m: float
) -> float:
    """Return the expected horizontal rms shape error of UAVs at their places, aligned as in `shape_std_m`.

    places_ned_m is (N, 3), ``linked`` (N, N) is symmetric and marks the pairs with a distance. ``gps_std_m``
    is one sigma per horizontal axis. A lone UAV has no shape, and no error of it: 0.
    """
    count = len(places_ned_m)
    way_m = places_ned_m[:, np.newaxis] - places_ned_m
    direction = way_m[..., :2] / np.maximum(np.linalg.norm(way_m, axis=2), 1e-9)[..., np.newaxis]
    pairs = np.einsum("ij,ija,ijb->ijab", linked / distance_std_m**2, direction, direction)
    blocks = -pairs
    blocks[np.arange(count), np.arange(count)] = np.eye(2) / gps_std_m**2 + pairs.sum(axis=1)
    cov = np.linalg.inv(blocks.transpose(0, 2, 1, 3).reshape(2 * count, 2 * count))
    arms_m = places_ned_m[:, :2] - places_ned_m[:, :2].mean(axis=0)
    # Two translations and the turn: orthogonal, because the arms have no mean.
    rigid = np.zeros((2 * count, 3))
    rigid[0::2, 0] = rigid[1::2, 1] = 1.0
    rigid[0::2, 2], rigid[1::2, 2] = -arms_m[:, 1], arms_m[:, 0]
    rigid /= np.maximum(np.linalg.norm(rigid, axis=0), 1e-9)
    shape_m2 = np.trace(cov) - np.trace(rigid.T @ cov @ rigid)
    return float(np.sqrt(max(shape_m2, 0.0) / count))


def is_near_line(places_ned_m: Array, *, gps_std_m: float, limit_m: float) -> bool:
    """Whether not even accurate distances of all pairs determine the shape of places (N, 3) to a limit."""
    linked = ~np.eye(len(places_ned_m), dtype=bool)
    expected_m = predicted_shape_std_m(
        places_ned_m, linked, gps_std_m=gps_std_m, distance_std_m=ACCURATE_STD_M
    )
    return expected_m >= limit_m


def width_m(places_ned_m: Array) -> float:
    """Return the largest horizontal distance of places (N, 3) from the line that fits them best."""
    arms_m = places_ned_m[:, :2] - places_ned_m[:, :2].mean(axis=0)
    across = np.linalg.svd(arms_m.T @ arms_m)[0][:, 1]
    return float(np.abs(arms_m @ across).max())
