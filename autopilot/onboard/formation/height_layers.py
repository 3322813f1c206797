"""Height layers: what keeps UAVs apart that no longer know well enough where each other is.

Without distances the horizontal errors of two UAVs go their own ways, by the root of two times what one GPS
receiver errs, and places 2.5 m apart meet within minutes: for errors of 1.5 m per axis and 60 s, passing
within 0.6 m happens about 0.8 exp(-s^2 / (4 sigma^2)) times a minute at spacing s (diffusion into a disc): at
2.5 m once in three minutes, at three sigma of the relative position once in two hours, at four in two days.
So places within four get layers of height, and who is without support for long goes to its own: before the
odometry of the two nearest places, less good by the root of time, may have brought them together.
"""

import math

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.formation.formation_control import COAST_S, joining_time_s

Array = NDArray[np.float64]

REACH_SIGMAS = 4.0
"""Places within so many standard deviations of the relative position are kept apart."""
SEPARATION_HEIGHT_M = 2.0
"""Three standard deviations of two barometers' difference (0.3 m each), the vehicle's height of 0.2 m, and
errors of holding it."""
GROUND_CLEARANCE_M = 2.0
"""No layer is lower than this above the ground."""
TOUCH_M = 0.6
"""Two vehicles whose centres are nearer than this touch."""
DRIFT_SIGMAS = 3.0
"""Layers are reached while so many standard deviations of two odometries' difference leave places apart."""
BACK_S = 5.0
"""Support for so long, and a layer is left: by then the correction has been brought back (0.5 m/s) after all
that a fade may have moved it."""


def layers(
    places_ned_m: Array, gps_std_m: float, *, separation_m: float = SEPARATION_HEIGHT_M
) -> NDArray[np.int64]:
    """(N,) layer of every place, in separations upwards: 0, 1, -1, 2, -2 ...

    Greedy in the order of the UAVs, so that everybody finds the same: the nearest to 0 that leaves every
    earlier place within reach a separation apart in height, and if it is not 0, all places within reach too:
    there may be somebody in them. A place never goes below `GROUND_CLEARANCE_M`.
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
            height_m = heights_m[k] + layer * separation_m
            low = layer < 0 and height_m < GROUND_CLEARANCE_M
            others_m = taken_m if layer == 0 else np.concatenate((taken_m, places_m))
            if not low and (np.abs(others_m - height_m) > separation_m - 1e-6).all():
                break
            layer = -layer if layer > 0 else 1 - layer
        found[k], heights_m[k] = layer, height_m
    return found


def apart_s(way_ne_m: Array, drift_m_sqrt_s: float) -> float:
    """Time in which odometry alone keeps apart two UAVs whose places are ``way_ne_m`` (N, 2) apart, all N.

    The drift of two, along the line, has variance 2 drift^2 t; so many of its deviations as `DRIFT_SIGMAS`
    says take the places to `TOUCH_M` of each other.
    """
    if not len(way_ne_m):
        return math.inf
    room_m = max(float(np.hypot(way_ne_m[:, 0], way_ne_m[:, 1]).min()) - TOUCH_M, 0.0)
    return 0.5 * (room_m / (DRIFT_SIGMAS * drift_m_sqrt_s)) ** 2


class HeightLayers:
    """Which height above its place one UAV keeps.

    Args:
        own: this UAV.
        places_ned_m: (N, 3) the formation's places.
        gps_std_m: horizontal error of everybody's GPS, per axis, one sigma.
        climb_speed_m_s: at which a layer is reached.
        drift_m_sqrt_s: of odometry, horizontally and per axis, after one second.

    Attributes:
        height_m: to keep above the place; steps, for a `Reference` to make smooth.
        layer_m: of the own layer.
        watched: stations in reach that never leave height 0. When one of them is without support, it is this
            UAV that has to go.

    """

    def __init__(
        self,
        *,
        own: int,
        places_ned_m: Array,
        gps_std_m: float,
        climb_speed_m_s: float = 1.5,
        drift_m_sqrt_s: float = 0.1,
    ) -> None:
        places = layers(places_ned_m, gps_std_m)
        way_m = places_ned_m[:, :2] - places_ned_m[own, :2]
        reach_m = REACH_SIGMAS * math.sqrt(2.0) * gps_std_m
        stays = (places == 0) & ((way_m**2).sum(axis=1) < reach_m**2)
        self.height_m = 0.0
        self.layer_m = SEPARATION_HEIGHT_M * float(places[own])
        self.watched = tuple(np.flatnonzero(stays).tolist()) if places[own] else ()
        way_s = joining_time_s(abs(self.layer_m), climb_speed_m_s)
        coast_s = min(COAST_S, apart_s(np.delete(way_m, own, axis=0), drift_m_sqrt_s))
        self._patience_us = round(max(coast_s - way_s, 0.0) * 1e6)
        self._since_us: int | None = None
        """Since when it has been otherwise than ``height_m`` supposes."""

    def update(self, now_us: int, *, supported: bool) -> float:
        """Return the height to keep, metres above the place.

        ``supported``: distances hold the position of this UAV and of those it watches, or it is on the
        ground. Without, odometry holds it for `COAST_S`, or less where places are near: the layer is reached
        by then, or as soon as can be.
        """
        if self.layer_m == 0.0:
            return 0.0
        at_layer = self.height_m != 0.0
        if supported is not at_layer:
            self._since_us = None
            return self.height_m
        if self._since_us is None:
            self._since_us = now_us
        if now_us - self._since_us >= (BACK_S * 1e6 if at_layer else self._patience_us):
            self.height_m = 0.0 if at_layer else self.layer_m
            self._since_us = None
        return self.height_m
