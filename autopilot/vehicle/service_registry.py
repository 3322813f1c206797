"""The MAVLink services: one row for each, which makes it from the parts of a vehicle.

A built-in service is one class and one row of `SERVICES`. A service of the user is one class, which is made
from a `ServiceContext` instead and added after the built-in ones.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from autopilot.navigation import plan_items
from autopilot.navigation.plan_store import PlanStore
from autopilot.parameters.table import ParameterSet
from autopilot.services.calibration import Calibration
from autopilot.services.clocks import PingService, TimesyncService
from autopilot.services.command import CommandService
from autopilot.services.files import FileStore
from autopilot.services.flight_data import FlightData
from autopilot.services.ftp import FtpService
from autopilot.services.logs import LogService
from autopilot.services.manual_control import ManualControlService
from autopilot.services.mission_progress import MissionProgress
from autopilot.services.offboard import OffboardService
from autopilot.services.parameter import ParameterService
from autopilot.services.parameter_ext import ParameterExtService
from autopilot.services.places import PlacesService
from autopilot.services.plan_transfer import PlanTransfer
from autopilot.services.service import MavlinkService, Partner, Services
from autopilot.services.telemetry import Telemetry
from autopilot.services.user_service import ServiceContext, UserService, check_ids
from autopilot.vehicle.pilot import Pilot
from foundation.extension_class import Extension


class ServiceParts(NamedTuple):
    """What services are made from: parts of one vehicle, and services that other parts call, too."""

    system: int
    """MAVLink system id."""
    flight: FlightData
    parameters: ParameterSet
    pilot: Pilot
    plans: PlanStore
    files: FileStore
    telemetry: Telemetry
    has_room: Callable[[Partner], bool]
    """Whether a partner's link can take further messages."""
    on_file_opened: Callable[[str, Partner], None]
    wake: Callable[[], None]
    """Reads all deadlines again."""
    offboard: OffboardService
    manual: ManualControlService
    missions: MissionProgress
    commands: CommandService
    ping: PingService
    timesync: TimesyncService
    calibration: Calibration
    parameter_service: ParameterService


def _plan_transfer(parts: ServiceParts) -> PlanTransfer:
    runner, flight = parts.pilot.navigator.mission.runner, parts.flight
    return PlanTransfer(
        parts.plans,
        make=plan_items.make,
        system=parts.system,
        current=lambda: runner.current,
        time_stands=lambda: flight.time_stands,
    )


SERVICES: tuple[Callable[[ServiceParts], MavlinkService], ...] = (
    lambda parts: parts.offboard,
    lambda parts: parts.manual,
    _plan_transfer,
    lambda parts: parts.missions,
    lambda parts: parts.commands,
    lambda parts: parts.ping,
    lambda parts: parts.timesync,
    lambda parts: PlacesService(parts.pilot.set_home, parts.telemetry.motion.gps_global_origin),
    lambda parts: parts.calibration,
    lambda parts: parts.parameter_service,
    lambda parts: ParameterExtService(parts.parameters, parts.has_room),
    lambda parts: FtpService(parts.files, parts.on_file_opened, parts.has_room),
    lambda parts: LogService(parts.files, parts.has_room),
)
"""Rows in the order in which services receive a message that several of them handle."""


def make_services(parts: ServiceParts, extensions: Sequence[Extension] = ()) -> Services:
    """Return the services of a vehicle, those of the user last.

    Raises ExtensionError if two services handle the same message, ExtensionFailure if one cannot be made.
    """
    built_in = [make(parts) for make in SERVICES]
    context = ServiceContext(
        instance=parts.system - 1, flight=parts.flight, parameters=parts.parameters, wake=parts.wake
    )
    added = [(each.title, UserService(each.make(context), each.title)) for each in extensions]
    check_ids(added, built_in)
    return Services((*built_in, *(service for _, service in added)))
