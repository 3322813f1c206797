"""Where each mode wants the vehicle, as setpoints for the flight controller. Pure.

Offboard needs nothing of this: its setpoints come from outside and go to the controller as they are.
"""

from autopilot.commander.conditions import MANUAL_MODES
from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import PositionParams, TrajectoryParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.guide import Guide, HomePosition, Moment
from autopilot.navigation.landing import IDLE, Landing, TakeOff, descend
from autopilot.navigation.manual import CENTRED, ManualFlight, ManualInput
from autopilot.navigation.mission_flight import MissionFlight
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.return_home import Phase, ReturnHome
from autopilot.types import Array, AttitudeSetpoint, EstimatorState, TrajectorySetpoint

__all__ = ["IDLE", "NavigationParams", "Navigator", "down_demand_m_s"]

_ENDS_IN_HOLD = {FlightMode.TAKEOFF, FlightMode.MISSION}
"""Modes whose end is the place to hold."""


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
        self._mode = FlightMode.HOLD

    # ---- what others may know

    @property
    def return_phase(self) -> Phase | None:
        """Where on the way home the vehicle is; None outside Return mode."""
        return self._return.phase if self._mode is FlightMode.RETURN else None

    @property
    def target_ned_m(self) -> Array | None:
        """(3,) place that the present mode flies to; None in modes without one."""
        if self._mode is FlightMode.MISSION:
            return self.mission.place_ned_m
        return None if self._mode in MANUAL_MODES | {FlightMode.DESCEND} else self._guide.target_ned_m

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
        return self._mode is FlightMode.RETURN and self._return.phase is Phase.DONE

    # ---- what others do

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
            self._guide.set_limits(trajectory)

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

        A mission and a return go on where they were; a finished mission that is entered anew begins with its
        first item. ``takeoff_down_m`` is where a take-off ends; it never goes down.
        """
        again = mode is self._mode
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
        self._guide.set_limits(self._limits)
        if mode is FlightMode.RETURN:
            (self._return.resume if again else self._return.start)(moment, self._params)
        elif mode is FlightMode.TAKEOFF:
            self._take_off.start(moment, down_m=takeoff_down_m, speed_m_s=self._position.tko_speed_m_s)
        elif mode in MANUAL_MODES:
            self._manual.start(state)
        else:
            self._guide.restart(state)
            self._landing.start(state)

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
        if mode is FlightMode.HOLD:
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
        if mode is FlightMode.LAND:
            return self._landing.update(moment, self._params)
        if mode is FlightMode.DESCEND:
            return descend(state, self._params, touching=touching, yaw_rad=self._guide.yaw_rad)
        return self._guide.follow(dt_s)


def down_demand_m_s(
    state: EstimatorState,
    setpoint: TrajectorySetpoint | AttitudeSetpoint,
    *,
    z_p_1_s: float,
    hover_thrust: float = 0.5,
) -> float:
    """Vertical speed that a setpoint asks for, down positive; an acceleration counts for one second of it.

    Of an attitude setpoint the acceleration is what its thrust gives beyond ``hover_thrust``.
    """
    if isinstance(setpoint, AttitudeSetpoint):
        return GRAVITY_M_S2 * (1.0 - setpoint.thrust / hover_thrust)
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
