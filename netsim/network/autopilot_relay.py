"""Relay of MAVLink datagrams between ``eth0`` of vehicles and their autopilots' companion links; one thread.

A program at port p of ``eth0`` has a flow: a socket on the host's loopback, connected to the autopilot, whose
datagrams it exchanges with the program. That of `PROGRAM`'s port is bound to the address to which the
autopilot sends by itself. It is open only while a program receives there, so that an autopilot without a
listener builds no telemetry. The contents of datagrams are not read.
"""

import logging
import selectors
import socket
from collections.abc import Callable, Sequence

from foundation.processes.socket_owners import DatagramOwners
from netsim.network.companion_sockets import PROGRAM, Address, CompanionSockets
from netsim.network.messages import CompanionLink

PERIOD_S = 0.25
"""Wall time between two looks for programs that receive."""
DATAGRAMS_PER_PERIOD = 150
"""Most datagrams to an autopilot: as many as frames that its link accepts. The rest stays in the kernel."""
DATAGRAMS_PER_TURN = 16
"""Most datagrams that are read from a socket before the others have their turn."""
MOST_FLOWS = 8
"""Ports of programs of a vehicle, as many as partners of a link; a new one replaces that which was silent
longest, except `PROGRAM`'s."""
MOST_BYTES = 2_048
"""Longer datagrams are dropped, as the autopilot's link does."""

logger = logging.getLogger(__name__)


class _Counts:
    to_autopilots = to_programs = dropped = foreign = pauses = 0


