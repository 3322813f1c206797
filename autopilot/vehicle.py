"""One UAV without its edges: estimator, commander, control, MAVLink services, on-board application.

`Vehicle.step` is all that happens in the moment of one HIL_SENSOR. It does no I/O: messages and radio items
come in as objects and go out as objects, and time is the sensor's.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.commander.commander import US_PER_S, Commander
from autopilot.commander.conditions import Condition
from autopilot.commander.land_detector import LandDetector, Stage
from autopilot.config import VehicleConfig
from autopilot.control import FlightController
from autopilot.estimation.estimator import Estimator
from autopilot.mavlink.codec import Message, stamp
from autopilot.mavlink.hil import HilActuatorControls
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.geodesy import ned_to_geodetic
from autopilot.navigation.setpoints import IDLE, Navigator, down_demand_m_s
from autopilot.onboard.app import NOTHING, OnboardApp
from autopilot.params import INDEX_OF, TABLE, ParameterError, ParameterSet, Settings
from autopilot.protocol.command import CommandService, TakeoffAltitude
from autopilot.protocol.flight_data import FlightData, Home
from autopilot.protocol.offboard import OffboardService
from autopilot.protocol.parameter import ParameterService
from autopilot.protocol.service import AUTOPILOT_COMPONENT, is_addressed_to
from autopilot.protocol.status import heartbeat, status_text
from autopilot.protocol.streams import APPLICATION_HZ, COMPANION_HZ, GROUND_STATION_HZ, Streams
from autopilot.protocol.telemetry import Telemetry
from autopilot.recording import SiteFrame
from autopilot.sensors import SensorInput
from autopilot.types import TrajectorySetpoint
from netsim.wire.messages import RxItem, TxItem

GROUND_STATION = 0
COMPANION = 1
"""Numbers of the links to the outside."""
APPLICATION_COMPONENT = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER"""

_HEARTBEAT_PERIOD_US = 1_000_000
_TRUTH_INTERVAL_US = 5_000.0
"""What PX4 asks a simulator for on connecting."""
_MODE_DISARMED = common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_MODE_ARMED = _MODE_DISARMED | common.MAV_MODE_FLAG_SAFETY_ARMED
_LOCKSTEP_FLAG = 1
_NO_CONTROLS = [0.0] * 16
_GPS_RAW_INT = common.MAVLINK_MSG_ID_GPS_RAW_INT


def is_clock(message: Message) -> bool:
    """Whether a simulator's message makes a step: HIL_SENSOR of the first sensor set."""
    return bool(message.get_msgId() == common.MAVLINK_MSG_ID_HIL_SENSOR and message.id == 0)


class StepOutput(Struct, frozen=True, kw_only=True):
    """What a step sends."""

    now_us: int
    actuators: HilActuatorControls
    """HIL_ACTUATOR_CONTROLS, stamped as the sensor data that it answers."""
    simulator: list[Message]
    """Other messages to the simulator; those of the application carry its component as source."""
    links: list[tuple[int, Message]]
    radio: tuple[TxItem, ...]


class _Link:
    """The services of one MAVLink partner: ground station, companion, or this process's application."""

    def __init__(self, vehicle: "Vehicle", rates_hz: dict[int, float]) -> None:
        self.streams = Streams(vehicle.telemetry.builders, rates_hz)
        self._commands = CommandService(vehicle.commander, vehicle.takeoff_altitude, self.streams)
        self._parameters = ParameterService(vehicle.parameters.get, vehicle.set_parameter)
        self._services = (vehicle.offboard, self._commands, self._parameters)
        self.deadline_us = 0
        """When `on_timer` next has something to do."""

    def set_active(self, *, active: bool) -> None:
        """Say whether somebody listens; without, only the heartbeat is formed."""
        if active is not self.streams.active:
            self.streams.active = active
            self._note_deadline()

    def on_new_data(self, message_id: int) -> None:
        """Note that a message has something new to say."""
        self.streams.on_new_data(message_id)
        self._note_deadline()

    def on_message(self, message: Message, now_us: int) -> list[Message]:
        """Answers to a message that is meant for the autopilot."""
        answers = [answer for service in self._services for answer in service.on_message(message, now_us)]
        self._note_deadline()
        return answers

    def on_timer(self, now_us: int) -> list[Message]:
        """Whatever is due."""
        messages = list(self.streams.on_timer(now_us))
        if now_us >= self._parameters.next_deadline_us():
            messages += self._parameters.on_timer(now_us)
        self._note_deadline()
        return messages

    def _note_deadline(self) -> None:
        self.deadline_us = min(self.streams.next_deadline_us(), self._parameters.next_deadline_us())


