"""Manual modes: setpoints of stabilized, altitude and position mode from stick input. Pure.

Deadzone and expo curve convert the sticks to demands. A velocity demand is followed by a reference within the
limits of acceleration and jerk, which the vehicle can track. Centred sticks brake; once the motion is slow,
the position (or the height) is held where the reference comes to rest.
"""

import math

import numpy as np
from numba import njit
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.mode_table import FLIES_TO_A_PLACE, ModeTraits
from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.navigation.flight_mode import (
    IDLE,
    VERTICAL,
    ManualInput,
    ModeContext,
    ModeEntry,
    ModeInputs,
    StopMode,
)
from autopilot.navigation.landing import speed_by_height_m_s
from foundation.geometry.rotations import quat_from_rotation_vector, quat_multiply, quat_to_euler
from foundation.types import Array, AttitudeSetpoint, EstimatorState, TrajectorySetpoint

TAKEOFF_STICK = 0.3
"""Throttle above the middle, as a fraction of its half range, at which the vehicle takes off (PX4: fixed)"""
_YAW_LEAD_MAX_RAD = 0.5
"""Greatest lead of the heading setpoint; a vehicle that cannot follow does not accumulate the turn."""
_REST_YAW_RATE_RAD_S = 1e-3
"""A filtered yaw rate below this is set to zero (PX4: fixed)"""

POS, VEL, ACC, JERK = range(4)
"""Rows of the reference's motion."""


def curve(stick: float, *, deadzone: float, expo: float) -> float:
    """Return the demand -1 .. 1 of a stick: 0 within the deadzone, then a mix of linear and cubic curve."""
    past = abs(stick) - deadzone
    if past <= 0.0:
        return 0.0
    x = min(past / (1.0 - deadzone), 1.0)
    return math.copysign((1.0 - expo) * x + expo * x**3, stick)


def in_circle(right: float, forward: float) -> tuple[float, float]:
    """Return the two sticks, limited to length 1 as a vector."""
    length = max(math.hypot(right, forward), 1.0)
    return right / length, forward / length


@njit(cache=True, inline="always")
def _acc_towards(missing: float, acc_max: float, jerk: float, dt_s: float) -> float:
    """Return the greatest acceleration (>= 0) that reaches zero at full jerk when ``missing`` (>= 0) does."""
    half = 0.5 * dt_s
    return min(acc_max, jerk * (math.sqrt(half * half + 2.0 * missing / jerk) - half))


@njit(cache=True)
def _advance_xy(
    motion: Array, demand: Array, vel_max: float, acc_max: float, jerk: float, dt_s: float
) -> None:
    """Advance columns 0 and 1 of ``motion`` (4, 3) towards the velocity ``demand``.

    The velocity at which the acceleration would reach zero at full jerk stays within the circle of
    ``vel_max`` (if it was in it), and so does the velocity.
    """
    vn, ve, an, ae = motion[VEL, 0], motion[VEL, 1], motion[ACC, 0], motion[ACC, 1]
    dn, de = demand[0] - vn - 0.5 * dt_s * an, demand[1] - ve - 0.5 * dt_s * ae
    missing = math.hypot(dn, de)
    goal = _acc_towards(missing, acc_max, jerk, dt_s) / max(missing, 1e-12)
    step_n, step_e = goal * dn - an, goal * de - ae
    step = math.hypot(step_n, step_e)
    if step > jerk * dt_s:
        step_n *= jerk * dt_s / step
        step_e *= jerk * dt_s / step
    acc = math.hypot(an, ae)
    settled = math.hypot(vn + an * acc / (2.0 * jerk), ve + ae * acc / (2.0 * jerk))
    for attempt in range(2):
        if attempt == 1:  # towards zero acceleration instead, which keeps the settled velocity
            share = min(jerk * dt_s / max(acc, 1e-12), 1.0)
            step_n, step_e = -share * an, -share * ae
        bn, be = an + step_n, ae + step_e
        new_n, new_e = vn + 0.5 * dt_s * (an + bn), ve + 0.5 * dt_s * (ae + be)
        b = math.hypot(bn, be)
        then = math.hypot(new_n + bn * b / (2.0 * jerk), new_e + be * b / (2.0 * jerk))
        if then <= max(vel_max, settled) + 1e-9:
            break
    reach = jerk * dt_s
    if b <= reach and math.hypot(demand[0] - new_n, demand[1] - new_e) <= reach * dt_s:
        new_n, new_e, bn, be = demand[0], demand[1], 0.0, 0.0
    motion[POS, 0] += dt_s * (vn + dt_s * (an / 3.0 + bn / 6.0))
    motion[POS, 1] += dt_s * (ve + dt_s * (ae / 3.0 + be / 6.0))
    motion[JERK, 0], motion[JERK, 1] = (bn - an) / dt_s, (be - ae) / dt_s
    motion[VEL, 0], motion[VEL, 1], motion[ACC, 0], motion[ACC, 1] = new_n, new_e, bn, be


