"""The built-in behaviours of the flight modes; `make_behaviours` returns them by mode.

Offboard mode has none: its setpoints are external and go to the controller unchanged.
"""

from collections.abc import Mapping
from typing import NamedTuple

from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import (
    ON_GROUND_M,
    FlightModeBehaviour,
    ModeContext,
    ModeEntry,
    ModeInputs,
)
from autopilot.navigation.guide import Moment, heading_rad
from autopilot.navigation.landing import IDLE, Landing, TakeOff, descend
from autopilot.navigation.manual import CENTRED, ManualFlight
from autopilot.navigation.mission_flight import MissionFlight, MissionStage
from autopilot.navigation.orbit import Orbit, default_circle
from autopilot.navigation.return_home import ReturnHome, ReturnPhase
from foundation.types import Array, AttitudeSetpoint, Course, EstimatorState, TrajectorySetpoint

_COURSE_OF_STAGE = {MissionStage.TAKE_OFF: Course.TAKE_OFF, MissionStage.LAND: Course.LANDING}


class HoldTarget(NamedTuple):
    """Target of a hold."""

    place_ned_m: Array
    """(3,) position."""
    yaw_rad: float | None
    """None: by MPC_YAW_MODE."""


class StopMode:
    """Stops, and stays there; base of the other modes, which override what differs."""

    def __init__(self, context: ModeContext) -> None:
        self._context = context
        self._guide = context.guide

    def enter(self, entry: ModeEntry) -> None:
        """Stop from the present motion."""
        self._context.apply_leg_limits()
        self._guide.restart(entry.state)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint | AttitudeSetpoint:
        """Return the setpoint of the stop; idle on the ground."""
        return IDLE if inputs.landed else self._guide.follow(inputs.dt_s)

    def next_mode(self, _state: EstimatorState, /) -> FlightMode | None:
        """Return None: it stays in this mode."""
        return None

    def completed(self, _state: EstimatorState, /) -> bool:
        """Return False: it has no aim."""
        return False

    @property
    def course(self) -> Course:
        """Neither take-off nor landing."""
        return Course.OTHER

    @property
    def target_ned_m(self) -> Array | None:
        """Target (3,) of the guide."""
        return self._guide.target_ned_m

    def apply_limits(self) -> None:
        """Apply the parameters to the present leg."""
        self._context.apply_leg_limits()

    def change_speed(self, _speed_m_s: float | None, /) -> None:
        """Do nothing: the mode has no legs."""


class HoldMode(StopMode):
    """Hold: stops, or flies to a target and lands there if it is on the ground."""

    def __init__(self, context: ModeContext, landing: Landing) -> None:
        super().__init__(context)
        self.target: HoldTarget | None = None
        """None: the stopping point."""
        self._landing = landing

    def enter(self, entry: ModeEntry) -> None:
        """Stop; if it has a target, fly there."""
        super().enter(entry)
        self._landing.start(entry.state)
        if self.target is not None:
            self.hold_at(self.target)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the stop or of the leg to the target."""
        if inputs.landed:
            return IDLE
        if self._context.is_target_on_ground:
            return self._set_down(inputs)
        if self.target is None:
            return self._guide.follow(inputs.dt_s)
        return self._fly_to_target(inputs)

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Change the ground speed of the leg to a target."""
        self._context.speed_m_s = speed_m_s
        self._context.apply_leg_limits()

    def hold_at(self, target: HoldTarget) -> None:
        """Fly to a target."""
        self.target = target
        self._guide.go_to(target.place_ned_m, yaw_rad=target.yaw_rad)

    def stop(self, state: EstimatorState) -> None:
        """Stop here."""
        self.target = None
        self._guide.restart(state)

    def _fly_to_target(self, moment: Moment) -> TrajectorySetpoint:
        """Return the setpoint on the way to the target; heading as on any leg unless one was given."""
        guide, target, params = self._guide, self.target, self._context.params
        if target is not None and target.yaw_rad is None and not guide.resting:
            yaw_rad = heading_rad(
                params.yaw_mode, guide, target.place_ned_m, moment.home_ned_m, near_m=params.acceptance_m
            )
            if yaw_rad is not None:
                guide.turn_to(yaw_rad)
        return guide.follow(moment.dt_s, vehicle_pos_ned_m=moment.state.pos_ned_m)

    def _set_down(self, moment: Moment) -> TrajectorySetpoint:
        """Land if the target is on the ground: a hover above it would never be detected as landed."""
        context = self._context
        if self._guide.pos_ned_m[2] <= context.ground_down_m - ON_GROUND_M:  # not yet at the target
            self._landing.start(moment.state)
            return self._fly_to_target(moment)
        return self._landing.update(moment, context.params)


