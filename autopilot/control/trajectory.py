"""Jerk-limited trajectories to a position.

At every step the reference uses the greatest jerk after which it can still stop at the target along a line.
It accelerates, cruises and brakes in minimum time, from any state and to a target that may change at any
time. The line leads from the reference to the target; across it the same rule brings the reference to rest on
the line.
"""

import math

import numpy as np
from numba import njit

from autopilot.control.params import TrajectoryParams
from foundation.types import Array, TrajectorySetpoint

_BISECTIONS = 30
"""Resolves the jerk to 2e-9 of its limit"""
_REST_M = 1e-6
_YAW_JERK_TIME_S = 0.25
"""Time in which the yaw acceleration reaches its limit"""


@njit(cache=True)
def stopping_distance(vel: float, acc: float, acc_min: float, acc_max: float, jerk: float) -> float:
    """Return the signed distance to rest (velocity and acceleration 0) in minimum time.

    acc_min < 0 < acc_max. The acceleration changes at full jerk to a peak against the motion, stays there if
    the peak is the limit, and returns to 0 at full jerk.
    """
    sign, brake = 1.0, -acc_min
    if vel + acc * abs(acc) / (2.0 * jerk) < 0.0:
        sign, brake = -1.0, acc_max
        vel, acc = -vel, -acc
    peak = math.sqrt(max(jerk * vel + 0.5 * acc * acc, 0.0))  # without the limit
    hold = 0.0
    if peak > brake:
        peak = max(brake, -acc)
        hold = max((vel + acc * acc / (2.0 * jerk) - peak * peak / jerk) / peak, 0.0)
    distance = 0.0
    for phase in range(3):
        if phase == 0:
            t, j = (acc + peak) / jerk, -jerk
        elif phase == 1:
            t, j = hold, 0.0
        else:
            t, j = peak / jerk, jerk
        distance += t * (vel + t * (acc / 2.0 + t * j / 6.0))
        vel += t * (acc + t * j / 2.0)
        acc += t * j
    return sign * distance


@njit(cache=True, inline="always")
def _speed_after(vel: float, acc: float, jerk: float) -> float:
    """Return the speed after the acceleration has returned to 0 at full jerk."""
    return vel + acc * abs(acc) / (2.0 * jerk)


@njit(cache=True)
def line_jerk(pos: float, vel: float, acc: float, target: float, limits: Array, dt_s: float) -> float:
    """Return the jerk for the next ``dt_s``.

    ``limits``: vel_min, vel_max, acc_min, acc_max, jerk; minima are negative. Stopping position and final
    speed both increase with the present jerk, so bisection finds one bound for each condition. Priority:
    stopping at the target, the speed limit, the acceleration limit.
    """
    vel_min, vel_max, acc_min, acc_max, jerk = limits[0], limits[1], limits[2], limits[3], limits[4]
    low, high = -jerk, jerk
    for _ in range(_BISECTIONS):
        j = 0.5 * (low + high)
        a = acc + j * dt_s
        v = vel + (acc + 0.5 * j * dt_s) * dt_s
        end = (
            pos
            + (vel + (acc / 2.0 + j * dt_s / 6.0) * dt_s) * dt_s
            + stopping_distance(v, a, acc_min, acc_max, jerk)
        )
        if end > target:
            high = j
        else:
            low = j
    demanded = 0.5 * (low + high)
    for bound in (vel_min, vel_max):
        low, high = -jerk, jerk
        for _ in range(_BISECTIONS):
            j = 0.5 * (low + high)
            if _speed_after(vel + (acc + 0.5 * j * dt_s) * dt_s, acc + j * dt_s, jerk) > bound:
                high = j
            else:
                low = j
        demanded = max(demanded, low) if bound == vel_min else min(demanded, high)
    demanded = min(max(demanded, (acc_min - acc) / dt_s), (acc_max - acc) / dt_s)
    return float(min(max(demanded, -jerk), jerk))


@njit(cache=True)
def _advance_line(motion: Array, target: float, limits: Array, dt_s: float) -> Array:
    """Return position, velocity and acceleration after ``dt_s``, and the jerk, (4,), from ``motion``."""
    pos, vel, acc = motion[0], motion[1], motion[2]
    jerk = line_jerk(pos, vel, acc, target, limits, dt_s)
    moved = np.empty(4)
    moved[0] = pos + (vel + (acc / 2.0 + jerk * dt_s / 6.0) * dt_s) * dt_s
    moved[1] = vel + (acc + 0.5 * jerk * dt_s) * dt_s
    moved[2] = acc + jerk * dt_s
    moved[3] = jerk
    reach = limits[4] * dt_s  # within one step of full jerk from rest at the target: snap to it
    if (
        abs(moved[2]) <= reach
        and abs(moved[1]) <= reach * dt_s
        and abs(moved[0] - target) <= max(reach * dt_s * dt_s, _REST_M)
    ):
        moved[:] = 0.0
        moved[0] = target
    return moved


