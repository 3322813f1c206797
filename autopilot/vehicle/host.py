"""Vehicle host: a vehicle with its simulator link in bytes, its radio and its logs.

`Host.step` does everything of a vehicle's process in a step, except for the UDP links and the transport
of bytes and radio items: over sockets (``autopilot.__main__``), or by function calls in one process. The
radio is shared by the application and, with ground stations on the radio, the ground link.
"""

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

from pymavlink.dialects.v20 import common

from autopilot.logs.ulog_file import FlightLog
from autopilot.logs.vehicle_record import record, vehicle_record
from autopilot.mavlink.codec import Encoder, Message
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.hil import TO_VEHICLE, HilActuatorControls, HilEncoder, HilParser, HilSensor
from autopilot.mavlink.tlog import TelemetryLog
from autopilot.parameters import parameter_file
from autopilot.parameters.airframe_settings import mav_type
from autopilot.parameters.config import VehicleConfig
from autopilot.services.service import GROUND_STATION, NEVER_US, Addressed
from autopilot.services.status import TEXT_BYTES
from autopilot.vehicle.fast_step import FastSteps
from autopilot.vehicle.ground_radio import GroundRadio
from autopilot.vehicle.link_settings import LinkSettings, ground_log
from autopilot.vehicle.vehicle import Vehicle
from foundation.records.record_log import RecordLog
from netsim.wire.lockstep import BATCH_DELIVERED, BATCH_HANDED_OVER
from netsim.wire.messages import RxItem, TxItem

Links = list[Addressed]
"""Messages of the external links, each with its partner."""


MOST_WAITING = 256
"""Greatest number of link messages that are kept until the first step; the oldest are dropped."""


