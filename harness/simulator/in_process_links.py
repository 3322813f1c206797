"""Vehicles and air in the simulation's own process: the same bytes as over sockets, handed on by plain calls.

Stand where `harness.simulator.lockstep` and a Zenoh session stand in a run of many processes.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import msgspec

from autopilot.logs.vehicle_record import VEHICLE_RECORD
from autopilot.mavlink.codec import Message
from autopilot.parameters.config import VehicleConfig
from autopilot.vehicle.host import Host, warnings
from foundation.processes.child_protocol import Warned
from foundation.records.record_log import BLOCK_ROWS
from harness.simulator.actuator_inbox import ANSWER_BYTES, ActuatorInbox
from harness.simulator.lockstep import CLOSED, ConnectionState
from netsim.emulator.service import EmulatorService
from netsim.transport.lockstep_radio import Deliveries, checked
from netsim.wire.lockstep import Advance, Advanced
from netsim.wire.messages import TxBatch, TxItem

NOBODY_LISTENS = (False, False)
"""On the links to the outside, of which there are none here."""


class InProcessRadio:
    """A vehicle's radio in this process, with the methods of `lockstep_radio.RadioClient`."""

    def __init__(self, emulator: EmulatorService, station: int) -> None:
        self._emulator = emulator
        self._station = station
        self.deliveries = Deliveries()
        self.receive = self.deliveries.take
        """What may be seen at a time, in order of (time, source, sequence)."""

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Hand over transmissions. Raises ValueError for what no station can send."""
        batch = TxBatch(station=self._station, now_us=now_us, items=tuple(items))
        checked(batch)
        if not self._emulator.submit(batch):
            raise ValueError(f"station {self._station}: the 802.11 emulator refuses what is sent")


class InProcessEmulatorLine:
    """The emulator as the time master uses it: replaces `netsim.transport.interval_stream.ClockLine`."""

    def __init__(self, emulator: EmulatorService, radios: Sequence[InProcessRadio]) -> None:
        self._emulator = emulator
        self._radios = radios
        self._advanced: Advanced | None = None

    def send(self, message: Advance) -> None:
        """Have the emulator simulate and deliver what is asked for.

        Raises ValueError for what it does not take.
        """
        delivered = []
        for station, batch in self._emulator.advance(message).items():
            if station < len(self._radios):  # a guest is not here
                self._radios[station].deliveries.put(batch)
                delivered.append(station)
        self._advanced = self._emulator.advanced(delivered=tuple(sorted(delivered)))

    def receive(self) -> Advanced | None:
        """What the emulator answered."""
        return self._advanced


class InProcessSlot(ConnectionState):
    """One vehicle's place at the simulator, and the vehicle itself."""

    def __init__(self, config: VehicleConfig, radio: InProcessRadio) -> None:
        super().__init__(config.instance)
        self.host = Host(config, radio)
        self.alive = True
        self.killed = False
        """To be found dead in the next step."""
        self.said = b""
        """In the present step, and not yet taken in."""
        self._log_path = config.log_path

    def hear(self, data: bytes | memoryview) -> list[tuple[int, str]]:
        """Have the vehicle do its step on what the simulator sends; returns its warnings with their times."""
        warned: list[tuple[int, str]] = []
        host = self.host
        size = host.put(bytes(data))
        inertial = host.inertial_step(size)
        if inertial is not None:
            self.said += inertial
            return warned
        for messages in host.push(size):
            answer, links = self.host.step(messages, link_messages=[], link_active=NOBODY_LISTENS)
            self.said += answer
            if links:
                warned += [(messages[-1].time_usec, text) for text in warnings(links)]
        return warned

    def end(self) -> None:
        """End the vehicle; of one that was killed its log keeps whole blocks, as that of a killed process."""
        self.alive = False
        self.host.close()
        if self.killed and self._log_path is not None:
            block_bytes = BLOCK_ROWS * VEHICLE_RECORD.itemsize
            os.truncate(self._log_path, Path(self._log_path).stat().st_size // block_bytes * block_bytes)


class InProcessVehicles:
    """All vehicles of a run; see `harness.simulator.interfaces.Vehicles`.

    ``on_message`` and ``on_lost`` are as `harness.simulator.lockstep.Lockstep`'s; ``emit`` is told of
    warnings, under the vehicle's name. An error in a vehicle is raised by the step, and is the end of the
    run.
    """

    def __init__(
        self,
        configs: Iterable[VehicleConfig],
        radios: Sequence[InProcessRadio],
        *,
        on_message: Callable[[int, Message], None],
        on_lost: Callable[[int, str], None],
        emit: Callable[[str, msgspec.Struct], None],
    ) -> None:
        self._on_message, self._on_lost, self._emit = on_message, on_lost, emit
        self.seats: list[InProcessSlot] = []
        self._answers = ActuatorInbox(len(radios))
        try:
            for config, radio in zip(configs, radios, strict=True):
                self.seats.append(InProcessSlot(config, radio))
        except BaseException:
            self.close()
            raise

    @property
    def living(self) -> int:
        """How many vehicles are in the run."""
        return sum(seat.alive for seat in self.seats)

    def connect(self, wall_timeout_s: float, *, keep_waiting: Callable[[], bool]) -> None:
        """Everybody is here."""

    def send(self, frames: Sequence[bytes | memoryview]) -> None:
        """Give every living vehicle its sensors, upon which it does its step."""
        for seat, frame in zip(self.seats, frames, strict=True):
            if seat.alive and not seat.killed:
                for time_us, text in seat.hear(frame):
                    self._emit(seat.host.name, Warned(name=seat.host.name, time_us=time_us, text=text))

    def answers(self, time_us: int) -> ActuatorInbox:
        """What every vehicle has answered to the sensors of ``time_us``."""
        answers, others = self._answers, []
        for seat in reversed(self.seats):
            said, seat.said = seat.said, b""
            if seat.killed and seat.alive:
                self._lose(seat)
            elif len(said) == ANSWER_BYTES:
                answers.hear(seat.instance, said)
            elif said:
                others.append((seat, said))
        answers.take(time_us)
        for seat, said in others:
            seat.await_answer()
            for message in seat.take(said, time_us):
                self._on_message(seat.instance, message)
            if seat.answer is not None:
                answers.put(seat.instance, seat.answer)
        return answers

    def judge(self, instances: Iterable[int]) -> None:
        """Nobody is ever waited for."""

    def kill(self, name: str) -> None:
        """End a vehicle at once; the simulation finds it gone in the next step."""
        for seat in self.seats:
            seat.killed |= seat.host.name == name

    def close(self) -> None:
        """End every vehicle; harmless when repeated."""
        with contextlib.ExitStack() as stack:
            for seat in self.seats:
                stack.callback(seat.end)

    def _lose(self, seat: InProcessSlot) -> None:
        seat.end()
        self._on_lost(seat.instance, CLOSED)