class TakeOffMode(StopMode):
    """Take-off: climbs vertically, then changes to hold."""

    def __init__(self, context: ModeContext, take_off: TakeOff) -> None:
        super().__init__(context)
        self._take_off = take_off

    def enter(self, entry: ModeEntry) -> None:
        """Climb to ``entry.takeoff_down_m``; never descends."""
        context = self._context
        context.apply_leg_limits()
        self._take_off.start(entry, down_m=entry.takeoff_down_m, speed_m_s=context.position.tko_speed_m_s)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the climb."""
        return self._take_off.update(inputs)

    def next_mode(self, state: EstimatorState, /) -> FlightMode | None:
        """Return hold at the final height."""
        return FlightMode.HOLD if self.completed(state) else None

    def completed(self, state: EstimatorState, /) -> bool:
        """Return whether the final height is reached."""
        missing_m = abs(float(state.pos_ned_m[2]) - float(self._guide.target_ned_m[2]))
        return self._take_off.airborne and missing_m < self._context.params.altitude_acceptance_m

    @property
    def course(self) -> Course:
        """Take-off."""
        return Course.TAKE_OFF

    def apply_limits(self) -> None:
        """Apply the parameters to the climb."""
        context = self._context
        self._take_off.set_limits(context.limits, speed_m_s=context.position.tko_speed_m_s)


class MissionMode(StopMode):
    """Mission: flies the items, then changes to hold, or to return by an item."""

    def __init__(self, context: ModeContext, mission: MissionFlight) -> None:
        super().__init__(context)
        self._mission = mission

    def enter(self, entry: ModeEntry) -> None:
        """Continue the mission; a finished one starts with its first item."""
        if self._mission.runner.finished and not entry.again:
            self._mission.restart()
        self._mission.resume(entry, self._context.params)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the present item."""
        return self._mission.update(inputs, self._context.params)

    def next_mode(self, state: EstimatorState, /) -> FlightMode | None:
        """Return hold at the end, return if an item requests it."""
        if self.completed(state):
            return FlightMode.HOLD
        return FlightMode.RETURN if self._mission.return_requested else None

    def completed(self, _state: EstimatorState, /) -> bool:
        """Return whether all items are flown."""
        return self._mission.done

    @property
    def course(self) -> Course:
        """As by the present item."""
        return _COURSE_OF_STAGE.get(self._mission.stage, Course.OTHER)

    @property
    def target_ned_m(self) -> Array | None:
        """Position (3,) of the present item."""
        return self._mission.place_ned_m

    def apply_limits(self) -> None:
        """Apply the parameters to the present item."""
        self._mission.apply_limits()

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Change the ground speed until an item changes it."""
        self._mission.runner.speed_m_s = speed_m_s
        self._mission.apply_limits()


class ReturnMode(StopMode):
    """Return: flies home or to a rally point, and lands."""

    def __init__(self, context: ModeContext, return_home: ReturnHome) -> None:
        super().__init__(context)
        self._return = return_home

    def enter(self, entry: ModeEntry) -> None:
        """Start a return, or continue it."""
        self._context.apply_leg_limits()
        begin = self._return.resume if entry.again else self._return.start
        begin(entry, self._context.params)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the present phase."""
        return self._return.update(inputs, self._context.params)

    def completed(self, _state: EstimatorState, /) -> bool:
        """Return whether the vehicle is on the ground."""
        return self._return.phase is ReturnPhase.DONE

    @property
    def course(self) -> Course:
        """Landing in the last phase."""
        return Course.LANDING if self._return.phase is ReturnPhase.LAND else Course.OTHER

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Change the ground speed of the legs."""
        self._context.speed_m_s = speed_m_s
        self._context.apply_leg_limits()


class OrbitMode(StopMode):
    """Orbit: flies to a circle and along it."""

    def __init__(self, context: ModeContext, orbit: Orbit) -> None:
        super().__init__(context)
        self._orbit = orbit

    def enter(self, entry: ModeEntry) -> None:
        """Start the default circle, or continue the requested one."""
        self._context.apply_leg_limits()
        circle = self._orbit.circle if entry.again else None
        self._orbit.start(entry.state, default_circle(entry.state) if circle is None else circle)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the approach or of the circle."""
        if inputs.landed:
            return IDLE
        return self._orbit.update(inputs, self._context.params, manual=inputs.manual)


