"""Vehicles and emulator in the simulation's own process: the same bytes as over sockets, passed by calls.

Replaces `harness.simulator.lockstep` and the Zenoh session of a run of many processes.
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
from netsim.emulator.interface import NetworkEmulator
from netsim.transport.lockstep_radio import Deliveries, checked
from netsim.wire.lockstep import Advance, Advanced
from netsim.wire.messages import TxBatch, TxItem

LINKS_INACTIVE = (False, False)
"""Activity of the links to ground station and companion, which do not exist here."""


class InProcessRadio:
    """A vehicle's radio in this process, with the methods of `lockstep_radio.RadioClient`."""

    def __init__(self, emulator: NetworkEmulator, station: int) -> None:
        self._emulator = emulator
        self._station = station
        self.deliveries = Deliveries()
        self.receive = self.deliveries.take
        """Return the items that are due at a time, in order of (time, source, sequence)."""

    def send(self, now_us: int, items: Sequence[TxItem]) -> None:
        """Hand over transmissions. Raises ValueError for items that no station can send."""
        batch = TxBatch(station=self._station, now_us=now_us, items=tuple(items))
        checked(batch)
        if not self._emulator.submit(batch):
            raise ValueError(f"station {self._station}: the 802.11 emulator refuses the transmissions")


class InProcessEmulatorLine:
    """The emulator as the time master uses it: replaces `netsim.transport.interval_stream.IntervalStream`."""

    def __init__(self, emulator: NetworkEmulator, radios: Sequence[InProcessRadio]) -> None:
        self._emulator = emulator
        self._radios = radios
        self._advanced: Advanced | None = None

    def send(self, message: Advance) -> None:
        """Let the emulator simulate the requested interval and deliver its frames.

        Raises ValueError for a request that the emulator refuses.
        """
        delivered = []
        for station, batch in self._emulator.advance(message).items():
            if station < len(self._radios):  # not for guests
                self._radios[station].deliveries.put(batch)
                delivered.append(station)
        self._advanced = self._emulator.advanced(delivered=tuple(sorted(delivered)))

    def receive(self) -> Advanced | None:
        """Return the emulator's answer to the last request."""
        return self._advanced


class InProcessSlot(ConnectionState):
    """One vehicle's slot at the simulator, and the vehicle itself."""

    def __init__(self, config: VehicleConfig, radio: InProcessRadio) -> None:
        super().__init__(config.instance)
        self.host = Host(config, radio)
        self.alive = True
        self.killed = False
        """Reported as lost in the next step."""
        self.output = b""
        """Bytes of the present step that are not processed yet."""
        self._log_path = config.log_path

    def step(self, data: bytes | memoryview) -> list[tuple[int, str]]:
        """Run the vehicle's step on the simulator's frames; returns its warnings with their times."""
        warned: list[tuple[int, str]] = []
        host = self.host
        size = host.put(bytes(data))
        inertial = host.inertial_step(size)
        if inertial is not None:
            self.output += inertial
            return warned
        for messages in host.push(size):
            answer, links = self.host.step(messages, link_messages=[], link_active=LINKS_INACTIVE)
            self.output += answer
            if links:
                warned += [(messages[-1].time_usec, text) for text in warnings(links)]
        return warned

    def end(self) -> None:
        """End the vehicle; the log of a killed one is cut to whole blocks, as that of a killed process is."""
        self.alive = False
        self.host.close()
        if self.killed and self._log_path is not None:
            block_bytes = BLOCK_ROWS * VEHICLE_RECORD.itemsize
            os.truncate(self._log_path, Path(self._log_path).stat().st_size // block_bytes * block_bytes)


class InProcessVehicles:
    """All vehicles of a run; see `harness.simulator.interfaces.Vehicles`.

    ``on_message`` and ``on_lost`` are those of `harness.simulator.lockstep.Lockstep`; ``emit`` receives
    warnings, under the vehicle's name. An error in a vehicle is raised by the step and ends the run.
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
        self.slots: list[InProcessSlot] = []
        self._inbox = ActuatorInbox(len(radios))
        try:
            for config, radio in zip(configs, radios, strict=True):
                self.slots.append(InProcessSlot(config, radio))
        except BaseException:
            self.close()
            raise

    @property
    def living(self) -> int:
        """How many vehicles are in the run."""
        return sum(slot.alive for slot in self.slots)

    def connect(self, wall_timeout_s: float, *, keep_waiting: Callable[[], bool]) -> None:
        """Return at once: all vehicles are connected from the start."""

    def send(self, frames: Sequence[bytes | memoryview]) -> None:
        """Send every living vehicle its sensors and run its step."""
        for slot, frame in zip(self.slots, frames, strict=True):
            if slot.alive and not slot.killed:
                for time_us, text in slot.step(frame):
                    self._emit(slot.host.name, Warned(name=slot.host.name, time_us=time_us, text=text))

    def receive(self, time_us: int) -> ActuatorInbox:
        """Return the answers of all vehicles to the sensors of ``time_us``."""
        inbox, others = self._inbox, []
        for slot in reversed(self.slots):
            data, slot.output = slot.output, b""
            if slot.killed and slot.alive:
                self._lose(slot)
            elif len(data) == ANSWER_BYTES:
                inbox.put_bytes(slot.instance, data)
            elif data:
                others.append((slot, data))
        inbox.unpack(time_us)
        for slot, data in others:
            slot.await_answer()
            for message in slot.take(data, time_us):
                self._on_message(slot.instance, message)
            if slot.answer is not None:
                inbox.put(slot.instance, slot.answer)
        return inbox

    def check(self, instances: Iterable[int]) -> None:
        """Do nothing: vehicles in this process are never awaited."""

    def kill(self, name: str) -> None:
        """End a vehicle at once; the simulation reports it as lost in the next step."""
        for slot in self.slots:
            slot.killed |= slot.host.name == name

    def close(self) -> None:
        """End every vehicle; harmless when repeated."""
        with contextlib.ExitStack() as stack:
            for slot in self.slots:
                stack.callback(slot.end)

    def _lose(self, slot: InProcessSlot) -> None:
        slot.end()
        self._on_lost(slot.instance, CLOSED)
