"""Take-off, landing, and descent without a position estimate. Pure."""

import numpy as np
from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.mode_table import FLIES_TO_A_PLACE, ModeTraits
from autopilot.control.params import TrajectoryParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import IDLE, VERTICAL, ModeEntry, ModeInputs, Moment, StopMode
from autopilot.navigation.params import NavigationParams
from foundation.types import Course, EstimatorState, TrajectorySetpoint

HORIZONTAL = (True, True, False)
UP = np.array((0.0, 0.0, -1.0))

_DESCEND_GAIN_1_S = 2.0
_DESCEND_ACC_MAX_M_S2 = 2.0
"""Proportional law that replaces the controller in a descent without a valid velocity."""
_SETTLE_ACC_M_S2 = 8.0
"""After such a descent no integral reduces thrust on the ground; an acceleration of most of gravity does."""


class TakeOffMode(StopMode):
    """Climbs vertically, from the ground or in the air, then changes to hold."""

    traits = ModeTraits(
        needs=FLIES_TO_A_PLACE, arms=True, of_one_flight=True, standard=common.MAV_STANDARD_MODE_TAKEOFF
    )
    airborne = False
    """Whether the vehicle has left the ground."""

    def enter(self, entry: ModeEntry) -> None:
        """Climb to ``entry.takeoff_down_m``; never descends."""
        self._context.apply_leg_limits()
        self.start(entry, down_m=entry.takeoff_down_m)

    def start(self, moment: Moment, *, down_m: float) -> None:
        """Climb to ``down_m``, vertically above the present stopping point; never descends."""
        guide = self._guide
        self.airborne = not moment.landed
        self._climb_within(guide.limits)
        guide.restart(moment.state)
        target_ned_m = guide.target_ned_m.copy()
        target_ned_m[2] = min(down_m, target_ned_m[2])
        guide.go_to(target_ned_m, along_ned=UP)

    def update(self, inputs: Moment) -> TrajectorySetpoint:
        """Return the setpoint of the climb."""
        guide = self._guide
        if not self.airborne:
            # Use the present estimate: on the ground only the estimate moves, and the vehicle would fly to an
            # earlier target as soon as it leaves the ground.
            target_ned_m, yaw_rad = inputs.state.pos_ned_m.copy(), guide.yaw_rad
            target_ned_m[2] = guide.target_ned_m[2]
            if inputs.landed:
                # the reference must not climb ahead while thrust is still rising
                return TrajectorySetpoint(
                    pos_ned_m=target_ned_m,
                    pos_axes=HORIZONTAL,
                    vel_ned_m_s=np.array([0.0, 0.0, -guide.limits.z_vel_up_m_s]),
                    yaw_rad=guide.yaw_rad,
                )
            self.airborne = True
            guide.restart(inputs.state)
            guide.go_to(target_ned_m, yaw_rad=yaw_rad, along_ned=UP)
        return guide.update(inputs.dt_s)

    def next_mode(self, state: EstimatorState, /) -> FlightMode | None:
        """Return hold at the final height."""
        missing_m = abs(float(state.pos_ned_m[2]) - float(self._guide.target_ned_m[2]))
        done = self.airborne and missing_m < self._context.params.altitude_acceptance_m
        return FlightMode.HOLD if done else None

    @property
    def course(self) -> Course:
        """Take-off."""
        return Course.TAKE_OFF

    def apply_limits(self) -> None:
        """Apply the parameters to the climb."""
        self._climb_within(self._context.limits)

    def _climb_within(self, limits: TrajectoryParams) -> None:
        """Use ``limits`` with the climb rate of take-offs."""
        self._guide.set_limits(replace(limits, z_vel_up_m_s=self._context.position.tko_speed_m_s))


