"""Ranging sessions of one radio, as initiator and as responder, above its MAC.

Initiator: request, acknowledged; then one burst of measurement frames from the responder, each acknowledged.
t1 (departure) and t4 (arrival of the ACK) of frame N are known to the responder alone and ride in frame N +
1, so N frames give N - 1 round trips. A frame or ACK that is lost for good costs the round trips it had a
part in. As soon as possible (ASAP) is always asked for and granted, with one burst; no frame goes out after
the burst's duration.

How a request ends: ``ok`` with at least one round trip; ``no_response`` if it was never acknowledged;
``rejected`` by a responder that serves as many as it can, or at once for a peer that is no other station or
is being ranged to already; ``dropped`` if it never left the queue; else ``timeout``.
"""

from collections.abc import Callable
from math import log10, sqrt
from typing import Protocol

import numpy as np
from msgspec import Struct

from netsim.config import BandwidthMhz, FtmConfig, RadioConfig
from netsim.frames import DATA_OVERHEAD_BYTES, FrameKind
from netsim.ftm.stamps import (
    Clock,
    arrival_std_ps,
    difference_ps,
    distance_m,
    frequency_ratio_std,
    round_trip_std_ps,
)
from netsim.kernel import Event, EventQueue
from netsim.mac.access import SIFS_NS
from netsim.mac.jobs import Job, Outcome
from netsim.mac.station import Station
from netsim.phy.medium import Transmission
from netsim.phy.modes import PhyMode, phy_mode
from netsim.phy.propagation import SPEED_OF_LIGHT_M_S, Trajectories, thermal_noise_mw
from netsim.streams import Normals

UNICAST_RETRY_LIMIT = 7
PARAMETERS_BYTES = 11
"""FTM parameters element with its header."""
REQUEST_BYTES = DATA_OVERHEAD_BYTES + 3 + PARAMETERS_BYTES
"""Category, action and trigger in front of the element."""
MEASUREMENT_BYTES = DATA_OVERHEAD_BYTES + 20
"""Category, action, two dialog tokens, times of departure and arrival (6 B each), their errors (2 B each)."""


class Request(Struct, frozen=True):
    """Body of a request frame."""

    session: int


class Measurement(Struct, frozen=True, kw_only=True):
    """Body of a measurement frame."""

    session: int
    token: int
    """Dialog token, 1 for the first frame of the burst."""
    last: bool = False
    accepted: bool = True
    followed: int = 0
    """Dialog token that t1 and t4 belong to; 0 if there is none."""
    t1_ps: int = 0
    t4_ps: int = 0


class Ranging(Struct, frozen=True, kw_only=True):
    """How a request ended, in the terms of `netsim.wire.messages.FtmResult`."""

    initiator: int
    peer: int
    seq: int
    status: str
    ended_ns: int
    measured_ns: int
    true_distance_m: float
    """Mean true distance over the round trips that were used; at the end if there were none."""
    distance_m: float = 0.0
    distance_std_m: float = 0.0
    rssi_dbm: float = 0.0
    round_trips: int = 0


class _Arrival(Struct):
    t2_ps: int
    t3_ps: int
    rate_ratio: float
    at_ns: int
    true_distance_m: float
    power_mw: float


class _Initiated:
    """A session of the initiator's."""

    __slots__ = ("arrivals", "burst_end", "job", "number", "peer", "round_trips", "seq", "time_out")

    def __init__(self, number: int, peer: int, seq: int) -> None:
        self.number = number
        self.peer = peer
        self.seq = seq
        self.job: Job | None = None
        self.time_out: Event | None = None
        self.burst_end: Event | None = None
        self.arrivals: dict[int, _Arrival] = {}
        self.round_trips: dict[int, tuple[float, _Arrival]] = {}


class _Answered:
    """A session of the responder's."""

    __slots__ = ("burst_end_ns", "followed", "initiator", "number", "token")

    def __init__(self, number: int, initiator: int, burst_end_ns: int) -> None:
        self.number = number
        self.initiator = initiator
        self.burst_end_ns = burst_end_ns
        self.token = 0
        self.followed: tuple[int, int, int] = (0, 0, 0)


class Environment(Protocol):
    """What all radios share."""

    trajectories: Trajectories
    queue: EventQueue

    def calibration_bias_m(self, a: int, b: int) -> float:
        """Constant range offset of a pair of devices."""


