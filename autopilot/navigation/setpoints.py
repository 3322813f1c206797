"""Where take-off, hold, land and descend want the vehicle, as setpoints for the flight controller. Pure.

Offboard needs nothing of this: its setpoints come from outside and go to the controller as they are.
"""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from autopilot.control.params import PositionParams, TrajectoryParams
from autopilot.control.trajectory import PositionTrajectory, stopping_distance
from autopilot.estimation.rotation import quat_to_euler
from autopilot.mavlink.modes import FlightMode
from autopilot.types import Array, EstimatorState, TrajectorySetpoint

Positive = Annotated[float, Meta(gt=0.0)]

_HORIZONTAL = (True, True, False)
_VERTICAL = (False, False, True)
_DESCEND_GAIN_1_S = 2.0
_DESCEND_ACC_MAX_M_S2 = 2.0
"""Descent without a valid velocity, which the controller then leaves alone: a proportional law stands in."""
_SETTLE_ACC_M_S2 = 8.0
"""On the ground after such a descent no integral takes the thrust away; asking for most of gravity does."""

IDLE = TrajectorySetpoint(vel_ned_m_s=np.zeros(3), vel_axes=_VERTICAL)
"""Armed on the ground and to stay there."""


class NavigationParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Heights and speeds; the parameter table states them by PX4's names."""

    takeoff_height_m: Positive = 2.5
    """MIS_TAKEOFF_ALT: above home, for a take-off without an altitude"""
    altitude_acceptance_m: Positive = 0.8
    """NAV_MC_ALT_RAD: from here on a take-off is done"""
    land_speed_m_s: Positive = 0.7
    """MPC_LAND_SPEED"""
    land_slow_height_m: Positive = 5.0
    """MPC_LAND_ALT2: below this height over home at the landing speed"""
    land_fast_height_m: Positive = 10.0
    """MPC_LAND_ALT1: above this height at MPC_Z_V_AUTO_DN; between the two in proportion"""


