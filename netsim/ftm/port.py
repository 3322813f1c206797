"""State shared by initiator and responder of a station: clock, time-stamp noise and MAC.

A time stamp refers to the start of a frame at the antenna. Departures have no error; the noise of the two
arrivals accounts for the error of the whole round trip.
"""

from collections.abc import Callable
from functools import partial
from math import sqrt
from typing import Protocol

import numpy as np

from netsim.ftm.elements import Measurement, Request, format_and_bandwidth
from netsim.ftm.stamps import Clock, arrival_std_ps, frequency_ratio_std, round_trip_std_ps, stamped_mhz
from netsim.mac.jobs import FrameSender, Job, JobOutcome, Reception
from netsim.model.config import BandwidthMhz, FtmConfig, RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import FloatStream
from netsim.phy.frames import DATA_OVERHEAD_BYTES, FrameKind
from netsim.phy.modes import PhyMode
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S
from netsim.phy.propagation import Trajectories, thermal_noise_mw
from netsim.phy.timing import channel_mode, is_2_4_ghz, timing_of

PS_PER_M = 1e12 / SPEED_OF_LIGHT_M_S


class Environment(Protocol):
    """Environment shared by all radios."""

    trajectories: Trajectories
    queue: EventQueue

    def calibration_bias_m(self, a: int, b: int) -> float:
        """Return the constant range offset of a pair of devices."""

    def blocked(self, a: int, b: int, at_ns: int) -> bool:
        """Whether the line of sight between two stations is blocked."""


class ObservedRequest(Request, frozen=True, kw_only=True):
    """A request with simulation data of the session that is not encoded in the frame."""

    excess_m: float = 0.0
    """Excess range while the line of sight is blocked, metres."""


class Port:
    """Clock, noise and MAC of one station; the MAC is attached before the first frame."""

    def __init__(
        self,
        *,
        station: int,
        stations: int,
        config: RadioConfig,
        environment: Environment,
        clocks: list[Clock],
        generator: np.random.Generator,
    ) -> None:
        self.station = station
        self.stations = stations
        self.config: FtmConfig = config.ftm
        self.bandwidth_mhz: BandwidthMhz = config.bandwidth_mhz
        self.vht = not is_2_4_ghz(config.frequency_mhz)
        """Whether the channel has VHT modes."""
        self.sifs_ns = timing_of(config).sifs_ns
        self.mode: PhyMode = channel_mode(config, config.ftm.mode)
        self.format_and_bandwidth = format_and_bandwidth(self.mode)
        self.queue = environment.queue
        self.clock = clocks[station]
        self.mac: FrameSender
        self.send: Callable[[Job], None]
        """Enqueue a frame; a full queue ends its job at once."""
        self._trajectories = environment.trajectories
        self._blocked = environment.blocked
        self._bias_m = [
            environment.calibration_bias_m(peer, station) if peer != station else 0.0
            for peer in range(stations)
        ]
        """Residual calibration offset of the pair, by peer."""
        self._clocks = clocks
        self._carrier_hz = config.frequency_mhz * 1e6
        self._lifetime_ns = 1_000 * config.queue_lifetime_us
        self._retry_limit = config.retry_limit
        self._noise_mw = thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db)
        self._floor_ps = round_trip_std_ps(config.ftm, config.bandwidth_mhz) / sqrt(2.0)
        self._stamped_mhz = stamped_mhz(config.ftm, config.bandwidth_mhz)
        self._errors = FloatStream(generator.standard_normal)

    def attach(self, mac: FrameSender) -> None:
        """Set the MAC that frames are sent through."""
        self.mac = mac
        self.send = partial(mac.enqueue, self.config.access_category)

    def distance_m(self, peer: int) -> float:
        """Return the true distance to another station now; 0.0 if it does not exist."""
        if not 0 <= peer < self.stations:
            return 0.0
        return self._trajectories.distance_m(self.station, peer, self.queue.now_ns)

    def arrival_ps(self, reception: Reception, excess_m: float) -> tuple[int, float]:
        """Return the arrival stamp of a frame and the standard deviation of its noise, in picoseconds.

        The calibration offset, and the session's excess range while the line of sight is blocked, are added
        to each way, so they add twice to the round trip and once to the range.
        """
        source, start_ns = reception.source, reception.start_ns
        way_m = self._trajectories.distance_m(source, self.station, start_ns)
        true_ps = 1_000 * start_ns + round(way_m / SPEED_OF_LIGHT_M_S * 1e12)
        bias_m = self._bias_m[source]
        if excess_m and self._blocked(source, self.station, start_ns):
            bias_m += excess_m
        std_ps = arrival_std_ps(self._floor_ps, self._stamped_mhz, reception.power_mw / self._noise_mw)
        error_ps = std_ps * self._errors.draw() + bias_m * PS_PER_M
        return self.clock.stamp_ps(true_ps + round(error_ps)), std_ps

    def rate_ratio(self, peer: int, power_mw: float) -> float:
        """Return the rate of a peer's clock relative to the own, estimated from a frame's carrier offset."""
        snr_linear = power_mw / self._noise_mw
        std = frequency_ratio_std(self._carrier_hz, self._stamped_mhz, snr_linear)
        return self._clocks[peer].rate / self.clock.rate + std * self._errors.draw()

    def job(
        self,
        body: Request | Measurement,
        to: int,
        done: Callable[[Job, JobOutcome], None],
        *,
        seq: int,
        expires_ns: int | None = None,
    ) -> Job:
        """Return a job for `send`: a frame to one station, dropped if not sent by ``expires_ns``."""
        lives_until_ns = self.queue.now_ns + self._lifetime_ns
        return Job(
            kind=FrameKind.FTM if isinstance(body, Measurement) else FrameKind.FTM_REQUEST,
            destination=to,
            mode=self.mode,
            frame_bytes=DATA_OVERHEAD_BYTES + body.size,
            expires_ns=lives_until_ns if expires_ns is None else min(lives_until_ns, expires_ns),
            retry_limit=self._retry_limit,
            done=done,
            seq=seq,
            body=body,
        )