class LandMode(StopMode):
    """Land: stops and descends."""

    def __init__(self, context: ModeContext, landing: Landing) -> None:
        super().__init__(context)
        self._landing = landing

    def enter(self, entry: ModeEntry) -> None:
        """Stop and begin the descent."""
        super().enter(entry)
        self._landing.start(entry.state)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the descent."""
        return IDLE if inputs.landed else self._landing.update(inputs, self._context.params)

    @property
    def course(self) -> Course:
        """Landing."""
        return Course.LANDING


class DescendMode(StopMode):
    """Landing without a position estimate."""

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the descent."""
        if inputs.landed:
            return IDLE
        return descend(
            inputs.state, self._context.params, touching=inputs.touching, yaw_rad=self._guide.yaw_rad
        )

    @property
    def course(self) -> Course:
        """Landing."""
        return Course.LANDING

    @property
    def target_ned_m(self) -> Array | None:
        """None: there is no position."""
        return None


class _ManualMode(StopMode):
    """A mode that follows the sticks; the three share one `ManualFlight`."""

    def __init__(self, context: ModeContext, manual: ManualFlight) -> None:
        super().__init__(context)
        self._manual = manual

    def enter(self, entry: ModeEntry) -> None:
        """Start from the present motion and heading."""
        self._context.apply_leg_limits()
        self._manual.start(entry.state)

    @property
    def target_ned_m(self) -> Array | None:
        """None: the sticks have no target."""
        return None


class StabilizedMode(_ManualMode):
    """Stabilized: sticks are tilt and thrust."""

    def update(self, inputs: ModeInputs) -> AttitudeSetpoint:
        """Return tilt, yaw rate and thrust."""
        return self._manual.stabilized(inputs, inputs.manual or CENTRED, hover_thrust=inputs.hover_thrust)


class AltitudeMode(_ManualMode):
    """Altitude: sticks are tilt and climb rate."""

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return tilt as an acceleration, and climb rate or height."""
        return self._manual.altitude(
            inputs, inputs.manual or CENTRED, disturbance_ned_m_s2=inputs.disturbance_ned_m_s2
        )


class PositionMode(_ManualMode):
    """Position: sticks are velocity."""

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return velocity, or position while the sticks are centred."""
        return self._manual.position(inputs, inputs.manual or CENTRED)


class Flights(NamedTuple):
    """The parts of one vehicle that fly the modes."""

    take_off: TakeOff
    landing: Landing
    mission: MissionFlight
    return_home: ReturnHome
    orbit: Orbit
    manual: ManualFlight


def make_behaviours(
    context: ModeContext, flights: Flights, hold: HoldMode
) -> Mapping[FlightMode, FlightModeBehaviour]:
    """Return the built-in behaviours; modes without one stop."""
    stop = StopMode(context)
    return dict.fromkeys(FlightMode, stop) | {
        FlightMode.HOLD: hold,
        FlightMode.TAKEOFF: TakeOffMode(context, flights.take_off),
        FlightMode.MISSION: MissionMode(context, flights.mission),
        FlightMode.RETURN: ReturnMode(context, flights.return_home),
        FlightMode.ORBIT: OrbitMode(context, flights.orbit),
        FlightMode.LAND: LandMode(context, flights.landing),
        FlightMode.DESCEND: DescendMode(context),
        FlightMode.STABILIZED: StabilizedMode(context, flights.manual),
        FlightMode.ALTITUDE: AltitudeMode(context, flights.manual),
        FlightMode.POSITION: PositionMode(context, flights.manual),
    }