class Navigator:
    """Setpoints of one vehicle's mode: `enter` it, then `update` at every step."""

    def __init__(
        self, params: NavigationParams, trajectory: TrajectoryParams, position: PositionParams
    ) -> None:
        self._params = params
        self._limits = trajectory
        self._takeoff_speed_m_s = position.tko_speed_m_s
        self._cruise = PositionTrajectory(trajectory)
        self._climb = PositionTrajectory(replace(trajectory, z_vel_up_m_s=position.tko_speed_m_s))
        self._trajectory = self._cruise
        self._mode = FlightMode.HOLD
        self._target_ned_m: Array = np.zeros(3)
        self._yaw_rad = 0.0
        self._vel_down_m_s = 0.0
        self._airborne = False
        self._at_rest: TrajectorySetpoint | None = None

    def enter(self, mode: FlightMode, state: EstimatorState, *, landed: bool, takeoff_down_m: float) -> None:
        """Begin a mode from the present motion, or begin it again after the estimate has jumped.

        ``takeoff_down_m`` is where a take-off ends; it never goes down.
        """
        from_takeoff = self._mode is FlightMode.TAKEOFF and mode is FlightMode.HOLD and self.completed(state)
        self._mode = mode
        if from_takeoff:
            return  # the climb's end is the place to hold
        self._airborne = not landed
        self._yaw_rad = float(quat_to_euler(state.q_ned_frd)[2])
        self._vel_down_m_s = float(state.vel_ned_m_s[2])
        self._trajectory = self._climb if mode is FlightMode.TAKEOFF else self._cruise
        self._restart(state)
        self._target_ned_m = state.pos_ned_m + self._stopping_way_ned_m(state.vel_ned_m_s)
        if mode is FlightMode.TAKEOFF:
            self._target_ned_m[2] = min(takeoff_down_m, self._target_ned_m[2])

    def update(
        self, state: EstimatorState, *, dt_s: float, landed: bool, touching: bool, home_down_m: float
    ) -> TrajectorySetpoint:
        """Give the mode's setpoint. ``touching``: the ground is suspected, and must not be leaned against."""
        if self._mode is FlightMode.TAKEOFF:
            return self._take_off(state, dt_s=dt_s, landed=landed)
        if landed:
            return IDLE
        if self._mode is FlightMode.LAND:
            return self._land(state, dt_s=dt_s, touching=touching, home_down_m=home_down_m)
        if self._mode is FlightMode.DESCEND:
            return self._descend(state, touching=touching)
        return self._follow(dt_s)

    def completed(self, state: EstimatorState) -> bool:
        """Whether a take-off has reached its height."""
        return (
            self._mode is FlightMode.TAKEOFF
            and self._airborne
            and abs(float(state.pos_ned_m[2]) - float(self._target_ned_m[2]))
            < self._params.altitude_acceptance_m
        )

    def _take_off(self, state: EstimatorState, *, dt_s: float, landed: bool) -> TrajectorySetpoint:
        if not self._airborne:
            if landed:
                # the reference must not climb ahead while thrust is still rising
                return TrajectorySetpoint(
                    pos_ned_m=self._target_ned_m,
                    pos_axes=_HORIZONTAL,
                    vel_ned_m_s=np.array([0.0, 0.0, -self._takeoff_speed_m_s]),
                    yaw_rad=self._yaw_rad,
                )
            self._airborne = True
            self._restart(state)
        return self._follow(dt_s)

    def _land(
        self, state: EstimatorState, *, dt_s: float, touching: bool, home_down_m: float
    ) -> TrajectorySetpoint:
        wanted_m_s = self._landing_speed_m_s(home_down_m - float(state.pos_ned_m[2]))
        acc_m_s2 = self._limits.acc_dn_m_s2 if wanted_m_s > self._vel_down_m_s else self._limits.acc_up_m_s2
        step_m_s = acc_m_s2 * dt_s
        self._vel_down_m_s += max(-step_m_s, min(step_m_s, wanted_m_s - self._vel_down_m_s))
        if touching:
            return TrajectorySetpoint(
                vel_ned_m_s=np.array([0.0, 0.0, self._vel_down_m_s]),
                vel_axes=_VERTICAL,
                acc_ned_m_s2=np.zeros(3),
                yaw_rad=self._yaw_rad,
            )
        way = self._follow(dt_s)
        assert way.vel_ned_m_s is not None  # noqa: S101  # PositionTrajectory gives all three groups
        return TrajectorySetpoint(
            pos_ned_m=way.pos_ned_m,
            pos_axes=_HORIZONTAL,
            vel_ned_m_s=np.array([way.vel_ned_m_s[0], way.vel_ned_m_s[1], self._vel_down_m_s]),
            acc_ned_m_s2=way.acc_ned_m_s2,
            acc_axes=_HORIZONTAL,
            yaw_rad=self._yaw_rad,
        )

    def _descend(self, state: EstimatorState, *, touching: bool) -> TrajectorySetpoint:
        speed_m_s = self._params.land_speed_m_s
        if state.velocity_valid:
            return TrajectorySetpoint(vel_ned_m_s=np.array([0.0, 0.0, speed_m_s]), yaw_rad=self._yaw_rad)
        acc_m_s2 = _DESCEND_GAIN_1_S * (speed_m_s - float(state.vel_ned_m_s[2]))
        acc_m_s2 = max(-_DESCEND_ACC_MAX_M_S2, min(_DESCEND_ACC_MAX_M_S2, acc_m_s2))
        if touching:
            acc_m_s2 = _SETTLE_ACC_M_S2
        return TrajectorySetpoint(acc_ned_m_s2=np.array([0.0, 0.0, acc_m_s2]), yaw_rad=self._yaw_rad)

    def _follow(self, dt_s: float) -> TrajectorySetpoint:
        if self._at_rest is not None:
            return self._at_rest
        setpoint = self._trajectory.update(self._target_ned_m, dt_s)
        if _has_arrived(setpoint, self._target_ned_m):
            self._at_rest = setpoint  # it needs no computing any more
        return setpoint

    def _restart(self, state: EstimatorState) -> None:
        self._at_rest = None
        self._trajectory.reset(state.pos_ned_m, yaw_rad=self._yaw_rad, vel_ned_m_s=state.vel_ned_m_s)

    def _stopping_way_ned_m(self, vel_ned_m_s: Array) -> Array:
        """(3,) way on which the motion comes to rest within the limits of acceleration and jerk."""
        limits = self._limits
        speed_m_s = math.hypot(vel_ned_m_s[0], vel_ned_m_s[1])
        acc_m_s2 = limits.acc_xy_m_s2
        horizontal_s = stopping_distance(speed_m_s, 0.0, -acc_m_s2, acc_m_s2, limits.jerk_m_s3) / max(
            speed_m_s, 1e-9
        )
        down_m = stopping_distance(
            float(vel_ned_m_s[2]), 0.0, -limits.acc_up_m_s2, limits.acc_dn_m_s2, limits.jerk_m_s3
        )
        return np.array([vel_ned_m_s[0] * horizontal_s, vel_ned_m_s[1] * horizontal_s, down_m])

    def _landing_speed_m_s(self, height_m: float) -> float:
        params = self._params
        return float(
            np.interp(
                height_m,
                (params.land_slow_height_m, params.land_fast_height_m),
                (params.land_speed_m_s, self._limits.z_vel_dn_m_s),
            )
        )


def _has_arrived(reference: TrajectorySetpoint, target_ned_m: Array) -> bool:
    """Whether the trajectory has ended; it then is exactly at the target."""
    pos_ned_m, vel_ned_m_s = reference.pos_ned_m, reference.vel_ned_m_s
    return (
        pos_ned_m is not None
        and vel_ned_m_s is not None
        and not vel_ned_m_s.any()
        and np.array_equal(pos_ned_m, target_ned_m)
    )


def down_demand_m_s(state: EstimatorState, setpoint: TrajectorySetpoint, *, z_p_1_s: float) -> float:
    """Vertical speed that a setpoint asks for, down positive; an acceleration counts for one second of it."""
    if setpoint.pos_ned_m is not None and setpoint.pos_axes[2]:
        demand_m_s = z_p_1_s * float(setpoint.pos_ned_m[2] - state.pos_ned_m[2])
        if setpoint.vel_ned_m_s is not None and setpoint.vel_axes[2]:
            demand_m_s += float(setpoint.vel_ned_m_s[2])
        return demand_m_s
    if setpoint.vel_ned_m_s is not None and setpoint.vel_axes[2]:
        return float(setpoint.vel_ned_m_s[2])
    if setpoint.acc_ned_m_s2 is not None and setpoint.acc_axes[2]:
        return float(setpoint.acc_ned_m_s2[2])
    return 0.0
