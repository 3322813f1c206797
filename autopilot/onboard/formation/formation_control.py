"""Formation control: position correction for the autopilot, and the reference that joins the plan.

The autopilot controls its own position estimate, which follows the GPS bias. For a true position r its
setpoint must be ``r + correction``, where the correction is its position estimate minus the true position as
estimated by localisation. The reference is the desired true position: a point that joins the formation's plan
and then equals it.
"""

import math
from collections.abc import Sequence
from struct import Struct

import numpy as np
from numba import njit
from numpy.typing import NDArray

from foundation.types import Array

Level = tuple[float, float]
"""North and east."""

OFFSET_TIME_CONSTANT_S = 0.5
"""Smooths the steps by single distances; the odometry drift in that time is a few centimetres."""
OFFSET_RATE_M_S = 0.5
"""Largest speed at which a new estimate may move the vehicle."""
COAST_S = 10.0
"""At the default odometry drift of 0.1 m after a second, the drift after this time (0.3 m) is still a
fraction of the change of a GPS bias (0.8 m per axis at 1.5 m and 60 s)."""
FADE_TIME_CONSTANT_S = 20.0
JOIN_SPEED_M_S = 1.0
ACCELERATION_M_S2 = 0.8
"""Acceleration limit of the moving setpoint: it leaves half of the tilt limit in the scenario's wind as a
reserve."""
BRAKING = 2.0 / 3.0
"""Share of the acceleration that is planned for braking: the reserve of a third prevents an overshoot."""
PLAN_SWING_M_S2 = 6.0
"""Largest change of a plan's acceleration within a step, as plans stay within 3 m/s^2; otherwise the target
has jumped."""
LAG_MAX_M = 1.0
"""Largest horizontal distance of the joining reference from the vehicle."""
_STILL = (0.0, 0.0, 0.0)
_TARGET = Struct("12d")
"""Packs an array's rows into its memory, in a fifth of the time of assigning them."""


class Correction:
    """Horizontal position correction over time.

    While distances arrive, it is the autopilot's drift against odometry, which is known exactly and applied
    at once, minus the estimated odometry offset, which is smoothed and limited in rate. When they stop, the
    offset is frozen and the vehicle coasts on its odometry for `COAST_S`. After that GPS is the better
    estimate, and the correction fades to zero.
    """

    def __init__(self) -> None:
        self.ne_m: Level = (0.0, 0.0)
        self.offset_ne_m: Level | None = None
        """Smoothed true position minus odometry; None before the first estimate."""
        self._silent_s = 0.0

    @property
    def holds(self) -> bool:
        """Whether the odometry offset is known, from distances at most `COAST_S` ago."""
        return self.offset_ne_m is not None and self._silent_s <= COAST_S

    def lose_odometry(self) -> None:
        """Invalidate the offset after a restart of odometry; the correction fades from its present value."""
        self._silent_s = math.inf

    def update(
        self, autopilot_less_odometry_ne_m: Level, offset_ne_m: Level | None, dt_s: float, *, at_once: bool
    ) -> None:
        """Advance the correction by the time ``dt_s`` since the last call.

        ``offset_ne_m`` is the estimated true position minus odometry; None without support by distances.
        ``at_once`` applies it without smoothing, which is safe on the ground only.
        """
        drift_n_m, drift_e_m = autopilot_less_odometry_ne_m
        known = self.offset_ne_m
        if offset_ne_m is None:
            if known is None:
                return
            self._silent_s += dt_s
            if self._silent_s > COAST_S:
                kept = math.exp(-dt_s / FADE_TIME_CONSTANT_S)
                self.ne_m = (self.ne_m[0] * kept, self.ne_m[1] * kept)
                return
        elif at_once:
            known = offset_ne_m
        else:
            if known is None or self._silent_s > COAST_S:
                # Continue from the present correction, which must not jump in the air.
                known = (drift_n_m - self.ne_m[0], drift_e_m - self.ne_m[1])
            part, limit_m = 1.0 - math.exp(-dt_s / OFFSET_TIME_CONSTANT_S), OFFSET_RATE_M_S * dt_s
            step_n_m, step_e_m = (offset_ne_m[0] - known[0]) * part, (offset_ne_m[1] - known[1]) * part
            size_m = math.sqrt(step_n_m * step_n_m + step_e_m * step_e_m)
            if size_m > limit_m:
                step_n_m, step_e_m = step_n_m * (limit_m / size_m), step_e_m * (limit_m / size_m)
            known = (known[0] + step_n_m, known[1] + step_e_m)
        if offset_ne_m is not None:
            self._silent_s = 0.0
        self.offset_ne_m = known
        self.ne_m = (drift_n_m - known[0], drift_e_m - known[1])


