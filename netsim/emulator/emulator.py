"""The complete 802.11 emulator: simulates submitted items with given vehicle poses and returns deliveries.

It composes hosts, Fine Time Measurement and a channel, emulated (`netsim.mac.radios`) or ideal. It does no
I/O and does not use the wall clock. The results depend only on seed, submissions and poses, not on the order
in which the stations' batches of one step are submitted.
"""

from collections.abc import Callable, Mapping
from functools import partial
from operator import attrgetter, itemgetter

import msgspec
import numpy as np
from numpy.typing import NDArray

from netsim.emulator.arrivals import Arrivals
from netsim.emulator.datagrams import Datagrams
from netsim.emulator.ideal_channel import IdealChannel, undisturbed
from netsim.emulator.packets import PacketReception, Packets
from netsim.emulator.records import EmulatorCounters, FrameRecord, Tally, frame_records
from netsim.emulator.settings_checks import check
from netsim.ftm.initiator import Ranging
from netsim.ftm.port import Port
from netsim.ftm.session import FtmRadio
from netsim.ftm.stamps import Clock
from netsim.mac.jobs import FrameSender, JobOutcome
from netsim.mac.radios import Radios
from netsim.mac.rates import DatagramModes, datagram_modes
from netsim.model.config import RadioConfig, StationConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import Model, RandomStreams
from netsim.model.tables import Integers
from netsim.phy.frames import (
    Transmission,
)
from netsim.phy.propagation import Links, Trajectories, is_possible
from netsim.radio_models.registry import make_models
from netsim.uwb.config import UwbConfig
from netsim.uwb.exchanges import UwbRadios
from netsim.wire.messages import Broadcast, FtmRequest, RxItem, TxBatch, TxItem, Unicast
from netsim.wire.packets import SentPacket

NOTHING_PENDING_US = 2**62 // 1_000
NOTHING_PENDING_NS = 1_000 * NOTHING_PENDING_US
"""Time of the next event if there is none."""
Doubles = NDArray[np.float64]
_ORDER = itemgetter(0, 1, 2)
_ITEM_ORDER = attrgetter("at_us", "seq")


