"""From the mode to the motors: navigation, control, contact with the ground, and the place to return to."""

from autopilot.commander.land_detector import LandDetector, Stage
from autopilot.control import FlightController
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.geodesy import ned_to_geodetic
from autopilot.navigation.mission import Mission, distance_trouble
from autopilot.navigation.setpoints import IDLE, Navigator, down_demand_m_s
from autopilot.params import Settings
from autopilot.protocol.command import TakeoffAltitude
from autopilot.protocol.flight_data import FlightData, Home
from autopilot.protocol.manual_control import ManualControlService
from autopilot.protocol.offboard import OffboardService
from autopilot.types import AttitudeSetpoint, TrajectorySetpoint

_NO_CONTROLS = [0.0] * 16


class Pilot:
    """Flies one vehicle in the commander's mode: `feel` the ground, then `fly`, at every step."""

    def __init__(
        self,
        settings: Settings,
        flight: FlightData,
        *,
        offboard: OffboardService,
        manual: ManualControlService,
    ) -> None:
        self.controls = _NO_CONTROLS
        """(16,) of HIL_ACTUATOR_CONTROLS, never written to."""
        self.takeoff_altitude = TakeoffAltitude()
        self.controller = FlightController(settings.control)
        control = settings.control
        self.navigator = Navigator(settings.navigation, control.trajectory, control.position)
        self.mission_valid = False
        """There is a mission that may be begun from home."""
        self._settings = settings
        self._flight = flight
        self._offboard = offboard
        self._manual = manual
        self._land_detector = LandDetector(settings.land_detector)
        self._setpoint: TrajectorySetpoint | AttitudeSetpoint = IDLE
        self._active: tuple[FlightMode, bool, int, float | None] | None = None
        """Mode, arming, estimator resets and take-off altitude that navigator and controller work with."""

    def set_params(self, settings: Settings) -> None:
        """Change what differs, at once and in flight; what was learned and flown stays."""
        before, self._settings = self._settings, settings
        control = settings.control
        if control is not before.control:
            self.controller.set_params(control)
        if control is not before.control or settings.navigation is not before.navigation:
            self.navigator.set_params(settings.navigation, control.trajectory, control.position)
            self._check_mission()
        self._land_detector.params = settings.land_detector

    def load_mission(self, mission: Mission | None) -> None:
        """Take another mission, or none; in mission mode it begins at once."""
        self.navigator.mission.load(mission)
        self._check_mission()

    @property
    def landed(self) -> bool:
        """On the ground for certain."""
        return self._land_detector.landed

    @property
    def next_mode(self) -> FlightMode | None:
        """The mode to go on with, where the present one has done what it is for."""
        return self.navigator.next_mode(self._flight.state)

    def feel(self) -> None:
        """Take the new estimate: whether there is ground below, and, once, where home is."""
        flight = self._flight
        state = flight.state
        if state.position_valid and flight.home is None:
            self._set_home()
        armed = flight.commander.armed
        if not armed and self._land_detector.landed:
            return
        controller, hover_thrust = self.controller, self.controller.hover_thrust
        north_m_s, east_m_s, down_m_s = state.vel_ned_m_s.tolist()
        p, q, r = state.omega_frd_rad_s.tolist()
        self._land_detector.update(
            flight.now_us,
            armed=armed,
            down_m=float(state.pos_ned_m[2]),
            vel_down_m_s=down_m_s,
            horizontal_speed_m_s=(north_m_s * north_m_s + east_m_s * east_m_s) ** 0.5,
            rotation_rad_s=(p * p + q * q + r * r) ** 0.5,
            down_demand_m_s=down_demand_m_s(
                state, self._setpoint, z_p_1_s=controller.params.position.z_p, hover_thrust=hover_thrust
            ),
            thrust_of_hover=controller.thrust / hover_thrust,
        )

    def fly(self, dt_s: float) -> None:
        """Set the mode's setpoint and the controls that follow it."""
        flight, commander, state = self._flight, self._flight.commander, self._flight.state
        active = (commander.mode, commander.armed, state.reset_counter, self.takeoff_altitude.amsl_m)
        if active != self._active:
            self._change(was_armed=self._active is not None and self._active[1])
            self._active = active
        if not commander.armed:
            return
        landed = self._land_detector.landed
        setpoint: TrajectorySetpoint | AttitudeSetpoint
        if landed and not commander.spooled_up(flight.now_us):
            setpoint = IDLE
        elif commander.mode is FlightMode.OFFBOARD and self._offboard.setpoint is not None:
            setpoint = self._offboard.setpoint
        else:
            setpoint = self.navigator.update(
                state,
                dt_s=dt_s,
                landed=landed,
                touching=self._land_detector.stage is not Stage.AIRBORNE,
                home_ned_m=flight.home.pos_ned_m if flight.home is not None else None,
                manual=self._manual.sticks,
                hover_thrust=self.controller.hover_thrust,
                disturbance_ned_m_s2=self.controller.disturbance_ned_m_s2,
            )
        self._setpoint = setpoint
        flight.setpoint = setpoint if isinstance(setpoint, TrajectorySetpoint) else None
        flight.motors = self.controller.update(state, setpoint, dt_s=dt_s, landed=landed)
        flight.attitude_setpoint = self.controller.attitude_setpoint
        self.controls = flight.motors.tolist() + _NO_CONTROLS[4:]

    def _change(self, *, was_armed: bool) -> None:
        """Begin what follows from a new mode, from arming, or from an estimate that jumped."""
        flight = self._flight
        if not flight.commander.armed:
            flight.motors = self.controller.idle()
            self._setpoint = IDLE
            flight.setpoint = flight.attitude_setpoint = None
            self.controls = _NO_CONTROLS
            return
        if not was_armed and flight.state.position_valid:
            self._set_home()
        self.navigator.enter(
            flight.commander.mode,
            flight.state,
            landed=self._land_detector.landed,
            takeoff_down_m=self._takeoff_down_m(),
            home_ned_m=flight.home.pos_ned_m if flight.home is not None else None,
        )

    # ---- pieces

    def _takeoff_down_m(self) -> float:
        amsl_m = self.takeoff_altitude.amsl_m
        if amsl_m is not None:
            return self._flight.state.origin_alt_m - amsl_m
        home_down_m = self._flight.home.pos_ned_m[2] if self._flight.home is not None else 0.0
        return home_down_m - self._settings.navigation.takeoff_height_m

    def _set_home(self) -> None:
        """Make the present place the one to return to."""
        self._flight.home = self._here()
        self._check_mission()

    def _check_mission(self) -> None:
        """Find out whether there is a mission that may be begun from home."""
        mission, home = self.navigator.mission.runner.mission, self._flight.home
        self.mission_valid = mission is not None and (
            home is None
            or distance_trouble(
                mission,
                home_lat_deg=home.lat_deg,
                home_lon_deg=home.lon_deg,
                max_m=self._settings.navigation.first_place_max_m,
            )
            is None
        )

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
