"""Links to the on-board applications beside PX4s: requests for the iterations of their loops.

An iteration is requested with the sensors of its step and awaited after the vehicles' answers, so that the
applications compute in parallel with the autopilots. An I/O module: owns one stream socket per application,
which the launcher has created. `harness.simulator.response_watchdog` decides when a silent application is
given up.
"""

import contextlib
import socket
import time
from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType

from autopilot.mavlink.codec import Message, Parser
from autopilot.process.iteration import Iterate, Iterated
from foundation.processes.message_stream import MessageStream
from harness.simulator.response_watchdog import ResponseWatchdog

POLL_S = 0.25
"""Wall time after which a silent application is checked, again and again."""
CLOSED = "its process ended"
NO_READINGS: Mapping[int, bytes] = MappingProxyType({})


class ApplicationLinks:
    """The applications by vehicle.

    ``period_us`` is the period of their loops, ``on_message(instance, message)`` receives their reports,
    ``on_silent(instance, wall_silence_s)`` is called once per silence, and ``on_lost(instance, reason)`` when
    an application is given up. Its vehicle stays in the run.
    """

    def __init__(
        self,
        connections: Mapping[int, socket.socket],
        *,
        period_us: int,
        watchdog: ResponseWatchdog,
        on_message: Callable[[int, Message], None],
        on_silent: Callable[[int, float], None],
        on_lost: Callable[[int, str], None],
    ) -> None:
        self._lines: dict[int, MessageStream[Iterate, Iterated]] = {
            instance: MessageStream(connection, Iterated, limit_s=POLL_S)
            for instance, connection in connections.items()
        }
        self._connections = connections
        self._period_us = period_us
        self._watchdog = watchdog
        self._on_message, self._on_silent, self._on_lost = on_message, on_silent, on_lost
        self._released_us: dict[int, int] = {}
        """Release time of the newest batch for each application that has not been announced yet."""
        self._readings: dict[int, bytes] = {}
        """Frames of sensors for each application that have arrived since its last request."""
        self._pending: list[int] = []
        """Applications whose iteration has been requested and not awaited."""

    def begin(
        self,
        time_us: int,
        delivered: Collection[int],
        lost: Collection[int],
        readings: Mapping[int, bytes] = NO_READINGS,
    ) -> None:
        """Request the iterations that begin at ``time_us``, if any do.

        ``delivered`` are the vehicles whose radio has a delivery for this step, ``lost`` those that are no
        longer in the run, whose applications rest, ``readings`` the frames of sensors by vehicle.
        """
        for instance, frames in readings.items():
            if instance in self._lines:
                self._readings[instance] = self._readings.get(instance, b"") + frames
        for instance in delivered:
            if instance in self._lines:
                self._released_us[instance] = time_us
        if time_us % self._period_us:
            return
        self._pending = [instance for instance in self._lines if instance not in lost]
        for instance in self._pending:
            released_us = self._released_us.pop(instance, 0)
            measured = self._readings.pop(instance, b"")
            self._lines[instance].send(Iterate(time_us=time_us, released_us=released_us, readings=measured))

    def finish(self, lost: Collection[int]) -> tuple[int, ...]:
        """Wait for the requested iterations; return the vehicles whose application sends a batch.

        Vehicles ``lost`` since the request are not waited for: their applications may have ended with them.
        """
        if not self._pending:
            return ()
        self._watchdog.begin(time.monotonic())
        senders = []
        for instance in self._pending:
            result = None if instance in lost else self._await(instance)
            if result is None:
                continue
            if result.handed_over:
                senders.append(instance)
            for message in Parser().push_datagram(result.reports) if result.reports else ():
                self._on_message(instance, message)
        self._pending.clear()
        return tuple(senders)

    def _await(self, instance: int) -> Iterated | None:
        """Return the result of an iteration; None if the application is lost."""
        while True:
            with contextlib.suppress(TimeoutError):
                result = self._lines[instance].receive()
                if result is None:
                    self._lose(instance, CLOSED)
                return result
            self._check(instance)
            if instance not in self._lines:
                return None

    def check(self, instances: Collection[int]) -> tuple[int, ...]:
        """Apply the watchdog to applications whose batches are missing; return those that are lost."""
        for instance in instances:
            if instance in self._lines:
                self._check(instance)
        return tuple(instance for instance in instances if instance not in self._lines)

    def _check(self, instance: int) -> None:
        finding = self._watchdog.check(instance, time.monotonic(), starting=False)
        if finding.newly_silent:
            self._on_silent(instance, finding.wall_silence_s)
        if finding.give_up is not None:
            self._lose(instance, finding.give_up)

    def _lose(self, instance: int, reason: str) -> None:
        del self._lines[instance]
        self._connections[instance].close()
        self._on_lost(instance, reason)

    def close(self) -> None:
        """Close the sockets; the applications then wait for their stop."""
        for connection in self._connections.values():
            connection.close()