@njit(cache=True)
def _advance_down(
    motion: Array, demand: float, acc_up: float, acc_down: float, jerk: float, dt_s: float
) -> None:
    """Advance column 2 of ``motion`` towards the velocity ``demand``, positive down."""
    vel, acc = motion[VEL, 2], motion[ACC, 2]
    missing = demand - vel - 0.5 * dt_s * acc
    if missing >= 0.0:
        goal = _acc_towards(missing, acc_down, jerk, dt_s)
    else:
        goal = -_acc_towards(-missing, acc_up, jerk, dt_s)
    reach = jerk * dt_s
    then = acc + min(max(goal - acc, -reach), reach)
    new = vel + 0.5 * dt_s * (acc + then)
    if abs(then) <= reach and abs(demand - new) <= reach * dt_s:
        new, then = demand, 0.0
    motion[POS, 2] += dt_s * (vel + dt_s * (acc / 3.0 + then / 6.0))
    motion[JERK, 2] = (then - acc) / dt_s
    motion[VEL, 2], motion[ACC, 2] = new, then


class ManualMode(StopMode):
    """A mode that follows the sticks."""

    def __init__(self, context: ModeContext) -> None:
        super().__init__(context)
        self._motion: Array = np.zeros((4, 3))
        self._locked_xy = False
        self._locked_down = False
        self._yaw_rad = 0.0
        self._yaw_rate_rad_s = 0.0
        self._still: tuple[ManualInput, TrajectorySetpoint] | None = None
        """Sticks and setpoint of a vehicle at rest, which are reused."""

    def apply_limits(self) -> None:
        """Apply the parameters from the next step on."""
        super().apply_limits()
        self._still = None

    def enter(self, entry: ModeEntry) -> None:
        """Start from the present motion and heading."""
        self._context.apply_leg_limits()
        self._start(entry.state)

    def _start(self, state: EstimatorState) -> None:
        """Start from the vehicle's motion and heading, or restart after a reset of the estimate."""
        self._motion[:] = 0.0
        self._motion[VEL] = state.vel_ned_m_s
        self._locked_xy = self._locked_down = False
        self._yaw_rad = float(quat_to_euler(state.q_ned_frd)[2])
        self._yaw_rate_rad_s = 0.0
        self._still = None

    def _on_ground(self, inputs: ModeInputs) -> TrajectorySetpoint | None:
        """Return the setpoint on the ground; None in the air."""
        if not inputs.landed:
            return None
        self._start(inputs.state)
        if 2.0 * inputs.sticks.throttle - 1.0 <= TAKEOFF_STICK:
            return IDLE
        # the take-off ramp limits the climb; the reference follows once the ground is left
        return TrajectorySetpoint(
            vel_ned_m_s=np.array((0.0, 0.0, -self._context.position.tko_speed_m_s)),
            vel_axes=VERTICAL,
            acc_ned_m_s2=np.zeros(3),
            yaw_rad=self._yaw_rad,
        )

    def _turn(self, inputs: ModeInputs) -> None:
        """Update heading setpoint and yaw rate; the heading is kept when the stick is centred."""
        manual = self._context.params.manual
        stick = curve(inputs.sticks.yaw, deadzone=manual.deadzone, expo=manual.yaw_expo)
        demand = stick * manual.yaw_rate_max_rad_s
        if demand == 0.0 and self._yaw_rate_rad_s == 0.0:
            return
        share = inputs.dt_s / (manual.yaw_rate_filter_s + inputs.dt_s)
        self._yaw_rate_rad_s += share * (demand - self._yaw_rate_rad_s)
        if demand == 0.0 and abs(self._yaw_rate_rad_s) < _REST_YAW_RATE_RAD_S:
            self._yaw_rate_rad_s = 0.0
        yaw_rad = float(quat_to_euler(inputs.state.q_ned_frd)[2])
        ahead_rad = math.remainder(self._yaw_rad + self._yaw_rate_rad_s * inputs.dt_s - yaw_rad, math.tau)
        ahead_rad = min(max(ahead_rad, -_YAW_LEAD_MAX_RAD), _YAW_LEAD_MAX_RAD)
        self._yaw_rad = math.remainder(yaw_rad + ahead_rad, math.tau)

    def _climb(self, inputs: ModeInputs) -> None:
        manual, motion, state = self._context.params.manual, self._motion, inputs.state
        stick = curve(2.0 * inputs.sticks.throttle - 1.0, deadzone=manual.deadzone, expo=manual.z_expo)
        limits = self._context.limits
        if not self._locked_down:
            motion[POS, 2] = state.pos_ned_m[2]
        if stick == 0.0:
            speed_m_s = max(abs(motion.item(VEL, 2)), abs(state.vel_ned_m_s.item(2)))
            self._locked_down = self._locked_down or _is_slow(speed_m_s, manual.hold_max_z_m_s)
            demand_m_s = 0.0
        else:
            self._locked_down = False
            demand_m_s = self._climb_speed_m_s(stick, inputs)
        _advance_down(
            motion, demand_m_s, limits.acc_up_m_s2, limits.acc_dn_m_s2, manual.jerk_m_s3, inputs.dt_s
        )

    def _climb_speed_m_s(self, stick: float, inputs: ModeInputs) -> float:
        """Return a throttle's downward speed; near the ground at most that of take-off or landing (PX4)."""
        position, params = self._context.position, self._context.params
        up_m_s, down_m_s = position.z_vel_max_up_m_s, position.z_vel_max_dn_m_s
        speed_m_s = -stick * (up_m_s if stick > 0.0 else down_m_s)
        if inputs.home_ned_m is None:
            return speed_m_s
        height_m = inputs.home_down_m - float(inputs.state.pos_ned_m[2])
        down_max_m_s = speed_by_height_m_s(
            height_m, params, slow_m_s=min(params.land_speed_m_s, down_m_s), fast_m_s=down_m_s
        )
        up_max_m_s = speed_by_height_m_s(
            height_m, params, slow_m_s=min(position.tko_speed_m_s, up_m_s), fast_m_s=up_m_s
        )
        return min(max(speed_m_s, -up_max_m_s), down_max_m_s)

    def _move(self, inputs: ModeInputs) -> None:
        manual, motion, state = self._context.params.manual, self._motion, inputs.state
        right = curve(inputs.sticks.roll, deadzone=manual.deadzone, expo=manual.xy_expo)
        forward = curve(inputs.sticks.pitch, deadzone=manual.deadzone, expo=manual.xy_expo)
        vel_max_m_s = min(manual.xy_speed_m_s, self._context.position.xy_vel_max_m_s)
        if not self._locked_xy:
            motion[POS, :2] = state.pos_ned_m[:2]
        if right == 0.0 and forward == 0.0:
            speed_m_s = max(
                math.hypot(motion[VEL, 0], motion[VEL, 1]),
                math.hypot(state.vel_ned_m_s[0], state.vel_ned_m_s[1]),
            )
            self._locked_xy = self._locked_xy or _is_slow(speed_m_s, manual.hold_max_xy_m_s)
            demand_ned_m_s = np.zeros(3)
        else:
            self._locked_xy = False
            demand_ned_m_s = vel_max_m_s * self._to_ned(*in_circle(right, forward))
        acc_max_m_s2 = self._context.limits.acc_xy_m_s2
        _advance_xy(motion, demand_ned_m_s, vel_max_m_s, acc_max_m_s2, manual.jerk_m_s3, inputs.dt_s)

    def _to_ned(self, right: float, forward: float) -> Array:
        """Return a horizontal vector (3,) of the heading's frame in NED."""
        sine, cosine = math.sin(self._yaw_rad), math.cos(self._yaw_rad)
        return np.array((cosine * forward - sine * right, sine * forward + cosine * right, 0.0))