@njit(cache=True)
def join(
    pos: Array, vel: Array, acc: Array, target: Array, first: int, end: int, speed_m_s: float, dt_s: float,
    joined: bool,  # noqa: FBT001  # numba has no keyword-only arguments
) -> bool:  # fmt: skip
    """Advance pos, vel and acc (3,) on axes ``first`` to ``end`` - 1 by ``dt_s`` towards a moving target.

    ``target`` is that of `follow`, ``speed_m_s`` limits the speed relative to it. ``joined``: whether pos,
    vel and acc equalled the target's before. Returns whether they do now.
    """
    gap_m, apart_m_s = np.zeros(3), np.zeros(3)
    distance_m2, speed_m2_s2 = 0.0, 0.0
    for a in range(first, end):
        # Relative to the target's previous position by its motion, so that joining does not depend on it.
        gap_m[a] = target[0, a] - dt_s * (target[1, a] - 0.5 * dt_s * target[2, a]) - pos[a]
        apart_m_s[a] = vel[a] - target[1, a] + dt_s * target[2, a]
        distance_m2 += gap_m[a] * gap_m[a]
        speed_m2_s2 += apart_m_s[a] * apart_m_s[a]
    distance_m = math.sqrt(distance_m2)
    near_m_s2 = PLAN_SWING_M_S2 if joined else ACCELERATION_M_S2
    if distance_m <= 0.5 * near_m_s2 * (dt_s * dt_s) and math.sqrt(speed_m2_s2) <= near_m_s2 * dt_s:
        for a in range(first, end):
            pos[a], vel[a], acc[a] = target[0, a], target[1, a], target[2, a]
        return True
    # Braking on v^2 = 2 a s; the last step ends at the target.
    braking_m_s = math.sqrt(2.0 * BRAKING * ACCELERATION_M_S2 * distance_m)
    desired_1_s = min(speed_m_s, braking_m_s, distance_m / dt_s) / max(distance_m, 1e-9)
    size_m2_s2 = 0.0
    for a in range(first, end):
        missing_m_s = gap_m[a] * desired_1_s - apart_m_s[a]
        size_m2_s2 += missing_m_s * missing_m_s
    part = min(1.0, ACCELERATION_M_S2 * dt_s / max(math.sqrt(size_m2_s2), 1e-9))
    for a in range(first, end):
        change_m_s = part * (gap_m[a] * desired_1_s - apart_m_s[a])
        apart_m_s[a] += change_m_s
        pos[a] = target[0, a] - gap_m[a] + apart_m_s[a] * dt_s
        vel[a] = target[1, a] + apart_m_s[a]
        acc[a] = target[2, a] + change_m_s / dt_s
    return False


