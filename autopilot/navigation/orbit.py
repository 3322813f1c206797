"""Orbit mode: flight on a circle around a centre, with a selectable heading. Pure.

After PX4's FlightTaskOrbit: the vehicle flies straight to the nearest point of the circle, and then along it.
Unlike in PX4, position, velocity and acceleration of the circle are all feed-forward, from rest within the
jerk limit, so there is no radial tracking error.
"""

import math
from enum import IntEnum

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.commander.mode_table import FLIES_TO_A_PLACE, ModeTraits
from autopilot.control.params import TrajectoryParams
from autopilot.navigation.flight_mode import IDLE, ModeContext, ModeEntry, ModeInputs, StopMode
from autopilot.navigation.manual import curve
from foundation.geometry.rotations import quat_to_euler
from foundation.types import Array, EstimatorState, TrajectorySetpoint

RADIUS_MIN_M, RADIUS_MAX_M = 1.0, 1_000.0
SPEED_MAX_M_S = 10.0
ACC_MAX_M_S2 = 2.0
"""PX4's bounds of radius, speed and centripetal acceleration; the speed is reduced to respect the last."""
_CENTRE_M = 0.1
"""Nearer to the centre than this, all points of the circle count as equally near."""


class YawBehaviour(IntEnum):
    """Heading on the circle: ORBIT_YAW_BEHAVIOUR."""

    TO_CENTRE = 0
    INITIAL = 1
    UNCONTROLLED = 2
    """The heading is kept."""
    TANGENT = 3
    STICK = 4
    UNCHANGED = 5
    """As before, or to the centre."""


class Circle(Struct, frozen=True, kw_only=True):
    """Parameters of an orbit."""

    north_m: float
    east_m: float
    down_m: float
    """Of the centre, from the estimator's origin"""
    radius_m: float
    speed_m_s: float
    """Clockwise seen from above; negative: counter-clockwise"""
    yaw: YawBehaviour

    def bounded(self) -> "Circle":
        """Return the circle within the bounds."""
        radius_m = min(max(self.radius_m, RADIUS_MIN_M), RADIUS_MAX_M)
        most_m_s = min(SPEED_MAX_M_S, math.sqrt(ACC_MAX_M_S2 * radius_m))
        speed_m_s = min(max(self.speed_m_s, -most_m_s), most_m_s)
        return replace(self, radius_m=radius_m, speed_m_s=speed_m_s)


def default_circle(state: EstimatorState) -> Circle:
    """Return PX4's circle for a mode selected without one: radius 1 m, centre to the south, 1 m/s."""
    north_m, east_m, down_m = state.pos_ned_m.tolist()
    return Circle(
        north_m=north_m - RADIUS_MIN_M, east_m=east_m, down_m=down_m, radius_m=RADIUS_MIN_M, speed_m_s=1.0,
        yaw=YawBehaviour.TO_CENTRE,
    )  # fmt: skip


