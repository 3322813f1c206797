"""The emulated 802.11 channel as a whole: items in, time advances with the vehicles' poses, deliveries out.

Composes medium, MAC and Fine Time Measurement; does no I/O and knows no wall clock. The same seed,
submissions and poses give the same results, in whatever order the stations' batches of one step were
submitted.
"""

from collections import Counter
from math import log10

import numpy as np
from numpy.typing import NDArray

from netsim.config import RadioConfig
from netsim.frames import DATA_OVERHEAD_BYTES, GROUP, UDP_OVERHEAD_BYTES, FrameKind
from netsim.ftm.session import FtmRadio, Ranging
from netsim.ftm.stamps import Clock
from netsim.kernel import EventQueue
from netsim.mac.access import EDCA, AccessParameters
from netsim.mac.jobs import Job, Outcome
from netsim.mac.station import Station as Mac
from netsim.phy.medium import Medium, Transmission
from netsim.phy.modes import phy_mode
from netsim.phy.propagation import Links, Trajectories, Vector
from netsim.records import Counters, FrameRecord, FtmCounters, SessionRecord
from netsim.streams import Model, Streams, Uniforms
from netsim.wire.messages import Broadcast, Delivery, FtmResult, RxItem, TxBatch, TxItem

NOTHING_PENDING_US = 2**62 // 1000
Doubles = NDArray[np.float64]


class _Host:
    """Between one station's MAC and its applications: hands broadcasts up and FTM frames to the ranging."""

    def __init__(self, emulator: "Emulator", index: int, ftm: FtmRadio) -> None:
        self._emulator = emulator
        self._index = index
        self._ftm = ftm

    def on_frame(self, transmission: Transmission, power_mw: float, end_ns: int, *, duplicate: bool) -> None:
        """See `netsim.mac.station.Upper`."""
        payload = transmission.frame.body
        if isinstance(payload, bytes):
            self._emulator.deliver(self._index, transmission, payload, power_mw, end_ns)
        else:
            self._ftm.on_frame(transmission, power_mw, end_ns, duplicate=duplicate)