def _is_slow(speed_m_s: float, hold_max_m_s: float) -> bool:
    return hold_max_m_s == 0.0 or speed_m_s < hold_max_m_s


class StabilizedMode(ManualMode):
    """Stabilized: sticks are tilt and thrust."""

    traits = ModeTraits(
        needs=Condition.ATTITUDE | Condition.MANUAL, arms=True, by_sticks=True, is_advanced=True
    )

    def update(self, inputs: ModeInputs) -> AttitudeSetpoint:
        """Return tilt, yaw rate and thrust."""
        manual, position, sticks = self._context.params.manual, self._context.position, inputs.sticks
        if inputs.landed and sticks.throttle < manual.deadzone:
            self._start(inputs.state)  # on the ground the heading setpoint is reset
        self._turn(inputs)
        right, forward = in_circle(sticks.roll, sticks.pitch)
        tilt_rad = np.array((right * manual.tilt_max_rad, -forward * manual.tilt_max_rad, 0.0))
        heading_rad = np.array((0.0, 0.0, self._yaw_rad))
        least = 0.0 if inputs.landed else manual.thrust_min
        middle = position.thr_hover if inputs.hover_thrust is None else inputs.hover_thrust
        throttle = 2.0 * min(max(sticks.throttle, 0.0), 1.0) - 1.0
        if throttle < 0.0:
            thrust = middle + throttle * (middle - least)
        else:
            thrust = middle + throttle * (position.thr_max - middle)
        return AttitudeSetpoint(
            q_ned_frd=quat_multiply(
                quat_from_rotation_vector(heading_rad), quat_from_rotation_vector(tilt_rad)
            ),
            yaw_rate_rad_s=self._yaw_rate_rad_s,
            thrust=min(max(thrust, least), position.thr_max),
        )


