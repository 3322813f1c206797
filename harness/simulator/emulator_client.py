"""Client of the 802.11 emulator in the time master: requests intervals of simulated time."""

from collections import deque
from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple, Protocol

import msgspec

from harness.world.physics.truth import Truth
from netsim.wire.lockstep import LEAD_US, Advance, Advanced, pack_rows

MAX_QUIET_US = LEAD_US // 2
"""Longest simulated time without a request. The emulator refuses a vehicle that is `LEAD_US` ahead of it."""


GONE = "the 802.11 emulator is gone"
"""Text of a `RadioSilent` whose cause is the end of the emulator's process."""
UNANSWERED = "the 802.11 emulator does not answer"
"""Begin of the text of any other."""


class RadioSilent(ConnectionError):
    """The 802.11 emulator does not answer the time master."""


class Pace(NamedTuple):
    """How simulated time follows wall time."""

    due_ns: int
    """Wall time, of the monotonic clock, at which a simulated time is due; 0: as soon as possible"""
    speed: float
    """Simulated over wall time"""


UNPACED = Pace(0, 0.0)


class Occupancy(NamedTuple):
    """How long the channel was occupied."""

    until_us: int
    """Simulated time up to which it counts"""
    busy_ns: int
    """Time since the start for which it carried at least one transmission"""


class EmulatorLine(Protocol):
    """Connection to the emulator: see `netsim.transport.interval_stream`."""

    def send(self, message: Advance) -> None:
        """Request an interval."""

    def receive(self) -> Advanced | None:
        """Wait for the answer; None if the emulator is gone. Raises TimeoutError."""


class EmulatorClient:
    """Requests the intervals of the emulated channel and collects their results.

    Intervals are as long as the loop of the on-board applications, ``period_us``. An interval begins when the
    applications have handed over their batches; frames that arrive in it are delivered at its end. The
    emulator runs in parallel with the steps in between. Quiet intervals are skipped, up to `MAX_QUIET_US`.

    ``asynchronous``: some radios belong to hosts outside the lockstep and may transmit at any time. Intervals
    are then as long as a step and none is skipped; deliveries are released ``lead_steps`` after the
    interval's end, so that the steps can be that far ahead of the channel. ``pace`` returns the pace at a
    simulated time, for the packets of programs, which live in wall time.
    """

    def __init__(
        self,
        line: EmulatorLine,
        *,
        period_us: int,
        asynchronous: bool = False,
        lead_steps: int = 1,
        pace: Callable[[int], Pace] = lambda _: UNPACED,
    ) -> None:
        self._period_us = period_us
        self._asynchronous = asynchronous
        self._lead_steps = lead_steps
        self._pace = pace
        self._line = line
        self._requests: deque[Advance] = deque()
        """Requests that the emulator has not answered yet, in their order."""
        self._quiet_until_us = 0
        self._requested_us = 0
        """End of the last interval requested."""
        self._delivered: dict[int, tuple[int, ...]] = {}
        """Vehicles with a delivery, by time of release."""
        self.busy_ns = 0
        """Time for which the channel was occupied until the end of the last completed interval."""
        self._unreleased: deque[tuple[int, Occupancy]] = deque()
        """Of completed intervals: time of release, and the occupancy at their end."""
        self._released = Occupancy(0, 0)

    @property
    def is_busy(self) -> bool:
        """Whether the emulator has yet to complete an interval."""
        return bool(self._requests)

    def is_pending(self, time_us: int) -> bool:
        """Whether the emulator has yet to complete an interval whose deliveries are due at ``time_us``."""
        return bool(self._requests) and self._requests[0].release_us <= time_us

    def occupancy(self, time_us: int) -> Occupancy:
        """Return the occupancy of the channel that is released at ``time_us``, the present time.

        It does not depend on how far ahead of that the emulator is, which it is after a pause.
        """
        if not self._asynchronous:
            return Occupancy(time_us, self.busy_ns)
        while self._unreleased and self._unreleased[0][0] <= time_us:
            _, self._released = self._unreleased.popleft()
        return self._released

    def delivered(self, time_us: int) -> tuple[int, ...]:
        """Return the vehicles whose radio has a delivery for the step of ``time_us``; call once a step."""
        return self._delivered.pop(time_us, ()) if self._delivered else ()

    def begins_at(self, time_us: int) -> bool:
        """Whether an interval begins with the step of ``time_us``."""
        return self._asynchronous or time_us % self._period_us == 0

    def begin(
        self,
        time_us: int,
        step_us: int,
        truth: Truth,
        *,
        extra_attenuation_db: float,
        range_offsets_m: Mapping[int, float],
        senders: tuple[int, ...] = (),
        silent: tuple[int, ...] = (),
    ) -> None:
        """Request the interval that begins at ``time_us``, unless the channel stays quiet until its end.

        The emulator runs in parallel with the physics, so it uses the positions and velocities at the
        interval's begin: an acceleration of 2 m/s2 changes a position by 1.6 mm in 40 ms. ``senders`` are the
        vehicles that handed over a batch in this step; ``silent`` are those that were lost. The attenuation
        is that of every link; ``range_offsets_m`` are added to the ranges that a station measures.
        """
        to_us = time_us + (step_us if self._asynchronous else self._period_us)
        quiet_us = min(self._quiet_until_us, self._requested_us + MAX_QUIET_US)
        if not self._asynchronous and not senders and to_us < quiet_us:
            return
        self._requested_us = to_us
        due_ns, speed = self._pace(to_us)
        request = Advance(
            to_us=to_us,
            release_us=to_us + self._lead_steps * step_us if self._asynchronous else to_us,
            at_us=time_us,
            pos_ned_m=pack_rows(truth.pos_ned_m),
            vel_ned_m_s=pack_rows(truth.vel_ned_m_s),
            q_ned_frd=pack_rows(truth.q_ned_frd),
            senders=senders,
            silent=silent,
            extra_attenuation_db=extra_attenuation_db,
            range_offsets_m=tuple(range_offsets_m.items()),
            due_ns=due_ns,
            speed=speed,
        )
        self._requests.append(request)
        self._line.send(request)

    def end(self) -> tuple[int, ...]:
        """Wait until the emulator has completed the first of the requested intervals, if there is one.

        Returns the vehicles whose batches are missing; continue with `wait_on`. Raises RadioSilent.
        """
        if not self._requests:
            return ()
        try:
            advanced = self._line.receive()
        except TimeoutError:
            raise RadioSilent(UNANSWERED) from None
        if advanced is None:
            raise RadioSilent(GONE)
        if advanced.missing:
            return advanced.missing
        request = self._requests.popleft()
        if self._asynchronous:
            self._unreleased.append((request.release_us, Occupancy(request.to_us, advanced.busy_ns)))
        self._quiet_until_us = advanced.quiet_until_us
        self.busy_ns = advanced.busy_ns
        if advanced.delivered:
            self._delivered[request.release_us] = advanced.delivered
        return ()

    def wait_on(self, silent: tuple[int, ...], without: Collection[int] = ()) -> tuple[int, ...]:
        """After `end`: continue to wait for the missing batches.

        Those of ``silent`` vehicles, whose radios are off, and of vehicles ``without`` their application are
        not waited for.
        """
        if self._requests:
            first = self._requests[0]
            senders = tuple(sender for sender in first.senders if sender not in without)
            self._requests[0] = msgspec.structs.replace(first, silent=silent, senders=senders)
            self._line.send(self._requests[0])
        return self.end()
