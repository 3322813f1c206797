"""A channel with given powers and delays, stations with given backoffs, and a log of all transmissions."""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np

from netsim.mac.jobs import DatagramReception, Job, JobOutcome, Reception
from netsim.mac.radios import Radios
from netsim.mac.rates import AdaptiveRate
from netsim.model.config import Mode, RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import FloatStream, RandomStreams
from netsim.phy.frames import GROUP, FrameKind, Transmission
from netsim.phy.propagation import LinkRow
from netsim.phy.timing import channel_mode

UNDETECTED_DBM = -200.0
A, B, C, D = range(4)


class GivenLinks:
    """Powers and delays by (from, to); -50 dBm and no delay by default."""

    version = 0
    fading = None

    def __init__(
        self,
        stations: int,
        powers_dbm: Mapping[tuple[int, int], float],
        delays_ns: Mapping[tuple[int, int], int],
    ):
        self.asked: list[tuple[int, int]] = []
        """Times and sources of all requested rows."""
        self._rows = []
        for source in range(stations):
            powers_mw = [10 ** (powers_dbm.get((source, to), -50.0) / 10) for to in range(stations)]
            row_ns = [delays_ns.get((source, to), 0) for to in range(stations)]
            self._rows.append(LinkRow(np.array(powers_mw), np.array(row_ns), max(row_ns)))

    def row(self, source: int, at_ns: int) -> LinkRow:
        assert at_ns >= 0
        self.asked.append((at_ns, source))
        return self._rows[source]


class GivenBackoffs(FloatStream):
    """Draws that result in backoffs of (slots, contention window); further draws come from a stream."""

    def __init__(self, draws: Sequence[tuple[int, int]]) -> None:
        super().__init__(np.random.default_rng(1).random)
        given = [(slots + 0.5) / (window + 1) for slots, window in draws]
        self._floats = chain(given, self._floats)
        self.draw = self._floats.__next__


def give_backoffs(radios: Radios, backoffs: Mapping[int, Sequence[tuple[int, int]]]) -> None:
    """Set the backoffs of stations, by station."""
    for station, draws in backoffs.items():
        radios._backoffs[station] = GivenBackoffs(draws)


class Air:
    """Stations 0..n-1 at 20 MHz, DCF by default; times in microseconds. ``settings``: of `RadioConfig`."""

    def __init__(
        self,
        stations: int,
        *,
        powers_dbm: Mapping[tuple[int, int], float] | None = None,
        delays_ns: Mapping[tuple[int, int], int] | None = None,
        backoffs: Mapping[int, Sequence[tuple[int, int]]] | None = None,
        access: str = "dcf",
        control_mode: Mode = "ofdm24",
        seed: int = 1,
        **settings: Any,
    ) -> None:
        config = RadioConfig(
            bandwidth_mhz=20, rician_k_db=None, control_mode=control_mode, queue_frames=10, access=access,
            log_receptions=True, **settings,
        )  # fmt: skip
        self.config = config
        streams = RandomStreams(np.random.SeedSequence(seed))
        self.queue = EventQueue()
        self.transmissions: list[Transmission] = []
        self.outcomes: list[JobOutcome] = []
        self.arrivals: list[tuple[int, int, bool]] = []
        self.bodies: list[object] = []
        """Bodies of received unicast frames"""
        self.links = GivenLinks(stations, powers_dbm or {}, delays_ns or {})
        self.radios = Radios(
            config=config,
            queue=self.queue,
            links=self.links,
            stations=stations,
            streams=streams,
            on_datagram=self._on_datagram,
            on_ended=self.transmissions.append,
        )
        self.stations = [self.radios.join(i, _Upper(self, i)) for i in range(stations)]
        give_backoffs(self.radios, backoffs or {})

    def send(
        self,
        at_us: int,
        source: int,
        to: int = GROUP,
        *,
        frame_bytes: int = 100,
        mode: Mode = "ofdm6",
        rts: bool = False,
        category: str = "be",
        retry_limit: int = 7,
        lifetime_us: int = 1_000_000,
        rates: AdaptiveRate | None = None,
        body: object = None,
    ) -> Job:
        job = Job(
            kind=FrameKind.DATA,
            destination=to,
            mode=channel_mode(self.config, mode),
            frame_bytes=frame_bytes,
            expires_ns=1_000 * (at_us + lifetime_us),
            retry_limit=retry_limit,
            done=lambda _job, outcome: self.outcomes.append(outcome),
            rts=rts,
            rates=rates,
            body=body,
        )
        self.queue.at(1_000 * at_us, lambda job: self.stations[source].enqueue(category, job), job)
        return job

    def run(self, until_us: int = 1_000_000) -> list[tuple[int, int, int, str]]:
        """Return (start, end, source, kind) of all transmissions, in order of start; whole microseconds."""
        self.queue.run_until(1_000 * until_us)
        order = sorted(self.transmissions, key=lambda t: (t.start_ns, t.source))
        assert all(t.start_ns % 1_000 == 0 for t in order)
        return [(t.start_ns // 1_000, t.end_ns // 1_000, t.source, t.frame.kind.value) for t in order]

    def _on_datagram(self, received: DatagramReception) -> None:
        assert min(received.powers_mw) > 0.0
        assert len(received.stations) == len(received.ends_ns) == len(received.powers_mw)
        self.arrivals += [(station, received.source, False) for station in received.stations]


class _Upper:
    def __init__(self, air: Air, index: int) -> None:
        self._air = air
        self._index = index

    def on_frame(self, reception: Reception) -> None:
        assert reception.power_mw > 0.0
        assert reception.end_ns > reception.start_ns
        self._air.arrivals.append((self._index, reception.source, reception.duplicate))
        self._air.bodies.append(reception.body)
