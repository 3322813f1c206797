"""Pilot: runs navigation and control in the commander's mode, detects landing, and sets home."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from autopilot.commander.arming_checks import Reason
from autopilot.commander.geofence import Geofence, Origin
from autopilot.commander.land_detector import LandDetector, LandStage
from autopilot.control import FlightController
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.feasibility import distance_warning, fence_violation
from autopilot.navigation.flight_mode import IDLE, ON_GROUND_M, ModeInputs
from autopilot.navigation.mode_registry import MODES, ModeRow
from autopilot.navigation.orbit import Circle, YawBehaviour
from autopilot.navigation.plan_store import PlanStore, PlanType
from autopilot.navigation.setpoints import Navigator, down_demand_m_s
from autopilot.parameters.table import ParameterSet
from autopilot.services.command import TakeoffAltitude
from autopilot.services.flight_data import FlightData, Home
from autopilot.services.manual_control import ManualControlService
from autopilot.services.offboard import OffboardService
from foundation.airframe.description import MOST_ROTORS
from foundation.geometry.geodesy import geodetic_to_ned, ned_to_geodetic
from foundation.types import Array, Setpoint, TrajectorySetpoint

_FENCE_WARNS = 1
"""Values of GF_ACTION up to this one do not restrict targets."""
_HEIGHT_MAX_M = 1e5
"""Greatest magnitude of an altitude; a greater one is rejected."""


class Pilot:
    """Flies one vehicle in the commander's mode: `update` at every step, `update_land_state` at decisions."""

    def __init__(
        self,
        parameters: ParameterSet,
        flight: FlightData,
        *,
        offboard: OffboardService,
        manual: ManualControlService,
        geofence: Geofence,
        controller: FlightController,
        modes: Sequence[ModeRow] = MODES,
    ) -> None:
        settings, control = parameters.settings, parameters.settings.control
        self.takeoff_altitude = TakeoffAltitude()
        self.controller = controller
        self.navigator = Navigator(settings.navigation, control.trajectory, control.position, modes)
        flight.course = lambda: self.navigator.course
        flight.attitude_setpoint = lambda: self.controller.attitude_setpoint
        flight.motors = lambda: self.controller.controls
        self.mission_valid = False
        """Whether there is a mission that may be flown."""
        self.mission_fault: str | None = None
        """Why the present mission may not be flown."""
        self.warnings: list[str] = []
        """Messages about the mission; the reader sends and removes them."""
        self._mission_warning: str | None = None
        self._parameters = parameters
        self._flight = flight
        self._offboard = offboard
        self._manual = manual
        self._geofence = geofence
        self._land_detector = LandDetector(settings.land_detector)
        self.landed = True
        """Whether the vehicle is on the ground, by the last `update_land_state`."""
        self.flies_on = False
        """Whether the next step can continue the trajectory of this one, unless a message changes it."""
        self._setpoint: Setpoint = IDLE
        self._active: tuple[FlightMode, bool, int, float | None, bool] | None = None
        """Mode, arming, estimator resets, take-off altitude and failsafe hold at the last `update`."""
        self._home_is_manual = False
        """Home was set by a command: arming elsewhere does not change it."""
        parameters.subscribe(self.controller.set_params, "control")
        parameters.subscribe(
            self.navigator.set_params, "navigation", "control.trajectory", "control.position"
        )
        parameters.subscribe(lambda *_: self._check_mission(), "navigation", "geofence")
        parameters.subscribe(self._land_detector.set_params, "land_detector")

    @property
    def land_stage(self) -> LandStage:
        """Stage of the land detector."""
        return self._land_detector.stage

    @property
    def controls(self) -> list[float]:
        """Controls (16,) of HIL_ACTUATOR_CONTROLS."""
        motors = self.controller.controls
        return motors + [0.0] * (MOST_ROTORS - len(motors))

    # ---- requests in flight; the result is the reason for refusal or None

    def reposition(
        self,
        lat_deg: float | None,
        lon_deg: float | None,
        alt_amsl_m: float | None,
        yaw_rad: float | None,
        speed_m_s: float | None,
    ) -> Reason | None:
        """Hold at another position, as MAV_CMD_DO_REPOSITION with the flag that changes the mode.

        Missing latitude and longitude keep the position, a missing altitude the height; without any of them
        the vehicle stops here. Without a heading it is that of any leg. Refused on the ground. A position
        outside the geofence results in a hold here.
        """
        if (lat_deg is None) is not (lon_deg is None) or not _are_usable(lat_deg, lon_deg, alt_amsl_m):
            return Reason.BAD_ARGUMENT
        refusal = self._enter_in_flight(FlightMode.HOLD)
        if refusal is not None:
            return refusal
        if speed_m_s is not None and speed_m_s > 0.0:
            self.change_speed(speed_m_s)
        if lat_deg is None and alt_amsl_m is None:
            self.navigator.stop(self._flight.state)
        else:
            place_ned_m = self._place_ned_m(self.navigator.place_ned_m, lat_deg, lon_deg, alt_amsl_m)
            if not self._is_allowed(place_ned_m):
                self.navigator.stop(self._flight.state)
                return Reason.OUTSIDE_GEOFENCE
            self.navigator.hold_at(place_ned_m, yaw_rad=_number(yaw_rad))
        return None

    def orbit(
        self,
        radius_m: float | None,
        speed_m_s: float | None,
        yaw_behaviour: float | None,
        lat_deg: float | None,
        lon_deg: float | None,
        alt_amsl_m: float | None,
    ) -> Reason | None:
        """Circle around a centre, as MAV_CMD_DO_ORBIT; None keeps the present value or position.

        A positive radius is clockwise; a negative speed reverses the direction. The bounds are PX4's
        (`autopilot.navigation.orbit`). Refused on the ground.
        """
        if (lat_deg is None) is not (lon_deg is None) or not _are_usable(lat_deg, lon_deg, alt_amsl_m):
            return Reason.BAD_ARGUMENT
        radius_m, speed_m_s, yaw_behaviour = map(_number, (radius_m, speed_m_s, yaw_behaviour))
        if yaw_behaviour is not None and yaw_behaviour not in set(YawBehaviour):
            return Reason.BAD_ARGUMENT
        orbit, state = self.navigator.orbit, self._flight.state
        goes_on = self._flight.commander.mode is FlightMode.ORBIT
        refusal = self._enter_in_flight(FlightMode.ORBIT)
        if refusal is not None:
            return refusal
        before = orbit.circle
        if before is None:
            return Reason.MODE_UNAVAILABLE  # unreachable: entering the mode sets a circle
        here_ned_m = np.array((before.north_m, before.east_m, before.down_m)) if goes_on else state.pos_ned_m
        north_m, east_m, down_m = self._place_ned_m(here_ned_m, lat_deg, lon_deg, alt_amsl_m).tolist()
        yaw = before.yaw if yaw_behaviour is None else YawBehaviour(int(yaw_behaviour))
        clockwise = before.speed_m_s if radius_m is None else radius_m
        orbit.start(
            state,
            Circle(
                north_m=north_m,
                east_m=east_m,
                down_m=down_m,
                radius_m=before.radius_m if radius_m is None else abs(radius_m),
                speed_m_s=math.copysign(1.0, clockwise)
                * (abs(before.speed_m_s) if speed_m_s is None else speed_m_s),
                yaw=before.yaw if yaw is YawBehaviour.UNCHANGED else yaw,
            ),
        )
        return None

    def change_speed(self, speed_m_s: float | None) -> None:
        """Fly legs at this ground speed until the mode ends; None: by the parameters."""
        usable = speed_m_s is not None and 0.0 < speed_m_s < math.inf
        self.navigator.change_speed(speed_m_s if usable else None)

    def set_home(self, lat_deg: float, lon_deg: float, alt_m: float) -> Reason | None:
        """Set home to a position, altitude above mean sea level; arming does not change it."""
        state = self._flight.state
        if not _are_usable(lat_deg, lon_deg, alt_m):
            return Reason.BAD_ARGUMENT
        if not state.position_valid:
            return Reason.NO_POSITION
        north_m, east_m, down_m = self._place_ned_m(state.pos_ned_m, lat_deg, lon_deg, alt_m).tolist()
        self._flight.home = replace(
            self._here(), lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m, pos_ned_m=(north_m, east_m, down_m)
        )
        self._home_is_manual = True
        self._check_mission()
        return None

    def set_home_here(self) -> Reason | None:
        """Set home to the vehicle's position; arming sets it again."""
        if not self._flight.state.position_valid:
            return Reason.NO_POSITION
        self._home_is_manual = False
        self._set_home()
        return None

    def load_plans(self, plans: PlanStore, kinds: Collection[PlanType]) -> None:
        """Use the stored plans of these types; a mission starts with the marked item.

        In mission mode it starts immediately. If it may not be flown the vehicle then holds.
        """
        if PlanType.RALLY in kinds:
            self.navigator.set_rally_points(plans[PlanType.RALLY].made.rally_points)
        if PlanType.FENCE in kinds:
            self._geofence.set_shapes(plans[PlanType.FENCE].made.fence_shapes)
        if PlanType.MISSION in kinds:
            plan = plans[PlanType.MISSION]
            start = plan.start if plan.start < len(plan.items) else 0
            self.navigator.mission.load(plan.made.mission, start=start)
            self.mission_fault = self._mission_warning = None
        if kinds != {PlanType.RALLY}:
            self._check_mission(flown=True)

    @property
    def next_mode(self) -> FlightMode | None:
        """Mode that follows the present one if that is complete or may not continue; or None."""
        mode = self._flight.commander.mode
        if mode is FlightMode.OFFBOARD:
            return None  # it ends on request
        if mode is FlightMode.MISSION and self.mission_fault is not None:
            return FlightMode.HOLD
        return self.navigator.next_mode(self._flight.state)

    def update_land_state(self) -> None:
        """Update the land state from the present estimate, and set home at the first valid position."""
        flight = self._flight
        state = flight.state
        if state.position_valid and flight.home is None:
            self._set_home()
        armed = flight.commander.armed
        if self.landed and not armed:
            return
        controller, hover_thrust = self.controller, self.controller.hover_thrust
        self._land_detector.update(
            flight.now_us,
            state,
            armed=armed,
            down_demand_m_s=down_demand_m_s(
                state, self._setpoint, z_p_1_s=controller.params.position.z_p, hover_thrust=hover_thrust
            ),
            thrust_of_hover=controller.thrust / hover_thrust,
        )
        self.landed = self._land_detector.landed

    def update(self, dt_s: float) -> None:
        """Update the setpoint of the mode and the controls."""
        flight, commander, state = self._flight, self._flight.commander, self._flight.state
        self._apply_changes()
        self.flies_on = False
        if not commander.armed:
            return
        landed, controller = self.landed, self.controller
        offboard = self._offboard.setpoint if commander.mode is FlightMode.OFFBOARD else None
        setpoint: Setpoint
        if landed and not commander.spooled_up(flight.now_us):
            setpoint = IDLE
        elif offboard is not None:
            setpoint = offboard
        else:
            inputs = ModeInputs(
                state=state,
                dt_s=dt_s,
                landed=landed,
                touching=self._land_detector.stage is not LandStage.AIRBORNE,
                home_ned_m=flight.home.pos_ned_m if flight.home is not None else None,
                manual=self._manual.sticks,
                hover_thrust=controller.hover_thrust,
                disturbance_ned_m_s2=controller.disturbance_ned_m_s2,
            )
            setpoint = self.navigator.update(inputs)
        self._setpoint = setpoint
        flight.setpoint = setpoint if isinstance(setpoint, TrajectorySetpoint) else None
        controller.update(state, setpoint, dt_s=dt_s, landed=landed)
        self.flies_on = not landed and setpoint is offboard and controller.flies_on

    def _apply_changes(self) -> None:
        """Apply a change of mode, arming, estimate or take-off altitude to navigator and controller."""
        commander = self._flight.commander
        active = (
            commander.mode,
            commander.armed,
            self._flight.state.reset_counter,
            self.takeoff_altitude.amsl_m,
            commander.failsafe and commander.mode is FlightMode.HOLD,
        )
        if active != self._active:
            self._on_change(was_armed=self._active is not None and self._active[1])
            self._active = active

    def _on_change(self, *, was_armed: bool) -> None:
        """Handle a new mode, arming or disarming, or a reset of the estimate."""
        flight = self._flight
        if not flight.commander.armed:
            self.controller.idle()
            self._setpoint = IDLE
            flight.setpoint = None
            return
        if not was_armed and flight.state.position_valid and not self._home_is_manual:
            self._set_home()
        self.navigator.enter(
            flight.commander.mode,
            flight.state,
            landed=self.landed,
            takeoff_down_m=self._takeoff_down_m(),
            home_ned_m=flight.home.pos_ned_m if flight.home is not None else None,
        )
        if flight.commander.failsafe and flight.commander.mode is FlightMode.HOLD:
            self.navigator.stop(flight.state)  # stop, instead of continuing to a hold target

    # ---- parts

    def _is_allowed(self, place_ned_m: Array) -> bool:
        """Return whether a position (3,) is allowed by the geofence, or its action is at most a warning."""
        if self._parameters.settings.commander.geofence_action <= _FENCE_WARNS:
            return True
        home = self._flight.home
        home_ned_m = None if home is None else home.pos_ned_m
        return self._geofence.check(place_ned_m, home_ned_m, self._origin()) is None

    def _origin(self) -> Origin:
        """Return the geodetic origin of the local frame."""
        state = self._flight.state
        return Origin(state.origin_lat_deg, state.origin_lon_deg, state.origin_alt_m)

    def _takeoff_down_m(self) -> float:
        """Return the final height of a take-off: MIS_TAKEOFF_ALT above home, or the requested altitude.

        A requested altitude that is not above the ground is ignored.
        """
        home_down_m = self._flight.home.pos_ned_m[2] if self._flight.home is not None else 0.0
        amsl_m = self.takeoff_altitude.amsl_m
        if amsl_m is not None:
            down_m = self._flight.state.origin_alt_m - amsl_m
            if down_m < home_down_m - ON_GROUND_M:
                return down_m
        return home_down_m - self._parameters.settings.navigation.takeoff_height_m

    def _enter_in_flight(self, mode: FlightMode) -> Reason | None:
        """Enter a mode that requires the vehicle to be in the air."""
        commander = self._flight.commander
        if not commander.armed or self.landed:
            return Reason.ON_GROUND
        refusal = commander.set_mode(mode)
        if refusal is None:
            self.takeoff_altitude.amsl_m = None
            self._apply_changes()
        return refusal

    def _place_ned_m(
        self, here_ned_m: Array, lat_deg: float | None, lon_deg: float | None, alt_amsl_m: float | None
    ) -> Array:
        """Return a position (3,) from the estimator's origin; ``here_ned_m`` (3,) replaces what is None."""
        state = self._flight.state
        place_ned_m = here_ned_m.copy()
        if lat_deg is not None and lon_deg is not None:
            place_ned_m[:2] = geodetic_to_ned(
                lat_deg,
                lon_deg,
                state.origin_alt_m,
                origin_lat_deg=state.origin_lat_deg,
                origin_lon_deg=state.origin_lon_deg,
                origin_alt_m=state.origin_alt_m,
            )[:2]
        if alt_amsl_m is not None:
            place_ned_m[2] = state.origin_alt_m - alt_amsl_m
        return place_ned_m

    def _set_home(self) -> None:
        """Set home to the present position."""
        self._flight.home = self._here()
        self._check_mission()

    def _check_mission(self, *, flown: bool = False) -> None:
        """Check whether there is a mission that may be flown.

        As in PX4 a mission in progress is only checked if ``flown``: when mission or geofence have changed.
        """
        mission, home, commander = (
            self.navigator.mission.runner.mission,
            self._flight.home,
            self._flight.commander,
        )
        if commander.mode is FlightMode.MISSION and commander.armed and not self.landed and not flown:
            return
        violation = warning = None
        if mission is not None and home is not None:
            violation = fence_violation(
                mission, self._geofence, home_ned_m=home.pos_ned_m, origin=self._origin()
            )
            warning = distance_warning(
                mission,
                home_lat_deg=home.lat_deg,
                home_lon_deg=home.lon_deg,
                max_m=self._parameters.settings.navigation.first_place_max_m,
            )
        if violation is not None and violation != self.mission_fault:
            self.warnings.append(f"Mission rejected: {violation}")
        if warning is not None and warning != self._mission_warning:
            self.warnings.append(warning)
        self.mission_fault, self._mission_warning = violation, warning
        self.mission_valid = mission is not None and violation is None

    def _here(self) -> Home:
        state = self._flight.state
        lat_deg, lon_deg, alt_m = ned_to_geodetic(
            state.pos_ned_m,
            origin_lat_deg=state.origin_lat_deg,
            origin_lon_deg=state.origin_lon_deg,
            origin_alt_m=state.origin_alt_m,
        )
        north_m, east_m, down_m = state.pos_ned_m.tolist()
        w, x, y, z = state.q_ned_frd.tolist()
        return Home(
            lat_deg=float(lat_deg),
            lon_deg=float(lon_deg),
            alt_m=float(alt_m),
            pos_ned_m=(north_m, east_m, down_m),
            q_ned_frd=(w, x, y, z),
        )


def _number(value: float | None) -> float | None:
    """Return None for a value that is not finite, as MAVLink defines it."""
    return value if value is not None and math.isfinite(value) else None


def _are_usable(lat_deg: float | None, lon_deg: float | None, alt_m: float | None) -> bool:
    """Return whether latitude, longitude and altitude are each valid or None; False for NaN."""
    return (
        (lat_deg is None or abs(lat_deg) <= 90.0)
        and (lon_deg is None or abs(lon_deg) <= 180.0)
        and (alt_m is None or abs(alt_m) <= _HEIGHT_MAX_M)
    )