@njit(cache=True)
def follow(
    motion: Array, joined: NDArray[np.bool_], target: Array, limited: bool,  # noqa: FBT001
    climb_speed_m_s: float, dt_s: float,
) -> None:  # fmt: skip
    """Advance a `FormationReference` by ``dt_s``, in place.

    Rows of motion (3, 3) are its position, velocity and acceleration. ``joined`` (2,) states whether these
    equal the target's, horizontally and in height. Rows of target (4, 3) are the target's position after
    ``dt_s``, its velocity and acceleration, and the position of the vehicle, which is used if ``limited``.
    """
    if limited and not joined[0]:
        north_m, east_m = motion[0, 0] - target[3, 0], motion[0, 1] - target[3, 1]
        away_m = math.sqrt(north_m * north_m + east_m * east_m)
        if away_m > LAG_MAX_M:
            motion[0, 0] -= (1.0 - LAG_MAX_M / away_m) * north_m
            motion[0, 1] -= (1.0 - LAG_MAX_M / away_m) * east_m
    pos, vel, acc = motion[0], motion[1], motion[2]
    for part in range(2):
        first, end, speed_m_s = (0, 2, JOIN_SPEED_M_S) if part == 0 else (2, 3, climb_speed_m_s)
        joined[part] = join(pos, vel, acc, target, first, end, speed_m_s, dt_s, joined[part])


class FormationReference:
    """A reference point that joins a moving target, separately in the horizontal and in height.

    While it joins, its speed and acceleration relative to the target are limited. When the acceleration of
    one step can close the gap, its position, velocity and acceleration (3,) become exactly the target's,
    until the target jumps.
    """

    def __init__(self, *, climb_speed_m_s: float) -> None:
        motion = np.zeros((3, 3))
        self.pos_ned_m, self.vel_ned_m_s, self.acc_ned_m_s2 = motion
        self._motion = motion
        self._climb_speed_m_s = climb_speed_m_s
        # The arguments of `follow`.
        self._target = np.zeros((4, 3))
        self._target_bytes = self._target.data.cast("B")
        self._joined = np.zeros(2, bool)

    def reset(self, pos_ned_m: Sequence[float], vel_ned_m_s: Sequence[float]) -> None:
        """Set position and velocity, (3,), and restart joining."""
        self.pos_ned_m[:] = pos_ned_m
        self.vel_ned_m_s[:] = vel_ned_m_s
        self.acc_ned_m_s2[:] = 0.0
        self._joined[:] = False

    def advance(
        self, target_pos_ned_m: Sequence[float], dt_s: float, *,
        target_vel_ned_m_s: Sequence[float] = _STILL, target_acc_ned_m_s2: Sequence[float] = _STILL,
        vehicle_ned_m: Sequence[float] | None = None,
    ) -> None:  # fmt: skip
        """Advance by the time ``dt_s`` (> 0) since the last call, after which the target has this state (3,).

        While joining, the reference stays within `LAG_MAX_M` of ``vehicle_ned_m`` (3,) horizontally, so it
        follows a vehicle that avoids an obstacle.
        """
        limited = vehicle_ned_m is not None
        there_ned_m = _STILL if vehicle_ned_m is None else vehicle_ned_m
        _TARGET.pack_into(
            self._target_bytes, 0,
            *target_pos_ned_m, *target_vel_ned_m_s, *target_acc_ned_m_s2, *there_ned_m,
        )  # fmt: skip
        follow(self._motion, self._joined, self._target, limited, self._climb_speed_m_s, dt_s)


def joining_time_s(distance_m: float, speed_m_s: float) -> float:
    """Return the time in which a `FormationReference` from rest comes to rest at a target at a distance.

    From rest to v and back to rest takes the time v / a (1 + 1 / BRAKING) and covers v / 2 times that; the
    remaining distance is covered at v, which is the speed limit or what the distance allows.
    """
    if distance_m <= 0.0:
        return 0.0
    change_s2_m = (1.0 + 1.0 / BRAKING) / ACCELERATION_M_S2
    peak_m_s = min(speed_m_s, math.sqrt(2.0 * distance_m / change_s2_m))
    return distance_m / peak_m_s + 0.5 * peak_m_s * change_s2_m
