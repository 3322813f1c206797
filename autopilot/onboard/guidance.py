"""Guidance of one UAV: from what it knows of the formation to its setpoint. No I/O, no MAVLink.

The own place of the plan, joined at bounded speed; a height layer of its own where distances no longer hold
the formation together; kept clear of the others; and turned into the autopilot's frame, in which the vehicle
believes itself elsewhere than it is.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autopilot.config import OnboardConfig
from autopilot.formation_plan import FormationPlan
from autopilot.onboard.avoidance import Avoidance
from autopilot.onboard.formation import Correction, Reference
from autopilot.onboard.layers import HeightLayers
from autopilot.onboard.localisation import Others
from autopilot.onboard.motion import Heard, MotionStart
from autopilot.onboard.neighbourhood import Neighbourhood
from autopilot.onboard.own_state import OwnState
from autopilot.onboard.wind import WindObserver

Array = NDArray[np.float64]

POSITION_GAIN_1_S = 0.95
"""MPC_XY_P of an autopilot that has not said what it is."""
EXTRAPOLATED_US = 50_000
"""The autopilot's position is moved on by its velocity for so long at most: telemetry comes more often."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the autopilot is asked for; arrays (3,), NED, position from its own origin."""

    pos_ned_m: Array
    vel_ned_m_s: Array
    acc_ned_m_s2: Array | None
    """None: none is given."""


class Guidance:
    """One UAV's part of the formation control.

    Args:
        station: this UAV.
        plan: of the formation.
        config: settings.
        near: whom the UAV keeps clear of.

    Attributes:
        start: agreement on when the formation's motion begins.
        correction: the autopilot's position less the true one, as far as known.
        layers: height that keeps UAVs apart that no longer know where each other is.
        wind: what the wind does to the vehicle; None unless it is asked for.
        position_gain_1_s: MPC_XY_P of the autopilot that follows the setpoints.

    """

    def __init__(
        self, *, station: int, plan: FormationPlan, config: OnboardConfig, near: Neighbourhood
    ) -> None:
        places_ned_m = plan.at(0.0).pos_ned_m
        self.start = MotionStart(station, len(places_ned_m))
        self.correction = Correction()
        self.layers = HeightLayers(
            own=station, places_ned_m=places_ned_m, gps_std_m=config.gps_bias_std_m,
            climb_speed_m_s=config.climb_speed_m_s, drift_m_sqrt_s=config.odometry_drift_m_sqrt_s,
        )  # fmt: skip
        self.wind = WindObserver() if config.wind_feed_forward else None
        self.position_gain_1_s = POSITION_GAIN_1_S
        self.down_error_m = 0.0
        """The autopilot's position less the true one, down; known to those alone who are told the truth."""
        self._station = station
        self._plan = plan
        self._reference = Reference(climb_speed_m_s=config.climb_speed_m_s)
        self._near = near.members
        self._avoidance = Avoidance(
            own=near.own, places_ned_m=places_ned_m[near.members], radius_m=config.safety_radius_m
        )

    def place_ned_m(self, now_us: int) -> Array:
        """(3,) the own place of the plan, at the height of the own layer, site NED."""
        place_ned_m = self._plan.own(self._station, self._since_start_s(now_us)).pos_ned_m.copy()
        if self.layers.height_m:
            place_ned_m[2] -= self.layers.height_m
        return place_ned_m

    def believed_ned_m(self, own: OwnState, now_us: int) -> Array:
        """(3,) where the UAV believes itself to be, site NED; the caller's."""
        age_us = min(max(now_us - own.time_us, 0), EXTRAPOLATED_US)
        position_ned_m = own.autopilot_ned_m
        position_ned_m += own.vel_ned_m_s * (1e-6 * age_us)
        position_ned_m[:2] -= self.correction.ne_m
        if self.down_error_m:
            position_ned_m[2] -= self.down_error_m
        return position_ned_m

    def agree(self, now_us: int, *, on_station: bool, neighbours: dict[int, Heard]) -> None:
        """Settle with the others when the motion starts."""
        if self._plan.moves:
            self.start.update(now_us, on_station=on_station, neighbours=neighbours)

    def wait(self, own: OwnState, now_us: int) -> Setpoint:
        """Setpoint where the vehicle is, going on vertically as it does: offboard begins smoothly from it."""
        believed_ned_m = self.believed_ned_m(own, now_us)
        vel_ned_m_s = np.array((0.0, 0.0, own.vel_ned_m_s[2]))
        self._reference.reset(believed_ned_m, vel_ned_m_s)
        return self._in_autopilots_frame(believed_ned_m, vel_ned_m_s, own, leans=False)

    def follow(
        self, own: OwnState, believed_ned_m: Array, others: Others | None, now_us: int, dt_s: float
    ) -> Setpoint:
        """Setpoint on the way to the own place, and in it, of a UAV that believes itself at (3,).

        ``others`` are the neighbourhood; None where the own position in it is not known, to keep clear.
        """
        since_s = self._since_start_s(now_us) + 0.5 * dt_s  # half of the time for which the setpoint holds
        target = self._plan.own(self._station, since_s)
        self._reference.advance(
            target.pos_ned_m - np.array((0.0, 0.0, self.layers.height_m)), dt_s,
            target_vel_ned_m_s=target.vel_ned_m_s, target_acc_ned_m_s2=target.acc_ned_m_s2,
            vehicle_ned_m=believed_ned_m,
        )  # fmt: skip
        reference = self._reference
        vel_ned_m_s = reference.vel_ned_m_s.copy()
        if others is not None:
            way_ne_m = (reference.pos_ned_m - believed_ned_m)[:2]
            wanted_ne_m_s = self.position_gain_1_s * way_ne_m + vel_ned_m_s[:2]
            plan = self._plan.at(since_s)
            vel_ned_m_s[:2] += self._avoidance.velocity_change_ne_m_s(
                now_us,
                pos_ned_m=others.pos_ned_m, vel_ned_m_s=others.vel_ned_m_s,
                std_m=others.std_m, fresh=others.fresh,
                plan_pos_ned_m=plan.pos_ned_m[self._near], plan_vel_ned_m_s=plan.vel_ned_m_s[self._near],
                goal_ned_m=target.pos_ned_m, wanted_ne_m_s=wanted_ne_m_s,
            )  # fmt: skip
        return self._in_autopilots_frame(reference.pos_ned_m, vel_ned_m_s, own, leans=True)

    def _in_autopilots_frame(
        self, pos_ned_m: Array, vel_ned_m_s: Array, own: OwnState, *, leans: bool
    ) -> Setpoint:
        asked_ned_m = pos_ned_m.copy()
        asked_ned_m[:2] += self.correction.ne_m
        asked_ned_m[2] += self.down_error_m
        if own.origin_ned_m is not None:
            asked_ned_m[:2] -= own.origin_ned_m[:2]
        acc_ned_m_s2 = None
        if leans and (self._plan.moves or self.wind is not None):
            acc_ned_m_s2 = self._reference.acc_ned_m_s2.copy()
            if self.wind is not None:
                acc_ned_m_s2[:2] += self.wind.feed_forward_ne_m_s2
        return Setpoint(asked_ned_m, vel_ned_m_s, acc_ned_m_s2)

    def _since_start_s(self, now_us: int) -> float:
        start_us = self.start.start_us
        return -1.0 if start_us is None else (now_us - start_us) * 1e-6
