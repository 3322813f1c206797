"""Which frames follow which: exchanges of RTS, CTS, data and ACK, their failures, and TXOPs of several.

After a success a queue that has a TXOP limit goes on after SIFS, as long as its next exchange as a whole ends
within the limit (10.22.2.8). The Duration field of a frame covers the rest of its own exchange and the one
that is to follow it in the TXOP, as between fragments: others that are not in reach of the answer keep quiet,
and little is reserved in vain if the TXOP breaks off. After a failure it does: the queue backs off.

Group frames after RTS, which the standard does not have: the RTS goes to the neighbour heard loudest within
the last second, the CTS of that neighbour clears the way, and the group frame follows after SIFS; a station
that has heard nobody for a second sends without. No CTS means a collision: the window doubles, and the next
RTS goes to the next loudest, for the first may be gone; after the retry limit the frame is dropped.

At the retry limit the window falls back to its smallest (10.3.3). A frame that expires leaves it as it is.

Left out: fragmentation, power save, aggregation, block acknowledgement, CF-End.
"""

from collections.abc import Mapping
from enum import Enum
from typing import Protocol

from netsim.frames import ACK_BYTES, CTS_BYTES, GROUP, RTS_BYTES, Frame, FrameKind
from netsim.kernel import Event, EventQueue
from netsim.mac.access import SIFS_NS, SLOT_NS, AccessParameters, Contender
from netsim.mac.channel import ChannelAccess
from netsim.mac.jobs import Job, Outcome
from netsim.phy.medium import Medium, Transmission
from netsim.phy.modes import NON_HT_PREAMBLE_NS, PhyMode, response_mode, response_ns
from netsim.phy.sensing import LOCK, NOBODY, RESERVED_BY, RESERVED_UNTIL, SENDING_UNTIL, UNLOCKED, loudest
from netsim.streams import Uniforms

RESPONSE_TIMEOUT_NS = SIFS_NS + SLOT_NS + NON_HT_PREAMBLE_NS
"""From the end of a frame to the moment at which its CTS or ACK must have begun (10.3.2.9)."""
HEARD_WITHIN_NS = 1_000_000_000


class Upper(Protocol):
    """Who gets the frames that are for this station or for everybody."""

    def on_frame(self, transmission: Transmission, power_mw: float, end_ns: int, *, duplicate: bool) -> None:
        """Take a data or action frame; ``end_ns`` is the time at this antenna."""


class Phase(Enum):
    """Where an exchange stands."""

    IDLE = 0
    AWAITING_CTS = 1
    SENDING = 2
    """The frame itself is on the air or follows within SIFS, and nothing is awaited."""
    AWAITING_ACK = 3


