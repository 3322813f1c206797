"""Radios that range to each other over a channel with given losses, and a log of all transmissions."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from netsim_air import UNDETECTED_DBM, GivenLinks, give_backoffs

from netsim.ftm.elements import Measurement, Request
from netsim.ftm.initiator import Ranging
from netsim.ftm.port import Port
from netsim.ftm.session import FtmRadio
from netsim.ftm.stamps import Clock
from netsim.mac.jobs import Job
from netsim.mac.radios import Radios
from netsim.model.config import FtmConfig, RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.frames import DATA_OVERHEAD_BYTES, FrameKind, Transmission
from netsim.phy.modes import phy_mode
from netsim.phy.propagation import LinkRow, Trajectories

A, B, C = range(3)
Interval = tuple[int, int]
Way = tuple[int, int]
"""From a station to another."""


class LossyLinks:
    """Links over which frames that a station begins to send within given intervals are not received."""

    version = 0
    fading = None

    def __init__(self, stations: int, lost_us: Mapping[int, Sequence[Interval]], delay_ns: int) -> None:
        pairs = [(a, b) for a in range(stations) for b in range(stations) if a != b]
        delays_ns = dict.fromkeys(pairs, delay_ns)
        self._heard = GivenLinks(stations, {}, delays_ns)
        self._lost = GivenLinks(stations, dict.fromkeys(pairs, UNDETECTED_DBM), delays_ns)
        self._lost_us = lost_us

    def row(self, source: int, at_ns: int) -> LinkRow:
        lost = any(begin <= at_ns / 1_000 <= end for begin, end in self._lost_us.get(source, ()))
        return (self._lost if lost else self._heard).row(source, at_ns)


class FtmAir:
    """Stations at 24 Mbit/s in 20 MHz, on a line ``distance_m`` apart; at 0 m times are whole microseconds.

    Without noise unless the settings say otherwise; clocks are 20 ppm off.
    """

    def __init__(
        self,
        stations: int = 2,
        *,
        distance_m: float = 0.0,
        backoffs: Mapping[int, Sequence[Interval]] | None = None,
        lost_us: Mapping[int, Sequence[Interval]] | None = None,
        bias_m: float = 0.0,
        blocked_ways: Collection[Way] = (),
        blocked_from_ns: int = 0,
        seed: int = 1,
        ftm: FtmConfig | None = None,
        **settings: object,
    ) -> None:
        ftm = FtmConfig(mode="ofdm24", round_trip_std_ps=0.0) if ftm is None else ftm
        config = RadioConfig(
            **{"bandwidth_mhz": 20, "rician_k_db": None, "nlos_fraction": 0.5, "ftm": ftm, **settings}
        )
        self.config = config
        self.queue = EventQueue()
        self.trajectories = Trajectories(stations)
        self.trajectories.set(
            0, [(0.0, distance_m * i, 0.0) for i in range(stations)], [(0.0, 0.0, 0.0)] * stations
        )
        self.transmissions: list[Transmission] = []
        self.results: list[Ranging] = []
        self._bias_m = bias_m
        self._blocked_ways = blocked_ways
        self._blocked_from_ns = blocked_from_ns
        streams = RandomStreams(np.random.SeedSequence(seed))
        radios = Radios(
            config=config,
            queue=self.queue,
            links=LossyLinks(stations, lost_us or {}, round(distance_m / 0.299792458)),
            stations=stations,
            streams=streams,
            on_datagram=lambda _: None,
            on_ended=self.transmissions.append,
        )
        clocks = [Clock(ftm.clock_ppm, streams.generator(Model.CLOCK, i)) for i in range(stations)]
        ports = [
            Port(
                station=i,
                stations=stations,
                config=config,
                environment=self,
                clocks=clocks,
                generator=streams.generator(Model.TIME_STAMP, i),
            )
            for i in range(stations)
        ]
        self.radios = [
            FtmRadio(
                port,
                streams.generator(Model.NLOS_BIAS, i),
                on_result=self.results.append,
            )
            for i, port in enumerate(ports)
        ]
        self.macs = [radios.join(i, radio) for i, radio in enumerate(self.radios)]
        give_backoffs(radios, backoffs or {})
        for port, mac in zip(ports, self.macs, strict=True):
            port.attach(mac)

    def calibration_bias_m(self, a: int, b: int) -> float:
        assert a != b
        return self._bias_m

    def blocked(self, a: int, b: int, at_ns: int) -> bool:
        return at_ns >= self._blocked_from_ns and (a, b) in self._blocked_ways

    def request(self, at_us: int, source: int = A, peer: int = B, *, seq: int = 1) -> None:
        timeout_ns = 1_000 * (at_us + self.config.ftm.request_timeout_us)
        self.queue.at(
            1_000 * at_us, lambda _: self.radios[source].initiator.request(peer, seq, timeout_ns), None
        )

    def send(self, at_us: int, source: int, to: int, body: Request) -> None:
        """Send a request frame that belongs to no session of the radio."""
        job = Job(
            kind=FrameKind.FTM_REQUEST,
            destination=to,
            mode=phy_mode("ofdm24", self.config.bandwidth_mhz),
            frame_bytes=DATA_OVERHEAD_BYTES + len(body.encode()),
            expires_ns=1_000 * at_us + 10**9,
            retry_limit=7,
            done=lambda _job, _outcome: None,
            body=body,
        )
        self.queue.at(1_000 * at_us, lambda job: self.macs[source].enqueue("vo", job), job)

    def run(self, until_us: int) -> list[tuple[int, int, int, str]]:
        """Return (start, end, source, what) of all transmissions, in whole microseconds.

        "request" has parameters and "trigger" has none; "2<1" is a measurement frame of dialog token 2 with
        the time stamps of token 1, "1!" one with parameters.
        """
        self.queue.run_until(1_000 * until_us)
        order = sorted(self.transmissions, key=lambda t: (t.start_ns, t.source))
        assert all(t.start_ns % 1_000 == 0 for t in order)
        return [(t.start_ns // 1_000, t.end_ns // 1_000, t.source, self.what(t)) for t in order]

    @staticmethod
    def what(transmission: Transmission) -> str:
        body = transmission.frame.body
        if isinstance(body, Request):
            return "trigger" if body.parameters is None else "request"
        if not isinstance(body, Measurement):
            return transmission.frame.kind.value
        followed = f"<{body.followed}" if body.followed else ""
        return f"{body.token}{followed}" + ("!" if body.parameters is not None else "")
