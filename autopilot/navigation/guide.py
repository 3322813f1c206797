"""Jerk-limited reference of the automatic modes along the legs of a path.

The line of a leg is constant: the motion along it and the two motions across it are independent, and each
comes to rest in minimum time from any initial motion (`autopilot.control.trajectory`). (A line that is
recomputed at every step from the reference to its target turns with the motion across it; near the target the
reference may then circle around it.)
"""

import math

import numpy as np
from numba import njit

from autopilot.control.params import TrajectoryParams
from autopilot.control.trajectory import line_jerk, stopping_distance
from foundation.geometry.rotations import quat_to_euler
from foundation.types import Array, EstimatorState, TrajectorySetpoint

_REST_M = 1e-6
_YAW_JERK_TIME_S = 0.25
"""Time in which the yaw acceleration reaches its limit"""

POS, VEL, ACC, JERK = range(4)
"""Rows of the motion."""


@njit(cache=True)
def _move(line: Array, goal: float, limits: Array, dt_s: float) -> bool:
    """Advance position, velocity, acceleration and jerk (4,); return whether they are at rest at the goal."""
    pos, vel, acc = line[POS], line[VEL], line[ACC]
    if vel == 0.0 and acc == 0.0 and abs(pos - goal) < _REST_M:
        line[POS], line[JERK] = goal, 0.0
        return True
    jerk = line_jerk(pos, vel, acc, goal, limits, dt_s)
    line[POS] = pos + (vel + (acc / 2.0 + jerk * dt_s / 6.0) * dt_s) * dt_s
    line[VEL] = vel + (acc + 0.5 * jerk * dt_s) * dt_s
    line[ACC] = acc + jerk * dt_s
    line[JERK] = jerk
    reach = limits[4] * dt_s  # within one step of full jerk from rest at the goal: snap to it
    if (
        abs(line[ACC]) <= reach
        and abs(line[VEL]) <= reach * dt_s
        and abs(line[POS] - goal) <= max(reach * dt_s * dt_s, _REST_M)
    ):
        line[:] = 0.0
        line[POS] = goal
        return True
    return False


@njit(cache=True)
def _advance(
    motion: Array, target: Array, axes: Array, limits: Array, yaw: Array, yaw_goal: float, yaw_limits: Array,
    pace: float, dt_s: float,
) -> bool:  # fmt: skip
    """Advance ``motion`` (4, 3) by ``pace * dt_s`` and ``yaw`` (4,) by ``dt_s``; return whether both rest.

    ``axes`` (3, 3): rows are the leg's directions; ``limits`` (3, 5): those of each axis, for `line_jerk`.
    """
    rests = pace > 0.0
    if pace > 0.0:
        moved = np.zeros((4, 3))
        line = np.empty(4)
        for k in range(3):
            goal = 0.0
            line[:] = 0.0
            for i in range(3):
                goal += axes[k, i] * target[i]
                for row in range(4):
                    line[row] += axes[k, i] * motion[row, i]
            rests = _move(line, goal, limits[k], pace * dt_s) and rests
            for i in range(3):
                for row in range(4):
                    moved[row, i] += axes[k, i] * line[row]
        for i in range(3):
            for row in range(4):
                motion[row, i] = 0.0 if rests else moved[row, i]
            if rests:
                motion[POS, i] = target[i]
    return _move(yaw, yaw_goal, yaw_limits, dt_s) and rests


def _limits_along(direction: Array, p: TrajectoryParams) -> tuple[float, float, float, float, float]:
    """Return the limits of speed and acceleration, backward and forward along a unit vector, and of jerk.

    Each component respects its own limit.
    """
    xy = max(math.hypot(direction[0], direction[1]), 1e-9)
    z = max(abs(float(direction[2])), 1e-9)
    back = (p.z_vel_up_m_s, p.acc_up_m_s2)
    forth = (p.z_vel_dn_m_s, p.acc_dn_m_s2)
    if direction[2] < 0.0:
        back, forth = forth, back
    return (
        -min(p.xy_cruise_m_s / xy, back[0] / z),
        min(p.xy_cruise_m_s / xy, forth[0] / z),
        -min(p.acc_xy_m_s2 / xy, back[1] / z),
        min(p.acc_xy_m_s2 / xy, forth[1] / z),
        p.jerk_m_s3,
    )


