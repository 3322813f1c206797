"""Lockstep with the vehicles, over sockets or by calls (`harness.simulator.in_process_links`).

Each step sends the sensors of one instant to every vehicle and waits for the answers, within the limits of
each vehicle's `LockstepPolicy`.

An I/O module: owns the connections of PX4's simulator API. `harness.simulator.response_watchdog` decides when
a silent vehicle is given up, `harness.simulator.handshake` which connection belongs to which slot.
"""

import contextlib
import errno
import socket
import struct
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import HilActuatorControls, HilParser
from harness.simulator.actuator_inbox import ActuatorInbox
from harness.simulator.ardupilot_json import servo_packet
from harness.simulator.ardupilot_link import ArduPilotLink
from harness.simulator.handshake import ArduPilotArrival, Arrival, Handshake
from harness.simulator.response_watchdog import STARTING_LIMIT_S, ResponseWatchdog
from harness.simulator.slot_guard import UNGUARDED, Guard

POLL_S = 0.1
STARTING_STEP_S = 0.004
"""Least wall time of a step while a starting vehicle has not answered yet: a PX4 reads sensors from the first
on, but starts up in wall time, and drops messages that arrive faster."""
BREAK_S = 2.0
"""A longer wall time between two steps counts as a pause of the simulation, which resets silences."""
_RECEIVE_BYTES = 4096
_UNREACHABLE = {errno.EHOSTUNREACH, errno.EHOSTDOWN, errno.ENETUNREACH, errno.ENETDOWN, errno.ENOBUFS}
_NONE: Mapping[int, Any] = MappingProxyType({})
_POLL_TIMEVAL = struct.pack("ll", 0, round(POLL_S * 1e6))


def _check_lost(error: OSError) -> None:
    """Raise the error of a link again unless its vehicle has ended or cannot be reached: it ends the run."""
    if not (isinstance(error, ConnectionError | TimeoutError) or error.errno in _UNREACHABLE):
        raise error


def _limit_waits(connection: socket.socket) -> None:
    """Limit each wait for input to `POLL_S`, by the kernel: Python's own limit costs one more system call."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _POLL_TIMEVAL)


CLOSED = "its connection closed"
"""Reason of the loss of a vehicle that ended."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LockstepPolicy:
    """How a kind of vehicle answers its sensors."""

    starts_silent: bool = False
    """It receives sensors for a while before its first answer; steps do not wait for it until then."""
    late_after_s: float | None = None
    """Wall time after which a step continues with its previous controls; None: the watchdog's limit."""


OWN = LockstepPolicy()
"""coflight's own vehicles: one answer to each HIL_SENSOR, from the first on."""
PX4 = LockstepPolicy(starts_silent=True, late_after_s=0.3)
"""A real PX4: silent for its first 13 to 54 steps; under load an answer occasionally takes 0.2 s; after
a lost answer it sends the next one only if it receives further sensors."""


class Link(Protocol):
    """Connection to one vehicle: a socket, or `harness.simulator.in_process_links.InProcessLink`.

    All methods raise OSError if the connection is lost, and BlockingIOError if they
    cannot go on within the link's time limit.
    """

    def sendall(self, data: bytes | memoryview, /) -> None:
        """Send the vehicle its sensors."""

    def recv_into(self, buffer: memoryview, /) -> int:
        """Receive bytes of the vehicle into a buffer; returns how many, 0 if the vehicle has ended."""

    def recv(self, size: int, flags: int = 0, /) -> bytes:
        """Receive at most ``size`` bytes of the vehicle; none if it has ended."""

    def close(self) -> None:
        """Close the connection, which ends the vehicle; harmless when repeated."""


