"""Setpoints of each flight mode for the flight controller. Pure.

Offboard mode is not part of this: its setpoints are external and go to the controller unchanged.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from msgspec.structs import replace

from autopilot.commander.arming_requirements import MANUAL_MODES
from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import PositionParams, TrajectoryParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.guide import Guide, HomePosition, Moment, heading_rad
from autopilot.navigation.landing import IDLE, Landing, TakeOff, descend
from autopilot.navigation.manual import CENTRED, ManualFlight, ManualInput
from autopilot.navigation.mission_flight import MissionFlight, MissionStage
from autopilot.navigation.orbit import Orbit, default_circle
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.plan_items import RallyPoint
from autopilot.navigation.return_home import ReturnHome, ReturnPhase
from foundation.types import Array, AttitudeSetpoint, Course, EstimatorState, Setpoint, TrajectorySetpoint

__all__ = ["IDLE", "ON_GROUND_M", "NavigationParams", "Navigator", "down_demand_m_s"]

ON_GROUND_M = 0.3
"""A target less than this above the last position on the ground counts as on the ground, given the accuracy
of heights."""
_HAVE_LEGS = {FlightMode.HOLD, FlightMode.RETURN}
"""Modes besides Mission that accept a change of speed."""
_ENDS_IN_HOLD = {FlightMode.TAKEOFF, FlightMode.MISSION}
"""Modes that continue as hold at their final position."""
_COURSE_OF_MODE = {
    FlightMode.TAKEOFF: Course.TAKE_OFF,
    FlightMode.LAND: Course.LANDING,
    FlightMode.DESCEND: Course.LANDING,
}
_COURSE_OF_STAGE = {MissionStage.TAKE_OFF: Course.TAKE_OFF, MissionStage.LAND: Course.LANDING}


class _HoldTarget(NamedTuple):
    """Target of a hold."""

    place_ned_m: Array
    yaw_rad: float | None
    """None: by MPC_YAW_MODE."""


class Navigator:
    """Computes the setpoints of one vehicle's mode: call `enter`, then `update` at every step."""

    def __init__(
        self, params: NavigationParams, trajectory: TrajectoryParams, position: PositionParams
    ) -> None:
        self._params = params
        self._limits = trajectory
        self._position = position
        self._guide = Guide(trajectory)
        self._take_off = TakeOff(self._guide)
        self._landing = Landing(self._guide)
        self._return = ReturnHome(self._guide, self._landing)
        self._manual = ManualFlight(params, trajectory, position)
        self.mission = MissionFlight(
            self._guide, self._take_off, self._landing, limits=trajectory, position=position
        )
        """The mission and its progress; kept while other modes are active."""
        self.orbit = Orbit(self._guide)
        self._mode = FlightMode.HOLD
        self._ground_down_m = math.inf
        """Down position when a mode was last entered on the ground; infinite before."""
        self._hold_target: _HoldTarget | None = None
        self._speed_m_s: float | None = None
        """Ground speed requested in the present mode; None: MPC_XY_CRUISE."""

    # ---- status

    @property
    def return_phase(self) -> ReturnPhase | None:
        """Phase of the return; None outside Return mode."""
        return self._return.phase if self._mode is FlightMode.RETURN else None

    @property
    def course(self) -> Course:
        """Whether the vehicle takes off or lands, by a mode, a mission item or a return."""
        if self._mode is FlightMode.MISSION:
            return _COURSE_OF_STAGE.get(self.mission.stage, Course.OTHER)
        if self._mode is FlightMode.RETURN and self._return.phase is ReturnPhase.LAND:
            return Course.LANDING
        return _COURSE_OF_MODE.get(self._mode, Course.OTHER)

    @property
    def target_ned_m(self) -> Array | None:
        """Target position (3,) of the present mode; None in modes without one."""
        if self._mode is FlightMode.MISSION:
            return self.mission.place_ned_m
        return None if self._mode in MANUAL_MODES | {FlightMode.DESCEND} else self._guide.target_ned_m

    @property
    def place_ned_m(self) -> Array:
        """Position (3,) at which the present leg comes to rest, in modes that fly a path."""
        return self._guide.target_ned_m

    def next_mode(self, state: EstimatorState) -> FlightMode | None:
        """Return the next mode: hold after a take-off or a mission, return by a mission item; or None."""
        if self._mode in _ENDS_IN_HOLD and self.completed(state):
            return FlightMode.HOLD
        returns = self._mode is FlightMode.MISSION and self.mission.return_requested
        return FlightMode.RETURN if returns else None

    def completed(self, state: EstimatorState) -> bool:
        """Return whether a take-off is at its height, a mission at its end, or a return on the ground."""
        if self._mode is FlightMode.TAKEOFF:
            missing_m = abs(float(state.pos_ned_m[2]) - float(self._guide.target_ned_m[2]))
            return self._take_off.airborne and missing_m < self._params.altitude_acceptance_m
        if self._mode is FlightMode.MISSION:
            return self.mission.done
        return self._mode is FlightMode.RETURN and self._return.phase is ReturnPhase.DONE

    # ---- requests

    def set_rally_points(self, points: Sequence[RallyPoint]) -> None:
        """Change the rally points; a return in progress keeps its destination."""
        self._return.rally_points = tuple(points)

    def set_params(
        self, params: NavigationParams, trajectory: TrajectoryParams, position: PositionParams
    ) -> None:
        """Change the settings; a take-off or a leg in progress keeps its target."""
        self._params, self._limits, self._position = params, trajectory, position
        self.mission.set_limits(trajectory, position)
        self._manual.set_params(params, trajectory, position)
        if self._mode is FlightMode.MISSION:
            self.mission.apply_limits()
        elif self._mode is FlightMode.TAKEOFF:
            self._take_off.set_limits(trajectory, speed_m_s=position.tko_speed_m_s)
        else:
            self._guide.set_limits(self._leg_limits())

    def change_speed(self, speed_m_s: float | None) -> None:
        """Change the ground speed of legs until the mode ends; None: as by the parameters.

        In a mission it applies until an item changes the speed.
        """
        if self._mode is FlightMode.MISSION:
            self.mission.runner.speed_m_s = speed_m_s
            self.mission.apply_limits()
        elif self._mode in _HAVE_LEGS:
            self._speed_m_s = speed_m_s
            self._guide.set_limits(self._leg_limits())

    def hold_at(self, place_ned_m: Array, *, yaw_rad: float | None = None) -> None:
        """Fly to a position (3,) in the hold mode that was entered; yaw None: by MPC_YAW_MODE."""
        self._hold_target = _HoldTarget(place_ned_m, yaw_rad)
        self._guide.go_to(place_ned_m, yaw_rad=yaw_rad)

    def stop(self, state: EstimatorState) -> None:
        """Stop in the hold mode that was entered."""
        self._hold_target = None
        self._guide.restart(state)

    def enter(
        self,
        mode: FlightMode,
        state: EstimatorState,
        *,
        landed: bool,
        takeoff_down_m: float,
        home_ned_m: HomePosition | None = None,
    ) -> None:
        """Start a mode from the present motion, or restart it after a reset of the estimate.

        A mission, a return, an orbit and the flight to a hold target continue; a finished mission that is
        entered again starts with its first item. ``takeoff_down_m`` is the final height of a take-off, which
        never descends.
        """
        again = mode is self._mode
        if landed:
            self._ground_down_m = float(state.pos_ned_m[2])
        if landed or not again:
            self._hold_target = self._speed_m_s = None
        goes_on = (
            mode is FlightMode.HOLD and self._mode in _ENDS_IN_HOLD and not landed and self.completed(state)
        )
        self._mode = mode
        if goes_on:
            return
        moment = Moment(state=state, dt_s=0.0, landed=landed, touching=False, home_ned_m=home_ned_m)
        if mode is FlightMode.MISSION:
            if self.mission.runner.finished and not again:
                self.mission.restart()
            self.mission.resume(moment, self._params)
            return
        self._guide.set_limits(self._leg_limits())
        if mode is FlightMode.RETURN:
            (self._return.resume if again else self._return.start)(moment, self._params)
        elif mode is FlightMode.TAKEOFF:
            self._take_off.start(moment, down_m=takeoff_down_m, speed_m_s=self._position.tko_speed_m_s)
        elif mode in MANUAL_MODES:
            self._manual.start(state)
        elif mode is FlightMode.ORBIT:
            circle = self.orbit.circle if again else None
            self.orbit.start(state, default_circle(state) if circle is None else circle)
        else:
            self._guide.restart(state)
            self._landing.start(state)
            if self._hold_target is not None:
                self.hold_at(self._hold_target.place_ned_m, yaw_rad=self._hold_target.yaw_rad)

    def update(
        self,
        state: EstimatorState,
        *,
        dt_s: float,
        landed: bool,
        touching: bool,
        home_ned_m: HomePosition | None = None,
        manual: ManualInput | None = None,
        hover_thrust: float | None = None,
        disturbance_ned_m_s2: Array | None = None,
    ) -> TrajectorySetpoint | AttitudeSetpoint:
        """Return the setpoint of the present mode.

        ``touching``: ground contact is suspected, so the setpoint must not push against the ground.
        ``manual``: sticks; None: centred. ``hover_thrust``: thrust at mid throttle in stabilized mode; None:
        MPC_THR_HOVER. ``disturbance_ned_m_s2``: (3,) acceleration that the controller compensates.
        """
        mode = self._mode
        on_ground = self._guide.target_ned_m[2] > self._ground_down_m - ON_GROUND_M
        if mode is FlightMode.HOLD and self._hold_target is None and not on_ground:
            return IDLE if landed else self._guide.follow(dt_s)
        moment = Moment(state=state, dt_s=dt_s, landed=landed, touching=touching, home_ned_m=home_ned_m)
        if mode is FlightMode.MISSION:
            return self.mission.update(moment, self._params)
        if mode is FlightMode.RETURN:
            return self._return.update(moment, self._params)
        if mode is FlightMode.TAKEOFF:
            return self._take_off.update(moment)
        if mode in MANUAL_MODES:
            sticks = CENTRED if manual is None else manual
            if mode is FlightMode.STABILIZED:
                return self._manual.stabilized(moment, sticks, hover_thrust=hover_thrust)
            if mode is FlightMode.ALTITUDE:
                return self._manual.altitude(moment, sticks, disturbance_ned_m_s2=disturbance_ned_m_s2)
            return self._manual.position(moment, sticks)
        if landed:
            return IDLE
        if mode is FlightMode.HOLD:
            return self._set_down(moment) if on_ground else self._fly_to_hold_target(moment)
        if mode is FlightMode.ORBIT:
            return self.orbit.update(moment, self._params, manual=manual)
        if mode is FlightMode.LAND:
            return self._landing.update(moment, self._params)
        if mode is FlightMode.DESCEND:
            return descend(state, self._params, touching=touching, yaw_rad=self._guide.yaw_rad)
        return self._guide.follow(dt_s)

    # ---- parts

    def _fly_to_hold_target(self, moment: Moment) -> TrajectorySetpoint:
        """Return the setpoint on the way to the hold target; heading as on any leg unless one was given."""
        guide, target = self._guide, self._hold_target
        if target is not None and target.yaw_rad is None and not guide.resting:
            yaw_rad = heading_rad(
                self._params.yaw_mode, guide, target.place_ned_m, moment.home_ned_m,
                near_m=self._params.acceptance_m,
            )  # fmt: skip
            if yaw_rad is not None:
                guide.turn_to(yaw_rad)
        return guide.follow(moment.dt_s, vehicle_pos_ned_m=moment.state.pos_ned_m)

    def _set_down(self, moment: Moment) -> TrajectorySetpoint:
        """Land if the hold target is on the ground: a hover above it would never be detected as landed."""
        if self._guide.pos_ned_m[2] <= self._ground_down_m - ON_GROUND_M:  # not yet at the target
            self._landing.start(moment.state)
            return self._fly_to_hold_target(moment)
        return self._landing.update(moment, self._params)

    def _leg_limits(self) -> TrajectoryParams:
        if self._speed_m_s is None:
            return self._limits
        return replace(self._limits, xy_cruise_m_s=min(self._speed_m_s, self._position.xy_vel_max_m_s))


def down_demand_m_s(
    state: EstimatorState,
    setpoint: Setpoint,
    *,
    z_p_1_s: float,
    hover_thrust: float = 0.5,
) -> float:
    """Return the vertical speed that a setpoint demands, positive down; accelerations count for one second.

    For attitudes and rates the acceleration is that of the thrust in excess of ``hover_thrust``.
    """
    if not isinstance(setpoint, TrajectorySetpoint):
        return GRAVITY_M_S2 * (1.0 - setpoint.thrust / hover_thrust)
    vel, acc = setpoint.vel_ned_m_s, setpoint.acc_ned_m_s2
    vel_down_m_s = float(vel[2]) if vel is not None and setpoint.vel_axes[2] else None
    if setpoint.pos_ned_m is not None and setpoint.pos_axes[2]:
        demand_m_s = z_p_1_s * (float(setpoint.pos_ned_m[2]) - state.pos_ned_m.item(2))
        return demand_m_s if vel_down_m_s is None else demand_m_s + vel_down_m_s
    if vel_down_m_s is not None:
        return vel_down_m_s
    return float(acc[2]) if acc is not None and setpoint.acc_axes[2] else 0.0