class FtmRadio:
    """Fine Time Measurement of one station."""

    def __init__(
        self,
        *,
        station: int,
        stations: int,
        config: RadioConfig,
        environment: Environment,
        clocks: list[Clock],
        generator: np.random.Generator,
        on_result: Callable[[Ranging], None],
    ) -> None:
        self._index = station
        self._stations = stations
        self._config: FtmConfig = config.ftm
        self._carrier_hz = config.frequency_mhz * 1e6
        self._bandwidth_mhz: BandwidthMhz = config.bandwidth_mhz
        self._lifetime_ns = 1_000 * config.queue_lifetime_us
        self._mode: PhyMode = phy_mode(config.ftm.mode, config.bandwidth_mhz)
        self._noise_mw = thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db)
        self._floor_ps = round_trip_std_ps(config.ftm, config.bandwidth_mhz) / sqrt(2.0)
        self._environment = environment
        self._queue = environment.queue
        self._clocks = clocks
        self._clock = clocks[station]
        self._errors = Normals(generator)
        self._on_result = on_result
        self._mac: Station
        self._numbers = 0
        self._initiated: dict[int, _Initiated] = {}
        self._answered: dict[int, _Answered] = {}

    def attach(self, mac: Station) -> None:
        """Give it the MAC to send through."""
        self._mac = mac

    # --- initiator

    def request(self, peer: int, seq: int, timeout_ns: int) -> None:
        """Range to a peer; ends by the absolute time ``timeout_ns`` at the latest."""
        self._numbers += 1
        session = _Initiated(self._numbers, peer, seq)
        if peer == self._index or not 0 <= peer < self._stations or peer in self._initiated:
            self._report(session, "rejected")
            return
        self._initiated[peer] = session
        session.time_out = self._queue.at(max(timeout_ns, self._queue.now_ns), self._on_time_out, session)
        session.job = self._job(
            FrameKind.FTM_REQUEST, peer, REQUEST_BYTES, Request(session.number), self._on_request_done, seq
        )
        self._mac.enqueue(self._config.access_category, session.job)

    def _on_request_done(self, job: Job, outcome: Outcome) -> None:
        session = self._initiated.get(job.destination)
        if session is None or session.job is not job or session.arrivals:
            return
        if outcome is Outcome.RETRY_LIMIT:
            self._finish(session, "no_response")
        elif outcome is not Outcome.ACKNOWLEDGED:
            self._finish(session, "dropped")

    def _on_time_out(self, session: _Initiated) -> None:
        never_sent = session.job is not None and session.job.attempts == 0
        self._finish(session, "dropped" if never_sent else "timeout")

    def _on_measurement(
        self, transmission: Transmission, body: Measurement, power_mw: float, end_ns: int
    ) -> None:
        frame = transmission.frame
        session = self._initiated.get(frame.source)
        if session is None or session.number != body.session:
            return
        if not body.accepted:
            self._finish(session, "rejected")
            return
        if session.burst_end is None:
            ends_ns = self._queue.now_ns + 1_000 * self._config.burst_duration_us
            session.burst_end = self._queue.at(ends_ns, self._on_burst_end, session)
        snr = power_mw / self._noise_mw
        true_ratio = self._clocks[frame.source].rate / self._clock.rate
        ratio_std = frequency_ratio_std(self._carrier_hz, self._bandwidth_mhz, snr)
        # a frame comes again if its ACK was lost: t1 and t4 will be those of its last transmission
        session.arrivals[body.token] = _Arrival(
            t2_ps=self._arrival_stamp_ps(transmission, power_mw),
            t3_ps=self._clock.stamp_ps(1_000 * (end_ns + SIFS_NS)),
            rate_ratio=true_ratio + ratio_std * self._errors.draw(),
            at_ns=end_ns,
            true_distance_m=self._true_distance_m(frame.source),
            power_mw=power_mw,
        )
        arrival = session.arrivals.get(body.followed)
        if arrival is not None:
            there_ps = difference_ps(body.t4_ps, body.t1_ps)
            here_ps = difference_ps(arrival.t3_ps, arrival.t2_ps)
            session.round_trips[body.followed] = (there_ps - here_ps * arrival.rate_ratio, arrival)
        if body.last:
            self._finish(session, "timeout")

    def _on_burst_end(self, session: _Initiated) -> None:
        self._finish(session, "timeout")

    def _finish(self, session: _Initiated, failure: str) -> None:
        """End a session: ``ok`` if there is a round trip, else with the failure."""
        del self._initiated[session.peer]
        for event in (session.time_out, session.burst_end):
            if event is not None:
                self._queue.cancel(event)
        if session.job is not None:
            session.job.cancelled = True
        self._report(session, failure)

    def _report(self, session: _Initiated, failure: str) -> None:
        now = self._queue.now_ns
        round_trips = list(session.round_trips.values())
        if not round_trips:
            self._on_result(
                Ranging(
                    initiator=self._index,
                    peer=session.peer,
                    seq=session.seq,
                    status=failure,
                    ended_ns=now,
                    measured_ns=now,
                    true_distance_m=self._true_distance_m(session.peer),
                )
            )
            return
        count = len(round_trips)
        distances_m = [distance_m(round_trip_ps) for round_trip_ps, _ in round_trips]
        mean_m = sum(distances_m) / count
        squares_m2 = sum((d - mean_m) ** 2 for d in distances_m)
        self._on_result(
            Ranging(
                initiator=self._index,
                peer=session.peer,
                seq=session.seq,
                status="ok",
                ended_ns=now,
                measured_ns=sum(arrival.at_ns for _, arrival in round_trips) // count,
                true_distance_m=sum(arrival.true_distance_m for _, arrival in round_trips) / count,
                distance_m=mean_m,
                distance_std_m=sqrt(squares_m2 / (count - 1)) if count > 1 else 0.0,
                rssi_dbm=10.0 * log10(sum(arrival.power_mw for _, arrival in round_trips) / count),
                round_trips=count,
            )
        )

    def _true_distance_m(self, peer: int) -> float:
        if not 0 <= peer < self._stations:
            return 0.0
        return self._environment.trajectories.distance_m(self._index, peer, self._queue.now_ns)

    # --- responder

    def _on_request(self, initiator: int, body: Request) -> None:
        burst_end_ns = self._queue.now_ns + 1_000 * self._config.burst_duration_us
        if initiator not in self._answered and len(self._answered) >= self._config.responder_sessions:
            refusal = Measurement(session=body.session, token=0, accepted=False)
            self._send_measurement(initiator, refusal, burst_end_ns, lambda _job, _outcome: None)
            return
        session = _Answered(body.session, initiator, burst_end_ns)
        # a new request of the same initiator ends the session before
        self._answered[initiator] = session
        self._next_measurement(session)

    def _next_measurement(self, session: _Answered) -> None:
        if self._answered.get(session.initiator) is not session:
            return
        session.token += 1
        token, t1_ps, t4_ps = session.followed
        body = Measurement(
            session=session.number,
            token=session.token,
            last=session.token == self._config.ftms_per_burst,
            followed=token,
            t1_ps=t1_ps,
            t4_ps=t4_ps,
        )
        self._send_measurement(
            session.initiator,
            body,
            session.burst_end_ns,
            lambda job, outcome: self._on_measurement_done(session, job, outcome),
        )

    def _on_measurement_done(self, session: _Answered, job: Job, outcome: Outcome) -> None:
        if self._answered.get(session.initiator) is not session:
            return
        sent = job.transmission
        if sent is None or session.token == self._config.ftms_per_burst:
            del self._answered[session.initiator]
            return
        session.followed = (0, 0, 0)
        if outcome is Outcome.ACKNOWLEDGED and job.ack is not None:
            t1_ps = self._clock.stamp_ps(1_000 * sent.start_ns)
            t4_ps = self._arrival_stamp_ps(job.ack, job.ack.powers_mw[self._index])
            session.followed = (session.token, t1_ps, t4_ps)
        next_ns = max(self._queue.now_ns, sent.start_ns + 1_000 * self._config.min_delta_us)
        if next_ns > session.burst_end_ns:
            del self._answered[session.initiator]
        else:
            self._queue.at(next_ns, self._next_measurement, session)

    # --- both

    def on_frame(self, transmission: Transmission, power_mw: float, end_ns: int, *, duplicate: bool) -> None:
        """Take an FTM frame; a measurement that comes again brings new time stamps, a request nothing."""
        body = transmission.frame.body
        if isinstance(body, Measurement):
            self._on_measurement(transmission, body, power_mw, end_ns)
        elif isinstance(body, Request) and not duplicate:
            self._on_request(transmission.frame.source, body)

    def silence(self) -> None:
        """End every session."""
        self._answered.clear()
        for session in list(self._initiated.values()):
            self._finish(session, "dropped")

    def _arrival_stamp_ps(self, transmission: Transmission, power_mw: float) -> int:
        """Noisy time of arrival of a frame at this station, with the pair's calibration bias in it."""
        source = transmission.source
        true_ps = 1_000 * transmission.start_ns
        true_ps += self._environment.trajectories.delay_ps(source, self._index, transmission.start_ns)
        std_ps = arrival_std_ps(self._floor_ps, self._bandwidth_mhz, power_mw / self._noise_mw)
        error_ps = std_ps * self._errors.draw()
        error_ps += self._environment.calibration_bias_m(source, self._index) / SPEED_OF_LIGHT_M_S * 1e12
        return self._clock.stamp_ps(true_ps + round(error_ps))

    def _send_measurement(
        self, to: int, body: Measurement, burst_end_ns: int, done: Callable[[Job, Outcome], None]
    ) -> None:
        job = self._job(FrameKind.FTM, to, MEASUREMENT_BYTES, body, done, body.token)
        job.expires_ns = min(job.expires_ns, burst_end_ns)  # what has not gone out by then is of no use
        self._mac.enqueue(self._config.access_category, job)

    def _job(
        self,
        kind: FrameKind,
        to: int,
        frame_bytes: int,
        body: Request | Measurement,
        done: Callable[[Job, Outcome], None],
        seq: int,
    ) -> Job:
        return Job(
            kind=kind,
            destination=to,
            mode=self._mode,
            frame_bytes=frame_bytes,
            expires_ns=self._queue.now_ns + self._lifetime_ns,
            retry_limit=UNICAST_RETRY_LIMIT,
            done=done,
            seq=seq,
            body=body,
        )
