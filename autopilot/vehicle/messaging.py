"""MAVLink messaging of a vehicle: its services, their shared state, telemetry streams and outgoing messages.

`Vehicle` passes messages and time, and collects the outgoing messages once a step. No I/O.
"""

from collections.abc import Callable, Mapping, Sequence

from pymavlink.dialects.v20 import common

from autopilot.commander.geofence import Geofence
from autopilot.mavlink.codec import Message
from autopilot.mavlink.signing import SIGNATURE_BYTES
from autopilot.navigation.plan_store import Plan, PlanStore, PlanType
from autopilot.parameters.config import VehicleConfig
from autopilot.parameters.table import ParameterSet
from autopilot.services import flow_control, metadata
from autopilot.services.actions_flight import FlightActions, FlightCommands
from autopilot.services.actions_system import SystemCommands
from autopilot.services.calibration import Calibration
from autopilot.services.clocks import PingService, TimesyncService
from autopilot.services.command import ACCEPTED, FAILED, CommandService
from autopilot.services.files import FileStore
from autopilot.services.flight_data import FlightData, Home
from autopilot.services.flow_control import FlowControl
from autopilot.services.manual_control import ManualControlService
from autopilot.services.mission_progress import MissionProgress
from autopilot.services.offboard import OffboardService
from autopilot.services.parameter import ParameterService
from autopilot.services.service import (
    ALL,
    APPLICATION,
    COMPANION,
    GROUND_STATION,
    Addressed,
    Partner,
    reply,
)
from autopilot.services.shaper import Shapers
from autopilot.services.status import Chunks, status_text
from autopilot.services.streams import (
    APPLICATION_HZ,
    APPLICATION_WITH_ATTITUDE_HZ,
    COMPANION_HZ,
    GROUND_STATION_HZ,
    SERIAL_HZ,
    MessageStreams,
)
from autopilot.services.telemetry import Telemetry
from autopilot.vehicle.pilot import Pilot
from autopilot.vehicle.service_registry import ServiceParts, make_services
from foundation.extension_class import Extension

_OUTSIDE = (GROUND_STATION, COMPANION)


