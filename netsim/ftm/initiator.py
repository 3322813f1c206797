"""Initiator of ranging sessions: requests, time-stamps measurements, triggers bursts, reports results."""

from collections.abc import Callable
from functools import partial
from math import log10, sqrt

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from netsim.ftm.elements import Measurement, Parameters, Request, Status
from netsim.ftm.negotiation import TIME_UNIT_NS, Schedule, requested_parameters
from netsim.ftm.port import ObservedRequest, Port
from netsim.ftm.stamps import measured_m
from netsim.mac.jobs import Job, JobOutcome, Reception
from netsim.model.event_queue import Event

GRACE_NS = TIME_UNIT_NS + 1_000_000
"""Time from the scheduled end of a session to its end at the initiator.

The schedule may be early by one time unit, and the last frame needs time to arrive.
"""


class Ranging(Struct, frozen=True, kw_only=True):
    """Result of a ranging request; fields as in `netsim.wire.messages.FtmResult`."""

    initiator: int
    peer: int
    seq: int
    status: str
    ended_ns: int
    measured_ns: int
    true_distance_m: float
    """Mean over the round trips; without any, the distance at the end. Unknown peer: 0.0."""
    distance_m: float = 0.0
    distance_std_m: float = 0.0
    rssi_dbm: float = 0.0
    round_trips: int = 0
    measurements: int = 0
    """Measurement frames received, duplicates not counted."""
    retry_after_s: int = 0
    """If ``rejected`` by a responder: time for which it requests no new request, in seconds."""


class _Arrival(Struct, gc=False):
    token: int
    t2_ps: int
    t3_ps: int
    rate_ratio: float
    at_ns: int
    true_distance_m: float
    power_mw: float


class _Session(Struct, eq=False):
    peer: int
    seq: int
    request_deadline_ns: int
    excess_m: float = 0.0
    job: Job | None = None
    """The request, later the last trigger."""
    schedule: Schedule | None = None
    """None until the responder has granted the session."""
    burst: int = 0
    """Number of the next burst to trigger."""
    time_out: Event | None = None
    burst_begin: Event | None = None
    end: Event | None = None
    arrival: _Arrival | None = None
    """The last measurement frame."""
    measurements: int = 0
    round_trips: list[tuple[float, _Arrival]] = []
    """Distance in metres and first measurement frame of each round trip."""