class VehicleSlot:
    """One vehicle's slot at the simulator: its link, the state of its answers, and a parser.

    The parser reads what `actuator_inbox` does not unpack.
    """

    def __init__(self, instance: int, policy: LockstepPolicy = OWN, link: Link | None = None) -> None:
        self.instance = instance
        self.policy = policy
        self.link = link
        self.parser = HilParser(HilActuatorControls)
        self.answer: HilActuatorControls | None = None
        """HIL_ACTUATOR_CONTROLS of the present step once received, or the previous one if it is late."""
        self.newest: HilActuatorControls | None = None
        """Answer to any step, of a vehicle that is late; see `ActuatorInbox.newest` for the others."""
        self.silent_since_s: float | None = None
        """Wall time of the first step that continued without an answer of a vehicle that may be late."""
        self.late_answers = 0
        """Steps that continued with its previous controls."""

    @property
    def alive(self) -> bool:
        """Whether the vehicle is still in the run."""
        return self.link is not None

    def take(self, data: bytes, time_us: int) -> list[Message]:
        """Parse the next bytes: store the answer to the sensors of ``time_us``, return the other messages."""
        others: list[Message] = []
        for message in self.parser.push(data):
            if not isinstance(message, HilActuatorControls):
                others.append(message)
            elif message.time_usec == time_us:  # a late answer to an earlier step does not count
                self.answer = self.newest = message
                self.silent_since_s = None
            elif self.policy.late_after_s is not None and message.time_usec < time_us:
                self.newest = message
                self.silent_since_s = None
        return others


class ArduPilotSlot(VehicleSlot):
    """The slot of an ArduPilot, which answers each state by one servo packet."""

    def __init__(self, instance: int, mavlink: ArduPilotLink) -> None:
        super().__init__(instance)
        self._mavlink = mavlink

    def take(self, data: bytes, time_us: int) -> list[Message]:
        """Unpack the answer to the state of ``time_us``; return the messages of the MAVLink link."""
        packet = servo_packet(data)
        if packet is not None:
            self.answer = packet.answer(time_us)
        return self._mavlink.messages()


class ConnectTimeout(TimeoutError):
    """Not every vehicle connected in time; the text names those that did not."""


