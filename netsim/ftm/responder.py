"""Responder of ranging sessions: grants or rejects requests and sends the measurement frames."""

from functools import partial

import msgspec

from netsim.ftm.elements import Measurement, Parameters, Request, Status, error_exponent
from netsim.ftm.negotiation import Schedule, can_measure, grant, rejection
from netsim.ftm.port import ObservedRequest, Port
from netsim.mac.jobs import Job, JobOutcome
from netsim.model.event_queue import Event

HIGHEST_TOKEN = 255
DEPARTURE_ERROR_EXPONENT = error_exponent(1.0)
"""Departures are exact to the unit of 1 ps."""
ARRIVAL_ERROR_STD = 3.0
"""Error bound of an arrival, in standard deviations of its noise."""

_NOTHING = Measurement(token=0)
"""Follow-up data if no frame precedes."""


class _Session(msgspec.Struct, eq=False):
    initiator: int
    granted: Parameters
    schedule: Schedule
    excess_m: float
    confirmed: bool = False
    """The initiator has acknowledged a frame with the granted parameters."""
    burst: int = -1
    """Number of the current or last burst; -1 before the first."""
    burst_end_ns: int = 0
    closing: Event | None = None
    closing_ns: int = 0
    job: Job | None = None
    number: int = 0
    """Number of measurement frames so far."""
    number_in_burst: int = 0
    token: int = 0
    followed: Measurement = _NOTHING
    """Time stamps of the last frame, which the next frame carries, also in a later burst."""


class Responder:
    """Sessions in which one station is the responder."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self._queue = port.queue
        self._sessions: dict[int, _Session] = {}

    def on_request(self, initiator: int, body: Request) -> None:
        """Process a request, a trigger or a request to stop."""
        if not body.trigger:
            session = self._sessions.get(initiator)
            if session is not None:
                self._end(session)
        elif body.parameters is None:
            self._on_trigger(initiator)
        else:
            excess_m = body.excess_m if isinstance(body, ObservedRequest) else 0.0
            self._negotiate(initiator, body.parameters, excess_m)

    def silence(self) -> None:
        """End every session."""
        for session in list(self._sessions.values()):
            self._end(session)

    def _negotiate(self, initiator: int, requested: Parameters, excess_m: float) -> None:
        now = self._queue.now_ns
        port = self._port
        before = self._sessions.get(initiator)
        if before is not None:
            self._end(before)  # a new request of an initiator ends its previous session
        if not can_measure(requested, port.bandwidth_mhz, vht=port.vht):
            self._reject(initiator, rejection(Status.INCAPABLE))
            return
        if len(self._sessions) >= port.config.responder_sessions:
            free_ns = min(session.closing_ns for session in self._sessions.values())
            self._reject(initiator, rejection(Status.FAILED, max(1, free_ns - now)))
            return
        granted = grant(requested, port.config, port.format_and_bandwidth, now)
        schedule = Schedule.of(granted, now)
        session = _Session(initiator, granted, schedule, excess_m)
        if granted.asap:
            session.burst = 0
            session.burst_end_ns = now + schedule.duration_ns
        else:
            session.burst_end_ns = schedule.begin_ns(0)
        session.closing_ns = max(session.burst_end_ns, schedule.end_ns(schedule.last))
        session.closing = self._queue.at(session.closing_ns, self._end, session)
        self._sessions[initiator] = session
        self._send_next(session)

    def _reject(self, initiator: int, parameters: Parameters) -> None:
        body = Measurement(token=0, parameters=parameters)
        self._port.send(self._port.job(body, initiator, lambda _job, _outcome: None, seq=0))

    def _on_trigger(self, initiator: int) -> None:
        """Begin the current burst; a trigger between bursts or a second one in a burst is ignored."""
        session = self._sessions.get(initiator)
        if session is None:
            return
        burst = session.schedule.burst_at(self._queue.now_ns)
        if burst is None or burst <= session.burst:
            return
        session.confirmed = True  # the trigger shows that the initiator has the grant
        session.burst = burst
        session.burst_end_ns = session.schedule.end_ns(burst)
        session.number_in_burst = 0
        self._send_next(session)

    def _send_next(self, session: _Session) -> None:
        if self._sessions.get(session.initiator) is not session:
            return
        session.number += 1
        if session.burst >= 0:
            session.number_in_burst += 1
        is_last = (
            session.burst == session.schedule.last
            and session.number_in_burst == session.granted.ftms_per_burst
        )
        session.token = 0 if is_last else session.token % HIGHEST_TOKEN + 1
        granted = None if session.confirmed else session.granted
        body = msgspec.structs.replace(session.followed, token=session.token, parameters=granted)
        session.job = self._port.job(
            body,
            session.initiator,
            partial(self._on_sent, session),
            seq=session.number,
            expires_ns=session.burst_end_ns,  # frames after the burst are useless
        )
        self._port.send(session.job)

    def _on_sent(self, session: _Session, job: Job, outcome: JobOutcome) -> None:
        if self._sessions.get(session.initiator) is not session or session.job is not job:
            return
        acknowledged = outcome is JobOutcome.ACKNOWLEDGED
        session.confirmed = session.confirmed or acknowledged
        if session.burst < 0:
            if not acknowledged:
                self._end(session)  # the initiator may not have the grant and will not trigger
            return
        sent_ns = job.sent_ns
        session.followed = _NOTHING
        if acknowledged and sent_ns is not None and job.ack is not None:
            t4_ps, std_ps = self._port.arrival_ps(job.ack, session.excess_m)
            session.followed = Measurement(
                token=0,
                followed=session.token,
                t1_ps=self._port.clock.stamp_ps(1_000 * sent_ns),
                t4_ps=t4_ps,
                t1_error_exponent=DEPARTURE_ERROR_EXPONENT,
                t4_error_exponent=error_exponent(ARRIVAL_ERROR_STD * std_ps),
            )
        over = sent_ns is None or session.number_in_burst == session.granted.ftms_per_burst
        next_ns = self._queue.now_ns
        if sent_ns is not None:
            next_ns = max(next_ns, sent_ns + 1_000 * (session.granted.min_delta_us or 0))
        if not over and next_ns <= session.burst_end_ns:
            self._queue.at(next_ns, self._send_next, session)
        elif session.burst == session.schedule.last:
            self._end(session)

    def _end(self, session: _Session) -> None:
        del self._sessions[session.initiator]
        if session.closing is not None:
            self._queue.cancel(session.closing)
        if session.job is not None:
            self._port.mac.cancel(session.job)
