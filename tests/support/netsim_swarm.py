"""An emulator with stations at given positions, advanced in steps as by the time master."""

from collections.abc import Callable, Sequence

import numpy as np

from netsim.emulator.emulator import Emulator
from netsim.model.config import RadioConfig
from netsim.model.random_streams import RandomStreams
from netsim.phy.frames import Transmission
from netsim.phy.path_loss import Doubles
from netsim.phy.propagation import Links, Trajectories
from netsim.radio_models.registry import make_models
from netsim.wire.messages import Broadcast, FtmRequest, RxItem, Survey, TxBatch, TxItem, Unicast

STEP_US = 4_000
Place = tuple[float, float, float]


class Swarm:
    """Stations that hand items over; ``run`` advances in steps and gathers arrivals, and surveys for itself.

    They stand still, or ``motion`` gives places and velocities of all, both (n, 3), at a time in seconds.
    """

    def __init__(
        self,
        places_ned_m: Sequence[Place],
        *,
        seed: int = 1,
        motion: Callable[[float], tuple[Doubles, Doubles]] | None = None,
        on_transmission: Callable[[Transmission], None] | None = None,
        **settings: object,
    ) -> None:
        self.places = np.array(places_ned_m)
        self._motion = motion
        count = len(places_ned_m)
        config = RadioConfig(**{"host_latency_us": 0, "host_jitter_us": 0, **settings})
        self.emulator = Emulator(
            config=config,
            stations=count,
            seed=np.random.SeedSequence(seed),
            on_transmission=on_transmission,
        )
        self.now_us = 0
        self.received: list[tuple[int, RxItem]] = []
        self.surveys: list[tuple[int, Survey]] = []
        self._seqs = [0] * count

    def submit(self, station: int, *items: TxItem) -> None:
        self.emulator.submit(TxBatch(station=station, now_us=self.now_us, items=items))

    def broadcast(self, station: int, at_us: int, payload: bytes = b"x" * 100) -> int:
        self.submit(station, Broadcast(seq=self._next(station), at_us=at_us, payload=payload))
        return self._seqs[station]

    def request(self, station: int, peer: int, at_us: int) -> int:
        self.submit(station, FtmRequest(seq=self._next(station), at_us=at_us, peer=peer))
        return self._seqs[station]

    def unicast(self, station: int, destination: int, at_us: int, payload: bytes = b"x" * 100) -> int:
        seq = self._next(station)
        self.submit(station, Unicast(seq=seq, at_us=at_us, destination=destination, payload=payload))
        return seq

    def _next(self, station: int) -> int:
        self._seqs[station] += 1
        return self._seqs[station]

    def run(self, until_us: int) -> list[tuple[int, RxItem]]:
        arrived = []
        while self.now_us < until_us:
            places, velocities = self.places, np.zeros_like(self.places)
            if self._motion is not None:
                places, velocities = self._motion(1e-6 * self.now_us)
            by_station = self.emulator.advance(
                to_us=self.now_us + STEP_US, at_us=self.now_us, pos_ned_m=places, vel_ned_m_s=velocities
            )
            for station, items in by_station.items():
                for item in items:
                    if isinstance(item, Survey):
                        self.surveys.append((station, item))
                    else:
                        arrived.append((station, item))
            self.now_us += STEP_US
        self.received += arrived
        return arrived


def make_links(config: RadioConfig, trajectories: Trajectories, stations: int, seed: int) -> Links:
    """Return the link budgets of stations with the models of the settings."""
    streams = RandomStreams(np.random.SeedSequence(seed))
    return Links(config, trajectories, stations, streams, make_models(config, stations, streams))
