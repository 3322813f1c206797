"""The step's rendezvous with the vehicles.

Everyone gets the sensors of an instant, everyone's answer is waited for, as far as its `LockstepPolicy` let
it be.

An edge: owns the connections of PX4's simulator API and the wall-clock patience with a vehicle that stays
silent. What a silence means is told from outside by `harness.simulator.response_watchdog`, and who may take a
seat is `harness.simulator.handshake`'s.
"""

import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import HilActuatorControls, HilParser
from harness.simulator.actuator_inbox import ActuatorInbox
from harness.simulator.handshake import Arrival, Handshake, Listener
from harness.simulator.response_watchdog import STARTING_LIMIT_S, ResponseWatchdog

POLL_S = 0.1
FREE_STEP_S = 0.004
"""Wall time of a step, at least, while a vehicle that starts has not answered yet: a PX4 takes sensors from
the first on, but starts up by its own time, and drops some of those that come faster."""
BREAK_S = 2.0
"""Wall time between two steps from which the simulation is said to have stood: nobody can answer then."""
_RECEIVE_BYTES = 4096
_POLL_TIMEVAL = struct.pack("ll", 0, round(POLL_S * 1e6))


CLOSED = "its connection closed"
"""Reason of the loss of a vehicle that ended."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LockstepPolicy:
    """What is to be expected of a sort of vehicle at its simulator's link."""

    starts_silent: bool = False
    """It takes sensors for a while before its first answer: until then nobody waits for it."""
    late_after_s: float | None = None
    """Wall time after which a step goes on with its controls of before; None: as long as patience lasts."""


OWN = LockstepPolicy()
"""coflight's own vehicles: one answer to each HIL_SENSOR, from the first on."""
PX4 = LockstepPolicy(starts_silent=True, late_after_s=0.3)
"""A real PX4: silent for its first 13 to 54 steps; under load an answer takes 0.2 s now and then, and after
one that was lost there are others only if sensors go on."""


class ConnectionState:
    """Bytes from one vehicle that `actuator_inbox` does not take at once."""

    def __init__(self, instance: int, manners: LockstepPolicy = OWN) -> None:
        self.instance = instance
        self.manners = manners
        self.parser = HilParser(HilActuatorControls)
        self.answer: HilActuatorControls | None = None
        """HIL_ACTUATOR_CONTROLS of the present step, once it is there, or what stands for it."""
        self.newest: HilActuatorControls | None = None
        """Of any step; kept of vehicles that may be late."""
        self.silent_since_s: float | None = None
        """Wall time since which a vehicle that may be late has not answered, if steps went on without it."""

    def await_answer(self) -> None:
        """Begin a step, to which it has not answered yet."""
        self.answer = None

    def take(self, data: bytes, time_us: int) -> list[Message]:
        """Take in the next bytes: keep the answer to the sensors of ``time_us``, return all but answers."""
        others: list[Message] = []
        for message in self.parser.push(data):
            if not isinstance(message, HilActuatorControls):
                others.append(message)
            elif message.time_usec == time_us:  # a late answer to an earlier step is none to this
                self._heed(message)
            elif self.manners.late_after_s is not None and message.time_usec < time_us:
                self.newest = message
                self.silent_since_s = None
        return others

    def _heed(self, answer: HilActuatorControls) -> None:
        """Take the answer of the present step."""
        self.answer = self.newest = answer
        self.silent_since_s = None


class VehicleSlot(ConnectionState):
    """One vehicle's place at the simulator: its connection and what it last said of itself."""

    def __init__(self, instance: int, manners: LockstepPolicy) -> None:
        super().__init__(instance, manners)
        self.connection: socket.socket | None = None
        self.late_answers = 0
        """Steps that went on with its controls of before."""

    @property
    def alive(self) -> bool:
        """Whether the vehicle is still in the run."""
        return self.connection is not None


class ConnectTimeout(TimeoutError):
    """Not every vehicle connected in time; the text names those that did not."""


