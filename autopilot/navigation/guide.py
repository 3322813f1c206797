"""Common parts of the automatic modes: a jerk-limited path to a position, and the inputs of a step."""

import math

import numpy as np
from msgspec import Struct

from autopilot.control.params import TrajectoryParams
from autopilot.control.trajectory import stopping_distance
from autopilot.navigation.reference import LegReference
from foundation.geometry.rotations import quat_to_euler
from foundation.types import Array, EstimatorState, TrajectorySetpoint

HomePosition = tuple[float, float, float]
"""NED metres from the estimator's origin."""


class Moment(Struct, frozen=True, kw_only=True):
    """Inputs of a mode at one step."""

    state: EstimatorState
    dt_s: float
    landed: bool
    touching: bool
    """Ground contact is suspected, so the setpoint must not push against the ground."""
    home_ned_m: HomePosition | None


class Guide:
    """Path to one target at a time, with a heading; `follow` is cheap once it has arrived."""

    def __init__(self, limits: TrajectoryParams) -> None:
        self.limits = limits
        self.target_ned_m: Array = np.zeros(3)
        self.yaw_rad = 0.0
        """Target heading."""
        self._reference = LegReference(limits)
        self._at_rest: TrajectorySetpoint | None = None

    @property
    def resting(self) -> bool:
        """Whether the reference is at rest at its target, with its heading."""
        return self._at_rest is not None

    @property
    def pos_ned_m(self) -> Array:
        """Position (3,) of the reference."""
        return self._reference.pos_ned_m

    @property
    def vel_ned_m_s(self) -> Array:
        """Velocity (3,) of the reference."""
        return self._reference.vel_ned_m_s

    def set_limits(self, limits: TrajectoryParams) -> None:
        """Change speeds and accelerations."""
        if limits != self.limits:
            self.limits = limits
            self._reference.set_params(limits)

    def restart(self, state: EstimatorState) -> None:
        """Restart from the vehicle's motion and heading; the target is the stopping point."""
        yaw_rad = float(quat_to_euler(state.q_ned_frd)[2])
        self._reference.reset(state.pos_ned_m, yaw_rad=yaw_rad, vel_ned_m_s=state.vel_ned_m_s)
        self.go_to(
            state.pos_ned_m + self._stopping_way_ned_m(state.vel_ned_m_s),
            yaw_rad=yaw_rad,
            along_ned=np.array((state.vel_ned_m_s[0], state.vel_ned_m_s[1], 0.0)),
        )

    def go_to(
        self, target_ned_m: Array, *, yaw_rad: float | None = None, along_ned: Array | None = None
    ) -> None:
        """Set another target (3,), and another heading unless None.

        The leg is on the line through the target along ``along_ned`` (3,), by default from the reference.
        """
        self.target_ned_m = target_ned_m
        self._reference.go_to(target_ned_m, along_ned=along_ned)
        self._at_rest = None
        if yaw_rad is not None:
            self.turn_to(yaw_rad)

    def turn_to(self, yaw_rad: float) -> None:
        """Set another heading."""
        if yaw_rad != self.yaw_rad:
            self.yaw_rad = yaw_rad
            self._reference.turn_to(yaw_rad)
            self._at_rest = None

    def follow(self, dt_s: float, *, vehicle_pos_ned_m: Array | None = None) -> TrajectorySetpoint:
        """Return the setpoint after ``dt_s``; the reference waits for a vehicle whose position is given."""
        if self._at_rest is not None:
            return self._at_rest
        setpoint = self._reference.update(dt_s, vehicle_pos_ned_m=vehicle_pos_ned_m)
        if self._reference.resting:
            self._at_rest = setpoint
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


def is_near(pos_ned_m: Array, place_ned_m: Array, *, radius_m: float, height_m: float) -> bool:
    """Return whether a position is within the radius and height tolerance of another."""
    return (
        abs(pos_ned_m[2] - place_ned_m[2]) <= height_m
        and math.hypot(pos_ned_m[0] - place_ned_m[0], pos_ned_m[1] - place_ned_m[1]) <= radius_m
    )


def heading_rad(
    mode: int, guide: Guide, place_ned_m: Array, home_ned_m: HomePosition | None, *, near_m: float
) -> float | None:
    """Return the heading by MPC_YAW_MODE on the way to a position; None keeps the last one.

    A target nearer than ``near_m``, or a path slower than a tenth of it per second, has no direction.
    """
    pos_ned_m = guide.pos_ned_m
    if mode == 3:
        way = guide.vel_ned_m_s
        near_m *= 0.1
    elif mode == 0:
        way = place_ned_m - pos_ned_m
    elif home_ned_m is None:
        return None
    else:
        way = np.array(home_ned_m) - pos_ned_m
        if mode == 2:
            way = -way
    if math.hypot(way[0], way[1]) < near_m:
        return None
    return math.atan2(way[1], way[0])
