"""Datagrams of the stations' hosts: jobs for the MACs, and reports of how they end."""

from collections.abc import Sequence
from functools import partial

from netsim.emulator.arrivals import Arrivals
from netsim.emulator.records import Tally
from netsim.mac.jobs import FrameSender, Job, JobOutcome
from netsim.mac.rates import DatagramModes
from netsim.model.config import RadioConfig
from netsim.model.event_queue import NEVER_NS, EventQueue
from netsim.phy.frames import DATA_OVERHEAD_BYTES, GROUP, UDP_OVERHEAD_BYTES, Datagram, FrameKind
from netsim.wire.messages import Broadcast, Sent, Unicast


class Datagrams:
    """Enqueues datagrams at their senders' MACs.

    ``macs`` and ``modes`` are indexed by station; ``silent`` stations do not send. ``arrivals`` takes the
    reports of unicasts, and ``tally`` counts the outcomes.
    """

    def __init__(
        self,
        *,
        config: RadioConfig,
        queue: EventQueue,
        macs: Sequence[FrameSender],
        modes: Sequence[DatagramModes],
        arrivals: Arrivals,
        tally: Tally,
        silent: set[int],
    ) -> None:
        self._config = config
        self._queue = queue
        self._macs = macs
        self._modes = modes
        self._arrivals = arrivals
        self._tally = tally
        self._silent = silent

    def broadcast(self, station: int, at_ns: int, item: Broadcast) -> None:
        """Enqueue a datagram to all at ``at_ns``."""
        config = self._config
        job = Job(
            kind=FrameKind.DATA,
            destination=GROUP,
            mode=self._modes[station].broadcast,
            frame_bytes=len(item.payload) + UDP_OVERHEAD_BYTES + DATA_OVERHEAD_BYTES,
            expires_ns=at_ns + 1_000 * config.queue_lifetime_us,
            retry_limit=config.rts_retry_limit,
            done=self._on_broadcast_done,
            seq=item.seq,
            body=Datagram(item.port, item.payload),
            rts=config.broadcast_rts,
            deferred=True,
        )
        self._macs[station].enqueue_at(at_ns, config.broadcast_access_category, job)

    def send(self, station: int, at_ns: int, item: Unicast) -> None:
        """Enqueue a datagram to one station at ``at_ns``; reject it if there is no such other station."""
        if item.destination == station or item.destination >= len(self._macs):
            self._queue.at(at_ns, self._reject, (station, item))
            return
        job = self._job(station, item.destination, len(item.payload))
        job.expires_ns = at_ns + 1_000 * self._config.queue_lifetime_us
        job.seq, job.body = item.seq, Datagram(item.port, item.payload)
        self._macs[station].enqueue_at(at_ns, self._config.data_access_category, job)

    def saturate(self, station: int, destination: int, payload_bytes: int) -> None:
        """Fill a station's queue with datagrams that repeat: see `netsim.emulator.emulator.Emulator`."""
        if self._modes[station].rates is not None:
            raise ValueError(f"station {station}: the data mode must not be adaptive, to be saturated")
        # while one is sent, the next one is in the queue
        for _ in range(2):
            job = self._job(station, destination, payload_bytes)
            job.repeats = True
            self._macs[station].enqueue_at(self._queue.now_ns, self._config.data_access_category, job)

    def _job(self, station: int, destination: int, payload_bytes: int) -> Job:
        """Return a job of a datagram to one station without content, which never expires."""
        config, modes = self._config, self._modes[station]
        frame_bytes = payload_bytes + UDP_OVERHEAD_BYTES + DATA_OVERHEAD_BYTES
        return Job(
            kind=FrameKind.DATA,
            destination=destination,
            mode=modes.data,
            rates=modes.rates,
            frame_bytes=frame_bytes,
            expires_ns=NEVER_NS,
            retry_limit=config.retry_limit,
            done=partial(self._on_unicast_done, station),
            rts=frame_bytes > config.rts_threshold_bytes,
            deferred=True,
        )

    def _on_broadcast_done(self, _job: Job, outcome: JobOutcome) -> None:
        if outcome is not JobOutcome.SENT:
            self._tally.drops[outcome.value] += 1

    def _on_unicast_done(self, station: int, job: Job, outcome: JobOutcome) -> None:
        if not job.repeats:
            self._report(station, job.destination, job.seq, outcome.value, job.attempts, job.ended_ns)

    def _reject(self, entry: tuple[int, Unicast]) -> None:
        station, item = entry
        if station not in self._silent:
            self._report(station, item.destination, item.seq, "rejected", 0, self._queue.now_ns)

    def _report(
        self, station: int, destination: int, seq: int, status: str, attempts: int, ended_ns: int
    ) -> None:
        self._tally.unicasts[status] += 1
        self._arrivals.add_report(
            station,
            Sent(destination=destination, seq=seq, ended_ns=ended_ns, status=status, attempts=attempts),
        )