class Station(ChannelAccess):
    """MAC of one station."""

    def __init__(
        self,
        *,
        index: int,
        queue: EventQueue,
        medium: Medium,
        access: Mapping[str, AccessParameters],
        control_mode: PhyMode,
        queue_frames: int,
        backoff: Uniforms,
        upper: Upper,
    ) -> None:
        super().__init__(
            queue=queue,
            receiver=medium.receivers[index],
            access=access,
            queue_frames=queue_frames,
            backoff=backoff,
        )
        self.index = index
        self._medium = medium
        self._heard = medium.heard_ns[index], medium.heard_mw[index]
        """When and how loud each other station was last heard."""
        self._receiver.listener = self
        self._control_mode = control_mode
        self._upper = upper
        self._phase = Phase.IDLE
        self._txop_end_ns = 0
        self._timeout: Event | None = None
        self._timed_out = False
        self._sequence = 0
        self._last_sequence: dict[tuple[int, FrameKind], int] = {}
        """By sender and kind, each of which keeps to one queue of the sender and so to an order."""

    # --- the host's side

    def enqueue(self, category: str, job: Job) -> None:
        """Take a frame for transmission. A full queue, and a station that is silent, ends the job at once."""
        if self._silent or self._full():
            job.done(job, Outcome.OVERFLOW)
        else:
            self._contend(category, job)

    def silence(self) -> None:
        """End for good: nothing is sent, answered or heard any more."""
        self._silent = True
        self._medium.remove(self.index)
        self._freeze(self._queue.now_ns - 1)
        self._stop_waiting()
        self._current = None
        for contender in self._contenders:
            self._unwatch(contender)
            while contender.jobs:
                job = contender.jobs.popleft()
                # a group frame that is still here though it was sent is on the air, and is completed
                gone = job.destination == GROUP and job.transmission is not None
                job.done(job, Outcome.SENT if gone else Outcome.EXPIRED)
        self._held = 0

    # --- the own exchange

    def _begin(self, contender: Contender) -> None:
        self._txop_end_ns = self._queue.now_ns + contender.txop_ns
        self._choose_mode(contender.jobs[0])
        self._start(contender)

    def _choose_mode(self, job: Job) -> None:
        if job.rates is not None:
            job.mode = job.rates.mode_for(
                job.destination,
                frame_bytes=job.frame_bytes,
                failures=job.failures,
                now_ns=self._queue.now_ns,
            )

    def _start(self, contender: Contender) -> None:
        if self._current is not contender or not contender.jobs:
            return
        job = contender.jobs[0]
        target = self._rts_target(job) if job.rts else None
        if target is None:
            self._send_job(contender)
            return
        cts_ns = response_ns(self._control_mode, CTS_BYTES)
        rts = Frame(
            kind=FrameKind.RTS,
            source=self.index,
            destination=target,
            mode=self._control_mode,
            frame_bytes=RTS_BYTES,
            nav_ns=SIFS_NS + cts_ns + SIFS_NS + _data_ns(job),
            lapse_ns=2 * SIFS_NS + cts_ns + NON_HT_PREAMBLE_NS + 2 * SLOT_NS,
        )
        self._phase = Phase.AWAITING_CTS
        self._send(rts, timeout=True)

    def _rts_target(self, job: Job) -> int | None:
        if job.destination != GROUP:
            return job.destination
        oldest_ns = self._queue.now_ns - HEARD_WITHIN_NS
        target = loudest(*self._heard, oldest_ns, job.failures)
        return None if target == NOBODY else target

    def _send_job(self, contender: Contender) -> None:
        if self._current is not contender or not contender.jobs:
            return
        job = contender.jobs[0]
        if job.transmission is None:
            self._sequence += 1
            job.sequence = self._sequence
        awaits = job.destination != GROUP
        nav_ns = answer_ns(job)
        if contender.txop_ns and len(contender.jobs) > 1:
            next_ns = self._queue.now_ns + _data_ns(job) + SIFS_NS + self._exchange_ns(contender.jobs[1])
            if next_ns <= self._txop_end_ns:
                nav_ns += SIFS_NS + self._exchange_ns(contender.jobs[1])
        frame = Frame(
            kind=job.kind,
            source=self.index,
            destination=job.destination,
            mode=job.mode,
            frame_bytes=job.frame_bytes,
            nav_ns=nav_ns,
            seq=job.seq,
            sequence=job.sequence,
            body=job.body,
        )
        self._phase = Phase.AWAITING_ACK if awaits else Phase.SENDING
        job.attempts += 1
        job.transmission = self._send(frame, timeout=awaits)

    def _send(self, frame: Frame, *, timeout: bool = False) -> Transmission:
        self._freeze(self._queue.now_ns)
        transmission = self._medium.start(frame)
        if timeout:
            self._timed_out = False
            self._timeout = self._queue.at(transmission.end_ns + RESPONSE_TIMEOUT_NS, self._on_timeout, None)
        return transmission

    def _exchange_ns(self, job: Job) -> int:
        """Time that the exchange of a frame takes from its RTS or itself on."""
        if not job.rts:
            return _data_ns(job)
        cts_ns = response_ns(self._control_mode, CTS_BYTES)
        return self._control_mode.duration_ns(RTS_BYTES) + SIFS_NS + cts_ns + SIFS_NS + _data_ns(job)

    def _succeeded(self, outcome: Outcome, end_ns: int) -> None:
        """End the exchange at ``end_ns``, and begin the next one of the same TXOP if it fits."""
        contender = self._current
        if contender is None:
            return
        self._stop_waiting()
        self._give_up(contender, outcome)
        if self._current is not contender:
            return
        if contender.txop_ns and self._goes_on(contender, end_ns + SIFS_NS):
            return
        self._current = None
        self._phase = Phase.IDLE
        self._heed()
        contender.succeeded()
        self._resume()

    def _goes_on(self, contender: Contender, start_ns: int) -> bool:
        """Begin the next exchange of a TXOP at ``start_ns`` if there is one and it ends within the limit."""
        contender.cw = contender.parameters.cw_min
        self._drop_expired(contender)
        if self._current is not contender or not contender.jobs:
            return False
        job = contender.jobs[0]
        self._choose_mode(job)
        if start_ns + self._exchange_ns(job) > self._txop_end_ns:
            return False
        self._phase = Phase.SENDING
        self._queue.at(start_ns, self._start, contender)
        return True

    def _failed(self) -> None:
        contender = self._current
        if contender is None:
            return
        job = contender.jobs[0]
        if self._phase is Phase.AWAITING_ACK and job.rates is not None:
            job.rates.report(job.destination, job.mode, acknowledged=False)
        self._stop_waiting()
        self._current = None
        self._phase = Phase.IDLE
        self._wait_until_ns = self._queue.now_ns
        self._heed()
        self._fail(contender)
        self._resume()

    def _on_timeout(self, _: None) -> None:
        self._timeout = None
        if self._sensed[LOCK] != UNLOCKED:
            # a frame has begun in time: whether it is the answer shows at its end
            self._timed_out = True
        else:
            self._failed()

    def _stop_waiting(self) -> None:
        self._timed_out = False
        if self._timeout is not None:
            self._queue.cancel(self._timeout)
            self._timeout = None

    # --- what the receiver reports

    def on_sent(self, transmission: Transmission) -> None:
        """See `netsim.phy.medium.Listener`."""
        if self._phase is Phase.SENDING and not transmission.frame.is_answer:
            self._succeeded(Outcome.SENT, transmission.end_ns)
        elif self._timed_out and self._sensed[LOCK] == UNLOCKED:
            # to answer somebody it has given up the frame that might have been its own answer
            self._failed()
        else:
            self._resume()

    def on_error(self, end_ns: int) -> None:  # noqa: ARG002  it is in what is sensed
        """See `netsim.phy.medium.Listener`: errors make the station wait EIFS."""
        self._revise()
        if self._timed_out:
            self._failed()

    def on_received(self, transmission: Transmission, power_mw: float, end_ns: int) -> None:
        """See `netsim.phy.medium.Listener`."""
        self._revise()
        destination = transmission.frame.destination
        if destination == self.index:
            self._received_own(transmission, power_mw, end_ns)
        elif destination == GROUP:
            self._upper.on_frame(transmission, power_mw, end_ns, duplicate=False)
        if self._timed_out:
            self._failed()

    def _received_own(self, transmission: Transmission, power_mw: float, end_ns: int) -> None:
        frame = transmission.frame
        contender = self._current
        if frame.kind is FrameKind.CTS:
            if self._phase is Phase.AWAITING_CTS and contender is not None:
                self._stop_waiting()
                self._phase = Phase.SENDING
                self._queue.at(end_ns + SIFS_NS, self._send_job, contender)
        elif frame.kind is FrameKind.ACK:
            if self._phase is Phase.AWAITING_ACK and contender is not None:
                job = contender.jobs[0]
                job.ack = transmission
                if job.rates is not None:
                    job.rates.report(job.destination, job.mode, acknowledged=True)
                self._succeeded(Outcome.ACKNOWLEDGED, end_ns)
        elif frame.kind is FrameKind.RTS:
            # NAV holds back the answer, unless it is the same station that set it (10.22.2.4)
            sensed = self._sensed
            free = sensed[RESERVED_UNTIL] <= end_ns or sensed[RESERVED_BY] == frame.source
            if free and self._current is None:
                self._answer(FrameKind.CTS, frame, CTS_BYTES, end_ns)
        else:
            self._answer(FrameKind.ACK, frame, ACK_BYTES, end_ns)
            sender = (frame.source, frame.kind)
            duplicate = self._last_sequence.get(sender) == frame.sequence
            self._last_sequence[sender] = frame.sequence
            self._upper.on_frame(transmission, power_mw, end_ns, duplicate=duplicate)

    # --- answers

    def _answer(self, kind: FrameKind, to: Frame, frame_bytes: int, end_ns: int) -> None:
        mode = response_mode(to.mode)
        answer = Frame(
            kind=kind,
            source=self.index,
            destination=to.source,
            mode=mode,
            frame_bytes=frame_bytes,
            nav_ns=max(0, to.nav_ns - SIFS_NS - response_ns(to.mode, frame_bytes)),
        )
        self._queue.at(end_ns + SIFS_NS, self._respond, answer)

    def _respond(self, frame: Frame) -> None:
        if not self._silent and self._sensed[SENDING_UNTIL] <= self._queue.now_ns:
            self._send(frame)


def answer_ns(job: Job) -> int:
    """Time from the end of a frame to the end of its ACK."""
    if job.destination == GROUP:
        return 0
    return SIFS_NS + response_ns(job.mode, ACK_BYTES)


def _data_ns(job: Job) -> int:
    """Time from the beginning of a frame to the end of its ACK."""
    return job.mode.duration_ns(job.frame_bytes) + answer_ns(job)