class Messaging:
    """Services and streams of one vehicle, connected to the parts that execute requests."""

    def __init__(
        self,
        config: VehicleConfig,
        *,
        flight: FlightData,
        parameters: ParameterSet,
        pilot: Pilot,
        geofence: Geofence,
        offboard: OffboardService,
        manual: ManualControlService,
        plans: Mapping[PlanType, Plan],
        extensions: Sequence[Extension] = (),
    ) -> None:
        """``plans`` are the initial ones, ``extensions`` the services of the user."""
        self._config = config
        self._system = config.instance + 1
        self._flight = flight
        self._parameters = parameters
        self._pilot = pilot
        self._geofence = geofence
        self.send_to_application: Callable[[Message, int], None] | None = None
        """Receives a message for the application in this process, and the time."""
        self.plans = PlanStore()
        self._plans_taken = dict(self.plans.version)
        """Versions of the plans in use."""
        for kind, plan in plans.items():
            self.plans.put(kind, plan.items, made=plan.made)
        self.telemetry = Telemetry(
            flight,
            system=self._system,
            manual=manual,
            fenced=self._is_fenced,
            epoch_unix_us=config.epoch_unix_us,
        )
        self.missions = MissionProgress(
            pilot.navigator.mission.runner, self.plans, flight.commander, is_valid=lambda: pilot.mission_valid
        )
        ping, timesync = PingService(flight), TimesyncService(flight)
        self.files = FileStore()
        """Files that stations may read; the host adds the log."""
        metadata.add_files(self.files, parameters)
        self.telemetry.builders |= {
            common.MAVLINK_MSG_ID_PING: ping.question,
            common.MAVLINK_MSG_ID_TIMESYNC: timesync.question,
            common.MAVLINK_MSG_ID_MISSION_CURRENT: self.missions.mission_current,
            metadata.COMPONENT_METADATA: lambda: metadata.message(flight.now_us),
        }
        application_hz = APPLICATION_WITH_ATTITUDE_HZ if config.feeds_wind_forward else APPLICATION_HZ
        outside = self.telemetry.builders
        within = outside | {common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self.telemetry.motion.local_position}
        self.streams = {
            GROUND_STATION: MessageStreams(outside, SERIAL_HZ if config.serial_modem else GROUND_STATION_HZ),
            COMPANION: MessageStreams(outside, COMPANION_HZ),
            APPLICATION: MessageStreams(within, application_hz),
        }
        """By link number."""
        bandwidth_bytes_s = dict.fromkeys(_OUTSIDE, config.links.bandwidth_bytes_s)
        self._flow: FlowControl | None = None
        """Of the ground link over a serial modem."""
        if config.serial_modem:
            bandwidth_bytes_s[GROUND_STATION] = config.links.bandwidth_bytes_s or flow_control.BYTES_S
            self._flow = FlowControl(bandwidth_bytes_s[GROUND_STATION])
        self.shapers = Shapers(
            bandwidth_bytes_s,
            overhead_bytes=SIGNATURE_BYTES if config.links.signing_key_file is not None else 0,
        )
        self._is_limited = bool(self.shapers)
        self._link_active: Sequence[bool] = ()
        """By link number, the last value passed to the streams."""
        self.not_addressed = dict.fromkeys(_OUTSIDE, 0)
        """Number of messages for other components, by link number."""
        self._parameter_service = ParameterService(parameters, self._has_room)
        calibration = Calibration(flight, wake=self._wake_services)
        self._commands = self._make_commands(offboard, calibration)
        self.services = make_services(
            ServiceParts(
                system=self._system,
                flight=flight,
                parameters=parameters,
                pilot=pilot,
                plans=self.plans,
                files=self.files,
                telemetry=self.telemetry,
                has_room=self._has_room,
                on_file_opened=self._on_file_opened,
                wake=self._wake_services,
                offboard=offboard,
                manual=manual,
                missions=self.missions,
                commands=self._commands,
                ping=ping,
                timesync=timesync,
                calibration=calibration,
                parameter_service=self._parameter_service,
            ),
            extensions,
        )
        parameters.report_to(lambda _: self._wake_services())
        self._chunks = Chunks()
        self._outgoing: list[Addressed] = []
        self._home_reported: Home | None = None
        self._origin_reported = False
        self._save_requested = False
        self._take_plans()

    # ---- incoming

    def on_message(self, message: Message, now_us: int, partner: Partner) -> None:
        """Process a message for the autopilot and queue the replies."""
        self.post(self.services.on_message(message, now_us, partner))
        self._take_plans()
        self._warn()

    def on_new_fix(self) -> None:
        """Mark the streams of a new GPS fix as due."""
        for streams in self.streams.values():
            streams.on_new_data(common.MAVLINK_MSG_ID_GPS_RAW_INT)

    def on_new_distance(self) -> None:
        """Mark the streams of new readings of range finders as due."""
        for streams in self.streams.values():
            streams.on_new_data(common.MAVLINK_MSG_ID_DISTANCE_SENSOR)

    def on_modem_status(self, status: Message, now_us: int) -> None:
        """Adapt the rates of the ground link to a RADIO_STATUS of its serial modem."""
        if self._flow is not None:
            self._flow.on_radio_status(status.txbuf, now_us)

    def on_saved(self, error: str | None) -> None:
        """Reply with the result of the file write that `take_save_request` started; None: success."""
        result = ACCEPTED if error is None else FAILED
        self.post(self._commands.finish(common.MAV_CMD_PREFLIGHT_STORAGE, result, self._flight.now_us))
        if error is not None:
            text = f"Parameters not saved: {error}"
            self.post(reply(ALL, status_text(common.MAV_SEVERITY_CRITICAL, text)))

    # ---- outgoing

    def post(self, messages: Sequence[Addressed]) -> None:
        """Queue messages for this step; messages for the application are passed on immediately."""
        for addressed in messages:
            link = addressed.partner.link
            if link == ALL.link:
                pieces = self._chunks.split(addressed.message)
                self._outgoing += [
                    Addressed(Partner(outside), piece) for outside in _OUTSIDE for piece in pieces
                ]
            elif link != APPLICATION:
                self._outgoing += reply(addressed.partner, *self._chunks.split(addressed.message))
            if link in {ALL.link, APPLICATION} and self.send_to_application is not None:
                self.send_to_application(addressed.message, self._flight.now_us)

    def stream_to_application(self, now_us: int) -> None:
        """Pass the telemetry that is due to the application."""
        streams = self.streams[APPLICATION]
        if self.send_to_application is not None and now_us >= streams.deadline_us:
            for message in streams.on_timer(now_us):
                self.send_to_application(message, now_us)

    def on_timer(self, now_us: int, link_active: Sequence[bool]) -> list[Addressed]:
        """Run what is due and return all outgoing messages of this step.

        Links that are inactive by ``link_active`` only get the heartbeat.
        """
        if self._pilot.warnings:
            self._warn()
        if self.missions.has_news:
            self.services.look_again()
        answered = len(self._outgoing)
        if now_us >= self.services.deadline_us:
            self.post(self.services.on_timer(now_us))
        timed = len(self._outgoing)
        if any(link_active):
            self._update_telemetry()
        if link_active != self._link_active:
            self._link_active = link_active
            for link in _OUTSIDE:
                self.streams[link].active = link_active[link]
        if self._flow is not None:
            streams = self.streams[GROUND_STATION]
            streams.rate_factor = self._flow.factor(now_us, *streams.needs_bytes_s)
        for link in _OUTSIDE:
            streams = self.streams[link]
            if now_us >= streams.deadline_us:
                self._outgoing += reply(Partner(link), *streams.on_timer(now_us))
        outgoing, self._outgoing = self._outgoing, []
        if not self._is_limited:
            return outgoing
        return self.shapers.shape(
            now_us, answered=outgoing[:answered], timed=outgoing[answered:timed], streamed=outgoing[timed:]
        )

    def is_due(self, now_us: int) -> bool:
        """Return whether `on_timer` has something to do even if all links are inactive."""
        return now_us >= self.next_deadline_us()

    def next_deadline_us(self) -> int:
        """Return the time from which `is_due` is true."""
        return 0 if self._outgoing else self.services.deadline_us

    def take_outgoing(self) -> list[Addressed]:
        """Return the queued messages and clear the queue."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def take_save_request(self) -> bool:
        """Return whether a save of the parameters was requested, and clear the request."""
        requested, self._save_requested = self._save_requested, False
        return requested

    # ---- parts

    def _make_commands(self, offboard: OffboardService, calibration: Calibration) -> CommandService:
        pilot, parameters = self._pilot, self._parameters
        flying = FlightCommands(
            self._flight,
            pilot.takeoff_altitude,
            FlightActions(
                ask_offboard=offboard.ask,
                reposition=pilot.reposition,
                orbit=pilot.orbit,
                change_speed=pilot.change_speed,
                set_home=pilot.set_home,
                set_home_here=pilot.set_home_here,
                has_mission_item=self.missions.has_item,
                set_mission_current=self.missions.set_current,
                takeoff_height_m=lambda: parameters.settings.navigation.takeoff_height_m,
            ),
        )
        system = SystemCommands(
            self.streams,
            calibrate=calibration.command,
            save_parameters=self._request_save,
            parameters=parameters,
            is_armed=lambda: self._flight.commander.armed,
            modes=self._flight.commander.modes,
        )
        return CommandService(flying.table | system.table)

    def _has_room(self, partner: Partner) -> bool:
        """Whether one more message of a transfer to this partner would be sent soon."""
        is_low = (
            self._flow is not None
            and partner.link == GROUND_STATION
            and self._flow.is_low(self._flight.now_us)
        )
        return not is_low and self.shapers.has_room(partner)

    def _wake_services(self) -> None:
        self.services.look_again()

    def _take_plans(self) -> None:
        """Use plans that have changed."""
        if self.plans.version == self._plans_taken:
            return
        before, self._plans_taken = self._plans_taken, dict(self.plans.version)
        kinds = {kind for kind, version in self._plans_taken.items() if version != before[kind]}
        self._pilot.load_plans(self.plans, kinds)

    def _warn(self) -> None:
        """Send the new messages about the mission."""
        warnings = self._pilot.warnings
        while warnings:
            self.post(reply(ALL, status_text(common.MAV_SEVERITY_CRITICAL, warnings.pop(0))))

    def _update_telemetry(self) -> None:
        """Update what only connected stations need: vibration, and immediate reports of home and origin."""
        self.telemetry.sensors.on_sample()
        flight = self._flight
        if flight.home is not self._home_reported:
            self._home_reported = flight.home
            self._hasten(common.MAVLINK_MSG_ID_HOME_POSITION)
        if flight.origin_known is not self._origin_reported:
            self._origin_reported = flight.origin_known
            self._hasten(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)

    def _hasten(self, message_id: int) -> None:
        for link in _OUTSIDE:
            self.streams[link].hasten(message_id, self._flight.now_us)

    def _is_fenced(self) -> bool:
        return self._geofence.has_limits

    def _on_file_opened(self, path: str, partner: Partner) -> None:
        if path.startswith(metadata.PACKED_PATH):
            self._parameter_service.take_by_value(partner)

    def _request_save(self) -> bool:
        """Request a save of the parameters; return whether there is a file for them."""
        self._save_requested = self._config.params_path is not None
        return self._save_requested
