"""All radios of the emulated channel: the tables, and the Python side of their events.

`netsim.mac.loop` runs the events in compiled code. This module supplies what is not compiled (link budgets,
adaptive modes, interferers, random streams) and dispatches calls to the upper layers.
"""

from collections.abc import Callable
from functools import partial
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from foundation.kernels.records import Block, new_records, record_dtype
from netsim.mac import loop
from netsim.mac.access_parameters import DCF, EDCA, edca_parameters
from netsim.mac.initial_state import silent_block
from netsim.mac.interference import Bursts
from netsim.mac.jobs import DatagramReception, Job, JobOutcome, OnDatagram, Reception, Upper
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.config import RadioConfig
from netsim.model.event_queue import NEVER_NS, EventQueue
from netsim.model.random_streams import FloatStream, Model, RandomStreams
from netsim.model.records import BUFFERED_DRAWS, NewJob
from netsim.model.tables import Integers, Records
from netsim.phy.errors import ERRORS
from netsim.phy.fading import SampledFading
from netsim.phy.frames import KINDS, Frame, Transmission
from netsim.phy.interfaces import ErrorModel
from netsim.phy.modes import MODE_NAMES
from netsim.phy.path_loss import Doubles
from netsim.phy.propagation import Links
from netsim.phy.receptions import receptions_of
from netsim.phy.timing import channel_mode

KIND_ROWS = {kind: row for row, kind in enumerate(KINDS)}
OUTCOMES = list(JobOutcome)
_NO_FADING = np.empty(0)
_AT_END = ["sequence", "attempts", "failures", "sent_ns"]
_COUNTS = ["calls", "arrivals", "ended_jobs"]
_NEW_JOB = record_dtype(NewJob)
_FRAME = itemgetter(0)


