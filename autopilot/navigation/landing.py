"""Take-off, landing, and descent without a position estimate. Pure."""

import numpy as np
from msgspec.structs import replace

from autopilot.control.params import TrajectoryParams
from autopilot.navigation.guide import Guide, Moment
from autopilot.navigation.params import NavigationParams
from foundation.types import EstimatorState, TrajectorySetpoint

HORIZONTAL = (True, True, False)
VERTICAL = (False, False, True)
UP = np.array((0.0, 0.0, -1.0))

IDLE = TrajectorySetpoint(vel_ned_m_s=np.zeros(3), vel_axes=VERTICAL)
"""Setpoint of an armed vehicle that stays on the ground."""

_DESCEND_GAIN_1_S = 2.0
_DESCEND_ACC_MAX_M_S2 = 2.0
"""Descent without a valid velocity, which the controller then does not control: a proportional law replaces
it."""
_SETTLE_ACC_M_S2 = 8.0
"""After such a descent no integral reduces thrust on the ground; an acceleration of most of gravity does."""


class TakeOff:
    """Vertical climb from the ground, or continued climb in the air."""

    def __init__(self, guide: Guide) -> None:
        self._guide = guide
        self.airborne = False
        """Whether the vehicle has left the ground."""

    def start(self, moment: Moment, *, down_m: float, speed_m_s: float) -> None:
        """Climb to ``down_m``, vertically above the present stopping point; never descends."""
        guide = self._guide
        self.airborne = not moment.landed
        self.set_limits(guide.limits, speed_m_s=speed_m_s)
        guide.restart(moment.state)
        target_ned_m = guide.target_ned_m.copy()
        target_ned_m[2] = min(down_m, target_ned_m[2])
        guide.go_to(target_ned_m, along_ned=UP)

    def set_limits(self, limits: TrajectoryParams, *, speed_m_s: float) -> None:
        """Use ``limits``, with a climb rate of ``speed_m_s``."""
        self._speed_m_s = speed_m_s
        self._guide.set_limits(replace(limits, z_vel_up_m_s=speed_m_s))

    def update(self, moment: Moment) -> TrajectorySetpoint:
        """Return the next setpoint."""
        guide = self._guide
        if not self.airborne:
            # Use the present estimate: on the ground only the estimate moves, and the vehicle would fly to an
            # earlier target as soon as it leaves the ground.
            target_ned_m, yaw_rad = moment.state.pos_ned_m.copy(), guide.yaw_rad
            target_ned_m[2] = guide.target_ned_m[2]
            if moment.landed:
                # the reference must not climb ahead while thrust is still rising
                return TrajectorySetpoint(
                    pos_ned_m=target_ned_m,
                    pos_axes=HORIZONTAL,
                    vel_ned_m_s=np.array([0.0, 0.0, -self._speed_m_s]),
                    yaw_rad=guide.yaw_rad,
                )
            self.airborne = True
            guide.restart(moment.state)
            guide.go_to(target_ned_m, yaw_rad=yaw_rad, along_ned=UP)
        return guide.follow(moment.dt_s)


class Landing:
    """Descends at the landing speed while the guide leads to the landing position or holds it."""

    def __init__(self, guide: Guide) -> None:
        self._guide = guide
        self._vel_down_m_s = 0.0

    def start(self, state: EstimatorState) -> None:
        """Start from the vehicle's vertical motion."""
        self._vel_down_m_s = float(state.vel_ned_m_s[2])

    def update(self, moment: Moment, params: NavigationParams) -> TrajectorySetpoint:
        """Return the next setpoint; without a home position, heights are relative to the origin."""
        guide = self._guide
        limits = guide.limits
        home_down_m = moment.home_ned_m[2] if moment.home_ned_m is not None else 0.0
        height_m = home_down_m - float(moment.state.pos_ned_m[2])
        demanded_m_s = speed_by_height_m_s(
            height_m, params, slow_m_s=params.land_speed_m_s, fast_m_s=limits.z_vel_dn_m_s
        )
        acc_m_s2 = limits.acc_dn_m_s2 if demanded_m_s > self._vel_down_m_s else limits.acc_up_m_s2
        step_m_s = acc_m_s2 * moment.dt_s
        self._vel_down_m_s += max(-step_m_s, min(step_m_s, demanded_m_s - self._vel_down_m_s))
        if moment.touching:
            return TrajectorySetpoint(
                vel_ned_m_s=np.array([0.0, 0.0, self._vel_down_m_s]),
                vel_axes=VERTICAL,
                acc_ned_m_s2=np.zeros(3),
                yaw_rad=guide.yaw_rad,
            )
        way = guide.follow(moment.dt_s)
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


def speed_by_height_m_s(
    height_m: float, params: NavigationParams, *, slow_m_s: float, fast_m_s: float
) -> float:
    """Return ``slow_m_s`` near the ground, ``fast_m_s`` high up, interpolated in between."""
    low_m, high_m = params.land_slow_height_m, params.land_fast_height_m
    share = (height_m - low_m) / (high_m - low_m) if high_m > low_m else float(height_m > low_m)
    return slow_m_s + min(max(share, 0.0), 1.0) * (fast_m_s - slow_m_s)


def descend(
    state: EstimatorState, params: NavigationParams, *, touching: bool, yaw_rad: float
) -> TrajectorySetpoint:
    """Return the setpoint of a descent at the landing speed, without position or even velocity estimate."""
    speed_m_s = params.land_speed_m_s
    if state.velocity_valid or state.height_valid:  # a valid height implies a valid vertical velocity
        return TrajectorySetpoint(vel_ned_m_s=np.array([0.0, 0.0, speed_m_s]), yaw_rad=yaw_rad)
    acc_m_s2 = _DESCEND_GAIN_1_S * (speed_m_s - float(state.vel_ned_m_s[2]))
    acc_m_s2 = max(-_DESCEND_ACC_MAX_M_S2, min(_DESCEND_ACC_MAX_M_S2, acc_m_s2))
    if touching:
        acc_m_s2 = _SETTLE_ACC_M_S2
    return TrajectorySetpoint(acc_ned_m_s2=np.array([0.0, 0.0, acc_m_s2]), yaw_rad=yaw_rad)