class OrbitMode(StopMode):
    """Flies to a circle and along it; `start` is called with every requested circle."""

    traits = ModeTraits(
        needs=FLIES_TO_A_PLACE, of_one_flight=True, standard=common.MAV_STANDARD_MODE_ORBIT,
        is_selectable=False,  # needs a centre, from MAV_CMD_DO_ORBIT
    )  # fmt: skip

    def __init__(self, context: ModeContext) -> None:
        super().__init__(context)
        self.circle: Circle | None = None
        """The last requested circle, within the bounds."""
        self.approaching = True
        """Whether the vehicle is on the straight leg to the circle."""
        self._bearing_rad = 0.0
        """Bearing of the reference from the centre, clockwise from north."""
        self._speed_m_s = 0.0
        self._acc_m_s2 = 0.0
        """Of the reference, along the circle."""
        self._yaw_rad = 0.0
        self._initial_yaw_rad = 0.0

    def enter(self, entry: ModeEntry) -> None:
        """Start the default circle, or continue the requested one."""
        self._context.apply_leg_limits()
        circle = self.circle if entry.again else None
        self.start(entry.state, default_circle(entry.state) if circle is None else circle)

    def start(self, state: EstimatorState, circle: Circle) -> None:
        """Fly to the nearest point of a circle, from the present motion."""
        guide = self._guide
        guide.restart(state)
        self._initial_yaw_rad = self._yaw_rad = float(quat_to_euler(state.q_ned_frd)[2])
        if circle is not self.circle:
            self.circle = circle = circle.bounded()
        north_m, east_m = guide.target_ned_m[0] - circle.north_m, guide.target_ned_m[1] - circle.east_m
        self._bearing_rad = math.atan2(east_m, north_m)
        if math.hypot(north_m, east_m) < _CENTRE_M:
            self._bearing_rad = self._initial_yaw_rad
        self._speed_m_s = self._acc_m_s2 = 0.0
        self.approaching = True
        yaw_rad = self._heading_rad(circle)
        guide.go_to(self._place_ned_m(circle), yaw_rad=yaw_rad)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the approach or of the circle."""
        guide, circle, state = self._guide, self.circle, inputs.state
        if inputs.landed:
            return IDLE
        if circle is None:
            return guide.update(inputs.dt_s)
        if self.approaching and guide.resting:
            self.approaching = False
            self._yaw_rad = guide.yaw_rad
        if self.approaching:
            return guide.update(inputs.dt_s, vehicle_pos_ned_m=state.pos_ned_m)
        limits = guide.limits
        place_ned_m = self._place_ned_m(circle)
        lag_m = math.hypot(place_ned_m[0] - state.pos_ned_m[0], place_ned_m[1] - state.pos_ned_m[1])
        pace = min(max(2.0 - 2.0 * lag_m / limits.xy_error_max_m, 0.0), 1.0)
        jerk_m_s3 = self._advance(circle, pace * inputs.dt_s, limits)
        yaw_rate_rad_s = pace * self._turn(circle, inputs.dt_s, limits)
        if circle.yaw is YawBehaviour.STICK:
            stick = self._context.params.manual
            yaw_rate_rad_s = stick.yaw_rate_max_rad_s * curve(
                inputs.sticks.yaw, deadzone=stick.deadzone, expo=stick.yaw_expo
            )
        return self._setpoint(circle, pace, jerk_m_s3, yaw_rate_rad_s, limits.acc_lead_s)

    # ---- parts

    def _place_ned_m(self, circle: Circle) -> Array:
        return np.array((
            circle.north_m + circle.radius_m * math.cos(self._bearing_rad),
            circle.east_m + circle.radius_m * math.sin(self._bearing_rad),
            circle.down_m,
        ))  # fmt: skip

    def _advance(self, circle: Circle, dt_s: float, limits: TrajectoryParams) -> float:
        """Advance along the circle; return the jerk along it, m/s^3."""
        if dt_s <= 0.0:
            return 0.0
        missing_m_s = circle.speed_m_s - self._speed_m_s
        # the acceleration that reaches zero at full jerk exactly when the speed is reached
        half_s = 0.5 * dt_s
        most_m_s2 = limits.jerk_m_s3 * (
            math.sqrt(half_s * half_s + 2.0 * abs(missing_m_s) / limits.jerk_m_s3) - half_s
        )
        demanded_m_s2 = math.copysign(
            min(most_m_s2, limits.acc_xy_m_s2, abs(missing_m_s) / dt_s), missing_m_s
        )
        change_m_s2 = limits.jerk_m_s3 * dt_s
        before_m_s2 = self._acc_m_s2
        self._acc_m_s2 += min(max(demanded_m_s2 - before_m_s2, -change_m_s2), change_m_s2)
        way_m = (self._speed_m_s + half_s * self._acc_m_s2) * dt_s
        self._speed_m_s += self._acc_m_s2 * dt_s
        self._bearing_rad = math.remainder(self._bearing_rad + way_m / circle.radius_m, math.tau)
        return (self._acc_m_s2 - before_m_s2) / dt_s

    def _turn(self, circle: Circle, dt_s: float, limits: TrajectoryParams) -> float:
        """Turn towards the demanded heading; return the rate of that heading itself, rad/s."""
        most_rad = limits.yaw_rate_max_rad_s * dt_s
        missing_rad = math.remainder(self._heading_rad(circle) - self._yaw_rad, math.tau)
        self._yaw_rad = math.remainder(self._yaw_rad + min(max(missing_rad, -most_rad), most_rad), math.tau)
        if circle.yaw not in {YawBehaviour.TO_CENTRE, YawBehaviour.TANGENT}:
            return 0.0
        rate_rad_s = self._speed_m_s / circle.radius_m
        return min(max(rate_rad_s, -limits.yaw_rate_max_rad_s), limits.yaw_rate_max_rad_s)

    def _heading_rad(self, circle: Circle) -> float:
        if circle.yaw is YawBehaviour.TO_CENTRE:
            return math.remainder(self._bearing_rad + math.pi, math.tau)
        if circle.yaw is YawBehaviour.TANGENT:
            ahead_rad = math.copysign(0.5 * math.pi, circle.speed_m_s)
            return math.remainder(self._bearing_rad + ahead_rad, math.tau)
        return self._initial_yaw_rad

    def _setpoint(
        self, circle: Circle, pace: float, jerk_m_s3: float, yaw_rate_rad_s: float, lead_s: float
    ) -> TrajectorySetpoint:
        """Return the motion of the reference; the acceleration leads by the lag of the attitude loop."""
        cos, sin = math.cos(self._bearing_rad), math.sin(self._bearing_rad)
        outwards, along = np.array((cos, sin, 0.0)), np.array((-sin, cos, 0.0))
        speed_m_s, acc_m_s2, turn_1_s = self._speed_m_s, self._acc_m_s2, self._speed_m_s / circle.radius_m
        acc_ned_m_s2 = acc_m_s2 * along - speed_m_s * turn_1_s * outwards
        jerk_ned_m_s3 = (jerk_m_s3 - speed_m_s * turn_1_s**2) * along - 3.0 * acc_m_s2 * turn_1_s * outwards
        by_stick = circle.yaw is YawBehaviour.STICK
        return TrajectorySetpoint(
            pos_ned_m=self._place_ned_m(circle),
            vel_ned_m_s=pace * speed_m_s * along,
            acc_ned_m_s2=pace**2 * acc_ned_m_s2 + pace**3 * lead_s * jerk_ned_m_s3,
            yaw_rad=None if by_stick else self._yaw_rad,
            yaw_rate_rad_s=yaw_rate_rad_s,
        )
