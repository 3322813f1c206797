"""Height layers: vertical separation of UAVs whose relative positions are not known well enough.

Without distances the horizontal errors of two UAVs are independent, and their difference is sqrt(2) times the
GPS error. For errors of 1.5 m per axis and 60 s, two UAVs at spacing s pass within 0.6 m about
0.8 exp(-s^2 / (4 sigma^2)) times a minute (diffusion into a disc): at 2.5 m once in three minutes, at three
sigma of the relative position once in two hours, at four in two days. Places within four sigma are therefore
assigned different height layers. A UAV without support by distances moves to its layer before the odometry
drift, which grows with the square root of time, can bring it to the nearest place.
"""

import math

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.formation.formation_control import COAST_S, joining_time_s
from foundation.types import Array

REACH_SIGMAS = 4.0
"""Places within this many standard deviations of the relative position are separated."""
SEPARATION_HEIGHT_M = 2.0
"""Three sigma of the difference of two barometers (0.3 m each), the vehicle's height and control errors."""
GROUND_CLEARANCE_M = 2.0
"""Least height of a lower layer above the ground."""
TOUCH_M = 0.6
"""Distance of their centres below which two vehicles touch."""
DRIFT_SIGMAS = 3.0
"""Layers are reached before this many sigma of two odometries' difference close the gap between places."""
BACK_S = 5.0
"""Duration of support after which a layer is left: the correction has then returned from any fade."""


def layers(places_ned_m: Array, gps_std_m: float) -> NDArray[np.int64]:
    """Return (N,) the layer of every place, in units of `SEPARATION_HEIGHT_M`, upwards: 0, 1, -1, 2, -2 ...

    Greedy in the order of the UAVs, so that all compute the same: the layer nearest to 0 at which the place
    is a separation apart from the layers of all earlier places within reach. A layer other than 0 must also
    be a separation apart from the heights of all places within reach, where UAVs may be.
    """
    count = len(places_ned_m)
    found = np.zeros(count, np.int64)
    heights_m = -places_ned_m[:, 2].astype(float)
    reach_m = REACH_SIGMAS * math.sqrt(2.0) * gps_std_m
    for k in range(count):
        way_m = places_ned_m[:, :2] - places_ned_m[k, :2]
        within = (way_m**2).sum(axis=1) < reach_m**2
        taken_m = heights_m[:k][within[:k]]
        places_m = -places_ned_m[within, 2]
        layer = 0
        while True:
            height_m = heights_m[k] + layer * SEPARATION_HEIGHT_M
            low = layer < 0 and height_m < GROUND_CLEARANCE_M
            others_m = taken_m if layer == 0 else np.concatenate((taken_m, places_m))
            if not low and (np.abs(others_m - height_m) > SEPARATION_HEIGHT_M - 1e-6).all():
                break
            layer = -layer if layer > 0 else 1 - layer
        found[k], heights_m[k] = layer, height_m
    return found


def apart_s(way_ne_m: Array, drift_m_sqrt_s: float) -> float:
    """Return the time for which odometry alone separates a UAV from those at ``way_ne_m`` (N, 2) from it.

    The relative drift of two UAVs along their line has variance 2 drift^2 t. At the returned time
    `DRIFT_SIGMAS` standard deviations of it reduce the least distance to `TOUCH_M`.
    """
    if not len(way_ne_m):
        return math.inf
    room_m = max(float(np.hypot(way_ne_m[:, 0], way_ne_m[:, 1]).min()) - TOUCH_M, 0.0)
    return 0.5 * (room_m / (DRIFT_SIGMAS * drift_m_sqrt_s)) ** 2


class HeightLayers:
    """Selects the height of one UAV above its place, among the formation's places (N, 3).

    The GPS error, one sigma, and the drift of odometry after one second are horizontal and per axis.

    Attributes:
        height_m: height to keep above the place; it steps, and `FormationReference` smooths it.
        layer_m: height of the own layer.
        watched: stations within reach that always stay at height 0. If one of them loses support, this UAV
            must move to its layer.

    """

    def __init__(
        self, *, own: int, places_ned_m: Array, gps_std_m: float, climb_speed_m_s: float = 1.5,
        drift_m_sqrt_s: float = 0.1,
    ) -> None:  # fmt: skip
        places = layers(places_ned_m, gps_std_m)
        way_m = places_ned_m[:, :2] - places_ned_m[own, :2]
        reach_m = REACH_SIGMAS * math.sqrt(2.0) * gps_std_m
        stays = (places == 0) & ((way_m**2).sum(axis=1) < reach_m**2)
        self.height_m = 0.0
        self.layer_m = SEPARATION_HEIGHT_M * float(places[own])
        self.watched = tuple(np.flatnonzero(stays).tolist()) if places[own] else ()
        way_s = joining_time_s(abs(self.layer_m), climb_speed_m_s)
        coast_s = min(COAST_S, apart_s(np.delete(way_m, own, axis=0), drift_m_sqrt_s))
        self._leave_after_us = round(max(coast_s - way_s, 0.0) * 1e6)
        self._since_us: int | None = None
        """Time since which the support contradicts ``height_m``."""

    def update(self, now_us: int, *, supported: bool) -> float:
        """Return the height to keep, metres above the place.

        ``supported``: distances support the position of this UAV and of those it watches, or it is on the
        ground. Without support the layer is reached while odometry still separates the UAVs (`apart_s`).
        """
        if self.layer_m == 0.0:
            return 0.0
        at_layer = self.height_m != 0.0
        if supported is not at_layer:
            self._since_us = None
            return self.height_m
        if self._since_us is None:
            self._since_us = now_us
        if now_us - self._since_us >= (BACK_S * 1e6 if at_layer else self._leave_after_us):
            self.height_m = 0.0 if at_layer else self.layer_m
            self._since_us = None
        return self.height_m
