"""Builders of the messages that the vehicle streams or sends on request, from its current values."""

from collections.abc import Callable

from autopilot.services.fields import Part
from autopilot.services.flight_data import FlightData
from autopilot.services.manual_control import ManualControlService
from autopilot.services.streams import Builder
from autopilot.services.telemetry_motion import MotionTelemetry
from autopilot.services.telemetry_sensors import Sensors
from autopilot.services.telemetry_system import SystemState


class Telemetry:
    """Message builders by id; each returns None while its data is not available."""

    def __init__(
        self,
        flight: FlightData,
        *,
        system: int,
        manual: ManualControlService,
        fenced: Callable[[], bool] = lambda: False,
        epoch_unix_us: int = 0,
    ) -> None:
        """``fenced`` returns whether there is a geofence; ``epoch_unix_us`` is the date of time 0."""
        self.motion = MotionTelemetry(flight)
        self.sensors = Sensors(flight, manual=manual)
        self.system = SystemState(
            flight, system=system, manual=manual, fenced=fenced, epoch_unix_us=epoch_unix_us
        )
        parts: tuple[Part, ...] = (self.motion, self.sensors, self.system)
        self.builders: dict[int, Builder] = {
            message_id: build for part in parts for message_id, build in part.make_builders().items()
        }
        """Other parts of the vehicle add theirs."""