class Vehicle:
    """One UAV; `step` it with every HIL_SENSOR."""

    def __init__(self, config: VehicleConfig) -> None:
        """Put it together. Raises ParameterError for a parameter that does not exist or is out of range."""
        self.config = config
        self._system = config.instance + 1
        defaults = Settings()
        estimation = replace(
            defaults.estimation,
            magnetic_field_ned_gauss=config.site.magnetic_field_ned_gauss,
            gps_delay_us=round(config.devices.gps_delay_s * US_PER_S),
        )
        defaults = replace(defaults, estimation=estimation)
        self.parameters = ParameterSet(defaults, config.autopilot.params)
        settings = self.parameters.settings
        self.estimator = Estimator(settings.estimation)
        self.commander = Commander(settings.commander)
        self.flight = FlightData(
            estimator=self.estimator, commander=self.commander, state=self.estimator.state
        )
        self.telemetry = Telemetry(self.flight, system=self._system)
        self.takeoff_altitude = TakeoffAltitude()
        self.offboard = OffboardService(self.flight)
        self.site = SiteFrame(config.site)
        self._sensors = SensorInput(self.estimator)
        self._land_detector = LandDetector(settings.land_detector)
        self._make_control()
        self._links = (_Link(self, GROUND_STATION_HZ), _Link(self, COMPANION_HZ))
        self._app_link = _Link(self, APPLICATION_HZ)
        self.app = self._make_app()
        self._last_us: int | None = None
        self._active: tuple[FlightMode, bool, int, float | None] | None = None
        """Mode, arming, estimator resets and take-off altitude that navigator and controller work with."""
        self._announced: tuple[FlightMode, bool] | None = None
        self._announce_us = 0
        self._controls = _NO_CONTROLS

    def step(
        self,
        *,
        sim_messages: Sequence[Message],
        link_messages: Sequence[tuple[int, Message]] = (),
        radio_items: Sequence[RxItem] = (),
        link_active: tuple[bool, ...] = (True, True),
    ) -> StepOutput:
        """Take what arrived up to a HIL_SENSOR, the last of ``sim_messages``, and return what to send.

        Where ``link_active`` says that nobody listens only the heartbeat is formed. A HIL_SENSOR that is
        not later than the one before is answered with the controls of before.
        """
        now_us: int = sim_messages[-1].time_usec
        first = self._last_us is None
        if self._last_us is not None and now_us <= self._last_us:
            return StepOutput(
                now_us=now_us, actuators=self._actuators(now_us), simulator=[], links=[], radio=()
            )
        dt_s = (self.config.step_us if self._last_us is None else now_us - self._last_us) / US_PER_S
        self._last_us = now_us

        new_fix = self._sensors.take(sim_messages, now_us)
        self._sense(now_us)
        if new_fix:
            for link in (*self._links, self._app_link):
                link.on_new_data(_GPS_RAW_INT)
        outgoing: list[tuple[int, Message]] = []
        simulator = [_greeting()] if first else []
        for notice in self.commander.update(
            now_us,
            conditions=self.flight.conditions,
            landed=self._land_detector.landed,
            mode_completed=self._navigator.completed(self.flight.state),
        ):
            self._tell_everybody(status_text(notice.severity, notice.text), outgoing, now_us)
        for number, message in link_messages:
            outgoing += [(number, answer) for answer in self._on_link_message(number, message, now_us)]
        radio = self._run_app(radio_items, outgoing, simulator, now_us)
        self._control(dt_s)
        for number, link in enumerate(self._links):
            link.set_active(active=link_active[number])
            if now_us >= link.deadline_us:
                outgoing += [(number, message) for message in link.on_timer(now_us)]
        self._announce(simulator, now_us)
        return StepOutput(
            now_us=now_us, actuators=self._actuators(now_us), simulator=simulator, links=outgoing, radio=radio
        )

    def set_parameter(self, name: str, value: float) -> None:
        """Change a parameter, which acts at once. Raises ParameterError, also for what cannot change now.

        The estimator would have to start anew, so its parameters are those of the start; the controller's
        change while it idles.
        """
        if name in INDEX_OF:
            group = TABLE[INDEX_OF[name]].group
            if group == "estimation":
                raise ParameterError(f"{name} can only be set at the start")
            if group in {"control", "navigation"} and self.commander.armed:
                raise ParameterError(f"{name} cannot change while armed")
        self.parameters.set(name, value)
        self.commander.params = self.parameters.settings.commander
        self._land_detector.params = self.parameters.settings.land_detector
        if not self.commander.armed:
            self._make_control()

    def troubles(self) -> dict[str, int]:
        """Counts of what went wrong so far and was coped with."""
        counts = {"offboard_rejected": self.offboard.rejected}
        if self.app is not None:
            counts |= self.app.troubles()
        return counts

    # ---- parts of a step, in their order

    def _sense(self, now_us: int) -> None:
        """Bring the shared data up to now: the estimate, what holds, home, contact with the ground."""
        flight = self.flight
        flight.now_us = now_us
        sensors = self._sensors
        flight.sensor, flight.baro = sensors.sensor, sensors.baro
        flight.gps, flight.gps_us = sensors.gps, sensors.gps_us
        state = flight.state = self.estimator.live
        conditions = sensors.conditions(now_us)
        if state.attitude_valid:
            conditions |= _ATTITUDE
        if state.height_valid:
            conditions |= _HEIGHT
        if state.velocity_valid:
            conditions |= _VELOCITY
        if state.position_valid:
            conditions |= _POSITION
            flight.origin_known = True
            if flight.home is None:
                flight.home = self._here()
        if self.offboard.is_fresh(now_us, round(self.commander.params.offboard_loss_s * US_PER_S)):
            conditions |= _SETPOINTS
        flight.conditions = conditions
        if not self.commander.armed and self._land_detector.landed:
            return
        north_m_s, east_m_s, down_m_s = state.vel_ned_m_s.tolist()
        p, q, r = state.omega_frd_rad_s.tolist()
        setpoint = flight.setpoint if flight.setpoint is not None else IDLE
        self._land_detector.update(
            now_us,
            armed=self.commander.armed,
            down_m=float(state.pos_ned_m[2]),
            vel_down_m_s=down_m_s,
            horizontal_speed_m_s=(north_m_s * north_m_s + east_m_s * east_m_s) ** 0.5,
            rotation_rad_s=(p * p + q * q + r * r) ** 0.5,
            down_demand_m_s=down_demand_m_s(state, setpoint, z_p_1_s=self._controller.params.position.z_p),
            thrust_of_hover=self._controller.thrust / self._controller.hover_thrust,
        )

    def _on_link_message(self, number: int, message: Message, now_us: int) -> list[Message]:
        if is_addressed_to(message, system=self._system, component=AUTOPILOT_COMPONENT):
            return self._links[number].on_message(message, now_us)
        if self.app is not None and is_addressed_to(
            message, system=self._system, component=APPLICATION_COMPONENT
        ):
            self.app.on_mavlink(message, now_us)
        return []

    def _run_app(
        self,
        radio_items: Sequence[RxItem],
        outgoing: list[tuple[int, Message]],
        simulator: list[Message],
        now_us: int,
    ) -> tuple[TxItem, ...]:
        """Give the application its telemetry and radio, and carry out what it asks for."""
        app = self.app
        if app is None:
            return ()
        if now_us >= self._app_link.deadline_us:
            for message in self._app_link.on_timer(now_us):
                app.on_mavlink(message, now_us)
        for item in radio_items:
            app.on_radio(item, now_us)
        output = app.on_timer(now_us)
        if output is NOTHING:
            return ()
        for message in output.mavlink:
            stamp(message, system=self._system, component=APPLICATION_COMPONENT)
            kind = message.get_msgId()
            if kind == common.MAVLINK_MSG_ID_HEARTBEAT:
                simulator.append(message)
                outgoing.append((GROUND_STATION, message))
            elif kind == common.MAVLINK_MSG_ID_STATUSTEXT:
                outgoing.append((GROUND_STATION, message))
            else:
                for answer in self._app_link.on_message(message, now_us):
                    app.on_mavlink(answer, now_us)
                    if answer.get_msgId() == common.MAVLINK_MSG_ID_STATUSTEXT:
                        outgoing.append((GROUND_STATION, answer))
        return output.radio

    def _control(self, dt_s: float) -> None:
        """Setpoint of the mode and the controls that follow it."""
        flight, commander, state = self.flight, self.commander, self.flight.state
        active = (commander.mode, commander.armed, state.reset_counter, self.takeoff_altitude.amsl_m)
        if active != self._active:
            self._change(was_armed=self._active is not None and self._active[1])
            self._active = active
        if not commander.armed:
            return
        landed = self._land_detector.landed
        setpoint: TrajectorySetpoint
        if landed and not commander.spooled_up(flight.now_us):
            setpoint = IDLE
        elif commander.mode is FlightMode.OFFBOARD and self.offboard.setpoint is not None:
            setpoint = self.offboard.setpoint
        else:
            setpoint = self._navigator.update(
                state,
                dt_s=dt_s,
                landed=landed,
                touching=self._land_detector.stage is not Stage.AIRBORNE,
                home_down_m=flight.home.pos_ned_m[2] if flight.home is not None else 0.0,
            )
        flight.setpoint = setpoint
        flight.motors = self._controller.update(state, setpoint, dt_s=dt_s, landed=landed)
        flight.attitude_setpoint = self._controller.attitude_setpoint
        self._controls = flight.motors.tolist() + _NO_CONTROLS[4:]

    def _change(self, *, was_armed: bool) -> None:
        """Begin what follows from a new mode, from arming, or from an estimate that jumped."""
        flight = self.flight
        if not self.commander.armed:
            flight.motors = self._controller.idle()
            flight.setpoint = flight.attitude_setpoint = None
            self._controls = _NO_CONTROLS
            return
        if not was_armed and flight.state.position_valid:
            flight.home = self._here()
        self._navigator.enter(
            self.commander.mode,
            flight.state,
            landed=self._land_detector.landed,
            takeoff_down_m=self._takeoff_down_m(),
        )

    def _announce(self, simulator: list[Message], now_us: int) -> None:
        """Heartbeat to the simulator: each second, and at once when mode or arming change."""
        present = (self.commander.mode, self.commander.armed)
        if present != self._announced or now_us >= self._announce_us:
            self._announced = present
            self._announce_us = now_us + _HEARTBEAT_PERIOD_US
            simulator.append(heartbeat(self.commander, self.flight.conditions))

    # ---- pieces

    def _actuators(self, now_us: int) -> HilActuatorControls:
        mode = _MODE_ARMED if self.commander.armed else _MODE_DISARMED
        return HilActuatorControls(now_us, self._controls, mode, _LOCKSTEP_FLAG)

    def _tell_everybody(self, text: Message, outgoing: list[tuple[int, Message]], now_us: int) -> None:
        outgoing += [(number, text) for number in range(len(self._links))]
        if self.app is not None:
            self.app.on_mavlink(text, now_us)

    def _takeoff_down_m(self) -> float:
        amsl_m = self.takeoff_altitude.amsl_m
        if amsl_m is not None:
            return self.flight.state.origin_alt_m - amsl_m
        home_down_m = self.flight.home.pos_ned_m[2] if self.flight.home is not None else 0.0
        return home_down_m - self.parameters.settings.navigation.takeoff_height_m

    def _here(self) -> Home:
        state = self.flight.state
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

    def _make_control(self) -> None:
        settings = self.parameters.settings
        self._controller = FlightController(settings.control)
        self._navigator = Navigator(
            settings.navigation, settings.control.trajectory, settings.control.position
        )

    def _make_app(self) -> OnboardApp | None:
        config = self.config
        if not config.onboard.enabled:
            return None
        seed = np.random.SeedSequence([config.seed, config.instance, APPLICATION_COMPONENT])
        return OnboardApp(
            station=config.instance,
            places_ned_m=config.places_ned_m,
            site=config.site,
            config=config.onboard,
            devices=config.devices,
            rng=np.random.default_rng(seed),
        )


def _greeting() -> Message:
    """Give what PX4 sends a simulator on connecting, besides the heartbeat."""
    truth = float(common.MAVLINK_MSG_ID_HIL_STATE_QUATERNION)
    return common.MAVLink_command_long_message(
        0, 0, common.MAV_CMD_SET_MESSAGE_INTERVAL, 0, truth, _TRUTH_INTERVAL_US, 0.0, 0.0, 0.0, 0.0, 0.0
    )


_ATTITUDE = int(Condition.ATTITUDE)
_HEIGHT = int(Condition.HEIGHT)
_VELOCITY = int(Condition.VELOCITY)
_POSITION = int(Condition.POSITION)
_SETPOINTS = int(Condition.SETPOINTS)