class Lockstep:
    """The slots of all vehicles.

    ``on_message(instance, message)`` is called for every message except answers; ``on_silent(instance,
    wall_silence_s)`` once per silence; ``on_lost(instance, reason)`` when a vehicle is removed from the run.
    ``policies`` has one policy per vehicle, by default `OWN`. Each vehicle has either a link from the start
    (``links``: an inherited socket, or a vehicle in this process), a TCP listener at which it arrives, or,
    if it is an ArduPilot, one of ``ardupilots``, which own their listeners. ``guard`` decides which
    connections may be vehicles. ``rotors`` is the greatest number of rotors of a vehicle.
    """

    def __init__(
        self,
        listeners: Mapping[int, socket.socket] = _NONE,
        *,
        watchdog: ResponseWatchdog,
        on_message: Callable[[int, Message], None],
        on_silent: Callable[[int, float], None],
        on_lost: Callable[[int, str], None],
        policies: Sequence[LockstepPolicy] = (),
        links: Mapping[int, Link] = _NONE,
        ardupilots: Mapping[int, ArduPilotLink] = _NONE,
        guard: Guard = UNGUARDED,
        rotors: int = 4,
    ) -> None:
        vehicles = len({*links, *listeners, *ardupilots})
        self.slots = [
            ArduPilotSlot(i, ardupilots[i])
            if i in ardupilots
            else VehicleSlot(i, policies[i] if policies else OWN, links.get(i))
            for i in range(vehicles)
        ]
        for link in links.values():
            if isinstance(link, socket.socket):
                _limit_waits(link)
        self.living = len(links)
        """How many vehicles are in the run."""
        self._listeners = list(listeners.values())
        self._ardupilots = list(ardupilots.values())
        self._handshake = Handshake(listeners, ardupilots, guard=guard)
        self._watchdog = watchdog
        self._on_message, self._on_silent, self._on_lost = on_message, on_silent, on_lost
        self._inbox = ActuatorInbox(vehicles, rotors)
        self._inbox.states["needs_parser"] = [
            slot.policy != OWN or slot.instance in ardupilots for slot in self.slots
        ]
        self._pending: list[VehicleSlot] = []
        """Slots whose answers to this step's sensors are awaited."""
        self._starting: list[VehicleSlot] = []
        """Slots that were sent this step's sensors, but whose answers are not awaited."""
        self._late_tolerant = [slot for slot in self.slots if slot.policy.late_after_s is not None]
        self._wall_sent_s = self._wall_before_s = 0.0

    @property
    def late_answers(self) -> dict[int, int]:
        """Number of steps that continued without an answer, by vehicle, for vehicles that may be late."""
        return {slot.instance: slot.late_answers for slot in self._late_tolerant}

    def connect(self, wall_timeout_s: float, *, keep_waiting: Callable[[], bool]) -> None:
        """Wait until every vehicle has connected. Raises ConnectTimeout.

        Returns early if ``keep_waiting`` returns False; the next call waits for the missing vehicles.
        """
        handshake = self._handshake
        wall_deadline_s = time.monotonic() + wall_timeout_s
        while handshake.missing and keep_waiting():
            for arrival in handshake.poll(POLL_S):
                self._assign(arrival)
            if time.monotonic() > wall_deadline_s and handshake.missing:
                absent = ", ".join(map(str, handshake.missing))
                raise ConnectTimeout(f"no connection from uav {absent} within {wall_timeout_s:g} s")
        if not handshake.missing:
            handshake.close()

    def _assign(self, arrival: Arrival | ArduPilotArrival) -> None:
        slot = self.slots[arrival.instance]
        if isinstance(arrival, ArduPilotArrival):
            _limit_waits(arrival.link.states)
            slot.link = arrival.link
            self.living += 1
            return
        connection = arrival.connection
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _limit_waits(connection)
        if slot.policy.late_after_s is not None:
            # steps continue without it, so it may leave megabytes unread, which must not block the others
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _POLL_TIMEVAL)
        slot.link, slot.parser = connection, arrival.parser
        self.living += 1
        for message in arrival.messages[1:]:  # the first only identified the vehicle
            self._on_message(slot.instance, message)

    def is_starting(self, slot: VehicleSlot) -> bool:
        """Whether a vehicle has not given its first answer yet, so that steps do not wait for it."""
        return slot.policy.starts_silent and not self._has_answered(slot)

    def send(self, frames: Sequence[bytes | memoryview]) -> None:
        """Send every living vehicle its sensors."""
        if self._starting:
            time.sleep(max(0.0, self._wall_sent_s + STARTING_STEP_S - time.monotonic()))
            self._starting.clear()
        self._pending.clear()
        for slot, frame in zip(self.slots, frames, strict=True):
            if slot.link is None:
                continue
            try:
                slot.link.sendall(frame)
            except BlockingIOError:
                self.lose(slot.instance, "it does not read its sensors any more")
                continue
            except (BrokenPipeError, ConnectionResetError):
                pass  # closed by the vehicle: `receive` reads its last messages and reports it
            except OSError as error:
                _check_lost(error)
                self.lose(slot.instance, "its connection broke")
                continue
            (self._starting if self.is_starting(slot) else self._pending).append(slot)
        self._wall_sent_s = time.monotonic()
        if self._late_tolerant:
            self._begin_tolerant()
        else:
            self._watchdog.begin(self._wall_sent_s)

    def _begin_tolerant(self) -> None:
        """Begin the wait of a step in which some silences may have lasted for several steps."""
        wall_s, before_s = self._wall_sent_s, self._wall_before_s
        if wall_s - before_s > BREAK_S:
            for slot in self._late_tolerant:
                slot.silent_since_s = None
        self._wall_before_s = wall_s
        since_s = {
            slot.instance: slot.silent_since_s
            for slot in self._late_tolerant
            if slot.silent_since_s is not None
        }
        self._watchdog.begin(self._wall_sent_s, silent_since_s=since_s)

    def receive(self, time_us: int) -> ActuatorInbox:
        """Wait until every vehicle has answered the sensors of ``time_us`` that were sent, or is lost.

        The vehicles are awaited one by one, the last first: as they are served in turn, the answers of the
        others have arrived by then, so this process is woken once instead of once per vehicle.
        """
        inbox, pending = self._inbox, self._pending
        received_bytes = inbox.states["received_bytes"]
        for slot in reversed(pending):
            try:
                size = slot.link.recv_into(inbox.buffers[slot.instance]) if slot.link else 0
            except BlockingIOError:
                break  # a vehicle is silent: all are polled below
            except OSError as error:
                _check_lost(error)
                size = 0
            if size == 0:
                self.lose(slot.instance, CLOSED)
            received_bytes[slot.instance] = size
        if inbox.unpack(time_us) < len(pending):
            self._await_remaining(time_us)
        if self._starting:
            self._poll_starting(time_us)
        return inbox

    def _await_remaining(self, time_us: int) -> None:
        """Wait for the answers of the step that the inbox could not unpack."""
        inbox = self._inbox
        needs_parser = inbox.states["needs_parser"]
        slots = [slot for slot in self._pending if not inbox.answered_us[slot.instance]]
        for slot in slots:
            slot.answer = None
            if not needs_parser[slot.instance]:
                slot.newest = inbox.newest(slot.instance)
            self._take(slot, inbox.take_bytes(slot.instance), time_us)
        for slot in reversed(slots):
            while slot.link is not None and slot.answer is None:
                if not self._receive(slot, time_us):
                    self._poll_all(slots, time_us)
        for slot in slots:
            if slot.answer is not None:
                inbox.put(slot.instance, slot.answer)
                # of a late vehicle the parser reads all answers until one is in time
                needs_parser[slot.instance] = slot.answer.time_usec != time_us

    def check(self, instances: Iterable[int]) -> None:
        """Apply the watchdog to vehicles whose radio batches are missing, though they have answered."""
        for slot in (self.slots[instance] for instance in instances):
            if slot.alive:
                self._check(slot)

    def lose(self, instance: int, reason: str) -> None:
        """Remove a vehicle from the run."""
        slot = self.slots[instance]
        if slot.link is not None:
            slot.link.close()
            slot.link = None
            slot.answer = None
            self.living -= 1
            self._on_lost(instance, reason)

    def close(self) -> None:
        """Close every connection and listener; the vehicles end when their connection closes."""
        with contextlib.ExitStack() as stack:  # closes all, even if one cannot be closed
            for listener in self._listeners:
                stack.callback(listener.close)
            for ardupilot in self._ardupilots:
                stack.callback(ardupilot.close)
            stack.callback(self._handshake.close)
            for slot in self.slots:
                if slot.link is not None:
                    stack.callback(slot.link.close)
                    slot.link = None
        self.living = 0

    def _receive(self, slot: VehicleSlot, time_us: int, flags: int = 0) -> bool:
        """Receive and parse bytes of a vehicle, waiting `POLL_S` at most; False if there were none."""
        if slot.link is None:
            return False
        try:
            data = slot.link.recv(_RECEIVE_BYTES, flags)
        except BlockingIOError:
            return False
        except OSError as error:
            _check_lost(error)
            data = b""
        if not data:
            self.lose(slot.instance, CLOSED)
            return True
        self._take(slot, data, time_us)
        return True

    def _take(self, slot: VehicleSlot, data: bytes, time_us: int) -> None:
        for message in slot.take(data, time_us):
            self._on_message(slot.instance, message)

    def _poll_all(self, slots: Iterable[VehicleSlot], time_us: int) -> None:
        """While a vehicle is silent: receive from the others, and check those that have not answered."""
        for slot in slots:
            while slot.link is not None and slot.answer is None:
                if not self._receive(slot, time_us, socket.MSG_DONTWAIT):
                    self._check(slot)
                    break

    def _poll_starting(self, time_us: int) -> None:
        """Receive from starting vehicles without waiting; one that never answers is given up."""
        for slot in self._starting:
            while self._receive(slot, time_us, socket.MSG_DONTWAIT):
                pass
            if slot.newest is not None:
                self._inbox.put(slot.instance, slot.newest)
            if self.is_starting(slot):
                slot.silent_since_s = slot.silent_since_s or self._wall_sent_s
                if self._wall_sent_s - slot.silent_since_s > STARTING_LIMIT_S:
                    self.lose(slot.instance, f"it gave no answer in its first {STARTING_LIMIT_S:g} s")

    def _has_answered(self, slot: VehicleSlot) -> bool:
        """Whether a vehicle has ever answered."""
        return bool(self._inbox.states["newest_us"][slot.instance])

    def _check(self, slot: VehicleSlot) -> None:
        wall_s = time.monotonic()
        finding = self._watchdog.check(slot.instance, wall_s, starting=not self._has_answered(slot))
        if finding.newly_silent:
            self._on_silent(slot.instance, finding.wall_silence_s)
        if finding.give_up is not None:
            self.lose(slot.instance, finding.give_up)
            return
        late_after_s = slot.policy.late_after_s
        if late_after_s is not None and wall_s - self._wall_sent_s >= late_after_s:
            slot.answer = slot.newest  # exists: slots without one are not awaited
            slot.late_answers += 1
            slot.silent_since_s = slot.silent_since_s or self._wall_sent_s