class Initiator:
    """Sessions that one station initiates."""

    def __init__(
        self, port: Port, nlos_generator: np.random.Generator, on_result: Callable[[Ranging], None]
    ) -> None:
        self._port = port
        self._queue = port.queue
        self._nlos_generator = nlos_generator
        """Draws the excess range of a blocked line of sight for each session."""
        self._on_result = on_result
        self._parameters = requested_parameters(port.config, port.format_and_bandwidth)
        self._sessions: dict[int, _Session] = {}

    def request(self, peer: int, seq: int, timeout_ns: int) -> None:
        """Start a session with a peer.

        Without a response it ends at the absolute time ``timeout_ns``. A grant extends this by the time to
        the beginning of the last burst.
        """
        session = _Session(peer, seq, timeout_ns)
        if peer == self._port.station or not 0 <= peer < self._port.stations or peer in self._sessions:
            self._report(session, "rejected")
            return
        self._sessions[peer] = session
        session.excess_m = float(self._nlos_generator.exponential(self._port.config.nlos_bias_mean_m))
        session.time_out = self._queue.at(max(timeout_ns, self._queue.now_ns), self._on_time_out, session)
        body = ObservedRequest(parameters=self._parameters, excess_m=session.excess_m)
        session.job = self._port.job(body, peer, self._on_request_done, seq=seq)
        self._port.send(session.job)

    def silence(self) -> None:
        """End every session."""
        for session in list(self._sessions.values()):
            self._finish(session, "dropped")

    def _on_request_done(self, job: Job, outcome: JobOutcome) -> None:
        session = self._sessions.get(job.destination)
        if session is None or session.job is not job or session.schedule is not None:
            return
        if outcome is JobOutcome.RETRY_LIMIT:
            self._finish(session, "no_response")
        elif outcome is not JobOutcome.ACKNOWLEDGED:
            self._finish(session, "dropped")

    def _on_time_out(self, session: _Session) -> None:
        job = session.job
        never_sent = session.schedule is None and job is not None and not self._port.mac.has_begun(job)
        self._finish(session, "dropped" if never_sent else "timeout")

    # --- bursts

    def _on_granted(self, session: _Session, granted: Parameters) -> None:
        now = self._queue.now_ns
        session.schedule = schedule = Schedule.of(granted, now)
        for event in (session.burst_begin, session.end):
            if event is not None:
                self._queue.cancel(event)
        end_ns = max(now, schedule.end_ns(schedule.last) + GRACE_NS)
        session.end = self._queue.at(end_ns, partial(self._finish, failure="timeout"), session)
        wait_ns = schedule.begin_ns(schedule.last) - now
        if wait_ns > 0 and session.time_out is not None:
            self._queue.cancel(session.time_out)
            deadline_ns = max(now, session.request_deadline_ns + wait_ns)
            session.time_out = self._queue.at(deadline_ns, self._on_time_out, session)
        # ASAP: the first burst has begun with this frame
        session.burst = 1 if granted.asap else 0
        self._await_burst(session, schedule)

    def _await_burst(self, session: _Session, schedule: Schedule) -> None:
        session.burst_begin = None
        if session.burst <= schedule.last:
            begin_ns = max(self._queue.now_ns, schedule.begin_ns(session.burst))
            session.burst_begin = self._queue.at(begin_ns, self._on_burst, session)

    def _on_burst(self, session: _Session) -> None:
        schedule = session.schedule
        if schedule is None:
            return
        ends_ns = schedule.end_ns(session.burst)
        session.burst += 1
        self._await_burst(session, schedule)
        session.job = self._port.job(
            Request(), session.peer, self._on_request_done, seq=session.seq, expires_ns=ends_ns
        )
        self._port.send(session.job)

    # --- measurements

    def on_measurement(self, reception: Reception, body: Measurement) -> None:
        """Process a measurement frame; a retransmission has new time stamps."""
        peer, end_ns, power_mw = reception.source, reception.end_ns, reception.power_mw
        session = self._sessions.get(peer)
        if session is None:
            return
        granted = body.parameters
        if granted is not None:
            if granted.status is not Status.SUCCESSFUL:
                status = "incapable" if granted.status is Status.INCAPABLE else "rejected"
                self._finish(session, status, retry_after_s=granted.value)
                return
            self._on_granted(session, granted)
            if not granted.asap:
                return  # this frame announces the first burst and is not part of it
        elif session.schedule is None:
            return  # the session has already ended here
        arrival = session.arrival
        if arrival is not None and arrival.token == body.followed:
            trip_m = measured_m(body.t1_ps, arrival.t2_ps, arrival.t3_ps, body.t4_ps, arrival.rate_ratio)
            session.round_trips.append((trip_m, arrival))
        if not reception.duplicate:
            session.measurements += 1
        if body.token == 0:
            self._finish(session, "timeout", ended_ns=end_ns)
            return
        # a frame is repeated if its ACK was lost: t1 and t4 belong to its last transmission
        session.arrival = _Arrival(
            token=body.token,
            t2_ps=self._port.arrival_ps(reception, session.excess_m)[0],
            t3_ps=self._port.clock.stamp_ps(1_000 * (end_ns + self._port.sifs_ns)),
            rate_ratio=self._port.rate_ratio(peer, power_mw),
            at_ns=end_ns,
            true_distance_m=self._port.distance_m(peer),
            power_mw=power_mw,
        )

    # --- results

    def _finish(
        self, session: _Session, failure: str, *, retry_after_s: int = 0, ended_ns: int | None = None
    ) -> None:
        """End a session, by default now, with ``ok`` if there is a round trip, else with the failure."""
        del self._sessions[session.peer]
        for event in (session.time_out, session.burst_begin, session.end):
            if event is not None:
                self._queue.cancel(event)
        if session.job is not None:
            self._port.mac.cancel(session.job)
        self._report(session, failure, retry_after_s, ended_ns)

    def _report(
        self, session: _Session, failure: str, retry_after_s: int = 0, ended_ns: int | None = None
    ) -> None:
        now = self._queue.now_ns if ended_ns is None else ended_ns
        result = Ranging(
            initiator=self._port.station,
            peer=session.peer,
            seq=session.seq,
            status=failure,
            ended_ns=now,
            measured_ns=now,
            true_distance_m=self._port.distance_m(session.peer),
            measurements=session.measurements,
            retry_after_s=retry_after_s,
        )
        self._on_result(_averaged(result, session.round_trips) if session.round_trips else result)


def _averaged(result: Ranging, round_trips: list[tuple[float, _Arrival]]) -> Ranging:
    """Return the result with the means over the round trips."""
    count = len(round_trips)
    at_ns, power_mw, true_m, sum_m, squares_m2 = 0, 0.0, 0.0, 0.0, 0.0
    for trip_m, arrival in round_trips:
        at_ns += arrival.at_ns
        power_mw += arrival.power_mw
        true_m += arrival.true_distance_m
        sum_m += trip_m
    mean_m = sum_m / count
    for trip_m, _ in round_trips:
        squares_m2 += (trip_m - mean_m) ** 2
    return replace(
        result,
        status="ok",
        measured_ns=at_ns // count,
        true_distance_m=true_m / count,
        distance_m=mean_m,
        distance_std_m=sqrt(squares_m2 / (count - 1)) if count > 1 else 0.0,
        rssi_dbm=10.0 * log10(power_mw / count),
        round_trips=count,
        retry_after_s=0,
    )
