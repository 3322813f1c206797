"""A vehicle with what it flies on: its simulator's link in bytes, its radio, and what it writes down.

`Host.step` is all that a vehicle's process does in a step, except for the ground's links and for how bytes
and radio are carried: over sockets (``autopilot.__main__``), or by plain calls in one process.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from pymavlink.dialects.v20 import common

from autopilot.logs.ulog_file import FlightLog
from autopilot.logs.vehicle_record import VEHICLE_RECORD, record
from autopilot.mavlink.codec import Encoder, Message
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.hil import TO_VEHICLE, HilActuatorControls, HilEncoder, HilParser, HilSensor
from autopilot.parameters import parameter_file
from autopilot.parameters.config import VehicleConfig
from autopilot.services.service import GROUND_STATION, NEVER_US, Addressed
from autopilot.services.status import TEXT_BYTES
from autopilot.vehicle.fast_step import FastSteps
from autopilot.vehicle.vehicle import Vehicle
from foundation.records.record_log import RecordLog
from netsim.wire.lockstep import BATCH_DELIVERED, BATCH_HANDED_OVER
from netsim.wire.messages import RxItem, TxItem

Links = list[Addressed]
"""Messages of the links to the outside, each with its partner."""


MOST_WAITING = 256
"""Messages of the links that are kept for the first step; the newest count."""


class Radio(Protocol):
    """A vehicle's way to the channel: see `netsim.transport.lockstep_radio.RadioClient`."""

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Hand over transmissions."""

    def receive(self, now_us: int) -> Sequence[RxItem]:
        """What may be seen from ``now_us`` on, for a step in which there is something."""


class Host:
    """One vehicle; close it. Without a radio it flies alone.

    Raises OSError for a log, and what `Vehicle` raises.
    """

    def __init__(self, config: VehicleConfig, radio: Radio | None) -> None:
        self._config = config
        self.name = f"uav {config.instance}"
        self.vehicle = Vehicle(config)
        self._radio = radio
        self._parser = HilParser(*TO_VEHICLE)
        system = config.instance + 1
        self._encoder = HilEncoder(system=system, component=AUTOPILOT_COMPONENT)
        self._inertial = FastSteps()
        self.incoming = self._inertial.incoming
        """Where the simulator's bytes go, for `inertial_step` and then for `push`"""
        self._waiting: list[Message] = []
        self._links_waiting: Links = []
        self._log = None if config.log_path is None else RecordLog(config.log_path, VEHICLE_RECORD)
        self._flight_log: FlightLog | None = None
        self._may_log = config.params_path is not None

    def introduction(self) -> bytes:
        """What is said to the simulator on connecting, so that no stranger gets the vehicle's seat."""
        beat = common.MAVLink_heartbeat_message(
            common.MAV_TYPE_QUADROTOR, common.MAV_AUTOPILOT_PX4, 0, 0, common.MAV_STATE_UNINIT, 3
        )
        return Encoder(system=self._config.instance + 1, component=AUTOPILOT_COMPONENT).encode(beat)

    def put(self, data: bytes) -> int:
        """Put bytes into `incoming` that have come in another way than straight into it; returns how many."""
        self.incoming[: len(data)] = data
        return len(data)

    def inertial_step(self, size: int) -> memoryview | None:
        """Answer ``size`` bytes in `incoming`, if they are a step that brings an inertial sample alone.

        None: nothing has happened, and they are for `push`.
        """
        return self._inertial.step(size)

    def push(self, size: int) -> Iterator[list[Message]]:
        """The steps that ``size`` bytes in `incoming` complete: a HIL_SENSOR and what came before it."""
        self._catch_up()
        for message in self._parser.push(self.incoming[:size].tobytes()):
            self._waiting.append(message)
            if type(message) is HilSensor and message.id == 0:  # of the first sensor set, which is the clock
                complete, self._waiting = self._waiting, []
                yield complete

    def step(
        self,
        simulator_messages: list[Message],
        *,
        link_messages: Links,
        link_active: tuple[bool, ...],
    ) -> tuple[bytes, Links]:
        """One step; returns what goes back to the simulator, and what goes out on the links.

        A HIL_SENSOR that is not later than the one before is answered with the controls of before; what came
        with it otherwise is kept for the next step.
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
        output = self.vehicle.step(
            sim_messages=simulator_messages,
            link_messages=link_messages,
            radio_items=radio_items,
            link_active=link_active,
        )
        if link_messages and self._may_log:
            self._begin_flight_log(now_us)
        if self._flight_log is not None:
            self._flight_log.on_step(output, link_active)
        actuators = output.actuators
        if output.save_parameters:
            self._save_parameters()  # how it ended is told in the next step
        if output.radio and self._radio is not None:
            self._radio.send(now_us, output.radio)
            time_us, controls, mode, flags = actuators
            actuators = HilActuatorControls(time_us, controls, mode, flags | BATCH_HANDED_OVER)
        if self._log is not None and now_us % self._config.record_period_us == 0:
            self._log.append_packed(record(self.vehicle))
        before = b"".join(map(self._encoder.encode, output.simulator)) if output.simulator else b""
        frame = self._encoder.encode(actuators)
        if not any(link_active):  # who listens hears of every sample
            self._begin_fast_steps(now_us, frame)
        return before + frame, output.links

    def serve_while_paused(self, link_messages: Links) -> Links:
        """What goes out on the links in answer to messages that come while the simulator is silent.

        Before the first step there is no vehicle yet that could answer: then they are kept for that step.
        """
        if not self.vehicle.has_begun:
            self._links_waiting = (self._links_waiting + link_messages)[-MOST_WAITING:]
            return []
        if self._catch_up():
            self.vehicle.flight.sensor = self._inertial.last_sensor
        answers = self.vehicle.serve_while_paused(link_messages)
        messaging = self.vehicle.messaging
        if messaging.take_save_wanted():
            self._save_parameters()
            answers += messaging.take_outgoing()
        return answers

    def _begin_fast_steps(self, now_us: int, answer: bytes) -> None:
        """Let inertial steps follow on this answer, if that may be, up to the next look at anything else."""
        if self._waiting or self._parser.unfinished or self._flight_log is not None:
            return
        period_us = self._config.record_period_us
        next_record_us = NEVER_US if self._log is None else now_us - now_us % period_us + period_us
        self.vehicle.begin_fast_steps(self._inertial, answer, self._encoder.sequence, next_record_us)

    def _catch_up(self) -> bool:
        """Bring the vehicle to where inertial steps have got, which then are over; False: it is there."""
        reached = self._inertial.close()
        if reached is None:
            return False
        now_us, self._encoder.sequence = reached
        self.vehicle.catch_up(now_us)
        return True

    @property
    def bad_bytes(self) -> int:
        """Bytes from the simulator that belonged to no message."""
        return self._parser.bad_bytes

    def close(self) -> None:
        """Write the rest of the log; harmless when repeated."""
        if self._flight_log is not None:
            self._flight_log.close()
        if self._log is not None:
            self._log.close()

    def _begin_flight_log(self, now_us: int) -> None:
        """Begin the stations' log, once, beside the parameter file."""
        self._may_log = False
        path = Path(f"{self._config.params_path}").with_suffix(".ulg")
        try:
            self._flight_log = FlightLog(path, self.vehicle, now_us)
        except OSError as error:
            sys.stderr.write(f"{self.name}: no log: {error}\n")

    def _save_parameters(self) -> None:
        """Write the parameter file and have the askers told.

        A disk that will not have it is no reason to fall out of the sky.
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
    """What the ground station is warned of, for whoever looks on without one."""
    begun = ""
    for partner, message in links:
        if (
            partner.link == GROUND_STATION
            and message.get_msgId() == common.MAVLINK_MSG_ID_STATUSTEXT
            and message.severity <= common.MAV_SEVERITY_WARNING
        ):
            piece = _text(message)
            if message.id and len(piece) == TEXT_BYTES:  # the next one goes on with it: see `Chunks`
                begun += piece
            else:
                yield begun + piece
                begun = ""


def _text(message: Message) -> str:
    """Text of a STATUSTEXT that is made here: its bytes are what pymavlink makes of them on the wire."""
    text = message.text
    return text.decode("ascii", "replace") if isinstance(text, bytes) else str(text)
