"""Two-way ranging of all stations: requests in, results out, by events of the emulator's queue.

An exchange has the frames poll and response (``ss``), or poll, response, final and report (``ds``). Each
reply leaves ``reply_time_us`` after the frame that it answers. In ``ss`` the response carries the responder's
two time stamps; in ``ds`` the final carries the initiator's, and the report the time of flight. A radio takes
part in one exchange at a time: it misses polls meanwhile, and its own requests wait. An end that does not
receive the next frame in time leaves the exchange, and the initiator repeats it up to ``retry_limit`` times.

A request has one result, with a status as in `netsim.ftm.session`:

- ``ok``: the distance of one exchange; ``round_trips`` is 1, and ``distance_std_m`` 0.
- ``no_response``: no exchange had a response.
- ``timeout``: one had a response, but none its report.
- ``rejected``: the peer is unknown, is the station itself, or is ranged to already.
- ``dropped``: no exchange could begin before the request's time-out, or the radio was switched off.
- ``lost``: the host has lost the result (`netsim.emulator.arrivals`).

Not modelled: the bias of a DW1000's distance by signal level, for which drivers have a table.
"""

from collections import Counter, deque
from collections.abc import Callable
from math import ceil, log10

from msgspec import Struct

from netsim.ftm.initiator import Ranging
from netsim.ftm.port import Environment
from netsim.model.config import RadioConfig
from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S
from netsim.uwb import frames
from netsim.uwb.access import Access, check_stations
from netsim.uwb.clock import elapsed_ticks
from netsim.uwb.config import UwbConfig
from netsim.uwb.frames import FRAME_BYTES, UwbFrame
from netsim.uwb.link_budget import LinkBudget
from netsim.uwb.medium import LONGEST_WAY_NS, OnAir, Outcome, UwbMedium
from netsim.uwb.radio import UwbRadio
from netsim.uwb.time_of_flight import M_PER_TICK, double_sided_ticks, single_sided_ticks

PS_PER_M = 1e12 / SPEED_OF_LIGHT_M_S
MARGIN_NS = 10_000
"""Time for which a radio waits for a frame beyond its latest expected end."""


class UwbCounters(Struct, frozen=True, kw_only=True):
    """Counters of the UWB channel since the start of the run."""

    frames_sent: dict[str, int]
    """By kind."""
    outcomes: dict[str, int]
    """Frames at their addressees: received, collided, lost_to_noise, or missed by an occupied radio."""
    airtime_us: int
    """Sum of the durations of all frames."""
    exchanges: int
    """Exchanges begun, repetitions included."""


class _Request(Struct, eq=False):
    peer: int
    seq: int
    timeout_ns: int
    attempts: int = 0
    planned: bool = False
    """The beginning of its next exchange is scheduled."""
    answered: bool = False
    """An exchange has had a response."""


class _Exchange(Struct, eq=False):
    initiator: int
    responder: int
    request: _Request
    excess_m: float
    departures: dict[UwbFrame, int] = {}
    """Time stamps."""
    arrivals: dict[UwbFrame, int] = {}
    markers_ps: list[int] = []
    """True times of departure of the frames."""
    distances_m: list[float] = []
    """True distances at the departures of the frames that were received."""
    powers_mw: list[float] = []
    """At the initiator."""
    rate_ratio: float = 1.0

    def ends(self, kind: UwbFrame) -> tuple[int, int]:
        """Return the source and the destination of a frame."""
        forward = kind in (UwbFrame.POLL, UwbFrame.FINAL)
        return (self.initiator, self.responder) if forward else (self.responder, self.initiator)


