"""The ideal channel, the reference for the emulated one: every frame reaches all stations in range.

A frame is sent as soon as it is enqueued, regardless of other transmissions, also of the same station, and
takes its normal air time. A station receives it after the propagation delay if path loss, antennas and extra
attenuation leave at least ``cca_preamble_dbm``. A unicast frame is acknowledged after SIFS; without an ACK
that begins in time it is sent again at the time-out, up to the retry limit. Ranging (`netsim.ftm`) runs on
top: its frames have their normal air time and its time stamps their noise.

Not modelled, whatever the settings: contention, reservations (no RTS, no NAV), queues, collisions, noise,
fading, shadowing, blocked lines of sight and interferers. The medium is never busy.
"""

from collections.abc import Callable

import msgspec
import numpy as np

from netsim.emulator.records import FrameRecord
from netsim.mac.jobs import DatagramReception, Job, JobOutcome, OnDatagram, Reception, Upper
from netsim.model import codes as c
from netsim.model.config import RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.tables import Integers
from netsim.phy.frames import ACK_BYTES, GROUP, KINDS, Frame, FrameKind, Transmission
from netsim.phy.modes import MODE_NAMES, response_mode
from netsim.phy.propagation import Links
from netsim.phy.receptions import OUTCOMES, Receptions, without_noise
from netsim.phy.timing import RX_START_DELAY_NS, timing_of


def undisturbed(config: RadioConfig) -> RadioConfig:
    """Return the settings without fading, shadowing, blocked lines of sight and interferers."""
    return msgspec.structs.replace(config, fading="none", shadowing="none", nlos_fraction=0.0, interferers=())


class IdealChannel:
    """All stations' radios on a channel without contention; the interface is that of `Radios`."""

    def __init__(
        self,
        *,
        config: RadioConfig,
        queue: EventQueue,
        links: Links,
        stations: int,
        on_datagram: OnDatagram,
        on_ended: Callable[[Transmission], None] | None,
    ) -> None:
        self.queue = queue
        self.on_datagram = on_datagram
        self.timing = timing_of(config)
        self._stations = stations
        self._on_ended = on_ended
        self._sent = [0] * len(KINDS)
        self._broadcasts = np.zeros((stations, 3), np.int64)
        self._frames: list[tuple[int, ...]] = []
        """Rows since the last `take_frames`."""
        self._links = links
        self._reports_receptions = config.reports_receptions
        self._least_mw = 10.0 ** (config.cca_preamble_dbm / 10.0)
        self.radios: list[IdealRadio] = []

    def join(self, station: int, upper: Upper) -> "IdealRadio":
        """Add a station; stations are added in the order of their numbers."""
        radio = IdealRadio(station, self, upper)
        self.radios.append(radio)
        return radio

    def note_end(self, transmission: Transmission) -> None:
        """Record a frame that has ended."""
        frame = transmission.frame
        kind = KINDS.index(frame.kind)
        ends = transmission.delivered, transmission.collided, transmission.lost_to_noise
        self._sent[kind] += 1
        if frame.kind is FrameKind.DATA and frame.destination == GROUP:
            for end, receivers in enumerate(ends):
                self._broadcasts[receivers, end] += 1
        mode = MODE_NAMES.index(frame.mode.name)
        what = frame.source, frame.destination, kind, mode, frame.frame_bytes, frame.seq
        self._frames.append((transmission.start_ns, transmission.end_ns, *what, *map(len, ends)))
        if self._on_ended is not None:
            if self._reports_receptions:
                transmission.receptions = self._receptions(transmission)
            self._on_ended(transmission)

    def _receptions(self, transmission: Transmission) -> Receptions:
        """Return the receptions of a frame; a station that is not addressed receives it if it is in range."""
        outcomes = np.array([radio.silent for radio in self.radios]) * OUTCOMES.index("radio_off")
        outcomes[transmission.delivered] = c.DELIVERED
        outcomes[transmission.lost_to_noise] = c.LOST
        return without_noise(transmission.powers_mw, self._least_mw, outcomes)

    def frames_sent(self) -> list[int]:
        """Return the number of ended frames by kind."""
        return self._sent

    def broadcasts(self) -> Integers:
        """Return broadcast datagrams (n, 3) by receiver: delivered, collided, lost to noise."""
        return self._broadcasts

    def take_frames(self) -> Integers:
        """Return the frames that ended since the last call, as `netsim.mac.radios.Radios.take_frames`."""
        frames, self._frames = self._frames, []
        return np.array(frames, np.int64).reshape(-1, len(FrameRecord._fields))

    def busy_ns(self) -> int:
        """Return 0: the medium is never busy."""
        return 0

    def surveyed_ns(self) -> list[int]:
        """Return 0 for every station: none senses the medium busy."""
        return [0] * self._stations

    def start(self, frame: Frame) -> Transmission:
        """Start the transmission of a frame now."""
        row = self._links.row(frame.source, self.queue.now_ns)
        return Transmission(frame, self.queue.now_ns, row.powers_mw, row.delays_ns, row.longest_delay_ns)

    def reach(self, transmission: Transmission, station: int) -> "IdealRadio | None":
        """Return an intended receiver's radio, None if it is off or out of range; records the outcome."""
        radio = self.radios[station]
        if radio.silent:
            return None
        if transmission.powers_mw.item(station) < self._least_mw:
            transmission.lost_to_noise.append(station)
            return None
        transmission.delivered.append(station)
        return radio

    def deliver_group_frame(self, transmission: Transmission) -> None:
        """Deliver a group frame to all stations in range."""
        frame = transmission.frame
        others = (i for i in range(self._stations) if i != transmission.source)
        stations = [i for i in others if self.reach(transmission, i) is not None]
        if stations:
            ends_ns = [transmission.end_ns + transmission.delays_ns.item(i) for i in stations]
            powers_mw = [transmission.powers_mw.item(i) for i in stations]
            self.on_datagram(
                DatagramReception(frame.source, frame.seq, frame.body, stations, ends_ns, powers_mw)
            )


