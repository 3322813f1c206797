"""Which frames follow which: exchanges of RTS, CTS, data and ACK, with NAV, EIFS, retries and queues.

Every queue contends through its `Contender`; an exchange belongs to one of them and excludes the others while
it lasts.

Group frames after RTS, which the standard does not have: the RTS goes to the neighbour heard loudest within
the last second, the CTS of that neighbour clears the way, and the group frame follows after SIFS; a station
that has heard nobody for a second sends without. No CTS means a collision: the window doubles, and the next
RTS goes to the next loudest, for the first may be gone; after the retry limit the frame is dropped.

Left out: fragmentation, several frames in one TXOP, power save, aggregation.
"""

from collections.abc import Mapping
from enum import Enum
from typing import Protocol

from netsim.frames import ACK_BYTES, CTS_BYTES, GROUP, RTS_BYTES, Frame, FrameKind
from netsim.kernel import NEVER_NS, Event, EventQueue
from netsim.mac.access import EIFS_EXTRA_NS, SENSE_GUARD_NS, SIFS_NS, SLOT_NS, AccessParameters, Contender
from netsim.mac.jobs import Job, Outcome
from netsim.phy.medium import Medium, Transmission
from netsim.phy.modes import NON_HT_PREAMBLE_NS, PhyMode, response_mode
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