class Guide:
    """Position and heading reference along successive legs, which comes to rest at the end of the last."""

    def __init__(self, limits: TrajectoryParams) -> None:
        self._motion: Array = np.zeros((4, 3))
        self._yaw: Array = np.zeros(4)
        self._yaw_goal_rad = 0.0
        self._axes: Array = np.eye(3)
        self.target_ned_m: Array = np.zeros(3)
        self.yaw_rad = 0.0
        """Target heading."""
        self._at_rest: TrajectorySetpoint | None = None
        """Setpoint at the leg's end, which is reused."""
        self.set_limits(limits)

    def set_limits(self, limits: TrajectoryParams) -> None:
        """Change the limits, in effect from the next update; motion beyond new limits is reduced."""
        self.limits = limits
        self._limits: Array = np.array([_limits_along(axis, limits) for axis in self._axes])
        yaw_jerk = limits.yaw_acc_max_rad_s2 / _YAW_JERK_TIME_S
        self._yaw_limits: Array = np.array((
            -limits.yaw_rate_max_rad_s, limits.yaw_rate_max_rad_s,
            -limits.yaw_acc_max_rad_s2, limits.yaw_acc_max_rad_s2, yaw_jerk,
        ))  # fmt: skip

    @property
    def resting(self) -> bool:
        """Whether it is at rest at its target, with its heading."""
        return self._at_rest is not None

    @property
    def pos_ned_m(self) -> Array:
        """Position (3,) of the reference."""
        pos_ned_m: Array = self._motion[POS].copy()
        return pos_ned_m

    @property
    def vel_ned_m_s(self) -> Array:
        """Velocity (3,) of the reference."""
        vel_ned_m_s: Array = self._motion[VEL].copy()
        return vel_ned_m_s

    def reset(self, pos_ned_m: Array, *, vel_ned_m_s: Array, yaw_rad: float) -> None:
        """Set position, velocity and heading; the heading is kept."""
        self._motion[:] = 0.0
        self._motion[POS] = pos_ned_m
        self._motion[VEL] = vel_ned_m_s
        self._yaw = np.array((yaw_rad, 0.0, 0.0, 0.0))
        self._yaw_goal_rad = self.yaw_rad = yaw_rad
        self._at_rest = None

    def restart(self, state: EstimatorState) -> None:
        """Restart from the vehicle's motion and heading; the target is the stopping point."""
        vel_ned_m_s = state.vel_ned_m_s
        self.reset(state.pos_ned_m, yaw_rad=float(quat_to_euler(state.q_ned_frd)[2]), vel_ned_m_s=vel_ned_m_s)
        self.go_to(
            state.pos_ned_m + self._stopping_way_ned_m(vel_ned_m_s),
            along_ned=np.array((vel_ned_m_s[0], vel_ned_m_s[1], 0.0)),
        )

    def go_to(
        self, target_ned_m: Array, *, yaw_rad: float | None = None, along_ned: Array | None = None
    ) -> None:
        """Begin a leg to a target (3,), and turn to another heading unless None.

        The leg is on the line through the target along ``along_ned`` (3,), by default from the reference.
        """
        self.target_ned_m = target_ned_m
        self._axes = _leg_axes(target_ned_m - self._motion[POS] if along_ned is None else along_ned)
        self.set_limits(self.limits)
        self._at_rest = None
        if yaw_rad is not None:
            self.turn_to(yaw_rad)

    def turn_to(self, yaw_rad: float) -> None:
        """Turn to a heading by the shorter way."""
        if yaw_rad != self.yaw_rad:
            self.yaw_rad = yaw_rad
            present_rad = float(self._yaw[POS])
            self._yaw_goal_rad = present_rad + math.remainder(yaw_rad - present_rad, math.tau)
            self._at_rest = None

    def update(self, dt_s: float, *, vehicle_pos_ned_m: Array | None = None) -> TrajectorySetpoint:
        """Advance by ``dt_s`` (> 0) and return the setpoint; at rest this is cheap.

        The acceleration leads by the lag of the attitude loop. With ``vehicle_pos_ned_m`` the reference slows
        down once the vehicle is half of ``xy_error_max_m`` away from it horizontally, and stops at
        ``xy_error_max_m``.
        """
        if self._at_rest is not None:
            return self._at_rest
        limits, motion = self.limits, self._motion
        pace = 1.0
        if vehicle_pos_ned_m is not None:
            lag_m = math.hypot(motion[0, 0] - vehicle_pos_ned_m[0], motion[0, 1] - vehicle_pos_ned_m[1])
            pace = min(max(2.0 - 2.0 * lag_m / limits.xy_error_max_m, 0.0), 1.0)
        rests = _advance(
            motion, self.target_ned_m, self._axes, self._limits, self._yaw, self._yaw_goal_rad,
            self._yaw_limits, pace, dt_s,
        )  # fmt: skip
        setpoint = TrajectorySetpoint(
            pos_ned_m=motion[POS].copy(),
            vel_ned_m_s=pace * motion[VEL],
            acc_ned_m_s2=pace**2 * motion[ACC] + pace**3 * limits.acc_lead_s * motion[JERK],
            yaw_rad=math.remainder(float(self._yaw[POS]), math.tau),
            yaw_rate_rad_s=float(self._yaw[VEL]),
        )
        self._at_rest = setpoint if rests else None
        return setpoint

    def stopping_distance_m(self) -> float:
        """Return the distance in which the reference stops from its cruise speed."""
        p = self.limits
        return float(stopping_distance(p.xy_cruise_m_s, 0.0, -p.acc_xy_m_s2, p.acc_xy_m_s2, p.jerk_m_s3))

    def _stopping_way_ned_m(self, vel_ned_m_s: Array) -> Array:
        """Return the displacement (3,) until a motion stops, within the limits of acceleration and jerk."""
        limits = self.limits
        speed_m_s = math.hypot(vel_ned_m_s[0], vel_ned_m_s[1])
        acc_m_s2 = limits.acc_xy_m_s2
        horizontal_s = stopping_distance(speed_m_s, 0.0, -acc_m_s2, acc_m_s2, limits.jerk_m_s3) / max(
            speed_m_s, 1e-9
        )
        down_m = stopping_distance(
            float(vel_ned_m_s[2]), 0.0, -limits.acc_up_m_s2, limits.acc_dn_m_s2, limits.jerk_m_s3
        )
        return np.array([vel_ned_m_s[0] * horizontal_s, vel_ned_m_s[1] * horizontal_s, down_m])


def _leg_axes(along_ned: Array) -> Array:
    """Return a leg's axes, rows (3, 3): its direction (north without length), level across, the third."""
    axes = np.eye(3)
    length = math.sqrt(along_ned @ along_ned)
    if length < _REST_M:
        return axes
    axes[0] = along_ned / length
    level = math.hypot(axes[0, 0], axes[0, 1])
    if level > 1e-6:
        axes[1] = (-axes[0, 1] / level, axes[0, 0] / level, 0.0)
    else:  # exactly vertical: axes that are not orthogonal would couple the motions
        axes[0] = (0.0, 0.0, math.copysign(1.0, along_ned[2]))
        axes[1] = (1.0, 0.0, 0.0)
    a, b = axes[0], axes[1]
    axes[2] = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    return axes
