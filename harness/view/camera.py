"""Where the scene is seen from when a view opens, in the site's frame (NED)."""

from typing import NamedTuple

import numpy as np

from foundation.types import Array

DIRECTION_NED = np.array([-0.85, 0.3, -0.43])
"""From the scene's centre to the camera: north is ahead, east to the right"""
DISTANCE_RADII = 2.2
"""Distance of the camera at which a sphere is in a field of view of 55 degrees"""
PATTERN_RADII = 1.4
"""Distance to which a pattern with its arrow extends, in the formation's radius"""
LEAST_RADIUS_M = 5.0


class Camera(NamedTuple):
    """A place and the point that it looks at."""

    position_ned_m: Array
    """(3,)"""
    target_ned_m: Array
    """(3,)"""


def overview(places_ned_m: Array) -> Camera:
    """Return a camera that sees a formation's places (N, 3), the ground below and the antenna's pattern."""
    centre_ned_m = places_ned_m.mean(axis=0)
    apart_m = np.linalg.norm(places_ned_m - centre_ned_m, axis=1).max()
    radius_m = max(PATTERN_RADII * apart_m, abs(centre_ned_m[2]), LEAST_RADIUS_M)
    return Camera(centre_ned_m + DISTANCE_RADII * radius_m * DIRECTION_NED, centre_ned_m)