class Radios:
    """Stations that contend for one medium.

    ``on_datagram`` is called with received group frames and frames of deferred jobs
    (`netsim.mac.jobs.Job.deferred`); other frames go to the stations. ``on_ended`` is called with every frame
    that has ended at all stations.
    """

    def __init__(
        self,
        *,
        config: RadioConfig,
        queue: EventQueue,
        links: Links,
        stations: int,
        streams: RandomStreams,
        on_datagram: OnDatagram,
        on_ended: Callable[[Transmission], None] | None,
        errors: ErrorModel = ERRORS,
    ) -> None:
        self._config = config
        self._queue = queue
        self._links = links
        self._on_datagram = on_datagram
        self._on_ended = on_ended
        edca = config.access == "edca"
        parameters = list(edca_parameters(config.edca_edition).values()) if edca else [DCF]
        self._categories = {category: k if edca else 0 for k, category in enumerate(EDCA)}
        """Queue by access category; with DCF all share one."""
        self._queues_each = len(parameters)
        block, self._modes = silent_block(
            config, stations=stations, queues=parameters, errors=errors, observed=on_ended is not None
        )
        self._use(block)
        self._fading_block = _NO_FADING if links.fading is None else links.fading.block
        self._sampled = links.fading if isinstance(links.fading, SampledFading) else None
        self._links_version = links.version
        self._uppers: list[Upper] = []
        self._backoffs = [streams.uniforms(Model.BACKOFF, i) for i in range(stations)]
        self._receptions = [streams.uniforms(Model.RECEPTION, i) for i in range(stations)]
        self._jobs: list[Job] = []
        """Jobs by row; a free row holds its previous job."""
        self._free_jobs: list[int] = []
        self._planned: list[tuple[int | bool, ...]] = []
        """Fields of `NewJob` of the jobs to be enqueued later that the table has not yet."""
        self._new_job = new_records(NewJob)
        self._taken: list[Integers] = []
        """Blocks of records moved out of the full table."""
        self._bursts = Bursts(config, queue, streams, self._start_burst)
        queue.machine = self

    # --- stations

    def join(self, station: int, upper: Upper) -> "RadioStation":
        """Add the next station, in the order of their numbers; its received frames go to ``upper``."""
        self._uppers.append(upper)
        return RadioStation(station, self)

    def enqueue(self, station: int, category: str, job: Job) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        queue = self._queue
        self._new_job[0] = self._fields_of_new(station, category, job, queue.now_ns, 0)
        end, queue.scheduled, calls = loop.enqueue(self._block, queue.now_ns, queue.scheduled, self._new_job)
        if end == loop.LACKS_ROOM:
            self._make_ready()
            end, queue.scheduled, calls = loop.enqueue(
                self._block, queue.now_ns, queue.scheduled, self._new_job
            )
        if calls:
            self._dispatch_calls()
        if end == loop.REJECTED and job.row is not None:
            self._free_jobs.append(job.row)
            job.row, job.ended_ns = None, queue.now_ns
            job.done(job, JobOutcome.OVERFLOW)

    def enqueue_at(self, station: int, at_ns: int, category: str, job: Job) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        self._queue.scheduled += 1
        self._planned.append(self._fields_of_new(station, category, job, at_ns, self._queue.scheduled))

    def _fields_of_new(
        self, station: int, category: str, job: Job, at_ns: int, order: int
    ) -> tuple[int | bool, ...]:
        """Give a job a row of the table, and return its fields of `NewJob`."""
        if self._free_jobs:
            row = self._free_jobs.pop()
            self._jobs[row] = job
        else:
            row = self._new_job_row(job)
        job.row = row
        return (
            at_ns, order, station * self._queues_each + self._categories[category], row,
            KIND_ROWS[job.kind], job.destination, self._modes[job.mode], job.frame_bytes, job.expires_ns,
            job.retry_limit, job.rts, job.rates is not None, job.deferred, job.repeats, job.seq,
            job.cancelled,
        )  # fmt: skip

    def _plan(self) -> None:
        """Put the jobs to be enqueued later into the table."""
        planned, self._planned = self._planned, []
        events = int(self.tables.air["events"][0]) + len(planned)
        if events > len(self.tables.events):
            self._grow(events=2 * events)
        loop.plan(self._block, np.array(planned, _NEW_JOB))

    def _new_job_row(self, job: Job) -> int:
        row = len(self._jobs)
        self._jobs.append(job)
        if row == len(self.tables.jobs):
            self._grow(jobs=2 * row)
        return row

    def cancel(self, job: Job) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        job.cancelled = True
        if job.row is not None:
            self.tables.jobs["cancelled"][job.row] = True

    def has_begun(self, job: Job) -> bool:
        """See `netsim.mac.jobs.FrameSender`."""
        if job.row is None:
            return job.attempts > 0
        return bool(self.tables.jobs["attempts"][job.row] > 0)

    def silence(self, station: int) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        self._make_ready()
        self._report_deferred()
        loop.silence(self._block, station)
        # a frame of the station may be on the air: its receivers still need the job's body
        self._dispatch_calls(keep=True)

    # --- state and statistics

    def busy_ns(self) -> int:
        """Return the time up to now for which the medium carried at least one signal."""
        air = self.tables.air[0]
        return int(air.busy_ns - max(0, air.busy_until_ns - self._queue.now_ns))

    def surveyed_ns(self) -> list[int]:
        """Return the time up to now, by station, for which it sensed the medium busy or was sending."""
        surveyed: list[int] = loop.surveyed_ns(self._block, self._queue.now_ns).tolist()
        return surveyed

    def frames_sent(self) -> list[int]:
        """Return the number of ended frames by kind."""
        sent: list[int] = self.tables.air["sent"][0].tolist()
        return sent

    def broadcasts(self) -> Integers:
        """Return broadcast datagrams (n, 3) by receiver: delivered, collided, lost to noise."""
        return self.tables.stations["broadcasts"].copy()

    def repeated(self) -> Integers:
        """Return the ends of jobs that repeat (n, outcomes), in the order of `netsim.mac.jobs.JobOutcome`."""
        return self.tables.stations["repeated"][:, : len(OUTCOMES)].copy()

    def take_frames(self) -> Integers:
        """Return the frames that ended since the last call: see `netsim.emulator.records`."""
        self._put_records_aside()
        taken, self._taken = self._taken, []
        return taken[0] if len(taken) == 1 else np.concatenate(taken)

    def _put_records_aside(self) -> None:
        air, records = self.tables.air[0], self.tables.records
        self._taken.append(records[: air.records].view(np.int64).reshape(-1, records.itemsize // 8).copy())
        air.records = 0

    # --- events

    def next_ns(self) -> int:
        """See `netsim.model.event_queue.EventSource`."""
        if self._planned:
            self._plan()
        return int(loop.next_ns(self._block, NEVER_NS))

    def begin(self) -> None:
        """See `netsim.model.event_queue.EventSource`."""
        if self._planned:
            self._plan()
        version = self._links.version
        if version != self._links_version:
            self._links_version = version
            self.tables.stations["budget_until_ns"] = -1

    def run(self, until_ns: int, until_order: int) -> bool:
        """See `netsim.model.event_queue.EventSource`."""
        queue, limit = self._queue, (until_ns, until_order)
        while True:
            why, now_ns, queue.scheduled, needed_by = loop.run(
                self._block, self._fading_block, queue.now_ns, queue.scheduled, *limit
            )
            if why == loop.REACHED:
                return True
            queue.now_ns = now_ns
            if why == loop.NEEDS_BUDGET:
                self._update_budget(needed_by, now_ns)
            elif why == loop.HAS_CALLS:
                self._dispatch_calls()
                return False
            elif why == loop.NEEDS_MODE:
                self._choose_mode(needed_by)
                return False
            else:
                self._make_ready()

    def end(self) -> None:
        """See `netsim.model.event_queue.EventSource`."""
        self._report_deferred()

    def _make_ready(self) -> None:
        """Provide random draws and free rows for the next event, and set the clock."""
        tables = self.tables
        air = tables.air[0]
        air.now_ns, air.scheduled = self._queue.now_ns, self._queue.scheduled
        if air.draws_low:
            air.draws_low = False
            self._draw_ahead()
        if air.records == c.RECORD_ROWS:
            self._put_records_aside()
        if air.arrivals >= c.RECORD_ROWS:
            self._report_deferred()
        events = int(air.events) + t.spare_events(len(tables.stations), self._queues_each)
        if events > len(tables.events):
            self._grow(events=2 * events)
        if air.free_signal == c.NOTHING:
            self._grow(signals=2 * len(tables.signals))

    def _draw_ahead(self) -> None:
        draws, stations = self.tables.draws, self.tables.stations
        _draw_ahead(stations["backoffs_used"], draws["backoffs"], self._backoffs)
        _draw_ahead(stations["receptions_used"], draws["receptions"], self._receptions)

    def discard_drawn(self) -> None:
        """Discard the draws of all stations that were made in advance, and make others in their place."""
        stations = self.tables.stations
        stations["backoffs_used"] = stations["receptions_used"] = BUFFERED_DRAWS
        self._draw_ahead()

    def _grow(self, *, events: int = 0, jobs: int = 0, signals: int = 0) -> None:
        self._use(t.grown(self._block, events=events, jobs=jobs, signals=signals))

    def _use(self, block: Block) -> None:
        """Use this block from now on, with views of the fields that are read for every frame."""
        tables = t.tables_of(block)
        self._block, self._modes.tables = block, tables
        self.tables = tables
        """The current tables, which are replaced when they grow."""
        self._counts: Records = tables.air[_COUNTS]
        self._jobs_at_end = tables.jobs[_AT_END]

    def _update_budget(self, source: int, at_ns: int) -> None:
        row = self._links.row(source, at_ns)
        until_ns = max(row.until_ns, at_ns)
        if self._sampled is not None:
            self._sampled.sample(source, at_ns)
            until_ns = at_ns  # the next frame needs gains of its own
        loop.set_budget(self._block, source, row.powers_mw, row.delays_ns, until_ns, row.longest_delay_ns)

    def _choose_mode(self, q: int) -> None:
        self._dispatch_calls()
        tables = self.tables
        row = int(tables.queues["first_job"][q])
        job = self._jobs[row]
        if job.rates is None:
            raise AssertionError("a mode is needed for a frame without rate control")
        job.mode = job.rates.mode_for(
            job.destination,
            frame_bytes=job.frame_bytes,
            failures=int(tables.jobs["attempts"][row]),
            now_ns=self._queue.now_ns,
        )
        tables.jobs["mode"][row] = self._modes[job.mode]
        tables.air["mode_chosen"] = True

    # --- interferers

    def _start_burst(self, interferer: int, end_ns: int) -> None:
        """Start an interferer's burst now."""
        now = self._queue.now_ns
        row = self._links.interferer_row(interferer, now)
        self._make_ready()
        self._queue.scheduled = loop.start_burst(
            self._block, -1 - interferer, end_ns, row.powers_mw, row.delays_ns, row.longest_delay_ns
        )

    # --- calls to the upper layers

    def _dispatch_calls(self, *, keep: bool = False) -> None:
        """Dispatch the calls of the last event; ``keep`` does not free the rows of ended jobs.

        Deferred receptions and ends come first, as they have happened.
        """
        tables = self.tables
        count, arrivals, ended_jobs = self._counts.item(0)
        if arrivals or ended_jobs:
            self._report_deferred(keep=keep)
        if not count:
            return
        self._counts["calls"] = 0
        pending: list[tuple[Any, Job | None]] = []
        # free the rows first: a callback may enqueue a frame at once
        for call in tables.calls[:count].tolist():
            what, _, row, *_ = call
            job = self._jobs[row] if row >= 0 else None
            pending.append((call, job))
            if what == c.DONE and job is not None:
                job.sequence, job.attempts, job.failures, sent_ns = self._jobs_at_end[row].tolist()
                job.sent_ns = sent_ns if job.attempts else None
                job.row = None
                if not keep:
                    self._free_jobs.append(row)
        for (what, station, _, detail, source, start_ns, end_ns, power_mw), job in pending:
            if what == c.FRAME:
                seq, body = (0, None) if job is None else (job.seq, job.body)
                reception = Reception(source, start_ns, end_ns, power_mw, seq, body, bool(detail))
                self._uppers[station].on_frame(reception)
            elif what == c.FRAME_ENDED:
                self._report_ended(job)
            elif what == c.DONE and job is not None:
                outcome = OUTCOMES[detail]
                if outcome is JobOutcome.ACKNOWLEDGED:
                    job.ack = Reception(source, start_ns, end_ns, power_mw)
                    if job.rates is not None:
                        job.rates.report(job.destination, job.mode, acknowledged=True)
                job.done(job, outcome)
            elif what == c.FAILED and job is not None and job.rates is not None:
                job.rates.report(job.destination, job.mode, acknowledged=False)

    def _report_deferred(self, *, keep: bool = False) -> None:
        """Report received datagrams, then deferred jobs that have ended, each in their order."""
        tables, jobs = self.tables, self._jobs
        _, arrivals, ended_jobs = self._counts.item(0)
        self._counts["arrivals"] = self._counts["ended_jobs"] = 0
        received, ended = tables.arrivals[:arrivals].tolist(), tables.ended_jobs[:ended_jobs].tolist()
        for _, of_frame in groupby(received, key=_FRAME):
            _, rows, stations, sources, ends_ns, powers_mw = zip(*of_frame, strict=True)
            seq, body = (jobs[rows[0]].seq, jobs[rows[0]].body) if rows[0] >= 0 else (0, None)
            self._on_datagram(DatagramReception(sources[0], seq, body, stations, ends_ns, powers_mw))
        for row, outcome, attempts, ended_ns in ended:
            job = jobs[row]
            job.row = None
            if not keep:
                self._free_jobs.append(row)
            if outcome == c.RADIO_OFF:
                continue
            job.attempts, job.ended_ns = attempts, ended_ns
            if outcome == c.ACKNOWLEDGED and job.rates is not None:
                job.rates.report(job.destination, job.mode, acknowledged=True)
            job.done(job, OUTCOMES[outcome])

    def _report_ended(self, job: Job | None) -> None:
        """Report the frame that has ended, and free its row."""
        tables = self.tables
        ended = int(tables.air["ended_frame"][0])
        signal, paths, outcomes = tables.signals[ended], tables.paths[ended], tables.ends["receiver_outcome"]
        frame = Frame(
            kind=KINDS[signal.kind],
            source=int(signal.source),
            destination=int(signal.to),
            mode=channel_mode(self._config, MODE_NAMES[signal.mode]),
            frame_bytes=int(signal.frame_bytes),
            nav_ns=int(signal.nav_ns),
            seq=int(signal.seq),
            sequence=int(signal.sequence),
            body=None if job is None else job.body,
        )
        delivered, collided, lost = (
            (outcomes == each).nonzero()[0].tolist() for each in (c.DELIVERED, c.COLLIDED, c.LOST)
        )
        transmission = Transmission(
            frame, int(signal.start_ns), paths["power_mw"].copy(), paths["delay_ns"].copy(),
            int(signal.longest_delay_ns), delivered, collided, lost,
            receptions_of(tables, ended) if self._config.reports_receptions else None,
        )  # fmt: skip
        loop.release(self._block, ended)
        if self._on_ended is not None:
            self._on_ended(transmission)


def _draw_ahead(used_by: Integers, draws: Doubles, streams: list[FloatStream]) -> None:
    """Refill the draws (n, buffered) of stations that have used (n,) more than half of theirs."""
    for station in (used_by > BUFFERED_DRAWS // 2).nonzero()[0].tolist():
        used = int(used_by[station])
        left = BUFFERED_DRAWS - used
        draws[station, :left] = draws[station, used:].copy()
        draws[station, left:] = streams[station].take(used)
        used_by[station] = 0


class RadioStation:
    """MAC of one station; see `netsim.mac.jobs.FrameSender`."""

    def __init__(self, index: int, radios: Radios) -> None:
        self.enqueue = partial(radios.enqueue, index)
        self.enqueue_at = partial(radios.enqueue_at, index)
        self.cancel = radios.cancel
        self.has_begun = radios.has_begun
        self.silence = partial(radios.silence, index)
