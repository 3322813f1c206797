"""Where each mode wants the vehicle, as setpoints for the flight controller. Pure.

Offboard needs nothing of this: its setpoints come from outside and go to the controller as they are.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from msgspec.structs import replace

from autopilot.commander.conditions import MANUAL_MODES
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
"""A place no higher than this above where it stood last is on the ground, as well as heights are known."""
_HAVE_LEGS = {FlightMode.HOLD, FlightMode.RETURN}
"""Modes besides Mission in which a speed may be asked for."""
_ENDS_IN_HOLD = {FlightMode.TAKEOFF, FlightMode.MISSION}
"""Modes whose end is the place to hold."""
_COURSE_OF_MODE = {
    FlightMode.TAKEOFF: Course.TAKE_OFF,
    FlightMode.LAND: Course.LANDING,
    FlightMode.DESCEND: Course.LANDING,
}
_COURSE_OF_STAGE = {MissionStage.TAKE_OFF: Course.TAKE_OFF, MissionStage.LAND: Course.LANDING}


class _Errand(NamedTuple):
    """Where a hold was told to go."""

    place_ned_m: Array
    yaw_rad: float | None
    """None: as MPC_YAW_MODE says."""


class Navigator:
    """Setpoints of one vehicle's mode: `enter` it, then `update` at every step."""

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
        """The mission and where it stands; kept while other modes fly."""
        self.orbit = Orbit(self._guide)
        self._mode = FlightMode.HOLD
        self._ground_down_m = math.inf
        """Where it stood when it last entered a mode on the ground; infinite before that."""
        self._errand: _Errand | None = None
        self._speed_m_s: float | None = None
        """Over ground, asked for in the present mode; None: MPC_XY_CRUISE."""

    # ---- what others may know

    @property
    def return_phase(self) -> ReturnPhase | None:
        """Where on the way home the vehicle is; None outside Return mode."""
        return self._return.phase if self._mode is FlightMode.RETURN else None

    @property
    def course(self) -> Course:
        """Whether the ground is being left or come to, be it by a mode, a mission's item or a return."""
        if self._mode is FlightMode.MISSION:
            return _COURSE_OF_STAGE.get(self.mission.stage, Course.OTHER)
        if self._mode is FlightMode.RETURN and self._return.phase is ReturnPhase.LAND:
            return Course.LANDING
        return _COURSE_OF_MODE.get(self._mode, Course.OTHER)

    @property
    def target_ned_m(self) -> Array | None:
        """(3,) place that the present mode flies to; None in modes without one."""
        if self._mode is FlightMode.MISSION:
            return self.mission.place_ned_m
        return None if self._mode in MANUAL_MODES | {FlightMode.DESCEND} else self._guide.target_ned_m

    @property
    def place_ned_m(self) -> Array:
        """(3,) where a mode that flies by itself leads to at present, or comes to rest."""
        return self._guide.target_ned_m

    def next_mode(self, state: EstimatorState) -> FlightMode | None:
        """Mode to go on with: hold, after a take-off or a mission; return, where a mission's item says so."""
        if self._mode in _ENDS_IN_HOLD and self.completed(state):
            return FlightMode.HOLD
        is_wanted = self._mode is FlightMode.MISSION and self.mission.return_wanted
        return FlightMode.RETURN if is_wanted else None

    def completed(self, state: EstimatorState) -> bool:
        """Whether a take-off has reached its height, a mission its end, or a return the ground."""
        if self._mode is FlightMode.TAKEOFF:
            missing_m = abs(float(state.pos_ned_m[2]) - float(self._guide.target_ned_m[2]))
            return self._take_off.airborne and missing_m < self._params.altitude_acceptance_m
        if self._mode is FlightMode.MISSION:
            return self.mission.done
        return self._mode is FlightMode.RETURN and self._return.phase is ReturnPhase.DONE

    # ---- what others do

    def set_rally_points(self, points: Sequence[RallyPoint]) -> None:
        """Take other places to return to; a return under way keeps its own."""
        self._return.rally_points = tuple(points)

    def set_params(
        self, params: NavigationParams, trajectory: TrajectoryParams, position: PositionParams
    ) -> None:
        """Go on by other settings; a take-off or a leg under way keeps its place."""
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
        """Fly legs at another speed over ground until the mode ends; None: as the parameters say.

        A mission flies by it until an item changes the speed.
        """
        if self._mode is FlightMode.MISSION:
            self.mission.runner.speed_m_s = speed_m_s
            self.mission.apply_limits()
        elif self._mode in _HAVE_LEGS:
            self._speed_m_s = speed_m_s
            self._guide.set_limits(self._leg_limits())

    def hold_at(self, place_ned_m: Array, *, yaw_rad: float | None = None) -> None:
        """Go to a place (3,) in the hold mode that was entered; yaw None: as MPC_YAW_MODE says."""
        self._errand = _Errand(place_ned_m, yaw_rad)
        self._guide.go_to(place_ned_m, yaw_rad=yaw_rad)

    def stop(self, state: EstimatorState) -> None:
        """Come to rest on the way to a place, in the hold mode that was entered."""
        self._errand = None
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
        """Begin a mode from the present motion, or begin it again after the estimate has jumped.

        A mission, a return, an orbit and the way to a place to hold go on where they were; a finished mission
        that is entered anew begins with its first item. ``takeoff_down_m`` is where a take-off ends; it never
        goes down.
        """
        again = mode is self._mode
        if landed:
            self._ground_down_m = float(state.pos_ned_m[2])
        if landed or not again:
            self._errand = self._speed_m_s = None
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
            if self._errand is not None:
                self.hold_at(self._errand.place_ned_m, yaw_rad=self._errand.yaw_rad)

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
        """Give the mode's setpoint.

        ``touching``: the ground is suspected, and must not be leaned against. ``manual``: sticks; None are
        centred ones. ``hover_thrust``: what the middle of the throttle gives in stabilized mode; None:
        MPC_THR_HOVER. ``disturbance_ned_m_s2``: (3,) what the controller makes up for.
        """
        mode = self._mode
        on_ground = self._guide.target_ned_m[2] > self._ground_down_m - ON_GROUND_M
        if mode is FlightMode.HOLD and self._errand is None and not on_ground:
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
            return self._set_down(moment) if on_ground else self._run_errand(moment)
        if mode is FlightMode.ORBIT:
            return self.orbit.update(moment, self._params, manual=manual)
        if mode is FlightMode.LAND:
            return self._landing.update(moment, self._params)
        if mode is FlightMode.DESCEND:
            return descend(state, self._params, touching=touching, yaw_rad=self._guide.yaw_rad)
        return self._guide.follow(dt_s)

    # ---- pieces

    def _run_errand(self, moment: Moment) -> TrajectorySetpoint:
        """Lead to the place to hold, the nose as for any leg unless a heading was given."""
        guide, errand = self._guide, self._errand
        if errand is not None and errand.yaw_rad is None and not guide.resting:
            yaw_rad = heading_rad(
                self._params.yaw_mode, guide, errand.place_ned_m, moment.home_ned_m,
                near_m=self._params.acceptance_m,
            )  # fmt: skip
            if yaw_rad is not None:
                guide.turn_to(yaw_rad)
        return guide.follow(moment.dt_s, vehicle_pos_ned_m=moment.state.pos_ned_m)

    def _set_down(self, moment: Moment) -> TrajectorySetpoint:
        """Land where a hold leads to the ground: hovering upon it, nothing would tell that it has arrived."""
        if self._guide.pos_ned_m[2] <= self._ground_down_m - ON_GROUND_M:  # still on its way
            self._landing.start(moment.state)
            return self._run_errand(moment)
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
    """Vertical speed that a setpoint asks for, down positive; an acceleration counts for one second of it.

    Of attitudes and rates the acceleration is what their thrust gives beyond ``hover_thrust``.
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
