"""The step's rendezvous with the vehicles.

Everyone gets the sensors of an instant, everyone's answer is waited for.

An edge: owns the TCP connections of PX4's simulator API and the wall-clock patience with a vehicle that
stays silent. What a silence means is told from outside by `harness.patience`.
"""

import selectors
import socket
import time
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.codec import Message, Parser
from harness.patience import Patience

POLL_S = 0.1
_RECEIVE_BYTES = 65_536


class Seat:
    """One vehicle's place at the simulator: its connection and what it last said of itself."""

    def __init__(self, instance: int) -> None:
        self.instance = instance
        self.connection: socket.socket | None = None
        self.parser = Parser()
        self.answer: Message | None = None
        """HIL_ACTUATOR_CONTROLS of the present step, once it is there."""
        self.answered_ever = False

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
        self._selector = selectors.DefaultSelector()

    def connect(self, wall_timeout_s: float, *, keep_waiting: Callable[[], bool]) -> None:
        """Wait until every vehicle has connected. Raises ConnectTimeout.

        Returns early if told not to keep waiting.
        """
        waiting = selectors.DefaultSelector()
        for instance, listener in enumerate(self._listeners):
            waiting.register(listener, selectors.EVENT_READ, instance)
        wall_deadline_s = time.monotonic() + wall_timeout_s
        while waiting.get_map() and keep_waiting():
            for key, _ in waiting.select(POLL_S):
                connection, _ = self._listeners[key.data].accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.seats[key.data].connection = connection
                self._selector.register(connection, selectors.EVENT_READ, self.seats[key.data])
                waiting.unregister(key.fileobj)
            if time.monotonic() > wall_deadline_s:
                absent = ", ".join(str(seat.instance) for seat in self.seats if not seat.alive)
                raise ConnectTimeout(f"no connection from uav {absent} within {wall_timeout_s:g} s")
        waiting.close()

    def exchange(self, time_us: int, frames: Sequence[bytes | None]) -> list[Message | None]:
        """Send every living vehicle its sensors of ``time_us``.

        Returns each one's answer, None for those that are gone.
        """
        pending: set[int] = set()
        for seat, frame in zip(self.seats, frames, strict=True):
            seat.answer = None
            if seat.connection is None or frame is None:
                continue
            try:
                seat.connection.sendall(frame)
                pending.add(seat.instance)
            except OSError:
                self.lose(seat.instance, "its connection broke")
        self._patience.begin(time.monotonic())
        while pending:
            events = self._selector.select(POLL_S)
            for key, _ in events:
                self._receive(key.data, time_us)
            pending = {i for i in pending if self.seats[i].alive and self.seats[i].answer is None}
            if pending and not events:
                self._judge(pending)
        return [seat.answer for seat in self.seats]

    def lose(self, instance: int, reason: str) -> None:
        """Take a vehicle out of the run."""
        seat = self.seats[instance]
        if seat.connection is not None:
            self._selector.unregister(seat.connection)
            seat.connection.close()
            seat.connection = None
            seat.answer = None
            self._on_lost(instance, reason)

    def close(self) -> None:
        """Close every connection and listener; the vehicles end when they notice."""
        for seat in self.seats:
            if seat.connection is not None:
                self._selector.unregister(seat.connection)
                seat.connection.close()
                seat.connection = None
        for listener in self._listeners:
            listener.close()
        self._selector.close()

    def _receive(self, seat: Seat, time_us: int) -> None:
        if seat.connection is None:
            return
        try:
            data = seat.connection.recv(_RECEIVE_BYTES)
        except OSError:
            data = b""
        if not data:
            self.lose(seat.instance, "its connection closed")
            return
        for message in seat.parser.push(data):
            if message.get_msgId() != mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS:
                self._on_message(seat.instance, message)
            elif message.time_usec == time_us:  # a late answer to an earlier step is none to this
                seat.answer = message
                seat.answered_ever = True

    def _judge(self, pending: set[int]) -> None:
        for instance in sorted(pending):
            verdict = self._patience.judge(
                instance, time.monotonic(), starting=not self.seats[instance].answered_ever
            )
            if verdict.newly_silent:
                self._on_silent(instance, verdict.wall_silence_s)
            if verdict.give_up is not None:
                self.lose(instance, verdict.give_up)