class Emulator:
    """All radios of a run and the channel between them.

    ``seed`` is the emulator's own; every model and link draws from a stream of its own below it. Raises
    ValueError for a mode that the channel's width does not have.
    """

    def __init__(self, *, config: RadioConfig, stations: int, seed: np.random.SeedSequence) -> None:
        self._config = config
        self._stations = stations
        self._streams = Streams(seed)
        self.queue = EventQueue()
        self.trajectories = Trajectories(stations)
        self._links = Links(config, self.trajectories, stations, self._streams)
        self._medium = Medium(
            config=config,
            queue=self.queue,
            links=self._links,
            stations=stations,
            streams=self._streams,
            on_ended=self._on_ended,
        )
        self._broadcast_mode = phy_mode(config.broadcast_mode, config.bandwidth_mhz)
        self._host_jitter = [Uniforms(self._streams.generator(Model.HOST, i)) for i in range(stations)]
        self._bias_m: dict[tuple[int, int], float] = {}
        used = {config.broadcast_access_category, config.ftm.access_category}
        access: dict[str, AccessParameters] = {
            name: parameters for name, parameters in EDCA.items() if name in used
        }
        clocks = [
            Clock(config.ftm.clock_ppm, self._streams.generator(Model.CLOCK, i)) for i in range(stations)
        ]
        self._ftm: list[FtmRadio] = []
        self._macs: list[Mac] = []
        for i in range(stations):
            ftm = FtmRadio(
                station=i,
                stations=stations,
                config=config,
                environment=self,
                clocks=clocks,
                generator=self._streams.generator(Model.TIME_STAMP, i),
                on_result=self._on_ranged,
            )
            mac = Mac(
                index=i,
                queue=self.queue,
                medium=self._medium,
                access=access,
                control_mode=phy_mode(config.control_mode, config.bandwidth_mhz),
                queue_frames=config.queue_frames,
                backoff=Uniforms(self._streams.generator(Model.BACKOFF, i)),
                upper=_Host(self, i, ftm),
            )
            ftm.attach(mac)
            self._ftm.append(ftm)
            self._macs.append(mac)
        self._silent: set[int] = set()
        self._submitted: list[tuple[int, int, int, TxItem]] = []
        self._received: list[tuple[int, int, int, int, RxItem]] = []
        self._frames: list[FrameRecord] = []
        self._sessions: list[SessionRecord] = []
        self._sent = dict.fromkeys(FrameKind, 0)
        self._drops: Counter[str] = Counter()
        self._broadcasts_delivered = [0] * stations
        self._broadcasts_collided = [0] * stations
        self._broadcasts_lost = [0] * stations
        self._ftm_requested = 0
        self._ftm_ended: Counter[str] = Counter()
        self._error_sum_m = 0.0
        self._error_square_sum_m2 = 0.0

    # --- the hosts' side

    def submit(self, batch: TxBatch) -> None:
        """Take a station's items; each is queued at its ``at_us`` plus the host's latency and jitter.

        Raises ValueError for a station that does not exist.
        """
        if batch.station >= self._stations:
            raise ValueError(f"there is no station {batch.station}: this channel has {self._stations}")
        for item in sorted(batch.items, key=lambda item: (item.at_us, item.seq)):
            jitter_ns = int(1_000 * self._config.host_jitter_us * self._host_jitter[batch.station].draw())
            ready_ns = 1_000 * (item.at_us + self._config.host_latency_us) + jitter_ns
            self._submitted.append((max(ready_ns, self.queue.now_ns), batch.station, item.seq, item))

    def advance(
        self, *, to_us: int, at_us: int, pos_ned_m: Doubles, vel_ned_m_s: Doubles
    ) -> list[tuple[int, RxItem]]:
        """Simulate up to and including ``to_us``.

        The stations are at ``pos_ned_m`` (n, 3) at ``at_us`` and move at ``vel_ned_m_s`` (n, 3). Returns
        (station, item) in order of (time, source, seq, station), where the source of a ranging result is its
        peer. Raises ValueError for arrays of another shape or that are not finite, or a time that is past.
        """
        positions, velocities = (np.asarray(each, dtype=np.float64) for each in (pos_ned_m, vel_ned_m_s))
        for each in (positions, velocities):
            if each.shape != (self._stations, 3) or not np.isfinite(each).all():
                raise ValueError(
                    f"positions and velocities must be finite and of shape ({self._stations}, 3)"
                )
        to_ns = 1_000 * to_us
        if to_ns < self.queue.now_ns:
            raise ValueError(f"cannot go back to {to_us} us: it is {self.queue.now_ns // 1_000} us")
        self.trajectories.set(1_000 * at_us, _vectors(positions), _vectors(velocities))
        self._submitted.sort(key=lambda entry: entry[:3])
        for ready_ns, station, _, item in self._submitted:
            self.queue.at(ready_ns, self._on_ready, (station, item))
        self._submitted.clear()
        self.queue.run_until(to_ns)
        received = sorted(self._received, key=lambda entry: entry[:4])
        self._received.clear()
        return [(station, item) for _, _, _, station, item in received]

    @property
    def next_event_us(self) -> int:
        """Unless something is submitted, nothing happens before this time; rounded down."""
        submitted_ns = min((entry[0] for entry in self._submitted), default=NOTHING_PENDING_US * 1_000)
        return min(submitted_ns // 1_000, self.queue.next_ns() // 1_000, NOTHING_PENDING_US)

    def _on_ready(self, entry: tuple[int, TxItem]) -> None:
        station, item = entry
        if station in self._silent:
            return
        if isinstance(item, Broadcast):
            self._broadcast(station, item)
            return
        self._ftm_requested += 1
        timeout_ns = 1_000 * (item.at_us + self._config.ftm.request_timeout_us)
        self._ftm[station].request(item.peer, item.seq, timeout_ns)

    def _broadcast(self, station: int, item: Broadcast) -> None:
        job = Job(
            kind=FrameKind.DATA,
            destination=GROUP,
            mode=self._broadcast_mode,
            frame_bytes=len(item.payload) + UDP_OVERHEAD_BYTES + DATA_OVERHEAD_BYTES,
            expires_ns=self.queue.now_ns + 1_000 * self._config.queue_lifetime_us,
            retry_limit=self._config.rts_retry_limit,
            done=self._on_broadcast_done,
            seq=item.seq,
            body=item.payload,
            rts=self._config.broadcast_rts,
        )
        self._macs[station].enqueue(self._config.broadcast_access_category, job)

    def _on_broadcast_done(self, _job: Job, outcome: Outcome) -> None:
        if outcome is not Outcome.SENT:
            self._drops[outcome.value] += 1

    def deliver(
        self, station: int, transmission: Transmission, payload: bytes, power_mw: float, end_ns: int
    ) -> None:
        """Put a datagram that has reached a station among its deliveries."""
        frame = transmission.frame
        rssi_dbm = 10.0 * log10(power_mw)
        item = Delivery(
            source=frame.source, seq=frame.seq, received_ns=end_ns, rssi_dbm=rssi_dbm, payload=payload
        )
        self._received.append((end_ns, frame.source, frame.seq, station, item))

    def _on_ranged(self, ranging: Ranging) -> None:
        self._ftm_ended[ranging.status] += 1
        if ranging.status == "ok":
            error_m = ranging.distance_m - ranging.true_distance_m
            self._error_sum_m += error_m
            self._error_square_sum_m2 += error_m * error_m
        self._sessions.append(
            SessionRecord(
                measured_ns=ranging.measured_ns,
                initiator=ranging.initiator,
                peer=ranging.peer,
                status=ranging.status,
                distance_m=ranging.distance_m,
                true_distance_m=ranging.true_distance_m,
                distance_std_m=ranging.distance_std_m,
                round_trips=ranging.round_trips,
                rssi_dbm=ranging.rssi_dbm,
            )
        )
        if ranging.initiator in self._silent:
            return
        result = FtmResult(
            peer=ranging.peer,
            seq=ranging.seq,
            status=ranging.status,
            measured_ns=ranging.measured_ns,
            distance_m=ranging.distance_m,
            distance_std_m=ranging.distance_std_m,
            rssi_dbm=ranging.rssi_dbm,
            round_trips=ranging.round_trips,
        )
        self._received.append((ranging.ended_ns, ranging.peer, ranging.seq, ranging.initiator, result))

    # --- the run's side

    def set_silent(self, station: int) -> None:
        """End a station's radio: nothing is sent, answered or heard. Its frame on the air is completed."""
        if station in self._silent:
            return
        self._silent.add(station)
        self._macs[station].silence()
        self._ftm[station].silence()

    def set_extra_attenuation_db(self, value: float | None) -> None:
        """Attenuate every frame that starts from now on by this; None is the configured value."""
        self._links.set_extra_attenuation_db(value)

    @property
    def busy_ns(self) -> int:
        """Time since the start for which the medium carried at least one transmission."""
        return self._medium.busy_ns()

    @property
    def counters(self) -> Counters:
        """Counts since the start."""
        return Counters(
            frames_sent={kind.value: self._sent[kind] for kind in FrameKind},
            broadcasts_delivered=tuple(self._broadcasts_delivered),
            broadcasts_collided=tuple(self._broadcasts_collided),
            broadcasts_lost_to_noise=tuple(self._broadcasts_lost),
            drops=dict(sorted(self._drops.items())),
            ftm=FtmCounters(
                requested=self._ftm_requested,
                completed=self._ftm_ended["ok"],
                failed={status: count for status, count in sorted(self._ftm_ended.items()) if status != "ok"},
                error_sum_m=self._error_sum_m,
                error_square_sum_m2=self._error_square_sum_m2,
            ),
        )

    def take_frames(self) -> list[FrameRecord]:
        """Transmissions that ended since the last call, in order of their end."""
        frames, self._frames = self._frames, []
        return frames

    def take_sessions(self) -> list[SessionRecord]:
        """Ranging sessions that ended since the last call, in order of their end."""
        sessions, self._sessions = self._sessions, []
        return sessions

    def calibration_bias_m(self, a: int, b: int) -> float:
        """Constant range offset that calibration left between two devices."""
        if self._config.ftm.calibration_bias_std_m == 0.0:
            return 0.0
        pair = (min(a, b), max(a, b))
        if pair not in self._bias_m:
            generator = self._streams.generator(Model.CALIBRATION, *pair)
            self._bias_m[pair] = float(generator.normal(0.0, self._config.ftm.calibration_bias_std_m))
        return self._bias_m[pair]

    def _on_ended(self, transmission: Transmission) -> None:
        frame = transmission.frame
        self._sent[frame.kind] += 1
        if frame.kind is FrameKind.DATA:
            for counts, receivers in (
                (self._broadcasts_delivered, transmission.delivered),
                (self._broadcasts_collided, transmission.collided),
                (self._broadcasts_lost, transmission.lost_to_noise),
            ):
                for receiver in receivers:
                    counts[receiver] += 1
        self._frames.append(
            FrameRecord(
                transmission.start_ns,
                transmission.end_ns,
                frame.source,
                frame.destination,
                frame.kind,
                frame.mode.name,
                frame.bytes,
                frame.seq,
                len(transmission.delivered),
                len(transmission.collided),
                len(transmission.lost_to_noise),
            )
        )


def _vectors(rows: Doubles) -> list[Vector]:
    return [(x, y, z) for x, y, z in rows.tolist()]
