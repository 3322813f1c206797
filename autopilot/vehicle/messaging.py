"""All that speaks MAVLink for a vehicle: its services, what they share, its streams, and what goes out.

`Vehicle` feeds it messages and time, and takes what is to be sent once a step. No I/O.
"""

from collections.abc import Callable, Mapping, Sequence

from pymavlink.dialects.v20 import common

from autopilot.commander.geofence import Geofence
from autopilot.mavlink.codec import Message
from autopilot.mavlink.signing import SIGNATURE_BYTES
from autopilot.navigation import plan_items
from autopilot.navigation.plan_store import Plan, PlanStore, PlanType
from autopilot.parameters.config import VehicleConfig
from autopilot.parameters.table import ParameterSet
from autopilot.services import metadata
from autopilot.services.actions_flight import FlightActions, FlightCommands
from autopilot.services.actions_system import SystemCommands
from autopilot.services.calibration import Calibration
from autopilot.services.clocks import PingService, TimesyncService
from autopilot.services.command import ACCEPTED, FAILED, CommandService
from autopilot.services.files import FileStore
from autopilot.services.flight_data import FlightData, Home
from autopilot.services.ftp import FtpService
from autopilot.services.logs import LogService
from autopilot.services.manual_control import ManualControlService
from autopilot.services.mission_progress import MissionProgress
from autopilot.services.offboard import OffboardService
from autopilot.services.parameter import ParameterService
from autopilot.services.parameter_ext import ParameterExtService
from autopilot.services.places import PlacesService
from autopilot.services.plan_transfer import PlanTransfer
from autopilot.services.service import (
    ALL,
    APPLICATION,
    COMPANION,
    EVERYBODY,
    GROUND_STATION,
    Addressed,
    Partner,
    reply,
)
from autopilot.services.services import Services
from autopilot.services.shaper import Shapers
from autopilot.services.status import Chunks, status_text
from autopilot.services.streams import (
    APPLICATION_HZ,
    APPLICATION_WITH_ATTITUDE_HZ,
    COMPANION_HZ,
    GROUND_STATION_HZ,
    MessageStreams,
)
from autopilot.services.telemetry import Telemetry
from autopilot.vehicle.pilot import Pilot

_OUTSIDE = (GROUND_STATION, COMPANION)