class LandMode(StopMode):
    """Descends at the landing speed while the guide leads to the landing position, or holds it."""

    traits = ModeTraits(needs=FLIES_TO_A_PLACE, of_one_flight=True, standard=common.MAV_STANDARD_MODE_LAND)
    _vel_down_m_s = 0.0

    def enter(self, entry: ModeEntry) -> None:
        """Stop and begin the descent."""
        super().enter(entry)
        self.start(entry.state)

    def start(self, state: EstimatorState) -> None:
        """Begin the descent with the vehicle's vertical motion."""
        self._vel_down_m_s = float(state.vel_ned_m_s[2])

    def update(self, inputs: Moment) -> TrajectorySetpoint:
        """Return the setpoint of the descent."""
        if inputs.landed:
            return IDLE
        guide, params = self._guide, self._context.params
        limits = guide.limits
        height_m = inputs.home_down_m - float(inputs.state.pos_ned_m[2])
        demanded_m_s = speed_by_height_m_s(
            height_m, params, slow_m_s=params.land_speed_m_s, fast_m_s=limits.z_vel_dn_m_s
        )
        acc_m_s2 = limits.acc_dn_m_s2 if demanded_m_s > self._vel_down_m_s else limits.acc_up_m_s2
        step_m_s = acc_m_s2 * inputs.dt_s
        self._vel_down_m_s += max(-step_m_s, min(step_m_s, demanded_m_s - self._vel_down_m_s))
        if inputs.touching:
            return TrajectorySetpoint(
                vel_ned_m_s=np.array([0.0, 0.0, self._vel_down_m_s]),
                vel_axes=VERTICAL,
                acc_ned_m_s2=np.zeros(3),
                yaw_rad=guide.yaw_rad,
            )
        way = guide.update(inputs.dt_s)
        assert way.vel_ned_m_s is not None  # noqa: S101  # legs have all three
        return TrajectorySetpoint(
            pos_ned_m=way.pos_ned_m,
            pos_axes=HORIZONTAL,
            vel_ned_m_s=np.array([way.vel_ned_m_s[0], way.vel_ned_m_s[1], self._vel_down_m_s]),
            acc_ned_m_s2=way.acc_ned_m_s2,
            acc_axes=HORIZONTAL,
            yaw_rad=way.yaw_rad,
            yaw_rate_rad_s=way.yaw_rate_rad_s,
        )

    @property
    def course(self) -> Course:
        """Landing."""
        return Course.LANDING


class DescendMode(StopMode):
    """Descends at the landing speed without a position, or even a velocity estimate."""

    traits = ModeTraits(needs=Condition.ATTITUDE, of_one_flight=True)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the descent."""
        if inputs.landed:
            return IDLE
        state, yaw_rad = inputs.state, self._guide.yaw_rad
        speed_m_s = self._context.params.land_speed_m_s
        if state.velocity_valid or state.height_valid:  # a valid height implies a valid vertical velocity
            return TrajectorySetpoint(vel_ned_m_s=np.array([0.0, 0.0, speed_m_s]), yaw_rad=yaw_rad)
        acc_m_s2 = _DESCEND_GAIN_1_S * (speed_m_s - float(state.vel_ned_m_s[2]))
        acc_m_s2 = max(-_DESCEND_ACC_MAX_M_S2, min(_DESCEND_ACC_MAX_M_S2, acc_m_s2))
        if inputs.touching:
            acc_m_s2 = _SETTLE_ACC_M_S2
        return TrajectorySetpoint(acc_ned_m_s2=np.array([0.0, 0.0, acc_m_s2]), yaw_rad=yaw_rad)

    @property
    def course(self) -> Course:
        """Landing."""
        return Course.LANDING


def speed_by_height_m_s(
    height_m: float, params: NavigationParams, *, slow_m_s: float, fast_m_s: float
) -> float:
    """Return ``slow_m_s`` near the ground, ``fast_m_s`` high up, interpolated in between."""
    low_m, high_m = params.land_slow_height_m, params.land_fast_height_m
    share = (height_m - low_m) / (high_m - low_m) if high_m > low_m else float(height_m > low_m)
    return slow_m_s + min(max(share, 0.0), 1.0) * (fast_m_s - slow_m_s)