@njit(cache=True)
def _limits_along(direction: Array, p: Array) -> Array:
    """Return the limits along a line with NED ``direction`` (unit); each component respects its own limit.

    ``p``: xy speed, up speed, down speed, xy acceleration, up acceleration, down acceleration, jerk.
    """
    xy = math.hypot(direction[0], direction[1])
    z = abs(direction[2])
    down, up = (p[2], p[1]) if direction[2] >= 0.0 else (p[1], p[2])
    acc_down, acc_up = (p[5], p[4]) if direction[2] >= 0.0 else (p[4], p[5])
    limits = np.empty(5)
    limits[0] = -min(p[0] / max(xy, 1e-9), up / max(z, 1e-9))
    limits[1] = min(p[0] / max(xy, 1e-9), down / max(z, 1e-9))
    limits[2] = -min(p[3] / max(xy, 1e-9), acc_up / max(z, 1e-9))
    limits[3] = min(p[3] / max(xy, 1e-9), acc_down / max(z, 1e-9))
    limits[4] = p[6]
    return limits


@njit(cache=True)
def _advance(motion: Array, target: Array, p: Array, dt_s: float) -> None:
    """Advance ``motion`` (4, 3) in place: rows position, velocity, acceleration, jerk, NED."""
    axes = np.eye(3)
    line = target - motion[0]
    if np.abs(line).max() < _REST_M:  # at the target, with residual motion
        line = motion[1].copy()
    length = math.sqrt(line[0] * line[0] + line[1] * line[1] + line[2] * line[2])
    if length > 0.0:
        axes[0] = line / length
        horizontal = math.hypot(axes[0, 0], axes[0, 1])
        if horizontal > 1e-6:
            axes[1] = np.array([-axes[0, 1] / horizontal, axes[0, 0] / horizontal, 0.0])
        else:
            axes[1] = np.array([1.0, 0.0, 0.0])
        axes[2] = np.cross(axes[0], axes[1])
    along = axes @ motion.T  # row k: position, velocity, acceleration, jerk on axis k
    goal = axes @ target
    for k in range(3):
        along[k] = _advance_line(along[k], goal[k], _limits_along(axes[k], p), dt_s)
    motion[:] = (axes.T @ along).T


class PositionTrajectory:
    """Reference that moves to a target and comes to rest there; yaw takes the shorter turn."""

    def __init__(self, params: TrajectoryParams) -> None:
        self.set_params(params)
        self._motion: Array = np.zeros((4, 3))
        self._yaw: Array = np.zeros(4)
        self._yaw_target = 0.0

    def set_params(self, params: TrajectoryParams) -> None:
        """Change the settings, in effect from the next update; motion beyond new limits is reduced."""
        p = params
        self._params = p
        self._packed: Array = np.array((
            p.xy_cruise_m_s, p.z_vel_up_m_s, p.z_vel_dn_m_s,
            p.acc_xy_m_s2, p.acc_up_m_s2, p.acc_dn_m_s2, p.jerk_m_s3,
        ))  # fmt: skip
        yaw_jerk = p.yaw_acc_max_rad_s2 / _YAW_JERK_TIME_S
        self._yaw_limits: Array = np.array((
            -p.yaw_rate_max_rad_s, p.yaw_rate_max_rad_s,
            -p.yaw_acc_max_rad_s2, p.yaw_acc_max_rad_s2, yaw_jerk,
        ))  # fmt: skip

    def reset(
        self,
        pos_ned_m: Array,
        *,
        yaw_rad: float,
        vel_ned_m_s: Array | None = None,
        acc_ned_m_s2: Array | None = None,
    ) -> None:
        """Reset the reference to a position, by default at rest: for a new mode or an estimator reset."""
        self._motion[0] = pos_ned_m
        self._motion[1] = 0.0 if vel_ned_m_s is None else vel_ned_m_s
        self._motion[2] = 0.0 if acc_ned_m_s2 is None else acc_ned_m_s2
        self._motion[3] = 0.0
        self._yaw = np.array((yaw_rad, 0.0, 0.0, 0.0))
        self._yaw_target = yaw_rad

    def update(
        self,
        target_ned_m: Array,
        dt_s: float,
        *,
        yaw_rad: float | None = None,
        vehicle_pos_ned_m: Array | None = None,
    ) -> TrajectorySetpoint:
        """Advance by ``dt_s`` (> 0) towards ``target_ned_m`` (3,) and return the setpoint.

        Without ``yaw_rad`` the last target yaw is kept. The acceleration leads by the lag of the attitude
        loop. With ``vehicle_pos_ned_m`` the reference slows down once the vehicle is half of
        ``xy_error_max_m`` away from it horizontally, and stops at ``xy_error_max_m``.
        """
        p = self._params
        pace = 1.0
        if vehicle_pos_ned_m is not None:
            lag_m = math.hypot(*(self._motion[0, :2] - vehicle_pos_ned_m[:2]))
            pace = min(max(2.0 - 2.0 * lag_m / p.xy_error_max_m, 0.0), 1.0)
        if pace > 0.0:
            _advance(self._motion, target_ned_m, self._packed, pace * dt_s)
        if yaw_rad is not None:
            self._yaw_target = float(self._yaw[0]) + math.remainder(yaw_rad - float(self._yaw[0]), math.tau)
        self._yaw = _advance_line(self._yaw, self._yaw_target, self._yaw_limits, dt_s)
        pos, vel, acc, jerk = self._motion
        return TrajectorySetpoint(
            pos_ned_m=pos.copy(),
            vel_ned_m_s=pace * vel,
            acc_ned_m_s2=pace**2 * acc + pace**3 * p.acc_lead_s * jerk,
            yaw_rad=math.remainder(float(self._yaw[0]), math.tau),
            yaw_rate_rad_s=float(self._yaw[1]),
        )
