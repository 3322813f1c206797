"""Formation control: from what the UAV knows of its true position to where it asks its autopilot to be.

The autopilot holds position in an estimate that follows its GPS bias. To stand truly at r it must be told
``r + correction``, the correction being its own position estimate less the true position as localisation
knows it.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OFFSET_TIME_CONSTANT_S = 0.5
"""Smooths the steps that single distances make; the drift of odometry in that time is centimetres."""
OFFSET_RATE_M_S = 0.5
"""Fastest that a new estimate may move the vehicle."""
COAST_S = 10.0
"""With the default odometry drift of 0.1 m in a second, what odometry has lost after this time (0.3 m) is
still a fraction of what GPS bias moves (0.8 m per axis at 1.5 m and 60 s)."""
FADE_TIME_CONSTANT_S = 20.0
JOIN_SPEED_M_S = 1.0
ACCELERATION_M_S2 = 0.8
"""Of the moving setpoint: half of what tilt limits allow in the scenario's wind is left to the wind."""


class Correction:
    """The correction's course over time, horizontal.

    While distances come, it is the autopilot's drift against odometry, known exactly and passed on at once,
    less the estimated offset of odometry, smoothed and bounded in rate. When they stop, the offset is frozen
    and the vehicle coasts on its odometry for `COAST_S`; after that nothing known here is better than GPS,
    and the correction fades to zero.

    Attributes:
        ne_m: (2,) the correction, NED north and east.
        offset_ne_m: (2,) smoothed true position less odometry; None before the first.

    """

    def __init__(self) -> None:
        self.ne_m = np.zeros(2)
        self.offset_ne_m: Array | None = None
        self._silent_s = 0.0

    def update(
        self, autopilot_less_odometry_ne_m: Array, offset_ne_m: Array | None, dt_s: float, *, at_once: bool
    ) -> None:
        """Advance by dt_s.

        Args:
            autopilot_less_odometry_ne_m: (2,) the autopilot's position less the odometry, of one moment.
            offset_ne_m: (2,) estimated true position less odometry; None while no distances support it.
            dt_s: since the last call.
            at_once: take the estimate over without smoothing, as is safe on the ground.

        """
        if offset_ne_m is None:
            if self.offset_ne_m is None:
                return
            self._silent_s += dt_s
            if self._silent_s > COAST_S:
                self.ne_m = self.ne_m * np.exp(-dt_s / FADE_TIME_CONSTANT_S)
                return
        elif at_once:
            self.offset_ne_m = offset_ne_m.copy()
        else:
            if self.offset_ne_m is None or self._silent_s > COAST_S:
                # Continue from where the correction is: it may not jump in the air.
                self.offset_ne_m = autopilot_less_odometry_ne_m - self.ne_m
            step_m = (offset_ne_m - self.offset_ne_m) * (1.0 - np.exp(-dt_s / OFFSET_TIME_CONSTANT_S))
            length_m = float(np.hypot(*step_m))
            limit_m = OFFSET_RATE_M_S * dt_s
            self.offset_ne_m = self.offset_ne_m + step_m * min(1.0, limit_m / max(length_m, 1e-12))
        if offset_ne_m is not None:
            self._silent_s = 0.0
        self.ne_m = autopilot_less_odometry_ne_m - self.offset_ne_m


class Reference:
    """A point that moves to its target at bounded speed and acceleration, horizontally and vertically apart.

    Attributes:
        pos_ned_m: (3,) where the vehicle should truly be.
        vel_ned_m_s: (3,)

    """

    def __init__(self, *, climb_speed_m_s: float) -> None:
        self.pos_ned_m = np.zeros(3)
        self.vel_ned_m_s = np.zeros(3)
        self._climb_speed_m_s = climb_speed_m_s

    def reset(self, pos_ned_m: Array, vel_ned_m_s: Array) -> None:
        """Begin at a position and velocity."""
        self.pos_ned_m = pos_ned_m.copy()
        self.vel_ned_m_s = vel_ned_m_s.copy()

    def advance(self, target_ned_m: Array, dt_s: float) -> None:
        """Move towards the target for dt_s."""
        for axes, speed_m_s in ((slice(0, 2), JOIN_SPEED_M_S), (slice(2, 3), self._climb_speed_m_s)):
            gap_m = target_ned_m[axes] - self.pos_ned_m[axes]
            distance_m = float(np.sqrt(gap_m @ gap_m))
            # Braking on v^2 = 2 a s with a third of the acceleration in reserve keeps the point from
            # overshooting.
            wanted_m_s = min(
                speed_m_s, np.sqrt(4.0 / 3.0 * ACCELERATION_M_S2 * distance_m), distance_m / dt_s
            )
            change_m_s = gap_m * (wanted_m_s / max(distance_m, 1e-9)) - self.vel_ned_m_s[axes]
            size_m_s = float(np.sqrt(change_m_s @ change_m_s))
            limit_m_s = ACCELERATION_M_S2 * dt_s
            self.vel_ned_m_s[axes] += change_m_s * min(1.0, limit_m_s / max(size_m_s, 1e-9))
            self.pos_ned_m[axes] += self.vel_ned_m_s[axes] * dt_s


def separation_radius_limit_m(places_ned_m: Array, own: int) -> float:
    """Largest distance at which a neighbour may be pushed off: 0.6 of the own place's nearest spacing.

    At their places, and with errors of a fifth of the spacing, UAVs then do not push each other; inf for a
    lone one.
    """
    distances_m = np.linalg.norm(np.delete(places_ned_m, own, axis=0) - places_ned_m[own], axis=1)
    return 0.6 * float(distances_m.min()) if len(distances_m) else float("inf")