class Flow:
    """A socket on the loopback for one port of a program. Raises OSError if its port is in use."""

    def __init__(self, vehicle: "Vehicle", port: int, local_port: int = 0) -> None:
        """Bind ``local_port``, 0: a free one."""
        self._vehicle, self._port = vehicle, port
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)  # noqa: FBT003
            self._socket.bind((vehicle.link.companion_host, local_port))
            self.open()
        except OSError:
            self._socket.close()
            raise

    @property
    def address(self) -> Address:
        """The socket's own address."""
        host, port = self._socket.getsockname()
        return host, port

    def open(self) -> None:
        """Receive from the autopilot; while its port is not known, from every sender that can be it."""
        if self._vehicle.autopilot_port:
            self._socket.connect((self._vehicle.link.autopilot_host, self._vehicle.autopilot_port))

    def shut(self) -> None:
        """Keep the port, but let the kernel refuse what the autopilot sends there, once its port is known."""
        if self._vehicle.autopilot_port:
            self._socket.connect(self.address)

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._socket.fileno()

    def read(self) -> None:
        """Pass datagrams of the autopilot to the program, `DATAGRAMS_PER_TURN` at most."""
        counts = self._vehicle.counts
        for _ in range(DATAGRAMS_PER_TURN):
            try:
                data, sender = self._socket.recvfrom(MOST_BYTES + 1)
            except OSError:  # none, or the autopilot does not listen
                return
            if not self._vehicle.autopilot_port and self._vehicle.trusts(sender):
                self._vehicle.autopilot_port = sender[1]
                self.open()
            if sender == (self._vehicle.link.autopilot_host, self._vehicle.autopilot_port):
                self._vehicle.to_program(data, self._port)
            else:  # arrived before the socket was connected
                counts.foreign += 1

    def send(self, data: bytes) -> bool:
        """Send a datagram to the autopilot; False if it is lost."""
        try:
            self._socket.send(data)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Vehicle:
    """The autopilot's socket on one vehicle's ``eth0`` with its flows."""

    def __init__(
        self, link: CompanionLink, sockets: CompanionSockets, selector: selectors.BaseSelector,
        counts: _Counts, clock_s: Callable[[], float],
    ) -> None:  # fmt: skip
        self.link, self.counts = link, counts
        self.autopilot_port = link.autopilot_port
        """0: not known yet."""
        self._sockets, self._selector, self._clock_s = sockets, selector, clock_s
        self._owners = DatagramOwners(link.companion_host) if link.checks_owner else None
        self._flows: dict[int, Flow] = {}
        """By port of the program, that which sent last is last."""
        self._left = DATAGRAMS_PER_PERIOD
        self._is_paused = self._is_warned = False
        selector.register(sockets.autopilot, selectors.EVENT_READ, self)
        self.companion_port = link.companion_port
        """The port to which the autopilot is to send."""
        if not self.companion_port:  # nothing else has the number, so it is kept
            flow = Flow(self, PROGRAM[1])
            self.companion_port = flow.address[1]
            self._add(PROGRAM[1], flow)

    def read(self) -> None:
        """Pass datagrams of programs to the autopilot, `DATAGRAMS_PER_TURN` at most."""
        for _ in range(DATAGRAMS_PER_TURN):
            if self._left <= 0:
                self.counts.pauses += 1
                self._is_paused = True
                self._selector.unregister(self._sockets.autopilot)
                return
            try:
                data, (host, port) = self._sockets.autopilot.recvfrom(MOST_BYTES + 1)
            except OSError:
                return
            self._left -= 1
            flow = self._flow(port) if host == PROGRAM[0] and len(data) <= MOST_BYTES else None
            if flow is not None and flow.send(data):
                self.counts.to_autopilots += 1
            else:
                self.counts.dropped += 1

    def to_program(self, data: bytes, port: int) -> None:
        """Send a datagram of the autopilot to a port of ``eth0``."""
        try:
            self._sockets.autopilot.sendto(data, (PROGRAM[0], port))
        except OSError:
            self.counts.dropped += 1
        else:
            self.counts.to_programs += 1

    def trusts(self, sender: Address) -> bool:
        """Whether a sender on the loopback can be the autopilot, whose port is not known."""
        if sender[0] != self.link.autopilot_host:
            return False
        wall_s = self._clock_s()
        return self._owners is None or self._owners.trusts(sender, wall_s, wall_since_s=wall_s)

    def update(self) -> None:
        """Open and close flows by what receives at present, and read again what was left in the kernel."""
        if self._is_paused:
            self._is_paused = False
            self._selector.register(self._sockets.autopilot, selectors.EVENT_READ, self)
        self._left = DATAGRAMS_PER_PERIOD
        if self._sockets.receives(PROGRAM[1]):
            self._open(PROGRAM[1])
        for port in [port for port in self._flows if not self._sockets.receives(port)]:
            self._close(port)

    def _flow(self, port: int) -> Flow | None:
        """Return the flow of a program that sends, None without an autopilot or a free port."""
        flow = self._open(port)
        if flow is not None:
            self._flows[port] = self._flows.pop(port)
            if len(self._flows) > MOST_FLOWS:
                self._close(next(each for each in self._flows if each != PROGRAM[1]))
        return flow

    def _open(self, port: int) -> Flow | None:
        if port in self._flows:
            self._flows[port].open()
            return self._flows[port]
        if not self.autopilot_port and port != PROGRAM[1]:
            return None
        try:
            flow = Flow(self, port, self.companion_port if port == PROGRAM[1] else 0)
        except OSError as error:
            if not self._is_warned:
                self._is_warned = True
                local = f"{self.link.companion_host}:{self.companion_port}"
                logger.warning(
                    "station %d: eth0 has no autopilot: UDP %s: %s", self.link.station, local, error
                )
            return None
        return self._add(port, flow)

    def _add(self, port: int, flow: Flow) -> Flow:
        self._flows[port] = flow
        self._selector.register(flow, selectors.EVENT_READ, flow)
        return flow

    def _close(self, port: int) -> None:
        if port == PROGRAM[1] and not self.link.companion_port:
            self._flows[port].shut()
            return
        flow = self._flows.pop(port)
        self._selector.unregister(flow)
        flow.close()


class AutopilotRelay:
    """The relays of all vehicles; the selector's keys have `Flow` and `Vehicle`, which are to be read."""

    def __init__(
        self, companions: Sequence[tuple[CompanionLink, CompanionSockets]], selector: selectors.BaseSelector,
        clock_s: Callable[[], float],
    ) -> None:  # fmt: skip
        self._counts = _Counts()
        self._clock_s = clock_s
        self._vehicles = [Vehicle(*each, selector, self._counts, clock_s) for each in companions]
        self.wall_due_s = clock_s() if companions else None
        """When `update` is to be called; None: never."""

    def update(self, wall_s: float) -> None:
        """Update all vehicles if it is due."""
        if self.wall_due_s is not None and wall_s >= self.wall_due_s:
            for vehicle in self._vehicles:
                vehicle.update()
            self.wall_due_s = wall_s + PERIOD_S

    @property
    def companion_ports(self) -> dict[str, int]:
        """Return the ports to which the autopilots are to send, by station."""
        return {str(each.link.station): each.companion_port for each in self._vehicles}

    @property
    def counters(self) -> dict[str, object]:
        """Return numbers of datagrams of the run, and how often a vehicle had to wait for a period."""
        counts = self._counts
        return {
            "to_autopilots": counts.to_autopilots,
            "to_programs": counts.to_programs,
            "dropped": counts.dropped,
            "foreign": counts.foreign,
            "pauses": counts.pauses,
        }