class _Exchange(msgspec.Struct, eq=False):
    """Transmission attempts of one unicast frame."""

    job: Job
    arrived: bool = False
    """The station has received the frame; its ACK may be missing."""
    over: bool = False


class IdealRadio:
    """MAC of one station that sends every frame at once; see `netsim.mac.jobs.FrameSender`."""

    def __init__(self, index: int, channel: IdealChannel, upper: Upper) -> None:
        self.index = index
        self.silent = False
        self.upper = upper
        self._channel = channel
        self._queue = channel.queue
        self._timing = channel.timing
        self._sequence = 0
        self._exchanges: list[_Exchange] = []
        """Unfinished exchanges."""

    def enqueue(self, _category: str, job: Job, /) -> None:
        """Send a frame now; the access category has no effect."""
        job.ended_ns = self._queue.now_ns
        if self.silent:
            job.done(job, JobOutcome.OVERFLOW)
            return
        self._sequence += 1
        job.sequence = self._sequence
        if job.destination == GROUP:
            transmission = self._send(job)
            self._queue.at(
                transmission.end_ns + transmission.longest_delay_ns, self._on_group_ended, (job, transmission)
            )
        elif job.expires_ns <= self._queue.now_ns or job.cancelled:
            job.done(job, JobOutcome.EXPIRED)
        else:
            exchange = _Exchange(job)
            self._exchanges.append(exchange)
            self._attempt(exchange)

    def enqueue_at(self, at_ns: int, category: str, job: Job, /) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        self._queue.at(at_ns, self._enqueue_planned, (category, job))

    def _enqueue_planned(self, planned: tuple[str, Job]) -> None:
        if not self.silent:
            self.enqueue(*planned)

    def cancel(self, job: Job, /) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        job.cancelled = True

    def has_begun(self, job: Job, /) -> bool:
        """See `netsim.mac.jobs.FrameSender`: an enqueued frame is sent at once."""
        return job.attempts > 0

    def silence(self) -> None:
        """See `netsim.mac.jobs.FrameSender`: a frame on the air is completed."""
        self.silent = True
        for exchange in list(self._exchanges):
            self._finish(exchange, JobOutcome.EXPIRED)

    def _send(self, job: Job) -> Transmission:
        ack_ns = response_mode(job.mode).duration_ns(ACK_BYTES)
        frame = Frame(
            kind=job.kind,
            source=self.index,
            destination=job.destination,
            mode=job.mode,
            frame_bytes=job.frame_bytes,
            nav_ns=0 if job.destination == GROUP else self._timing.sifs_ns + ack_ns,
            seq=job.seq,
            sequence=job.sequence,
            body=job.body,
        )
        job.attempts += 1
        job.sent_ns = self._queue.now_ns
        return self._channel.start(frame)

    def _on_group_ended(self, ended: tuple[Job, Transmission]) -> None:
        job, transmission = ended
        self._channel.deliver_group_frame(transmission)
        job.done(job, JobOutcome.SENT)
        self._channel.note_end(transmission)

    # --- unicast frames

    def _attempt(self, exchange: _Exchange) -> None:
        job = exchange.job
        if exchange.over:
            return
        if job.rates is not None:
            job.mode = job.rates.mode_for(
                job.destination, frame_bytes=job.frame_bytes, failures=job.failures, now_ns=self._queue.now_ns
            )
        sent = self._send(job)
        self._queue.at(sent.end_ns + sent.delays_ns.item(job.destination), self._on_arrived, (exchange, sent))

    def _on_arrived(self, attempt: tuple[_Exchange, Transmission]) -> None:
        exchange, sent = attempt
        radio = self._channel.reach(sent, exchange.job.destination)
        if radio is None:
            self._await_time_out(exchange, sent)
        else:
            duplicate, exchange.arrived = exchange.arrived, True
            self._queue.at(self._queue.now_ns + self._timing.sifs_ns, self._send_ack, (exchange, sent))
            self._deliver(exchange.job, _reception(sent, radio.index, duplicate=duplicate), radio)
        self._channel.note_end(sent)

    def _deliver(self, job: Job, reception: Reception, to: "IdealRadio") -> None:
        if not job.deferred:
            to.upper.on_frame(reception)
        elif not reception.duplicate:
            self._channel.on_datagram(
                DatagramReception(
                    reception.source, reception.seq, reception.body, [to.index], [reception.end_ns],
                    [reception.power_mw],
                )
            )  # fmt: skip

    def _send_ack(self, attempt: tuple[_Exchange, Transmission]) -> None:
        """Send the ACK, unless the responder's radio is off."""
        exchange, sent = attempt
        data = sent.frame
        mode = response_mode(data.mode)
        if self._channel.radios[data.destination].silent:
            self._await_time_out(exchange, sent)
            return
        ack = self._channel.start(
            Frame(
                kind=FrameKind.ACK,
                source=data.destination,
                destination=self.index,
                mode=mode,
                frame_bytes=ACK_BYTES,
            )
        )
        delay_ns = ack.delays_ns.item(self.index)
        in_time = ack.start_ns + delay_ns + RX_START_DELAY_NS <= self._timed_out_ns(sent)
        if not in_time:
            self._await_time_out(exchange, sent)
        self._queue.at(ack.end_ns + delay_ns, self._on_ack, (exchange, sent, ack, in_time))

    def _on_ack(self, attempt: tuple[_Exchange, Transmission, Transmission, bool]) -> None:
        """Process the end of an ACK, whose reception may have begun after the time-out."""
        exchange, sent, ack, in_time = attempt
        received = self._channel.reach(ack, self.index) is not None
        if in_time and not received:
            self._await_time_out(exchange, sent)
        elif in_time and not exchange.over:
            job = exchange.job
            job.ack = _reception(ack, self.index)
            job.ended_ns = job.ack.end_ns
            if job.rates is not None:
                job.rates.report(job.destination, job.mode, acknowledged=True)
            self._finish(exchange, JobOutcome.ACKNOWLEDGED)
        self._channel.note_end(ack)

    def _await_time_out(self, exchange: _Exchange, sent: Transmission) -> None:
        self._queue.at(max(self._queue.now_ns, self._timed_out_ns(sent)), self._on_time_out, exchange)

    def _timed_out_ns(self, sent: Transmission) -> int:
        return sent.end_ns + self._timing.response_timeout_ns

    def _on_time_out(self, exchange: _Exchange) -> None:
        job = exchange.job
        if exchange.over:
            return
        if job.rates is not None:
            job.rates.report(job.destination, job.mode, acknowledged=False)
        job.failures += 1
        if job.failures > job.retry_limit:
            self._finish(exchange, JobOutcome.RETRY_LIMIT)
        elif job.expires_ns <= self._queue.now_ns or job.cancelled:
            self._finish(exchange, JobOutcome.EXPIRED)
        else:
            self._attempt(exchange)

    def _finish(self, exchange: _Exchange, outcome: JobOutcome) -> None:
        exchange.over = True
        if outcome is not JobOutcome.ACKNOWLEDGED:
            exchange.job.ended_ns = self._queue.now_ns
        self._exchanges.remove(exchange)
        exchange.job.done(exchange.job, outcome)


def _reception(transmission: Transmission, station: int, *, duplicate: bool = False) -> Reception:
    """Return the reception of a frame at a station."""
    frame, end_ns = transmission.frame, transmission.end_ns + transmission.delays_ns.item(station)
    power_mw = transmission.powers_mw.item(station)
    return Reception(frame.source, transmission.start_ns, end_ns, power_mw, frame.seq, frame.body, duplicate)
