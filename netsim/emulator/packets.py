"""Packets of network interfaces on the channel: frames of a vehicle's radio beside its application's.

A packet uses its sender's queues, modes and retries as a datagram does. It has no latency of a host, since
the kernel of the interface is the host.
"""

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from netsim.emulator.records import PacketCounters
from netsim.mac.jobs import DatagramReception, FrameSender, Job, JobOutcome
from netsim.mac.rates import DatagramModes
from netsim.model.config import RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.phy.frames import DATA_OVERHEAD_BYTES, GROUP, SNAP_OVERHEAD_BYTES, FrameKind, Packet
from netsim.wire.addresses import is_group, station_of
from netsim.wire.messages import Station
from netsim.wire.packets import SentPacket

UNKNOWN_DESTINATION = "unknown_destination"
"""Outcome of a packet to an address of no other station."""


class PacketReception(NamedTuple):
    """A packet that has reached stations."""

    end_ns: int
    """Simulated time of the frame's end at the latest of their antennas."""
    stations: tuple[Station, ...]
    """The receivers, in the order of their numbers"""
    source: Station
    destination: bytes
    """MAC address"""
    ether_type: int
    payload: bytes


class Packets:
    """Queues packets at their senders' MACs, and holds receptions until they are taken.

    ``macs`` and ``modes`` are indexed by station; ``silent`` stations do not send.
    """

    def __init__(
        self,
        *,
        config: RadioConfig,
        queue: EventQueue,
        macs: Sequence[FrameSender],
        modes: Sequence[DatagramModes],
        silent: set[int],
    ) -> None:
        self._config = config
        self._queue = queue
        self._macs = macs
        self._modes = modes
        self._silent = silent
        self._receptions: list[PacketReception] = []
        self._ended: Counter[Station] = Counter()
        self._submitted = 0
        self._outcomes: Counter[str] = Counter()
        self._delivered = 0
        self._lost_by_hosts = 0

    def submit(self, packet: SentPacket, at_ns: int) -> None:
        """Queue a packet at its sender at simulated time ``at_ns``, or now if that is in the past.

        Raises ValueError for a station that does not exist.
        """
        if packet.station >= len(self._macs):
            raise ValueError(f"packet of station {packet.station}: there are {len(self._macs)} stations")
        self._submitted += 1
        self._queue.at(max(at_ns, self._queue.now_ns), self._enqueue, packet)

    def add(self, packet: Packet, received: DatagramReception, lost: Sequence[bool]) -> None:
        """Add a packet's reception; the hosts of the stations with ``lost`` have lost it."""
        reached = [
            (station, end_ns)
            for station, end_ns, is_lost in zip(received.stations, received.ends_ns, lost, strict=True)
            if not is_lost
        ]
        self._lost_by_hosts += len(lost) - len(reached)
        self._delivered += len(reached)
        if reached:
            stations, ends_ns = zip(*sorted(reached), strict=True)
            self._receptions.append(PacketReception(max(ends_ns), stations, received.source, *packet))

    def take(self) -> list[PacketReception]:
        """Return and clear the receptions, in order of their end and source."""
        receptions, self._receptions = self._receptions, []
        receptions.sort(key=lambda each: (each.end_ns, each.source))
        return receptions

    def take_ended(self) -> dict[Station, int]:
        """Return and clear the numbers of packets that have left the queues, by sender."""
        ended, self._ended = self._ended, Counter()
        return dict(sorted(ended.items()))

    @property
    def counters(self) -> PacketCounters | None:
        """Counters since the start of the run; None if no packet was submitted."""
        if not self._submitted:
            return None
        return PacketCounters(
            outcomes=dict(sorted(self._outcomes.items())),
            delivered=self._delivered,
            lost_by_hosts=self._lost_by_hosts,
        )

    def _enqueue(self, packet: SentPacket) -> None:
        config, source = self._config, packet.station
        to = GROUP if is_group(packet.destination) else station_of(packet.destination)
        if source in self._silent:
            self._end(source, JobOutcome.EXPIRED)
            return
        if to is None or to == source or to >= len(self._macs):
            self._end(source, UNKNOWN_DESTINATION)
            return
        modes = self._modes[source]
        frame_bytes = len(packet.payload) + SNAP_OVERHEAD_BYTES + DATA_OVERHEAD_BYTES
        job = Job(
            kind=FrameKind.DATA,
            destination=to,
            mode=modes.data,
            rates=modes.rates,
            frame_bytes=frame_bytes,
            expires_ns=self._queue.now_ns + 1_000 * config.queue_lifetime_us,
            retry_limit=config.retry_limit,
            done=partial(self._on_done, source),
            body=Packet(packet.destination, packet.ether_type, packet.payload),
            rts=frame_bytes > config.rts_threshold_bytes,
            deferred=True,
        )
        if to == GROUP:
            job.mode, job.rates = modes.broadcast, None
            job.retry_limit, job.rts = config.rts_retry_limit, config.broadcast_rts
        self._macs[source].enqueue(packet.category, job)

    def _on_done(self, source: int, _job: Job, outcome: JobOutcome) -> None:
        self._end(source, outcome)

    def _end(self, source: int, outcome: str) -> None:
        self._outcomes[str(outcome)] += 1
        self._ended[source] += 1