class UwbRadios:
    """The ranging radios of all stations, numbered from 0.

    ``radio`` are the settings of the 802.11 radios, whose propagation models are used, and ``environment``
    has the stations' motion and the events. ``on_result`` is called with the result of each request. Raises
    ValueError, with the field below ``uwb``, for settings with which frames or slots do not fit.
    """

    def __init__(
        self,
        config: UwbConfig,
        *,
        radio: RadioConfig,
        stations: int,
        environment: Environment,
        streams: RandomStreams,
        on_result: Callable[[Ranging], None],
    ) -> None:
        frames.check(config)
        check_stations(config, stations)
        self._config, self._stations = config, stations
        self._queue, self._trajectories = environment.queue, environment.trajectories
        self._links = LinkBudget(radio, config, stations=stations, environment=environment, streams=streams)
        self._on_result = on_result
        numbers = range(stations)
        self._radios = [
            UwbRadio(
                config,
                clocks=streams.generator(Model.UWB, 0, i),
                noise=streams.generator(Model.UWB, 1, i),
                nlos=streams.generator(Model.UWB, 2, i),
            )
            for i in numbers
        ]
        draws = [streams.uniforms(Model.UWB, 3, i) for i in numbers]
        self._medium = UwbMedium(config, self._links, self._trajectories, draws)
        slot_errors_us = [
            config.slot_sync_std_us * float(streams.generator(Model.UWB, 4, i).standard_normal())
            for i in numbers
        ]
        self._access = Access(config, [streams.uniforms(Model.UWB, 5, i) for i in numbers], slot_errors_us)
        self._waiting: list[deque[_Request]] = [deque() for _ in numbers]
        """Requests by initiator; the first one has an exchange, or waits for its beginning."""
        self._silent: set[int] = set()
        self._kinds = frames.frames_of(config)
        self._to_marker_ps = round(1e6 * frames.to_marker_us(config))
        self._after_marker_ps = {
            kind: round(1e6 * frames.after_marker_us(config, FRAME_BYTES[kind])) for kind in UwbFrame
        }
        self._exchange_ns = ceil(1e3 * frames.exchange_us(config))
        self._sent: Counter[str] = Counter()
        self._outcomes: Counter[str] = Counter()
        self._airtime_ps = 0
        self._exchanges = 0

    @property
    def counters(self) -> UwbCounters:
        """Counters since the start of the run."""
        return UwbCounters(
            frames_sent={kind.name.lower(): self._sent[kind.name] for kind in self._kinds},
            outcomes={each.value: self._outcomes[each.value] for each in Outcome},
            airtime_us=self._airtime_ps // 1_000_000,
            exchanges=self._exchanges,
        )

    def set_extra_attenuation_db(self, value: float) -> None:
        """Set the extra attenuation of all links, dB."""
        self._links.set_extra_attenuation_db(value)

    # --- requests

    def request(self, station: int, peer: int, seq: int, timeout_ns: int) -> None:
        """Range from a station to a peer; its last exchange has ended by ``timeout_ns``."""
        request = _Request(peer, seq, timeout_ns)
        waiting = self._waiting[station]
        unknown = peer == station or not 0 <= peer < self._stations
        if unknown or any(other.peer == peer for other in waiting):
            self._report(station, request, "rejected")
            return
        waiting.append(request)
        if len(waiting) == 1:
            self._plan(station)

    def silence(self, station: int) -> None:
        """Switch a station's radio off for good; a frame on the air is completed."""
        self._silent.add(station)
        self._radios[station].occupied_by = None
        waiting = self._waiting[station]
        while waiting:
            self._report(station, waiting.popleft(), "dropped")

    def _plan(self, station: int) -> None:
        """Schedule the next exchange of a station's first request, or end the request."""
        waiting = self._waiting[station]
        while waiting:
            request = waiting[0]
            begin_ns = self._access.begin_ns(station, self._queue.now_ns)
            if (
                request.attempts <= self._config.retry_limit
                and begin_ns + self._exchange_ns <= request.timeout_ns
            ):
                request.planned = True
                self._queue.at(begin_ns, self._on_begin, (station, request))
                return
            self._finish(station, "dropped" if request.attempts == 0 else "no_response")

    def _finish(self, station: int, failure: str) -> None:
        request = self._waiting[station].popleft()
        self._report(station, request, "timeout" if request.answered else failure)

    def _report(self, station: int, request: _Request, status: str) -> None:
        known = 0 <= request.peer < self._stations
        now_ns = self._queue.now_ns
        self._on_result(
            Ranging(
                initiator=station,
                peer=request.peer,
                seq=request.seq,
                status=status,
                ended_ns=now_ns,
                measured_ns=now_ns,
                true_distance_m=self._trajectories.distance_m(station, request.peer, now_ns)
                if known
                else 0.0,
                measurements=int(request.answered),
            )
        )

    # --- exchanges

    def _on_begin(self, entry: tuple[int, _Request]) -> None:
        station, request = entry
        waiting = self._waiting[station]
        if not waiting or waiting[0] is not request:
            return  # switched off
        request.planned = False
        radio = self._radios[station]
        if radio.occupied_by is not None:
            return  # as a responder; at the end of that exchange the next beginning is planned
        request.attempts += 1
        self._exchanges += 1
        exchange = _Exchange(station, request.peer, request, radio.excess_m())
        radio.occupied_by = exchange
        marker_ps = radio.clock.departure_ps(1_000 * self._queue.now_ns + self._to_marker_ps)
        self._send(exchange, UwbFrame.POLL, marker_ps)

    def _send(self, exchange: _Exchange, kind: UwbFrame, marker_ps: int) -> None:
        """Schedule a frame whose marker leaves at ``marker_ps``."""
        exchange.markers_ps.append(marker_ps)
        begin_ns = max(self._queue.now_ns, (marker_ps - self._to_marker_ps) // 1_000)
        self._queue.at(begin_ns, self._on_sent, (exchange, kind))

    def _on_sent(self, entry: tuple[_Exchange, UwbFrame]) -> None:
        exchange, kind = entry
        source, destination = exchange.ends(kind)
        radio = self._radios[source]
        if radio.occupied_by is not exchange:
            return  # switched off
        marker_ps = exchange.markers_ps[-1]
        exchange.departures[kind] = radio.departure(marker_ps)
        end_ps = marker_ps + self._after_marker_ps[kind]
        self._sent[kind.name] += 1
        self._airtime_ps += self._to_marker_ps + self._after_marker_ps[kind]
        frame = self._medium.send(source, self._queue.now_ns, end_ps // 1_000, FRAME_BYTES[kind])
        arrives_ns = frame.end_ns + self._medium.delay_ns(frame, destination)
        self._queue.at(arrives_ns, self._on_arrived, (exchange, kind, frame))
        if kind is self._kinds[-1]:
            leaves_ns = frame.end_ns
        else:
            reply_ps = self._to_marker_ps + self._after_marker_ps[self._kinds[kind + 1]]
            expected_ns = (marker_ps + 1_000_000 * self._config.reply_time_us + reply_ps) // 1_000
            leaves_ns = expected_ns + 2 * LONGEST_WAY_NS + MARGIN_NS
        self._queue.at(leaves_ns, self._on_unanswered, (exchange, source, kind))

    def _on_unanswered(self, entry: tuple[_Exchange, int, UwbFrame]) -> None:
        """Let a radio leave an exchange whose next frame it has not received, or that is over for it."""
        exchange, station, kind = entry
        radio = self._radios[station]
        if radio.occupied_by is not exchange:
            return
        if kind is not self._kinds[-1] and self._kinds[kind + 1] in exchange.arrivals:
            return  # its reply has arrived
        radio.occupied_by = None
        waiting = self._waiting[station]
        if waiting and not waiting[0].planned:
            self._plan(station)

    def _on_arrived(self, entry: tuple[_Exchange, UwbFrame, OnAir]) -> None:
        exchange, kind, frame = entry
        source, destination = exchange.ends(kind)
        radio = self._radios[destination]
        listens = radio.occupied_by is (None if kind is UwbFrame.POLL else exchange)
        outcome = Outcome.MISSED
        if listens and destination not in self._silent:
            outcome = self._medium.outcome(frame, destination)
        self._outcomes[outcome.value] += 1
        if outcome is not Outcome.RECEIVED:
            return
        radio.occupied_by = exchange
        way_m = self._trajectories.distance_m(source, destination, frame.begin_ns)
        excess_m = exchange.excess_m
        if self._medium.is_clear(frame, destination):
            excess_m = 0.0
        marker_ps = exchange.markers_ps[-1] + round(way_m * PS_PER_M)
        power_mw = self._medium.power_mw(frame, destination)
        exchange.arrivals[kind] = radio.arrival(marker_ps, power_mw, excess_m * PS_PER_M)
        exchange.distances_m.append(way_m)
        if destination == exchange.initiator:
            exchange.powers_mw.append(power_mw)
            exchange.request.answered = True
        if kind is UwbFrame.RESPONSE and self._kinds[-1] is UwbFrame.RESPONSE:
            exchange.rate_ratio = radio.rate_ratio(self._radios[source].clock, marker_ps)
        if kind is self._kinds[-1]:
            self._complete(exchange)
            return
        reply_ps = radio.clock.departure_ps(radio.clock.after_ps(marker_ps, self._config.reply_time_us))
        self._send(exchange, self._kinds[kind + 1], reply_ps)

    def _complete(self, exchange: _Exchange) -> None:
        """Report the distance of an exchange, and begin the next request of its initiator."""
        station = exchange.initiator
        self._radios[station].occupied_by = None
        request = self._waiting[station].popleft()
        # those of the frames that are measured, not of the report
        markers_ps, distances_m = exchange.markers_ps[:3], exchange.distances_m[:3]
        self._on_result(
            Ranging(
                initiator=station,
                peer=request.peer,
                seq=request.seq,
                status="ok",
                ended_ns=self._queue.now_ns,
                measured_ns=sum(markers_ps) // len(markers_ps) // 1_000,
                true_distance_m=sum(distances_m) / len(distances_m),
                distance_m=M_PER_TICK * _flight_ticks(exchange),
                rssi_dbm=10.0 * log10(sum(exchange.powers_mw) / len(exchange.powers_mw)),
                round_trips=1,
                measurements=len(exchange.powers_mw),
            )
        )
        self._plan(station)


def _flight_ticks(exchange: _Exchange) -> float:
    """Return the time of flight that an exchange has measured."""
    sent, arrived = exchange.departures, exchange.arrivals
    round_a = elapsed_ticks(sent[UwbFrame.POLL], arrived[UwbFrame.RESPONSE])
    reply_b = elapsed_ticks(arrived[UwbFrame.POLL], sent[UwbFrame.RESPONSE])
    if UwbFrame.FINAL not in arrived:
        return single_sided_ticks(round_a, reply_b, exchange.rate_ratio)
    round_b = elapsed_ticks(sent[UwbFrame.RESPONSE], arrived[UwbFrame.FINAL])
    reply_a = elapsed_ticks(arrived[UwbFrame.RESPONSE], sent[UwbFrame.FINAL])
    return double_sided_ticks(round_a, reply_b, round_b, reply_a)
