"""One UAV without I/O: estimator, commander, control, MAVLink services, on-board application.

`Vehicle.step` processes one HIL_SENSOR. Messages and radio items are passed as objects, and time is that of
the sensor.

As in PX4 each part has its own rate. Prediction, rates and attitude run at every sample, position control at
every second one; magnetometer and barometer at the rates of their parameters. Land detection, conditions,
failsafes and modes are evaluated every `DECISION_PERIOD_US`, and immediately on messages from a link or
commands of the application. The application has its own loop (``onboard.loop_period_ms``), in which it
receives telemetry and sends messages. All run at multiples of their periods, so most steps only process the
sample.
"""

from collections.abc import Sequence

from msgspec import Struct
from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander
from autopilot.commander.failsafe import US_PER_S
from autopilot.commander.geofence import Geofence
from autopilot.control import FlightController
from autopilot.control.user_control import UserFlightController
from autopilot.estimation.estimator import Estimator
from autopilot.estimation.sensor_input import SensorInput
from autopilot.mavlink.codec import Message, stamp
from autopilot.mavlink.components import APPLICATION_COMPONENT, AUTOPILOT_COMPONENT
from autopilot.mavlink.hil import HilActuatorControls
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation import site_plan
from autopilot.navigation.mode_registry import MODES, mode_table, user_row
from autopilot.navigation.site_frame import SiteFrame
from autopilot.onboard.factory import make_programs
from autopilot.onboard.programs import NOTHING, Programs
from autopilot.parameters.airframe_settings import mav_type, settings_of, stated_of
from autopilot.parameters.config import VehicleConfig
from autopilot.parameters.table import ParameterSet
from autopilot.services.flight_data import FlightData
from autopilot.services.manual_control import ManualControlService
from autopilot.services.offboard import OffboardService
from autopilot.services.service import (
    ALL,
    APPLICATION_PARTNER,
    GROUND_STATION,
    NEVER_US,
    Addressed,
    Partner,
    is_addressed_to,
    reply,
)
from autopilot.services.status import heartbeat, status_text
from autopilot.vehicle.extensions import load_extensions
from autopilot.vehicle.fast_step import FastSteps
from autopilot.vehicle.messaging import Messaging
from autopilot.vehicle.monitor import Monitor
from autopilot.vehicle.pilot import Pilot
from autopilot.vehicle.shared_state import FastStepLimits, SharedState
from foundation.extension_class import Extension
from netsim.wire.messages import RxItem, TxItem

DECISION_PERIOD_US = 40_000
"""PX4 runs its land detector twice as often and failsafes four times; their time limits are far longer."""
_GROUND = Partner(GROUND_STATION)
_HEARTBEAT_PERIOD_US = 1_000_000
_TRUTH_INTERVAL_US = 5_000.0
"""Interval that PX4 requests from a simulator on connecting."""
_MODE_DISARMED = common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_MODE_ARMED = _MODE_DISARMED | common.MAV_MODE_FLAG_SAFETY_ARMED
_LOCKSTEP_FLAG = 1
_HIL_STATE_QUATERNION = common.MAVLINK_MSG_ID_HIL_STATE_QUATERNION
_COMMANDS = frozenset({common.MAVLINK_MSG_ID_COMMAND_LONG, common.MAVLINK_MSG_ID_COMMAND_INT})
_TO_GROUND_TOO = frozenset({
    common.MAVLINK_MSG_ID_HEARTBEAT, common.MAVLINK_MSG_ID_NAMED_VALUE_INT,
    common.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY, common.MAVLINK_MSG_ID_STATUSTEXT,
})  # fmt: skip
"""Messages of the application about itself, which go to the simulator and the ground station."""


class StepOutput(Struct, frozen=True, kw_only=True):
    """Outputs of a step."""

    now_us: int
    actuators: HilActuatorControls
    """HIL_ACTUATOR_CONTROLS, with the time stamp of the sensor data that it answers."""
    simulator: list[Message]
    """Other messages to the simulator; those of the application have its component as source."""
    links: list[Addressed]
    """To partners of the external links."""
    radio: tuple[TxItem, ...]
    save_parameters: bool = False
    """Whether the parameters are to be written to their file."""