class Lockstep:
    """All vehicles' seats.

    ``on_message(instance, message)`` is called for everything but the answers; ``on_silent(instance,
    wall_silence_s)`` once per silence; ``on_lost(instance, reason)`` when a vehicle leaves for good.
    ``manners`` are the vehicles', own ones' if not given. ``listeners`` are one for each seat, TCP;
    ``own_listener`` is a Unix socket at which all own vehicles may come as well.
    """

    def __init__(
        self,
        listeners: Sequence[socket.socket],
        *,
        patience: ResponseWatchdog,
        on_message: Callable[[int, Message], None],
        on_silent: Callable[[int, float], None],
        on_lost: Callable[[int, str], None],
        manners: Sequence[LockstepPolicy] = (),
        own_listener: socket.socket | None = None,
    ) -> None:
        manners = manners or [OWN] * len(listeners)
        self.seats = [VehicleSlot(i, manners[i]) for i in range(len(listeners))]
        self.living = 0
        """How many vehicles are in the run."""
        doors = [Listener(listener, frozenset((i,))) for i, listener in enumerate(listeners)]
        if own_listener is not None:
            own = frozenset(seat.instance for seat in self.seats if seat.manners == OWN)
            doors.append(Listener(own_listener, own))
        self._listeners = [door.listener for door in doors]
        self._reception = Handshake(doors)
        self._patience = patience
        self._on_message, self._on_silent, self._on_lost = on_message, on_silent, on_lost
        self._answers = ActuatorInbox(len(listeners))
        self._answers.voices["by_hand"] = [seat.manners != OWN for seat in self.seats]
        self._pending: list[VehicleSlot] = []
        """Seats that were sent this step's sensors and are waited for."""
        self._free: list[VehicleSlot] = []
        """Those that were sent them and are not."""
        self._tolerated = [seat for seat in self.seats if seat.manners.late_after_s is not None]
        self._wall_sent_s = self._wall_before_s = 0.0
        self._overheard: deque[tuple[int, Message]] = deque()

    @property
    def late_answers(self) -> dict[int, int]:
        """How many steps went on without the answer of whom, of vehicles that may be late."""
        return {seat.instance: seat.late_answers for seat in self._tolerated}

    def connect(self, wall_timeout_s: float, *, keep_waiting: Callable[[], bool]) -> None:
        """Wait until every vehicle has connected. Raises ConnectTimeout.

        Returns early if told not to keep waiting; called again it waits for those who are missing.
        """
        reception = self._reception
        wall_deadline_s = time.monotonic() + wall_timeout_s
        while reception.waiting_for and keep_waiting():
            for arrival in reception.look(POLL_S):
                self._seat(arrival)
            if time.monotonic() > wall_deadline_s and reception.waiting_for:
                absent = ", ".join(map(str, reception.waiting_for))
                raise ConnectTimeout(f"no connection from uav {absent} within {wall_timeout_s:g} s")
        if not reception.waiting_for:
            reception.close()

    def _seat(self, arrival: Arrival) -> None:
        connection, seat = arrival.connection, self.seats[arrival.instance]
        if connection.family == socket.AF_INET:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # the kernel's time limit, for Python's own costs a system call more each time
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _POLL_TIMEVAL)
        if seat.manners.late_after_s is not None:
            # steps go on without it, so it may leave megabytes unread, and must not hold up the others then
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _POLL_TIMEVAL)
        seat.connection, seat.parser = connection, arrival.parser
        self.living += 1
        for message in arrival.said[1:]:  # the first was its introduction, which is no news of a flight
            self._on_message(seat.instance, message)

    def overhear(self, instance: int, message: Message) -> None:
        """Take what a vehicle's parts say by another way; from any thread. Passed on with the answers."""
        self._overheard.append((instance, message))

    def is_free(self, seat: VehicleSlot) -> bool:
        """Whether a vehicle starts and has not answered yet, so that nobody waits for it."""
        return seat.manners.starts_silent and not self._has_answered(seat)

    def send(self, frames: Sequence[bytes | memoryview]) -> None:
        """Send every living vehicle its sensors."""
        if self._free:
            time.sleep(max(0.0, self._wall_sent_s + FREE_STEP_S - time.monotonic()))
            self._free.clear()
        self._pending.clear()
        for seat, frame in zip(self.seats, frames, strict=True):
            if seat.connection is None:
                continue
            try:
                seat.connection.sendall(frame)
            except BlockingIOError:
                self.lose(seat.instance, "it takes no sensors any more")
                continue
            except (BrokenPipeError, ConnectionResetError):
                pass  # it has hung up, which is found where its last words are read
            except OSError:
                self.lose(seat.instance, "its connection broke")
                continue
            (self._free if self.is_free(seat) else self._pending).append(seat)
        self._wall_sent_s = time.monotonic()
        if self._tolerated:
            self._begin_tolerant()
        else:
            self._patience.begin(self._wall_sent_s)

    def _begin_tolerant(self) -> None:
        """Begin the wait where silences may last for several steps."""
        wall_s, before_s = self._wall_sent_s, self._wall_before_s
        if wall_s - before_s > BREAK_S:
            for seat in self._tolerated:
                seat.silent_since_s = None
        self._wall_before_s = wall_s
        since_s = {
            seat.instance: seat.silent_since_s for seat in self._tolerated if seat.silent_since_s is not None
        }
        self._patience.begin(self._wall_sent_s, silent_since_s=since_s)

    def answers(self, time_us: int) -> ActuatorInbox:
        """Wait until every vehicle has answered the sensors of ``time_us`` that were sent, or is gone.

        They are waited for one by one, the last first: as they are served in turn, the others' answers are
        there by then, and this process is woken once instead of for each. Who is late answers as before.
        """
        answers, pending = self._answers, self._pending
        heard_bytes = answers.voices["heard_bytes"]
        for seat in reversed(pending):
            try:
                size = seat.connection.recv_into(answers.rooms[seat.instance]) if seat.connection else 0
            except BlockingIOError:
                break  # somebody is silent: it is looked around below
            except OSError:
                size = 0
            if size == 0:
                self.lose(seat.instance, CLOSED)
            heard_bytes[seat.instance] = size
        if answers.take(time_us) < len(pending):
            self._hear_out(time_us)
        if self._free:
            self._hear_the_free(time_us)
        while self._overheard:
            self._on_message(*self._overheard.popleft())
        return answers

    def _hear_out(self, time_us: int) -> None:
        """Have the answers of the step that could not be taken at once."""
        answers = self._answers
        seats = [seat for seat in self._pending if not answers.answered_us[seat.instance]]
        for seat in seats:
            seat.await_answer()
            self._take(seat, answers.said(seat.instance), time_us)
        for seat in reversed(seats):
            while seat.connection is not None and seat.answer is None:
                if not self._receive(seat, time_us):
                    self._look_around(seats, time_us)
        for seat in seats:
            if seat.answer is not None:
                answers.put(seat.instance, seat.answer)

    def judge(self, instances: Iterable[int]) -> None:
        """Decide on vehicles whose radio batches have not come, though they have answered."""
        for seat in (self.seats[instance] for instance in instances):
            if seat.alive:
                self._judge(seat)

    def lose(self, instance: int, reason: str) -> None:
        """Take a vehicle out of the run."""
        seat = self.seats[instance]
        if seat.connection is not None:
            seat.connection.close()
            seat.connection = None
            seat.answer = None
            self.living -= 1
            self._on_lost(instance, reason)

    def close(self) -> None:
        """Close every connection and listener; the vehicles end when they notice."""
        for seat in self.seats:
            if seat.connection is not None:
                seat.connection.close()
                seat.connection = None
        self.living = 0
        self._reception.close()
        for listener in self._listeners:
            listener.close()

    def _receive(self, seat: VehicleSlot, time_us: int, flags: int = 0) -> bool:
        """Take what a vehicle has said, waiting `POLL_S` at most; False if that was nothing."""
        if seat.connection is None:
            return False
        try:
            data = seat.connection.recv(_RECEIVE_BYTES, flags)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if not data:
            self.lose(seat.instance, CLOSED)
            return True
        self._take(seat, data, time_us)
        return True

    def _take(self, seat: VehicleSlot, data: bytes, time_us: int) -> None:
        for message in seat.take(data, time_us):
            self._on_message(seat.instance, message)

    def _look_around(self, seats: Iterable[VehicleSlot], time_us: int) -> None:
        """Somebody is silent: take what the others have said, and judge whoever has not answered."""
        for seat in seats:
            while seat.connection is not None and seat.answer is None:
                if not self._receive(seat, time_us, socket.MSG_DONTWAIT):
                    self._judge(seat)
                    break

    def _hear_the_free(self, time_us: int) -> None:
        """Take what those have said that nobody waits for; one that never says anything is given up."""
        for seat in self._free:
            while self._receive(seat, time_us, socket.MSG_DONTWAIT):
                pass
            if seat.newest is not None:
                self._answers.put(seat.instance, seat.newest)
            if self.is_free(seat):
                seat.silent_since_s = seat.silent_since_s or self._wall_sent_s
                if self._wall_sent_s - seat.silent_since_s > STARTING_LIMIT_S:
                    self.lose(seat.instance, f"it gave no answer in its first {STARTING_LIMIT_S:g} s")

    def _has_answered(self, seat: VehicleSlot) -> bool:
        """Whether it has ever."""
        return bool(self._answers.voices["ever"][seat.instance])

    def _judge(self, seat: VehicleSlot) -> None:
        wall_s = time.monotonic()
        verdict = self._patience.judge(seat.instance, wall_s, starting=not self._has_answered(seat))
        if verdict.newly_silent:
            self._on_silent(seat.instance, verdict.wall_silence_s)
        if verdict.give_up is not None:
            self.lose(seat.instance, verdict.give_up)
            return
        late_after_s = seat.manners.late_after_s
        if late_after_s is not None and wall_s - self._wall_sent_s >= late_after_s:
            seat.answer = seat.newest  # there is one, or nobody would wait
            seat.late_answers += 1
            seat.silent_since_s = seat.silent_since_s or self._wall_sent_s