class Radio(Protocol):
    """A vehicle's access to the channel; see `netsim.transport.lockstep_radio.RadioClient`."""

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Transmit items."""

    def receive(self, now_us: int) -> Sequence[RxItem]:
        """Return the items available from ``now_us``, in a step that has some."""


class Host:
    """One vehicle, to be closed; without a radio it has no beacons, and no ground stations on the radio.

    Raises OSError for a log or a key file, SigningKeyError, and the errors of `Vehicle`.
    """

    def __init__(self, config: VehicleConfig, radio: Radio | None) -> None:
        self._config = config
        self.link_settings = LinkSettings(config)
        self.name = f"uav {config.instance}"
        self.vehicle = Vehicle(config)
        self._radio = radio
        self._parser = HilParser(*TO_VEHICLE)
        system = config.instance + 1
        self._encoder = HilEncoder(
            system=system, component=AUTOPILOT_COMPONENT, sequence=self.vehicle.shared.sequence
        )
        self._inertial = FastSteps()
        self.incoming = self._inertial.incoming
        """Buffer for the simulator's bytes, used by `inertial_step` and `push`"""
        self._waiting: list[Message] = []
        self._links_waiting: Links = []
        self.record = vehicle_record(self.vehicle.columns)
        """Layout of the log"""
        self._log = self._open_log()
        self._ground_log: TelemetryLog | None = None
        self._ground: GroundRadio | None = None
        if config.ground_stations and radio is not None:
            self._ground = GroundRadio(config, self.link_settings, tap=self.open_ground_log())
        self._flight_log: FlightLog | None = None
        self._may_log = config.params_path is not None
        self._must_log = self._may_log and config.logging.ulog

    def _open_log(self) -> RecordLog | None:
        config = self._config
        if config.log_path is None:
            return None
        return RecordLog(config.log_path, self.record, block_rows=config.log_block_rows)

    def open_ground_log(self) -> Callable[[bytes], None] | None:
        """Create the log of the ground link; return a function that adds a frame to it, None without a log.

        To be called for a ground link over UDP. Raises OSError.
        """
        self._ground_log = log = ground_log(self._config)
        return None if log is None else lambda frame: log.add(self.vehicle.flight.now_us, frame)

    def introduction(self) -> bytes:
        """Return the heartbeat that identifies the vehicle when it connects to the simulator."""
        beat = common.MAVLink_heartbeat_message(
            mav_type(self._config.airframe), common.MAV_AUTOPILOT_PX4, 0, 0, common.MAV_STATE_UNINIT, 3
        )
        return Encoder(system=self._config.instance + 1, component=AUTOPILOT_COMPONENT).encode(beat)

    def put(self, data: bytes) -> int:
        """Copy bytes into `incoming`; return their number."""
        self.incoming[: len(data)] = data
        return len(data)

    def inertial_step(self, size: int) -> memoryview | None:
        """Return the reply to ``size`` bytes in `incoming` if they are a fast step.

        Returns None otherwise, with nothing changed; `push` then processes the bytes.
        """
        return self._inertial.step(size)

    def push(self, size: int) -> Iterator[list[Message]]:
        """Yield the messages of each step completed by ``size`` bytes in `incoming`, up to its HIL_SENSOR."""
        self._inertial.close()
        for message in self._parser.push(self.incoming[:size].tobytes()):
            self._waiting.append(message)
            if type(message) is HilSensor and message.id == 0:  # of the first sensor, which is the clock
                complete, self._waiting = self._waiting, []
                yield complete

    def step(
        self, simulator_messages: list[Message], *, link_messages: Links, link_active: tuple[bool, ...]
    ) -> tuple[bytes, Links]:
        """Run one step; return the bytes for the simulator and the messages of all links.

        The host sends those of a ground link over the radio itself; ``link_messages`` and ``link_active``
        are those of the others. A HIL_SENSOR that is not later than the previous one is answered with the
        previous controls; the other messages are then kept for the next step.
        """
        clock = simulator_messages[-1]
        now_us: int = clock.time_usec
        if self.vehicle.has_been_at(now_us):
            self._waiting = simulator_messages[:-1] + self._waiting
            self._links_waiting += link_messages
            repeated = self.vehicle.step(sim_messages=simulator_messages[-1:])
            return self._encoder.encode(repeated.actuators), []
        if self._links_waiting:
            link_messages, self._links_waiting = self._links_waiting + link_messages, []
        radio_items: Sequence[RxItem] = ()
        if self._radio is not None and clock.fields_updated & BATCH_DELIVERED:
            radio_items = self._radio.receive(now_us)
        ground = self._ground
        if ground is not None:
            radio_items = ground.take_in(radio_items)
            link_messages = [*link_messages, *ground.receive(now_us)]
            link_active = (ground.active, *link_active[1:])
        if self._must_log and self._may_log:
            self._begin_flight_log(now_us)
        output = self.vehicle.step(
            sim_messages=simulator_messages,
            link_messages=link_messages,
            radio_items=radio_items,
            link_active=link_active,
        )
        if link_messages and self._may_log:
            self._begin_flight_log(now_us)
        if self._flight_log is not None:
            self._flight_log.on_step(now_us, output.links)
        actuators = output.actuators
        if output.save_parameters:
            self._save_parameters()  # the result is reported in the next step
        to_radio = output.radio if ground is None else output.radio + ground.send(now_us, output.links)
        if to_radio and self._radio is not None:
            self._radio.send(now_us, to_radio)
            time_us, controls, mode, flags = actuators
            actuators = HilActuatorControls(time_us, controls, mode, flags | BATCH_HANDED_OVER)
        if self._log is not None and now_us % self._config.record_period_us == 0:
            self._log.append_packed(record(self.vehicle))
        before = b"".join(map(self._encoder.encode, output.simulator)) if output.simulator else b""
        frame = self._encoder.encode(actuators)
        if not any(link_active):  # a connected station receives telemetry of every sample
            self._begin_fast_steps(now_us, frame)
        return before + frame, output.links

    def serve_while_paused(self, link_messages: Links) -> Links:
        """Return the replies to link messages that arrive while the simulator is silent.

        Those of a ground link over the radio are sent in the next step. Before the first step the vehicle
        cannot reply: messages are then kept for that step.
        """
        if not self.vehicle.has_begun:
            self._links_waiting = (self._links_waiting + link_messages)[-MOST_WAITING:]
            return []
        if self._inertial.close():
            self.vehicle.flight.sensor = self._inertial.last_sensor
        answers = self.vehicle.serve_while_paused(link_messages)
        messaging = self.vehicle.messaging
        if messaging.take_save_request():
            self._save_parameters()
            answers += messaging.take_outgoing()
        if self._flight_log is not None:
            self._flight_log.on_texts(self.vehicle.flight.now_us, answers)
        if self._ground is not None:
            self._ground.hold(answers)
        return answers

    def _begin_fast_steps(self, now_us: int, answer: bytes) -> None:
        """Allow fast steps after this reply, if possible, until the next full step is due."""
        if self._waiting or self._parser.unfinished:
            return
        period_us = self._config.record_period_us
        next_record_us = NEVER_US if self._log is None else now_us - now_us % period_us + period_us
        self.vehicle.begin_fast_steps(self._inertial, answer, next_record_us)

    @property
    def ground_messages(self) -> int:
        """Number of messages received from ground stations over the radio."""
        return 0 if self._ground is None else self._ground.received

    def link_counts(self) -> dict[str, Any]:
        """Return the counts of a ground link over the radio, as an entry ``ground_station``.

        They are of rejected and dropped messages, by cause, and of frames, by ground station. Without such a
        link there is no entry.
        """
        if self._ground is None:
            return {}
        messaging = self.vehicle.messaging
        of_vehicle = {
            "not_addressed": messaging.not_addressed[GROUND_STATION],
            "rate_limited": messaging.shapers.limited(GROUND_STATION),
        }
        return {"ground_station": self._ground.counts() | of_vehicle}

    @property
    def bad_bytes(self) -> int:
        """Number of bytes from the simulator that did not belong to a message."""
        return self._parser.bad_bytes

    def close(self) -> None:
        """Write the rest of the logs; repeated calls have no effect. Raises OSError."""
        with contextlib.ExitStack() as stack:  # closes each even if another fails
            for log in (self._flight_log, self._ground_log, self._log):
                if log is not None:
                    stack.callback(log.close)

    def _begin_flight_log(self, now_us: int) -> None:
        """Start the ULog, once, next to the parameter file. Raises OSError if the scenario requires it."""
        self._may_log = False
        path = Path(f"{self._config.params_path}").with_suffix(".ulg")
        try:
            self._flight_log = FlightLog(path, self.vehicle, now_us, required=self._must_log)
        except OSError as error:
            if self._must_log:
                raise
            sys.stderr.write(f"{self.name}: no log: {error}\n")

    def _save_parameters(self) -> None:
        """Write the parameter file and have the result reported to the requesters.

        A failed write does not affect the flight.
        """
        path, system = self._config.params_path, self._config.instance + 1
        if path is None:
            return
        trouble = None
        try:
            parameter_file.save(Path(path), self.vehicle.parameters, system_id=system)
        except OSError as error:
            sys.stderr.write(f"{self.name}: parameters not saved: {error}\n")
            trouble = error.strerror or str(error)
        self.vehicle.messaging.on_saved(trouble)


def warnings(links: Links) -> Iterator[str]:
    """Yield the texts of warnings to the ground station, for display without one."""
    begun = ""
    for partner, message in links:
        if (
            partner.link == GROUND_STATION
            and message.get_msgId() == common.MAVLINK_MSG_ID_STATUSTEXT
            and message.severity <= common.MAV_SEVERITY_WARNING
        ):
            piece = _text(message)
            if message.id and len(piece) == TEXT_BYTES:  # continued in the next one: see `Chunks`
                begun += piece
            else:
                yield begun + piece
                begun = ""


def _text(message: Message) -> str:
    """Return the text of a STATUSTEXT of this process, whose bytes are those that pymavlink sends."""
    text = message.text
    return text.decode("ascii", "replace") if isinstance(text, bytes) else str(text)