class Vehicle:
    """One UAV; call `step` with every HIL_SENSOR."""

    def __init__(self, config: VehicleConfig) -> None:
        """Create the vehicle's parts.

        Raises ParameterError for a parameter that does not exist or is out of range, PlanError for an invalid
        mission or fence, ExtensionError or ExtensionFailure for code of the user that cannot be used.
        """
        self.config = config
        self._system = config.instance + 1
        defaults = settings_of(config.airframe)
        estimation = replace(
            defaults.estimation,
            magnetic_field_ned_gauss=config.site.magnetic_field_ned_gauss,
            gps_delay_us=round(config.devices.gps_delay_s * US_PER_S),
        )
        defaults = replace(defaults, estimation=estimation)
        extensions = load_extensions(config.autopilot)
        modes = [*MODES]
        for number, each in enumerate(extensions.modes):
            modes.append(user_row(number, each.kind.traits, each.make, each.title))
        self.parameters = ParameterSet(
            defaults,
            config.autopilot.params,
            system=self._system,
            vehicle=stated_of(config.airframe),
        )
        settings = self.parameters.settings
        self.shared = SharedState()
        """What full and fast steps both update"""
        self._clock = clock = self.shared.clock
        self.estimator = Estimator(settings.estimation, clock)
        self.commander = Commander(settings.commander, mode_table(modes))
        self.flight = FlightData(
            estimator=self.estimator,
            commander=self.commander,
            state=self.estimator.state,
            clock=clock,
            mav_type=mav_type(config.airframe),
        )
        self.offboard = OffboardService(self.flight)
        self.manual = ManualControlService(self.commander)
        self.site = SiteFrame(config.site)
        self._sensors = SensorInput(
            self.estimator, settings.sensors, clock, rotors=len(config.airframe.rotors)
        )
        self.parameters.subscribe(self.estimator.set_params, "estimation")
        self.parameters.subscribe(self._sensors.set_params, "sensors")
        self.parameters.subscribe(self.commander.set_params, "commander")
        self.monitor = Monitor(
            self.parameters,
            geofence=Geofence(settings.geofence),
            sensors=self._sensors,
            offboard=self.offboard,
            manual=self.manual,
            airframe=config.airframe,
        )
        self.flight.battery = self.monitor.battery
        self.pilot = Pilot(
            self.parameters,
            self.flight,
            offboard=self.offboard,
            manual=self.manual,
            geofence=self.monitor.geofence,
            controller=self._make_controller(extensions.controller),
            modes=modes,
        )
        self.messaging = Messaging(
            config,
            flight=self.flight,
            parameters=self.parameters,
            pilot=self.pilot,
            geofence=self.monitor.geofence,
            offboard=self.offboard,
            manual=self.manual,
            plans=site_plan.plans(config.autopilot, config.site),
            extensions=extensions.services,
        )
        self._before_conditions = self.offboard.takes | self.manual.takes
        """Messages that conditions depend on; processed first, so that a mode request in the same step
        succeeds."""
        self._loop_period_us = config.onboard.loop_period_us
        self.app: Programs | None = make_programs(config) if config.onboard.enabled else None
        if self.app is not None:
            self.messaging.send_to_application = self.app.on_mavlink
        self._uses_truth = self.app is not None and self.app.needs_truth
        self.has_begun = False
        """Whether there was a step."""
        self._announced: tuple[FlightMode, bool, bool] | None = None
        self._announce_us = 0
        self._decide_us = 0
        self._loop_us = NEVER_US
        """Time of the next loop of the application, set at the first step."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the numbers that the application reports, in tables."""
        return () if self.app is None else self.app.layout.columns

    def step(
        self,
        *,
        sim_messages: Sequence[Message],
        link_messages: Sequence[Addressed] = (),
        radio_items: Sequence[RxItem] = (),
        link_active: tuple[bool, ...] = (True, True),
    ) -> StepOutput:
        """Process the messages up to a HIL_SENSOR, the last of ``sim_messages``, and return the outputs.

        Links that are inactive by ``link_active`` only get the heartbeat. A HIL_SENSOR that is not later than
        the previous one is answered with the previous controls.
        """
        now_us: int = sim_messages[-1].time_usec
        last_us, begins = self._clock.now_us, not self.has_begun
        if self.has_been_at(now_us):
            return StepOutput(
                now_us=now_us, actuators=self._actuators(now_us), simulator=[], links=[], radio=()
            )
        self.has_begun = True
        self._sense(sim_messages, now_us)
        simulator: list[Message] = []
        if begins:
            simulator.append(_interval_request(requested=self._uses_truth))
            if self.app is not None:
                self._loop_us = _next(now_us - 1, self._loop_period_us)
        loops = now_us >= self._loop_us
        decides = now_us >= self._decide_us or self._is_addressed(link_messages)
        to_answer = self._take_in(link_messages, now_us) if link_messages else []
        if decides:
            self._decide_us = _next(now_us, DECISION_PERIOD_US)
            self._update_inputs()
            self._decide()
        for received in to_answer:
            self._on_link_message(received, now_us)
        if self._sensors.others:
            self._pass_readings_on(now_us)
        if self._uses_truth:
            self._pass_truth_on(sim_messages, now_us)
        if self.app is not None and radio_items:
            self.app.on_radio(radio_items, now_us)
        radio = self._run_app(simulator, now_us) if loops else ()
        self.pilot.update((self.config.step_us if begins else now_us - last_us) / US_PER_S)
        messaging = self.messaging
        links: list[Addressed] = []
        if decides or messaging.is_due(now_us) or any(link_active):
            links = messaging.on_timer(now_us, link_active)
        if decides or loops:
            self._announce(simulator, now_us)
        return StepOutput(
            now_us=now_us,
            actuators=self._actuators(now_us),
            simulator=simulator,
            links=links,
            radio=radio,
            save_parameters=messaging.take_save_request(),
        )

    def serve_while_paused(self, link_messages: Sequence[Addressed]) -> list[Addressed]:
        """Return replies to the links while simulated time is paused.

        Commands are executed and the newest setpoints stored. No time passes, so nothing is due and nothing
        times out.
        """
        if not self.has_begun:
            return []
        now_us = self._clock.now_us
        self.flight.time_stands = True
        to_answer = self._take_in(link_messages, now_us)
        # a mode may be requested just after its conditions are met
        self.monitor.update(self.flight, has_mission=self.pilot.mission_valid)
        self._decide()
        for received in to_answer:
            self._on_link_message(received, now_us)
        self.flight.time_stands = False
        return self.messaging.take_outgoing()

    def fast_step_limits(self, record_us: int) -> FastStepLimits:
        """Return the limits of fast steps after this step; ``record_us`` is the host's."""
        return FastStepLimits(
            decision_us=self._decide_us,
            application_us=self._loop_us,
            services_us=self.messaging.next_deadline_us(),
            record_us=record_us,
            aiding_us=self._sensors.next_aiding_us,
            horizon_us=self.estimator.valid_until_us,
        )

    def begin_fast_steps(self, steps: FastSteps, answer: bytes, record_us: int) -> bool:
        """Allow fast steps after this reply until a full step is due; return whether the next can be fast."""
        filtered, flies = self.estimator.filter, self.pilot.flies_on
        if filtered is None or (self.commander.armed and not flies):
            return False
        limits = self.fast_step_limits(record_us)
        if limits.full_step_us <= self._clock.now_us + self.config.step_us:
            return False
        self.shared.begin_run(limits, flies=flies)
        steps.open(answer, (self.shared.block, filtered.block, filtered.samples, self.pilot.controller.block))
        return True

    def heartbeat(self) -> Message:
        """Return the present HEARTBEAT."""
        return heartbeat(self.commander, self.flight.conditions, self.flight.mav_type)

    def has_been_at(self, now_us: int) -> bool:
        """Return whether there was a step at that time or later; a step at that time is a repetition."""
        return self.has_begun and now_us <= self._clock.now_us

    def troubles(self) -> dict[str, int]:
        """Return counts of errors that were handled."""
        counts = {"offboard_rejected": self.offboard.rejected}
        if self.app is not None:
            counts |= self.app.troubles()
        return counts

    # ---- parts of a step, in order

    def _sense(self, sim_messages: Sequence[Message], now_us: int) -> None:
        """Update sensors and estimate."""
        flight, sensors = self.flight, self._sensors
        self._clock.now_us = now_us
        if sensors.take(sim_messages, now_us):
            flight.gps, flight.gps_us = sensors.gps, sensors.gps_us
            self.messaging.on_new_fix()
        flight.sensor, flight.baro, flight.mag = sensors.sensor, sensors.baro, sensors.mag
        flight.state = self.estimator.live

    def _update_inputs(self) -> None:
        """Update the inputs of the commander: land state, conditions and causes."""
        flight, pilot = self.flight, self.pilot
        if flight.state.position_valid:
            flight.origin_known = True
        was_landed = pilot.landed
        pilot.update_land_state()
        if pilot.landed is not was_landed:
            if was_landed:
                flight.took_off_us = flight.now_us
            else:
                flight.landed_us = flight.now_us
                self.estimator.on_landed()
        if self.estimator.numerical_failure and not self.commander.armed:
            self.estimator.restart()
        self.monitor.update(flight, has_mission=pilot.mission_valid)
        pilot.controller.remove_motors(self.monitor.failures.failed_motors)

    def _is_addressed(self, link_messages: Sequence[Addressed]) -> bool:
        """Return whether a link message is addressed to this vehicle; others must not change its timing."""
        return any(
            is_addressed_to(message, system=self._system, component=component)
            for _, message in link_messages
            for component in (AUTOPILOT_COMPONENT, APPLICATION_COMPONENT)
        )

    def _take_in(self, link_messages: Sequence[Addressed], now_us: int) -> list[Addressed]:
        """Process the messages that conditions depend on, at any position; return the others."""
        to_answer = []
        for received in link_messages:
            self.monitor.on_message(received.message, now_us)
            if received.message.get_msgId() in self._before_conditions:
                self._on_link_message(received, now_us)
            else:
                to_answer.append(received)
        return to_answer

    def _decide(self) -> None:
        """Update the commander and send its notices."""
        for notice in self.commander.update(
            self.flight.now_us,
            conditions=self.flight.conditions,
            causes=self.flight.causes,
            landed=self.pilot.landed,
            next_mode=self.pilot.next_mode,
        ):
            self.messaging.post(reply(ALL, status_text(notice.severity, notice.text)))

    def _on_link_message(self, received: Addressed, now_us: int) -> None:
        partner, message = received
        messaging, system = self.messaging, self._system
        if is_addressed_to(message, system=system, component=AUTOPILOT_COMPONENT):
            messaging.on_message(message, now_us, partner)
        elif self.app is not None and is_addressed_to(
            message, system=system, component=APPLICATION_COMPONENT
        ):
            answers = self.app.on_request(message)  # messages of its autopilot use `send_to_application`
            for answer in answers:
                stamp(answer, system=system, component=APPLICATION_COMPONENT)
            messaging.post(reply(partner, *answers))
        else:
            messaging.not_addressed[partner.link] += 1

    def _run_app(self, simulator: list[Message], now_us: int) -> tuple[TxItem, ...]:
        """Run the application's loop: pass its telemetry and process its messages."""
        app = self.app
        if app is None:
            return ()
        self._loop_us = _next(now_us, self._loop_period_us)
        self.messaging.stream_to_application(now_us)
        output = app.on_timer(now_us)
        if output is NOTHING:
            return ()
        for message in output.mavlink:
            if isinstance(message, PositionTarget):
                self.offboard.on_message(message, now_us, APPLICATION_PARTNER)
                continue
            stamp(message, system=self._system, component=APPLICATION_COMPONENT)
            kind = message.get_msgId()
            if kind in _TO_GROUND_TOO:
                simulator.append(message)
                self.messaging.post(reply(_GROUND, message))
            else:
                self.messaging.on_message(message, now_us, APPLICATION_PARTNER)
                if kind in _COMMANDS:
                    self._decide_us = now_us  # decide at the next sample
        return output.radio

    def _pass_readings_on(self, now_us: int) -> None:
        """Store the readings of range finders, and pass those of the scenario's own sensors on."""
        for message in self._sensors.others:
            if message.get_msgId() == common.MAVLINK_MSG_ID_DISTANCE_SENSOR:
                self.flight.distances[message.id] = message
                self.messaging.on_new_distance()
            if self.app is not None:
                self.app.on_mavlink(message, now_us)

    def _pass_truth_on(self, sim_messages: Sequence[Message], now_us: int) -> None:
        """Pass the true state to the application, as the reference for estimates."""
        for message in sim_messages:
            if message.get_msgId() == _HIL_STATE_QUATERNION:
                self.flight.truth = message
                if self.app is not None:
                    self.app.on_mavlink(message, now_us)

    def _announce(self, simulator: list[Message], now_us: int) -> None:
        """Send the heartbeat to simulator and application, once a second and when it changes."""
        present = (self.commander.mode, self.commander.armed, self.commander.failsafe)
        if present != self._announced or now_us >= self._announce_us:
            if self.commander.armed and (self._announced is None or not self._announced[1]):
                self.flight.armed_us = now_us
                self.flight.flights += 1
            self._announced = present
            self._announce_us = _next(now_us, _HEARTBEAT_PERIOD_US)
            message = heartbeat(self.commander, self.flight.conditions, self.flight.mav_type)
            simulator.append(message)
            if self.app is not None:
                self.app.on_mavlink(message, now_us)

    # ---- parts

    def _make_controller(self, extension: Extension | None) -> FlightController:
        control = self.parameters.settings.control
        if extension is None:
            return FlightController(control)
        return UserFlightController(
            control,
            make=extension.make,
            title=extension.title,
            instance=self.config.instance,
            airframe=self.config.airframe,
        )

    def _actuators(self, now_us: int) -> HilActuatorControls:
        mode = _MODE_ARMED if self.commander.armed else _MODE_DISARMED
        return HilActuatorControls(now_us, self.pilot.controls, mode, _LOCKSTEP_FLAG)


def _next(now_us: int, period_us: int) -> int:
    """Return the first multiple of a period that is later than now."""
    return now_us - now_us % period_us + period_us


def _interval_request(*, requested: bool) -> Message:
    """Return the message that PX4 sends to a simulator on connecting, in addition to the heartbeat.

    PX4 always requests HIL_STATE_QUATERNION; an interval of -1 disables it.
    """
    truth = float(common.MAVLINK_MSG_ID_HIL_STATE_QUATERNION)
    interval_us = _TRUTH_INTERVAL_US if requested else -1.0
    return common.MAVLink_command_long_message(
        0, 0, common.MAV_CMD_SET_MESSAGE_INTERVAL, 0, truth, interval_us, 0.0, 0.0, 0.0, 0.0, 0.0
    )