class Emulator:
    """All radios of a run and the channel between them.

    ``seed`` seeds the emulator; every model and link has a separate stream derived from it. With ``uwb`` the
    requests of ranging are those of UWB radios beside the 802.11 channel, otherwise of Fine Time Measurement.
    ``on_transmission`` is called with every frame that has ended. Raises ValueError for inconsistent settings
    (`netsim.emulator.settings_checks`), and for models that cannot be created
    (`netsim.radio_models.registry`).
    """

    def __init__(
        self,
        *,
        config: RadioConfig,
        stations: int,
        seed: np.random.SeedSequence,
        on_transmission: Callable[[Transmission], None] | None = None,
        uwb: UwbConfig | None = None,
    ) -> None:
        self._vehicles = stations - len(config.guests)
        check(config, self._vehicles)
        if config.channel == "ideal":
            config = undisturbed(config)
        self._config = config
        self._stations = stations
        self._streams = RandomStreams(seed)
        self._tally = Tally()
        self._silent: set[int] = set()
        self.queue = EventQueue()
        self._modes: list[DatagramModes] = []
        self._macs: list[FrameSender] = []
        self._packets = Packets(
            config=config, queue=self.queue, macs=self._macs, modes=self._modes, silent=self._silent
        )
        self._arrivals = Arrivals(
            stations=stations,
            vehicles=self._vehicles,
            drop_fraction=config.drop_fraction,
            streams=self._streams,
            tally=self._tally,
            silent=self._silent,
            packets=self._packets,
        )
        self._datagrams = Datagrams(
            config=config,
            queue=self.queue,
            macs=self._macs,
            modes=self._modes,
            arrivals=self._arrivals,
            tally=self._tally,
            silent=self._silent,
        )
        self.trajectories = Trajectories(stations)
        self._level = np.tile([1.0, 0.0, 0.0, 0.0], (stations, 1))
        """Default attitudes (n, 4), wxyz."""
        self._shapes = (stations, 3), (stations, 3), self._level.shape
        models = make_models(config, stations, self._streams)
        self.links = Links(config, self.trajectories, stations, self._streams, models)
        emulated = partial(Radios, streams=self._streams, errors=models.error_model)
        channel = IdealChannel if config.channel == "ideal" else emulated
        self._channel: Radios | IdealChannel = channel(
            config=config,
            queue=self.queue,
            links=self.links,
            stations=stations,
            on_datagram=self._arrivals.add_datagram,
            on_ended=on_transmission,
        )
        self._host_jitter = [self._streams.uniforms(Model.HOST, i) for i in range(stations)]
        self.range_offsets_m: Mapping[int, float] = {}
        """Offsets added to the distances of sessions that end from now on, by initiator."""
        own = {each.station: each for each in config.stations}
        self._ftm: list[FtmRadio] = []
        clocks = [
            Clock(config.ftm.clock_ppm, self._streams.generator(Model.CLOCK, i)) for i in range(stations)
        ]
        for i in range(stations):
            own_config = own.get(i, StationConfig(station=i))
            self._modes.append(datagram_modes(config, own_config, self._streams))
            self._add_station(i, clocks)
        self._uwb: UwbRadios | None = None
        if uwb is not None:
            self._uwb = UwbRadios(
                uwb, radio=config, stations=stations, environment=self, streams=self._streams,
                on_result=self._on_ranged,
            )  # fmt: skip
        self._ranging_timeout_us = (config.ftm if uwb is None else uwb).request_timeout_us
        self._submitted: list[tuple[int, int, int, TxItem]] = []
        self._ready_ns = [0] * stations
        """Time by station at which its last item reaches the radio."""

    def _add_station(self, station: int, clocks: list[Clock]) -> None:
        port = Port(
            station=station,
            stations=self._stations,
            config=self._config,
            environment=self,
            clocks=clocks,
            generator=self._streams.generator(Model.TIME_STAMP, station),
        )
        ftm = FtmRadio(
            port,
            self._streams.generator(Model.NLOS_BIAS, station),
            on_result=self._on_ranged,
        )
        mac = self._channel.join(station, ftm)
        port.attach(mac)
        self._ftm.append(ftm)
        self._macs.append(mac)

    # --- the hosts' side

    def submit(self, batch: TxBatch) -> None:
        """Accept a station's items; each is queued at its ``at_us`` plus the host's latency and jitter.

        Raises ValueError for a station that does not exist.
        """
        station = batch.station
        if station >= self._stations:
            raise ValueError(f"station {station} is out of range: the channel has {self._stations} stations")
        for item in sorted(batch.items, key=_ITEM_ORDER):
            jitter_ns = int(1_000 * self._config.host_jitter_us * self._host_jitter[station].draw())
            ready_ns = 1_000 * (item.at_us + self._config.host_latency_us) + jitter_ns
            # a host's queue keeps its order
            ready_ns = max(ready_ns, self.queue.now_ns, self._ready_ns[station])
            self._ready_ns[station] = ready_ns
            self._submitted.append((ready_ns, station, item.seq, item))

    def submit_packet(self, packet: SentPacket, at_ns: int) -> None:
        """Queue a packet at its sender at simulated time ``at_ns``, or now if that is in the past.

        Packets of one station and time keep their order. Raises ValueError for a station that does not exist.
        """
        self._packets.submit(packet, at_ns)

    def take_packets(self) -> list[PacketReception]:
        """Return the packets received since the last call, in order of their end."""
        return self._packets.take()

    def take_ended(self) -> dict[int, int]:
        """Return the numbers of packets that have left the queues since the last call, by sender."""
        return self._packets.take_ended()

    def advance(
        self,
        *,
        to_us: int,
        at_us: int,
        pos_ned_m: Doubles,
        vel_ned_m_s: Doubles,
        q_ned_frd: Doubles | None = None,
    ) -> dict[int, list[RxItem]]:
        """Simulate up to and including ``to_us``: `begin`, `run_until` and `end` of an interval.

        Returns the received items by station. Raises ValueError as `begin`.
        """
        self.begin(
            to_us=to_us, at_us=at_us, pos_ned_m=pos_ned_m, vel_ned_m_s=vel_ned_m_s, q_ned_frd=q_ned_frd
        )
        self.run_until(1_000 * to_us)
        return self.end()

    def begin(
        self,
        *,
        to_us: int,
        at_us: int,
        pos_ned_m: Doubles,
        vel_ned_m_s: Doubles,
        q_ned_frd: Doubles | None = None,
    ) -> None:
        """Begin an interval that ends at ``to_us`` and schedule the submitted items.

        The stations are at ``pos_ned_m`` (n, 3) at ``at_us``, move at ``vel_ned_m_s`` (n, 3) and have the
        attitudes ``q_ned_frd`` (n, 4), wxyz, by default level. Raises ValueError for arrays of a wrong shape
        or with invalid values, or for a time in the past.
        """
        positions, velocities = (np.asarray(each, dtype=np.float64) for each in (pos_ned_m, vel_ned_m_s))
        attitudes = self._level if q_ned_frd is None else q_ned_frd
        shapes = positions.shape, velocities.shape, attitudes.shape
        if shapes != self._shapes or not is_possible(positions, velocities, attitudes):
            raise ValueError(
                f"positions and velocities must be finite and of shape ({self._stations}, 3), "
                f"attitudes of length one and of shape ({self._stations}, 4)"
            )
        to_ns = 1_000 * to_us
        if to_ns < self.queue.now_ns:
            raise ValueError(f"cannot go back to {to_us} us: the time is {self.queue.now_ns // 1_000} us")
        self.trajectories.set(1_000 * at_us, positions, velocities, q_ned_frd)
        self._submitted.sort(key=_ORDER)
        for ready_ns, station, _, item in self._submitted:
            match item:
                case Broadcast():
                    self._datagrams.broadcast(station, ready_ns, item)
                case Unicast():
                    self._datagrams.send(station, ready_ns, item)
                case FtmRequest():
                    self.queue.at(ready_ns, self._request_ranging, (station, item))
        self._submitted.clear()

    def run_until(self, time_ns: int) -> None:
        """Simulate up to and including ``time_ns``, which is within the interval."""
        self.queue.run_until(time_ns)

    def end(self) -> dict[int, list[RxItem]]:
        """Return the received items by station, for stations that received any.

        They are in order of (time, source, seq), where the source of a result is the peer or destination,
        followed by a `Survey` for a vehicle.
        """
        return self._arrivals.take(self.queue.now_ns, self._channel.surveyed_ns)

    def add_item(self, station: int, at_ns: int, source: int, seq: int, item: RxItem) -> None:
        """Add an item that has reached a station in this interval by another way than the channel."""
        self._arrivals.add_item(station, at_ns, source, seq, item)

    @property
    def next_event_ns(self) -> int:
        """Earliest time of the next event if nothing more is submitted."""
        submitted_ns = min((entry[0] for entry in self._submitted), default=NOTHING_PENDING_NS)
        return min(submitted_ns, self.queue.next_ns(), NOTHING_PENDING_NS)

    @property
    def next_event_us(self) -> int:
        """Earliest time of the next event if nothing more is submitted; rounded down."""
        return self.next_event_ns // 1_000

    def _request_ranging(self, entry: tuple[int, FtmRequest]) -> None:
        station, item = entry
        if station in self._silent:
            return
        self._tally.ftm_requested += 1
        config = self._config
        # a guest has no simulation time: its request begins on arrival
        latest_us = config.host_latency_us + config.host_jitter_us
        requested_ns = max(1_000 * item.at_us, self.queue.now_ns - 1_000 * latest_us)
        timeout_ns = requested_ns + 1_000 * self._ranging_timeout_us
        if self._uwb is None:
            self._ftm[station].initiator.request(item.peer, item.seq, timeout_ns)
        else:
            self._uwb.request(station, item.peer, item.seq, timeout_ns)

    def saturate(self, station: int, destination: int, payload_bytes: int) -> None:
        """Keep a station's queue filled with datagrams to another station from now on.

        They never expire. Only their frames are recorded, and their ends counted (`saturation`). Raises
        ValueError for an ideal channel, which has no queues, and for a station with an adaptive mode.
        """
        if self._config.channel == "ideal":
            raise ValueError('channel: the "ideal" channel has no queues to saturate, "emulated" has')
        self._datagrams.saturate(station, destination, payload_bytes)

    @property
    def saturation(self) -> Integers:
        """Ended datagrams of `saturate` (n, outcomes), in the order of `netsim.mac.jobs.JobOutcome`."""
        if isinstance(self._channel, Radios):
            return self._channel.repeated()
        return np.zeros((self._stations, len(JobOutcome)), np.int64)

    def _on_ranged(self, ranging: Ranging) -> None:
        offset_m = self.range_offsets_m.get(ranging.initiator)
        if offset_m is not None and ranging.status == "ok":
            ranging = msgspec.structs.replace(ranging, distance_m=ranging.distance_m + offset_m)
        self._arrivals.add_ranging(ranging)

    # --- control and results of the run

    def set_silent(self, station: int) -> None:
        """Switch a station's radio off for good; a frame on the air is completed."""
        if station in self._silent:
            return
        self._silent.add(station)
        self._macs[station].silence()
        self._ftm[station].silence()
        if self._uwb is not None:
            self._uwb.silence(station)

    def set_extra_attenuation_db(self, value: float) -> None:
        """Set the extra attenuation of all links, dB. Raises ValueError as `Links`."""
        self.links.set_extra_attenuation_db(value)
        if self._uwb is not None:
            self._uwb.set_extra_attenuation_db(value)

    @property
    def busy_ns(self) -> int:
        """Time since the start for which the medium carried at least one transmission; 0 if it is ideal."""
        return self._channel.busy_ns()

    @property
    def counters(self) -> EmulatorCounters:
        """Counters since the start of the run."""
        return self._tally.counters(
            self._channel.frames_sent(), self._channel.broadcasts(), self._packets.counters,
            None if self._uwb is None else self._uwb.counters,
        )  # fmt: skip

    def take_frames(self) -> list[FrameRecord]:
        """Return the transmissions that ended since the last call, in order of their end."""
        return frame_records(self.take_frame_rows())

    def take_frame_rows(self) -> Integers:
        """Return the same as rows, for `netsim.emulator.records.frame_log_rows`."""
        return self._channel.take_frames()

    def take_sessions(self) -> list[Ranging]:
        """Return the ranging sessions that ended since the last call, in order of their end."""
        return self._tally.take_sessions()

    # --- environment of ranging: `netsim.ftm.port.Environment`

    def calibration_bias_m(self, a: int, b: int) -> float:
        """Return the constant residual range offset of a pair of devices."""
        config = self._config.ftm
        if config.calibration_bias_std_m == 0.0:
            return config.calibration_bias_m
        generator = self._streams.generator(Model.CALIBRATION, min(a, b), max(a, b))
        return config.calibration_bias_m + float(generator.normal(0.0, config.calibration_bias_std_m))

    def blocked(self, a: int, b: int, at_ns: int) -> bool:
        """Whether the line of sight between two stations is blocked."""
        return self.links.blocked(a, b, at_ns)