class Station:
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
        self.index = index
        self._queue = queue
        self._medium = medium
        self._receiver = medium.receivers[index]
        self._receiver.listener = self
        self._control_mode = control_mode
        self._queue_frames = queue_frames
        self._held = 0
        self._upper = upper
        self._by_category = {name: Contender(parameters, backoff) for name, parameters in access.items()}
        self._contenders = list(self._by_category.values())
        self._current: Contender | None = None
        self._phase = Phase.IDLE
        self._timeout: Event | None = None
        self._timed_out = False
        self._frozen = False
        self._silent = False
        self._nav_until_ns = 0
        self._eifs_until_ns = 0
        self._wait_until_ns = 0
        self._sequence = 0
        self._heard: dict[int, tuple[int, float]] = {}
        self._last_sequence: dict[int, int] = {}

    # --- the host's side

    def enqueue(self, category: str, job: Job) -> None:
        """Take a frame for transmission. A full queue, and a station that is silent, ends the job at once."""
        if self._silent or self._held >= self._queue_frames:
            job.done(job, Outcome.OVERFLOW)
            return
        self._receiver.attentive = True
        contender = self._by_category[category]
        first = not contender.jobs
        contender.jobs.append(job)
        self._held += 1
        if not first or self._current is contender:
            return
        idle = not self._medium_busy()
        if contender.backoff_slots == 0 or (idle and self._backoff_passed(contender)):
            contender.backoff_slots = 0
            contender.fresh = idle
            if not idle:
                contender.draw_backoff()
        self._resume()

    def silence(self) -> None:
        """End for good: nothing is sent, answered or heard any more."""
        self._silent = True
        self._medium.remove(self.index)
        self._freeze(self._queue.now_ns - 2 * SENSE_GUARD_NS)
        self._stop_waiting()
        self._current = None
        for contender in self._contenders:
            while contender.jobs:
                job = contender.jobs.popleft()
                job.done(job, Outcome.EXPIRED)
        self._held = 0

    # --- when

    def _medium_busy(self) -> bool:
        now = self._queue.now_ns
        receiver = self._receiver
        return (
            self._current is not None
            or receiver.busy_from_ns + SENSE_GUARD_NS < now < receiver.busy_until_ns
            or now < self._nav_until_ns
            or now < receiver.sending_until_ns
        )

    def _backoff_passed(self, contender: Contender) -> bool:
        return self._queue.now_ns >= contender.base_ns + contender.backoff_slots * SLOT_NS

    def _freeze(self, from_ns: int) -> None:
        self._frozen = True
        attentive = self._held > 0
        for contender in self._contenders:
            contender.freeze(from_ns)
            if contender.backoff_slots:
                attentive = True
        # with nothing to send and no backoff to count, the station stays frozen until that changes
        self._receiver.attentive = attentive

    def _resume(self) -> None:
        """Plan each queue's next access from what is known of the medium; what changes that calls again."""
        now = self._queue.now_ns
        receiver = self._receiver
        if (
            self._current is not None
            or receiver.sending_until_ns > now
            or self._silent
            or not receiver.attentive
        ):
            return
        busy = receiver.busy_until_ns > now
        # a busy period that the station cannot have sensed yet does not hold it back
        unsensed = busy and now <= receiver.busy_from_ns + SENSE_GUARD_NS
        if busy and not unsensed:
            return
        idle_ns = max(
            receiver.idle_before_ns if unsensed else receiver.busy_until_ns,
            receiver.sending_until_ns,
            self._nav_until_ns,
            self._eifs_until_ns,
            self._wait_until_ns,
        )
        self._frozen = False
        for contender in self._contenders:
            base_ns = idle_ns + contender.aifs_ns
            contender.base_ns = base_ns
            if not contender.jobs:
                continue
            access_ns = max(now, base_ns + contender.backoff_slots * SLOT_NS)
            if contender.access is not None:
                if contender.access_ns == access_ns:
                    continue
                self._queue.cancel(contender.access)
            contender.access_ns = access_ns
            contender.access = self._queue.at(access_ns, self._on_access, contender)
        if unsensed:
            self._freeze(receiver.busy_from_ns)

    def _on_access(self, contender: Contender) -> None:
        contender.access = None
        now = self._queue.now_ns
        if self._current is not None or self._receiver.sending_until_ns > now:
            contender.base_ns = NEVER_NS
            return
        while contender.jobs and (contender.jobs[0].expires_ns <= now or contender.jobs[0].cancelled):
            self._give_up(contender, Outcome.EXPIRED)
        if not contender.jobs:
            self._resume()
            return
        rivals = [
            other
            for other in self._contenders
            if other.access is not None and other.access_ns <= now + SENSE_GUARD_NS
        ]
        winner = contender
        if rivals:
            # of queues that would send in one slot the first in priority does; the others have collided
            winner = min((contender, *rivals), key=self._contenders.index)
            self._current = winner
            for loser in (contender, *rivals):
                if loser.access is not None:
                    self._queue.cancel(loser.access)
                    loser.access = None
                if loser is not winner:
                    loser.base_ns = NEVER_NS
                    self._fail(loser)
        self._current = winner
        winner.backoff_slots = 0
        winner.fresh = False
        self._begin(winner)

    # --- which sequence

    def _begin(self, contender: Contender) -> None:
        job = contender.jobs[0]
        job.attempts += 1
        target = self._rts_target(job) if job.rts else None
        if target is None:
            self._send_job(contender)
            return
        cts_mode = response_mode(self._control_mode)
        nav_ns = (
            2 * SIFS_NS
            + cts_mode.duration_ns(CTS_BYTES)
            + job.mode.duration_ns(job.frame_bytes)
            + self._answer_ns(job)
        )
        rts = Frame(
            kind=FrameKind.RTS,
            source=self.index,
            destination=target,
            mode=self._control_mode,
            frame_bytes=RTS_BYTES,
            nav_ns=nav_ns,
        )
        self._phase = Phase.AWAITING_CTS
        self._send(rts, timeout=True)

    def _rts_target(self, job: Job) -> int | None:
        if job.destination != GROUP:
            return job.destination
        oldest_ns = self._queue.now_ns - HEARD_WITHIN_NS
        heard = [(-power_mw, other) for other, (at_ns, power_mw) in self._heard.items() if at_ns >= oldest_ns]
        return sorted(heard)[job.failures % len(heard)][1] if heard else None

    def _answer_ns(self, job: Job) -> int:
        if job.destination == GROUP:
            return 0
        return SIFS_NS + response_mode(job.mode).duration_ns(ACK_BYTES)

    def _send_job(self, contender: Contender) -> None:
        if self._current is not contender or not contender.jobs:
            return
        job = contender.jobs[0]
        if job.transmission is None:
            self._sequence += 1
            job.sequence = self._sequence
        awaits = job.destination != GROUP
        frame = Frame(
            kind=job.kind,
            source=self.index,
            destination=job.destination,
            mode=job.mode,
            frame_bytes=job.frame_bytes,
            nav_ns=self._answer_ns(job),
            seq=job.seq,
            sequence=job.sequence,
            body=job.body,
        )
        self._phase = Phase.AWAITING_ACK if awaits else Phase.SENDING
        job.transmission = self._send(frame, timeout=awaits)

    def _send(self, frame: Frame, *, timeout: bool = False) -> Transmission:
        self._freeze(self._queue.now_ns)
        transmission = self._medium.start(frame)
        if timeout:
            self._timed_out = False
            self._timeout = self._queue.at(transmission.end_ns + RESPONSE_TIMEOUT_NS, self._on_timeout, None)
        return transmission

    def _respond(self, frame: Frame) -> None:
        if not self._silent and self._receiver.sending_until_ns <= self._queue.now_ns:
            self._send(frame)

    def _on_timeout(self, _: None) -> None:
        self._timeout = None
        if self._receiver.lock is not None:
            # a frame has begun in time: whether it is the answer shows at its end
            self._timed_out = True
        else:
            self._exchange_failed()

    def _stop_waiting(self) -> None:
        self._timed_out = False
        if self._timeout is not None:
            self._queue.cancel(self._timeout)
            self._timeout = None

    def _exchange_failed(self) -> None:
        contender = self._current
        if contender is None:
            return
        self._stop_waiting()
        self._current = None
        self._phase = Phase.IDLE
        self._wait_until_ns = self._queue.now_ns
        self._receiver.attentive = True
        self._fail(contender)
        self._resume()

    def _fail(self, contender: Contender) -> None:
        job = contender.jobs[0]
        job.failures += 1
        if job.failures > job.retry_limit:
            contender.succeeded()
            self._give_up(contender, Outcome.RETRY_LIMIT)
        else:
            contender.collided()

    def _give_up(self, contender: Contender, outcome: Outcome) -> None:
        job = contender.jobs.popleft()
        self._held -= 1
        job.done(job, outcome)

    def _exchange_succeeded(self, outcome: Outcome) -> None:
        contender = self._current
        if contender is None:
            return
        self._stop_waiting()
        self._current = None
        self._phase = Phase.IDLE
        self._receiver.attentive = True
        contender.succeeded()
        self._give_up(contender, outcome)
        self._resume()

    # --- what the receiver reports

    def on_busy(self, from_ns: int) -> None:
        """See `netsim.phy.medium.Listener`."""
        if not self._frozen:
            self._freeze(from_ns)

    def on_air_changed(self) -> None:
        """See `netsim.phy.medium.Listener`."""
        if self._frozen:
            self._resume()

    def on_sent(self, transmission: Transmission) -> None:
        """See `netsim.phy.medium.Listener`."""
        if self._phase is Phase.SENDING and not transmission.frame.is_answer:
            self._exchange_succeeded(Outcome.SENT)
        else:
            self._resume()

    def on_error(self, end_ns: int) -> None:
        """See `netsim.phy.medium.Listener`: errors make the station wait EIFS."""
        self._eifs_until_ns = end_ns + EIFS_EXTRA_NS
        if self._timed_out:
            self._exchange_failed()

    def on_received(self, transmission: Transmission, power_mw: float, end_ns: int) -> None:
        """See `netsim.phy.medium.Listener`."""
        frame = transmission.frame
        self._eifs_until_ns = 0
        destination = frame.destination
        if destination == self.index:
            self._received_own(transmission, power_mw, end_ns)
        elif destination == GROUP:
            self._upper.on_frame(transmission, power_mw, end_ns, duplicate=False)
        else:
            nav_until_ns = end_ns + frame.nav_ns
            if nav_until_ns > self._nav_until_ns:
                self._nav_until_ns = nav_until_ns
                if frame.kind is FrameKind.RTS:
                    self._watch_rts(frame, end_ns)
        if not frame.is_answer:
            self._heard[frame.source] = (end_ns, power_mw)
        if self._timed_out:
            self._exchange_failed()

    def _watch_rts(self, rts: Frame, end_ns: int) -> None:
        """NAV falls if no frame follows an RTS (10.3.2.4)."""
        cts_ns = response_mode(rts.mode).duration_ns(CTS_BYTES)
        wait_ns = 2 * SIFS_NS + cts_ns + NON_HT_PREAMBLE_NS + 2 * SLOT_NS
        self._queue.at(end_ns + wait_ns, self._on_rts_unused, (end_ns, self._nav_until_ns))

    def _on_rts_unused(self, reservation: tuple[int, int]) -> None:
        rts_end_ns, nav_until_ns = reservation
        if self._receiver.locked_ns <= rts_end_ns and self._nav_until_ns == nav_until_ns:
            self._nav_until_ns = self._queue.now_ns
            self._resume()

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
                contender.jobs[0].ack = transmission
                self._exchange_succeeded(Outcome.ACKNOWLEDGED)
        elif frame.kind is FrameKind.RTS:
            if self._nav_until_ns <= end_ns and self._current is None:
                mode = response_mode(frame.mode)
                nav_ns = frame.nav_ns - SIFS_NS - mode.duration_ns(CTS_BYTES)
                self._answer(FrameKind.CTS, frame.source, mode, CTS_BYTES, nav_ns, end_ns)
        else:
            mode = response_mode(frame.mode)
            self._answer(FrameKind.ACK, frame.source, mode, ACK_BYTES, 0, end_ns)
            duplicate = self._last_sequence.get(frame.source) == frame.sequence
            self._last_sequence[frame.source] = frame.sequence
            self._upper.on_frame(transmission, power_mw, end_ns, duplicate=duplicate)

    def _answer(
        self, kind: FrameKind, to: int, mode: PhyMode, frame_bytes: int, nav_ns: int, end_ns: int
    ) -> None:
        answer = Frame(
            kind=kind, source=self.index, destination=to, mode=mode, frame_bytes=frame_bytes, nav_ns=nav_ns
        )
        self._queue.at(end_ns + SIFS_NS, self._respond, answer)