class AltitudeMode(ManualMode):
    """Altitude: sticks are tilt and climb rate."""

    traits = ModeTraits(
        needs=Condition.ATTITUDE | Condition.HEIGHT | Condition.MANUAL, arms=True, by_sticks=True,
        standard=common.MAV_STANDARD_MODE_ALTITUDE_HOLD,
    )  # fmt: skip

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return tilt by the sticks and climb rate by the throttle; the height is held when it is centred.

        The tilt is demanded as the acceleration that it causes in still air. The controller would compensate
        drag and wind by more tilt, so the estimated disturbance is added here.
        """
        waiting = self._on_ground(inputs)
        if waiting is not None:
            return waiting
        manual = self._context.params.manual
        self._turn(inputs)
        self._climb(inputs)
        right, forward = in_circle(inputs.sticks.roll, inputs.sticks.pitch)
        acc_m_s2 = GRAVITY_M_S2 * math.tan(manual.tilt_max_rad) * self._to_ned(right, forward)
        if inputs.disturbance_ned_m_s2 is not None:
            acc_m_s2 += inputs.disturbance_ned_m_s2
        motion = self._motion
        acc_m_s2[2] = motion[ACC, 2] + self._context.limits.acc_lead_s * motion[JERK, 2]
        return TrajectorySetpoint(
            pos_ned_m=motion[POS].copy() if self._locked_down else None,
            pos_axes=VERTICAL,
            vel_ned_m_s=motion[VEL].copy(),
            vel_axes=VERTICAL,
            acc_ned_m_s2=acc_m_s2,
            yaw_rad=self._yaw_rad,
            yaw_rate_rad_s=self._yaw_rate_rad_s,
        )


class PositionMode(ManualMode):
    """Position: sticks are velocity."""

    traits = ModeTraits(
        needs=FLIES_TO_A_PLACE | Condition.MANUAL, arms=True, by_sticks=True,
        standard=common.MAV_STANDARD_MODE_POSITION_HOLD,
    )  # fmt: skip

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return velocity by the sticks; the position is held when they are centred."""
        if self._still is not None and self._still[0] is inputs.sticks and not inputs.landed:
            return self._still[1]
        waiting = self._on_ground(inputs)
        if waiting is not None:
            return waiting
        self._turn(inputs)
        self._climb(inputs)
        on_ground = inputs.landed or (inputs.touching and self._motion[VEL, 2] > 0.0)
        if on_ground:
            self._motion[:, :2] = 0.0  # no horizontal demand on the ground
            self._locked_xy = False
        else:
            self._move(inputs)
        motion = self._motion
        locks = (self._locked_xy, self._locked_xy, self._locked_down)
        setpoint = TrajectorySetpoint(
            pos_ned_m=motion[POS].copy() if any(locks) else None,
            pos_axes=locks,
            vel_ned_m_s=motion[VEL].copy(),
            vel_axes=VERTICAL if on_ground else (True, True, True),
            acc_ned_m_s2=motion[ACC] + self._context.limits.acc_lead_s * motion[JERK],
            yaw_rad=self._yaw_rad,
            yaw_rate_rad_s=self._yaw_rate_rad_s,
        )
        still = (
            self._locked_xy
            and self._locked_down
            and not motion[VEL:].any()
            and self._yaw_rate_rad_s == 0.0
            and abs(inputs.sticks.yaw) <= self._context.params.manual.deadzone
        )
        self._still = (inputs.sticks, setpoint) if still else None
        return setpoint
