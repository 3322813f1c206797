"""The step's rendezvous with the vehicles.

Everyone gets the sensors of an instant, everyone's answer is waited for.

An edge: owns the TCP connections of PX4's simulator API and the wall-clock patience with a vehicle that
stays silent. What a silence means is told from outside by `harness.patience`.
"""

import selectors
import socket
import struct
import time
from collections.abc import Callable, Iterable, Sequence

from autopilot.mavlink.codec import Message
from autopilot.mavlink.hil import HilActuatorControls, HilParser
from harness.patience import Patience

POLL_S = 0.1
_RECEIVE_BYTES = 4096
_POLL_TIMEVAL = struct.pack("ll", 0, round(POLL_S * 1e6))


CLOSED = "its connection closed"
"""Reason of the loss of a vehicle that ended."""


class Voice:
    """What one vehicle says to the simulator."""

    def __init__(self, instance: int) -> None:
        self.instance = instance
        self.parser = HilParser(HilActuatorControls)
        self.answer: HilActuatorControls | None = None
        """HIL_ACTUATOR_CONTROLS of the present step, once it is there."""
        self.answered_ever = False

    def take(self, data: bytes, time_us: int) -> list[Message]:
        """Take in the next bytes: keep the answer to the sensors of ``time_us``, return all but answers."""
        others: list[Message] = []
        for message in self.parser.push(data):
            if not isinstance(message, HilActuatorControls):
                others.append(message)
            elif message.time_usec == time_us:  # a late answer to an earlier step is none to this
                self.answer = message
                self.answered_ever = True
        return others


class Seat(Voice):
    """One vehicle's place at the simulator: its connection and what it last said of itself."""

    def __init__(self, instance: int) -> None:
        super().__init__(instance)
        self.connection: socket.socket | None = None

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
    """

    def __init__(
        self,
        listeners: Sequence[socket.socket],
        *,
        patience: Patience,
        on_message: Callable[[int, Message], None],
        on_silent: Callable[[int, float], None],
        on_lost: Callable[[int, str], None],
    ) -> None:
        self.seats = [Seat(i) for i in range(len(listeners))]
        self._listeners = list(listeners)
        self._patience = patience
        self._on_message, self._on_silent, self._on_lost = on_message, on_silent, on_lost
        self._pending: list[Seat] = []
        """Seats that were sent this step's sensors."""

    @property
    def living(self) -> int:
        """How many vehicles are in the run."""
        return sum(seat.connection is not None for seat in self.seats)

    def connect(self, wall_timeout_s: float, *, keep_waiting: Callable[[], bool]) -> None:
        """Wait until every vehicle has connected. Raises ConnectTimeout.

        Returns early if told not to keep waiting; called again it waits for those who are missing.
        """
        waiting = selectors.DefaultSelector()
        for instance, listener in enumerate(self._listeners):
            if not self.seats[instance].alive:
                waiting.register(listener, selectors.EVENT_READ, instance)
        wall_deadline_s = time.monotonic() + wall_timeout_s
        while waiting.get_map() and keep_waiting():
            for key, _ in waiting.select(POLL_S):
                connection, _ = self._listeners[key.data].accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                # the kernel's time limit, for Python's own costs a system call more each time
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _POLL_TIMEVAL)
                self.seats[key.data].connection = connection
                waiting.unregister(key.fileobj)
            if time.monotonic() > wall_deadline_s:
                absent = ", ".join(str(seat.instance) for seat in self.seats if not seat.alive)
                raise ConnectTimeout(f"no connection from uav {absent} within {wall_timeout_s:g} s")
        waiting.close()

    def send(self, frames: Iterable[bytes | None]) -> None:
        """Send every living vehicle its sensors.

        Each frame is asked for when it is that vehicle's turn, so the first computes while others' are made.
        """
        self._pending.clear()
        for seat, frame in zip(self.seats, frames, strict=True):
            seat.answer = None
            if seat.connection is None or frame is None:
                continue
            try:
                seat.connection.sendall(frame)
                self._pending.append(seat)
            except OSError:
                self.lose(seat.instance, "its connection broke")
        self._patience.begin(time.monotonic())

    def answers(self, time_us: int) -> list[HilActuatorControls | None]:
        """Wait until every vehicle has answered the sensors of ``time_us`` that were sent; None: it is gone.

        They are waited for one by one, the last first: as they are served in turn, the others' answers are
        there by then, and this process is woken once instead of for each.
        """
        for seat in reversed(self._pending):
            while seat.connection is not None and seat.answer is None:
                if not self._receive(seat, time_us):
                    self._look_around(time_us)
        return [seat.answer for seat in self.seats]

    def judge(self, instances: Iterable[int]) -> None:
        """Decide on vehicles that have not done their part of the step, be it elsewhere than here."""
        for instance in instances:
            if self.seats[instance].alive:
                self._judge(self.seats[instance])

    def lose(self, instance: int, reason: str) -> None:
        """Take a vehicle out of the run."""
        seat = self.seats[instance]
        if seat.connection is not None:
            seat.connection.close()
            seat.connection = None
            seat.answer = None
            self._on_lost(instance, reason)

    def close(self) -> None:
        """Close every connection and listener; the vehicles end when they notice."""
        for seat in self.seats:
            if seat.connection is not None:
                seat.connection.close()
                seat.connection = None
        for listener in self._listeners:
            listener.close()

    def _receive(self, seat: Seat, time_us: int, flags: int = 0) -> bool:
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
        for message in seat.take(data, time_us):
            self._on_message(seat.instance, message)
        return True

    def _look_around(self, time_us: int) -> None:
        """Somebody is silent: take what the others have said, and judge whoever has not answered."""
        for seat in self._pending:
            while seat.connection is not None and seat.answer is None:
                if not self._receive(seat, time_us, socket.MSG_DONTWAIT):
                    self._judge(seat)
                    break

    def _judge(self, seat: Seat) -> None:
        verdict = self._patience.judge(seat.instance, time.monotonic(), starting=not seat.answered_ever)
        if verdict.newly_silent:
            self._on_silent(seat.instance, verdict.wall_silence_s)
        if verdict.give_up is not None:
            self.lose(seat.instance, verdict.give_up)