class Messaging:
    """Services and streams of one vehicle, over the parts that do what is asked."""

    def __init__(
        self,
        config: VehicleConfig,
        *,
        flight: FlightData,
        parameters: ParameterSet,
        set_parameter: Callable[[str, float], None],
        reset_parameters: Callable[[tuple[str, ...]], bool],
        pilot: Pilot,
        geofence: Geofence,
        offboard: OffboardService,
        manual: ManualControlService,
        plans: Mapping[PlanType, Plan],
    ) -> None:
        """``set_parameter`` changes one for good and at once; ``plans`` are those to begin with.

        ``reset_parameters`` gives those with these beginnings their defaults unless the vehicle is armed.
        """
        self._config = config
        self._system = config.instance + 1
        self._flight = flight
        self._parameters = parameters
        self._set_parameter = set_parameter
        self._reset_parameters = reset_parameters
        self._pilot = pilot
        self._geofence = geofence
        self.tell_application: Callable[[Message, int], None] | None = None
        """Takes a message for the application in this process, and the time."""
        self.plans = PlanStore()
        self._plans_taken = dict(self.plans.version)
        """Versions of the plans that are flown and kept to."""
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
            pilot.navigator.mission.runner,
            self.plans,
            flight.commander,
            is_valid=lambda: pilot.mission_valid,
        )
        self._clocks = (PingService(flight), TimesyncService(flight))
        self.files = FileStore()
        """What stations may read; the host adds the log."""
        metadata.add_files(self.files, parameters)
        self.telemetry.builders |= {
            common.MAVLINK_MSG_ID_PING: self._clocks[0].question,
            common.MAVLINK_MSG_ID_TIMESYNC: self._clocks[1].question,
            common.MAVLINK_MSG_ID_MISSION_CURRENT: self.missions.mission_current,
            metadata.COMPONENT_METADATA: metadata.message_builder(lambda: flight.now_us),
        }
        application_hz = APPLICATION_WITH_ATTITUDE_HZ if config.onboard.wind_feed_forward else APPLICATION_HZ
        outside = self.telemetry.builders
        within = outside | {common.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self.telemetry.motion.local_position}
        self.streams = {
            GROUND_STATION: MessageStreams(outside, GROUND_STATION_HZ),
            COMPANION: MessageStreams(outside, COMPANION_HZ),
            APPLICATION: MessageStreams(within, application_hz),
        }
        """By the links' numbers."""
        self.shapers = Shapers(
            _OUTSIDE,
            config.links.bandwidth_bytes_s,
            overhead_bytes=SIGNATURE_BYTES if config.links.signing_key_file is not None else 0,
        )
        self._is_limited = bool(self.shapers)
        self._link_active: Sequence[bool] = ()
        """By the links' numbers, as the streams were told."""
        self.not_addressed = dict.fromkeys(_OUTSIDE, 0)
        """Messages for somebody else, by the links' numbers."""
        self._parameter_service = ParameterService(parameters, set_parameter, self.shapers.has_room)
        self.services = self._make_services(offboard, manual)
        self._chunks = Chunks()
        self._outgoing: list[Addressed] = []
        self._home_told: Home | None = None
        self._origin_told = False
        self._save_wanted = False
        self._take_plans()

    # ---- what comes in

    def on_message(self, message: Message, now_us: int, partner: Partner) -> None:
        """Take a message that is meant for the autopilot; what it is answered goes out."""
        self.post(self.services.on_message(message, now_us, partner))
        self._take_plans()
        self._warn()

    def on_new_fix(self) -> None:
        """Note that there is a new GPS fix to tell of."""
        for streams in self.streams.values():
            streams.on_new_data(common.MAVLINK_MSG_ID_GPS_RAW_INT)

    def on_parameter(self, name: str) -> None:
        """Note that a parameter has changed, whoever changed it: all are told."""
        self._parameter_service.on_change(name)
        self.services.look_again()

    def on_saved(self, trouble: str | None) -> None:
        """Note how the writing has ended that `take_save_wanted` told of; None: the file is there."""
        result = ACCEPTED if trouble is None else FAILED
        self.post(self._commands.finish(common.MAV_CMD_PREFLIGHT_STORAGE, result, self._flight.now_us))
        if trouble is not None:
            text = f"Parameters not saved: {trouble}"
            self.post(reply(ALL, status_text(common.MAV_SEVERITY_CRITICAL, text)))

    # ---- what goes out

    def post(self, messages: Sequence[Addressed]) -> None:
        """Have messages go out in this step; the application is given at once what is for it."""
        for addressed in messages:
            link = addressed.partner.link
            if link == EVERYBODY:
                pieces = self._chunks.split(addressed.message)
                self._outgoing += [
                    Addressed(Partner(outside), piece) for outside in _OUTSIDE for piece in pieces
                ]
            elif link != APPLICATION:
                self._outgoing += reply(addressed.partner, *self._chunks.split(addressed.message))
            if link in {EVERYBODY, APPLICATION} and self.tell_application is not None:
                self.tell_application(addressed.message, self._flight.now_us)

    def stream_to_application(self, now_us: int) -> None:
        """Give the application the telemetry that is due."""
        streams = self.streams[APPLICATION]
        if self.tell_application is not None and now_us >= streams.deadline_us:
            for message in streams.on_timer(now_us):
                self.tell_application(message, now_us)

    def on_timer(self, now_us: int, link_active: Sequence[bool]) -> list[Addressed]:
        """Do what is due and return all that goes out of this step.

        Where ``link_active`` says that nobody listens, only the heartbeat is formed.
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
            self._keep_telemetry()
        if link_active != self._link_active:
            self._link_active = link_active
            for link in _OUTSIDE:
                self.streams[link].active = link_active[link]
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
        """Whether there is something for `on_timer` to do though nobody listens."""
        return now_us >= self.next_deadline_us()

    def next_deadline_us(self) -> int:
        """When that will be."""
        return 0 if self._outgoing else self.services.deadline_us

    def take_outgoing(self) -> list[Addressed]:
        """Give what has been posted, which then is gone from here."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def take_save_wanted(self) -> bool:
        """Tell whether the parameters are to be written to their file; it is told once."""
        wanted, self._save_wanted = self._save_wanted, False
        return wanted

    # ---- pieces

    def _make_services(self, offboard: OffboardService, manual: ManualControlService) -> Services:
        pilot, parameters, has_room = self._pilot, self._parameters, self.shapers.has_room
        runner = pilot.navigator.mission.runner
        calibration = Calibration(self._flight, wake=self._look_again)
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
            save_parameters=self._want_save,
            reset_parameters=self._reset_parameters,
        )
        self._commands = CommandService(flying.table | system.table)
        return Services(
            (
                offboard,
                manual,
                PlanTransfer(
                    self.plans,
                    make=plan_items.make,
                    system=self._system,
                    current=lambda: runner.current,
                    time_stands=lambda: self._flight.time_stands,
                ),
                self.missions,
                self._commands,
                *self._clocks,
                PlacesService(pilot.set_home, self.telemetry.motion.gps_global_origin),
                calibration,
                self._parameter_service,
                ParameterExtService(parameters, self._set_parameter, has_room),
                FtpService(self.files, self._on_file_opened, has_room),
                LogService(self.files, has_room),
            )
        )

    def _look_again(self) -> None:
        self.services.look_again()

    def _take_plans(self) -> None:
        """Fly by plans that were written, and keep to them."""
        if self.plans.version == self._plans_taken:
            return
        before, self._plans_taken = self._plans_taken, dict(self.plans.version)
        kinds = {kind for kind, version in self._plans_taken.items() if version != before[kind]}
        self._pilot.load_plans(self.plans, kinds)

    def _warn(self) -> None:
        """Say what is new about the mission."""
        warnings = self._pilot.warnings
        while warnings:
            self.post(reply(ALL, status_text(common.MAV_SEVERITY_CRITICAL, warnings.pop(0))))

    def _keep_telemetry(self) -> None:
        """Do what matters only while somebody listens: feel vibration, tell new places at once."""
        self.telemetry.sensors.on_sample()
        flight = self._flight
        if flight.home is not self._home_told:
            self._home_told = flight.home
            self._hasten(common.MAVLINK_MSG_ID_HOME_POSITION)
        if flight.origin_known is not self._origin_told:
            self._origin_told = flight.origin_known
            self._hasten(common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)

    def _hasten(self, message_id: int) -> None:
        for link in _OUTSIDE:
            self.streams[link].hasten(message_id, self._flight.now_us)

    def _is_fenced(self) -> bool:
        return self._geofence.has_limits

    def _on_file_opened(self, path: str, partner: Partner) -> None:
        if path.startswith(metadata.PACKED_PATH):
            self._parameter_service.take_by_value(partner)

    def _want_save(self) -> bool:
        """Have the parameters written; tells whether there is a file for them."""
        self._save_wanted = self._config.params_path is not None
        return self._save_wanted
