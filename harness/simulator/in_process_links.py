"""Vehicles and emulator in the simulation's own process: the same bytes as over sockets, passed by calls.

They replace the sockets and the Zenoh session of a run of many processes.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from autopilot.parameters.config import VehicleConfig
from autopilot.vehicle.host import Host, warnings
from foundation.extension_failure import ExtensionFailure
from foundation.processes.child_protocol import Warned
from foundation.records.record_log import cut_to_blocks
from netsim.emulator.interface import NetworkEmulator
from netsim.transport.lockstep_radio import Deliveries, checked
from netsim.wire.lockstep import Advance, Advanced
from netsim.wire.messages import TxBatch, TxItem

LINKS_INACTIVE = (False, False)
"""Activity of the UDP links to ground station and companion, which do not exist here."""


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
    """The emulator as the time master uses it: replaces `netsim.transport.interval_stream`."""

    def __init__(self, emulator: NetworkEmulator, radios: Sequence[InProcessRadio]) -> None:
        self._emulator = emulator
        self._radios = radios
        self._advanced: deque[Advanced] = deque()

    def send(self, message: Advance) -> None:
        """Let the emulator simulate the requested interval and deliver its frames.

        Raises ValueError for a request that the emulator refuses.
        """
        delivered = []
        for station, batch in self._emulator.advance(message).items():
            if station < len(self._radios):  # not for guests
                self._radios[station].deliveries.put(batch)
                delivered.append(station)
        self._advanced.append(self._emulator.advanced(delivered=tuple(sorted(delivered))))

    def receive(self) -> Advanced | None:
        """Return the emulator's answer to the first request that `receive` has not answered."""
        return self._advanced.popleft()


class InProcessLink:
    """A vehicle in this process, with the methods of `harness.simulator.lockstep.Link`.

    ``emit`` receives its warnings, under its name. A failure of the user's code, which ``on_failure``
    receives, ends the vehicle only; another error of the vehicle is raised by `sendall`.
    """

    def __init__(
        self,
        config: VehicleConfig,
        radio: InProcessRadio,
        *,
        emit: Callable[[str, msgspec.Struct], None],
        on_failure: Callable[[str, ExtensionFailure], None],
    ) -> None:
        self.host = Host(config, radio)
        self.killed = False
        """Its end is reported in the next step."""
        self._has_failed = False
        self._emit, self._on_failure = emit, on_failure
        self._output = b""
        """Bytes that are not received yet."""
        self._log_path = config.log_path
        self._is_open = True

    def sendall(self, data: bytes | memoryview, /) -> None:
        """Run the vehicle's step on the simulator's frames."""
        if self.killed or self._has_failed:
            return
        try:
            self._step(data)
        except ExtensionFailure as failure:
            self._has_failed = True
            self._on_failure(self.host.name, failure)

    def troubles(self) -> Mapping[str, int]:
        """Return the vehicle's counts of faults; none once the user's code has failed."""
        if not self._has_failed:
            try:
                return self.host.vehicle.troubles()
            except ExtensionFailure as failure:
                self._has_failed = True
                self._on_failure(self.host.name, failure)
        return {}

    def counts(self) -> Mapping[str, Any]:
        """Return `troubles`, and the counts of its ground link over the radio if there is one."""
        links = self.host.link_counts()
        return {**self.troubles(), "links": links} if links else self.troubles()

    def _step(self, data: bytes | memoryview) -> None:
        host = self.host
        size = host.put(bytes(data))
        inertial = host.inertial_step(size)
        if inertial is not None:
            self._output += inertial
            return
        for messages in host.push(size):
            answer, links = host.step(messages, link_messages=[], link_active=LINKS_INACTIVE)
            self._output += answer
            for text in warnings(links) if links else ():
                self._emit(host.name, Warned(name=host.name, time_us=messages[-1].time_usec, text=text))

    def recv_into(self, buffer: memoryview, /) -> int:
        """Receive the answer of the last step; 0 if the vehicle has ended."""
        data = self.recv(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def recv(self, size: int, flags: int = 0, /) -> bytes:  # noqa: ARG002  those of a socket
        """Receive at most ``size`` bytes of the answer."""
        data, self._output = self._output[:size], self._output[size:]
        return b"" if self.killed else data

    def close(self) -> None:
        """End the vehicle; the log of a killed one is cut to whole blocks, as that of a killed process is."""
        if not self._is_open:
            return
        self._is_open = False
        self.host.close()
        if self.killed and self._log_path is not None:
            cut_to_blocks(self._log_path, self.host.record)
