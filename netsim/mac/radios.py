"""All radios of the emulated channel: the tables, and the Python side of their events.

`netsim.mac.loop` runs the events in compiled code. This module supplies what is not compiled (link budgets,
adaptive modes, interferers, random streams) and dispatches calls to the upper layers.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Protocol

import numpy as np

from netsim.mac import loop
from netsim.mac.access_parameters import AccessParameters
from netsim.mac.initial_state import silent_air
from netsim.mac.interference import Bursts
from netsim.mac.jobs import GroupReception, Job, JobOutcome, OnGroupFrame, Reception, Upper
from netsim.mac.observations import KINDS, transmission_of
from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.config import RadioConfig
from netsim.model.event_queue import NEVER_NS, EventQueue
from netsim.model.events import schedule
from netsim.model.random_streams import Model, RandomStreams, Uniforms
from netsim.model.tables import Air, Integers
from netsim.phy.fading import RicianFading
from netsim.phy.frames import Frame
from netsim.phy.path_loss import Doubles
from netsim.phy.propagation import LinkRow
from netsim.phy.signals import Transmission

KIND_ROWS = {kind: row for row, kind in enumerate(KINDS)}
OUTCOMES = list(JobOutcome)
_NO_FADING = np.empty(0)


class LinkBudgets(Protocol):
    """Link budgets of all signals: `netsim.phy.propagation.Links`."""

    fading: RicianFading | None

    @property
    def version(self) -> int:
        """Version number, which changes when earlier link budgets become invalid."""

    def row(self, source: int, at_ns: int) -> LinkRow:
        """Return the link budget from a station to all others."""

    def interferer_row(self, index: int, at_ns: int) -> LinkRow:
        """Return the link budget from an interferer to all stations."""


class Radios:
    """Stations that contend for one medium; see `netsim.emulator.channels.Channel`.

    ``on_ended`` is called with every frame that has ended at all stations.
    """

    def __init__(
        self,
        *,
        config: RadioConfig,
        access: Mapping[str, AccessParameters],
        queue: EventQueue,
        links: LinkBudgets,
        stations: int,
        streams: RandomStreams,
        on_group_frame: OnGroupFrame,
        on_ended: Callable[[Transmission], None] | None = None,
    ) -> None:
        self._config = config
        self._queue = queue
        self._links = links
        self._streams = streams
        self._on_group_frame = on_group_frame
        self._on_ended = on_ended
        parameters = list(dict.fromkeys(access.values()))
        self._categories = {category: parameters.index(access[category]) for category in access}
        """Queue by access category; categories with equal parameters share a queue (DCF)."""
        self._air, self._modes = silent_air(
            config, stations=stations, queues=parameters, observed=on_ended is not None
        )
        self._head = memoryview(self._air.data)
        self._tables = t.tables_of(self._air)
        self._fading_block = _NO_FADING if links.fading is None else links.fading.block
        self._links_version = links.version
        self._uppers: list[Upper] = []
        self._backoffs: list[Uniforms] = []
        self._receptions = [Uniforms(streams.generator(Model.RECEPTION, i)) for i in range(stations)]
        self._jobs: list[Job] = []
        """Jobs by row; a free row holds its previous job."""
        self._free_jobs: list[int] = []
        self._taken: list[Integers] = []
        """Blocks of records moved out of the full table."""
        self._bursts = Bursts(config, queue, streams, self._start_burst)
        queue.machine = self

    # --- stations

    def join(self, station: int, upper: Upper, backoff: Uniforms | None = None) -> "RadioStation":
        """Add the next station, in the order of their numbers; its received frames go to ``upper``.

        ``backoff`` draws its backoffs, by default from the station's random stream.
        """
        self._uppers.append(upper)
        self._backoffs.append(backoff or Uniforms(self._streams.generator(Model.BACKOFF, station)))
        return RadioStation(station, self)

    def enqueue(self, station: int, category: str, job: Job) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        if self._free_jobs:
            row = self._free_jobs.pop()
            self._jobs[row] = job
        else:
            row = self._new_job_row(job)
        job.row = row
        queue, head = self._queue, self._head
        head[c.NOW], head[c.SCHEDULED] = queue.now_ns, queue.scheduled
        what = (
            station * head[c.CATEGORIES] + self._categories[category], row,
            KIND_ROWS[job.kind], job.destination, self._modes[job.mode], job.frame_bytes, job.expires_ns,
            job.retry_limit, job.rts, job.rates is not None, job.seq, job.cancelled,
        )  # fmt: skip
        end = loop.enqueue(self._air, *what)
        if end == loop.LACKS_ROOM:
            self._make_ready()
            end = loop.enqueue(self._air, *what)
        queue.scheduled = self._head[c.SCHEDULED]
        if self._head[c.CALLS]:
            self._dispatch_calls()
        if end == loop.REJECTED:
            job.row = None
            self._free_jobs.append(row)
            job.done(job, JobOutcome.OVERFLOW)

    def _new_job_row(self, job: Job) -> int:
        row = len(self._jobs)
        self._jobs.append(job)
        if row == self._head[c.JOB_ROWS]:
            self._grow(jobs=2 * row)
        return row

    def cancel(self, job: Job) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        job.cancelled = True
        if job.row is not None:
            self._tables.jobs[job.row, c.JOB_CANCELLED] = 1

    def has_begun(self, job: Job) -> bool:
        """See `netsim.mac.jobs.FrameSender`."""
        if job.row is None:
            return job.attempts > 0
        return bool(self._tables.jobs[job.row, c.JOB_ATTEMPTS] > 0)

    def silence(self, station: int) -> None:
        """See `netsim.mac.jobs.FrameSender`."""
        self._make_ready()
        loop.silence(self._air, station)
        # a frame of the station may be on the air: its receivers still need the job's body
        self._dispatch_calls(keep=True)

    def transmit(self, frame: Frame) -> None:
        """Send a frame now, regardless of the medium."""
        self._make_ready()
        what = KIND_ROWS[frame.kind] * c.MODES + self._modes[frame.mode]
        schedule(
            self._air,
            self._queue.now_ns,
            c.SEND_FRAME,
            frame.source,
            frame.destination,
            what,
            frame.bytes,
            frame.nav_ns,
        )
        self._queue.scheduled = self._head[c.SCHEDULED]

    # --- state and statistics

    @property
    def air(self) -> Air:
        """The current block of tables, which is replaced when they grow."""
        return self._air

    def busy_ns(self) -> int:
        """Return the time up to now for which the medium carried at least one signal."""
        return self._head[c.BUSY_NS] - max(0, self._head[c.BUSY_UNTIL_NS] - self._queue.now_ns)

    def surveyed_ns(self) -> list[int]:
        """Return the time up to now, by station, for which it sensed the medium busy or was sending."""
        surveyed: list[int] = loop.surveyed_ns(self._air, self._queue.now_ns).tolist()
        return surveyed

    def frames_sent(self) -> list[int]:
        """Return the number of ended frames by kind."""
        sent: list[int] = self._tables.sent[0].tolist()
        return sent

    def broadcasts(self) -> Integers:
        """Return broadcast datagrams (n, 3) by receiver: delivered, collided, lost to noise."""
        return self._tables.counts.copy()

    def take_frames(self) -> Integers:
        """Return the frames that ended since the last call: see `netsim.emulator.records`."""
        self._put_records_aside()
        taken, self._taken = self._taken, []
        return taken[0] if len(taken) == 1 else np.concatenate(taken)

    def _put_records_aside(self) -> None:
        count = self._head[c.RECORDS]
        self._head[c.RECORDS] = 0
        self._taken.append(self._tables.records[:count].copy())

    # --- events

    def next_ns(self) -> int:
        """See `netsim.model.event_queue.EventSource`."""
        return int(loop.next_ns(self._air, NEVER_NS))

    def begin(self) -> None:
        """See `netsim.model.event_queue.EventSource`."""
        version = self._links.version
        if version != self._links_version:
            self._links_version = version
            self._tables.budgets[:, c.BUDGET_UNTIL] = -1

    def run(self, until_ns: int, until_order: int) -> bool:
        """See `netsim.model.event_queue.EventSource`."""
        queue, head = self._queue, self._head
        head[c.NOW], head[c.SCHEDULED] = queue.now_ns, queue.scheduled
        while (why := loop.run(self._air, self._fading_block, until_ns, until_order)) != loop.REACHED:
            queue.now_ns, queue.scheduled = head[c.NOW], head[c.SCHEDULED]
            if why == loop.NEEDS_BUDGET:
                self._update_budget(head[c.BUDGET_SENDER], queue.now_ns)
            elif why == loop.HAS_CALLS:
                self._dispatch_calls()
                return False
            elif why == loop.NEEDS_MODE:
                self._choose_mode(head[c.DUE])
                return False
            else:
                self._make_ready()
                head = self._head  # of new tables, if they had to grow
        queue.scheduled = head[c.SCHEDULED]
        return True

    def _make_ready(self) -> None:
        """Provide random draws and free rows for the next event, and set the clock."""
        head = self._head
        head[c.NOW], head[c.SCHEDULED] = self._queue.now_ns, self._queue.scheduled
        if head[c.DRAWS_LOW]:
            head[c.DRAWS_LOW] = 0
            tables = self._tables
            _draw_ahead(tables.stations, c.BACKOFFS, tables.backoffs, self._backoffs)
            _draw_ahead(tables.stations, c.RECEPTIONS, tables.receptions, self._receptions)
        events = head[c.EVENTS] + loop.spare_events(self._air)
        if events > head[c.EVENT_ROWS]:
            self._grow(events=2 * events)
        if head[c.FREE_SIGNAL] == c.NOTHING:
            self._grow(signals=2 * head[c.SIGNAL_ROWS])
        if head[c.RECORDS] == c.RECORD_ROWS:
            self._put_records_aside()

    def _grow(self, *, events: int = 0, jobs: int = 0, signals: int = 0) -> None:
        self._air = t.grown(self._air, events=events, jobs=jobs, signals=signals)
        self._head = memoryview(self._air.data)
        self._tables = self._modes.tables = t.tables_of(self._air)

    def _update_budget(self, source: int, at_ns: int) -> None:
        row = self._links.row(source, at_ns)
        until_ns = max(row.until_ns, at_ns)
        loop.set_budget(self._air, source, row.powers_mw, row.delays_ns, until_ns, row.longest_delay_ns)

    def _choose_mode(self, q: int) -> None:
        self._dispatch_calls()
        tables = self._tables
        row = int(tables.queues[q, c.FIRST])
        job = self._jobs[row]
        if job.rates is None:
            raise AssertionError("a mode is needed for a frame without rate control")
        job.mode = job.rates.mode_for(
            job.destination,
            frame_bytes=job.frame_bytes,
            failures=int(tables.jobs[row, c.JOB_FAILURES]),
            now_ns=self._queue.now_ns,
        )
        tables.jobs[row, c.JOB_MODE] = self._modes[job.mode]
        self._head[c.CHOSEN] = 1

    # --- interferers

    def _start_burst(self, interferer: int, end_ns: int) -> None:
        """Start an interferer's burst now."""
        now = self._queue.now_ns
        row = self._links.interferer_row(interferer, now)
        self._make_ready()
        tables = self._tables
        burst = t.take_signal(self._air)
        columns = [c.SOURCE, c.START, c.END, c.LONGEST_DELAY]
        tables.signals[burst, columns] = -1 - interferer, now, end_ns, row.longest_delay_ns
        tables.powers_mw[burst], tables.delays_ns[burst] = row.powers_mw, row.delays_ns
        loop.start_burst(self._air, burst)
        self._queue.scheduled = self._head[c.SCHEDULED]

    # --- calls to the upper layers

    def _dispatch_calls(self, *, keep: bool = False) -> None:
        """Dispatch the calls of the last event; ``keep`` does not free the rows of ended jobs."""
        count, tables = self._head[c.CALLS], self._tables
        if not count:
            return
        self._head[c.CALLS] = 0
        pending: list[tuple[list[int], float, Job | None]] = []
        # free the rows first: a callback may enqueue a frame at once
        for i, call in enumerate(tables.calls[:count].tolist()):
            row = call[c.CALL_JOB]
            job = self._jobs[row] if row >= 0 else None
            pending.append((call, tables.calls_mw.item(i), job))
            if call[c.CALL] == c.DONE and job is not None:
                kept = tables.jobs[row].tolist()
                job.attempts, job.failures = kept[c.JOB_ATTEMPTS], kept[c.JOB_FAILURES]
                job.sequence = kept[c.JOB_SEQUENCE]
                job.sent_ns = kept[c.JOB_SENT_AT] if job.attempts else None
                job.row = None
                if not keep:
                    self._free_jobs.append(row)
        for call, power_mw, job in pending:
            what = call[c.CALL]
            if what == c.FRAME:
                _, station, _, again, source, start_ns, end_ns = call[: c.CALL_END + 1]
                seq, body = (0, None) if job is None else (job.seq, job.body)
                reception = Reception(source, start_ns, end_ns, power_mw, seq, body, bool(again))
                self._uppers[station].on_frame(reception)
            elif what == c.GROUP_FRAME:
                self._report_group_frame(job, call[c.CALL_DETAIL])
            elif what == c.FRAME_ENDED:
                self._report_ended(job)
            elif what == c.DONE and job is not None:
                outcome = OUTCOMES[call[c.CALL_DETAIL]]
                if outcome is JobOutcome.ACKNOWLEDGED:
                    job.ack = Reception(call[c.CALL_SOURCE], call[c.CALL_START], call[c.CALL_END], power_mw)
                    if job.rates is not None:
                        job.rates.report(job.destination, job.mode, acknowledged=True)
                job.done(job, outcome)
            elif what == c.FAILED and job is not None and job.rates is not None:
                job.rates.report(job.destination, job.mode, acknowledged=False)

    def _report_group_frame(self, job: Job | None, frame: int) -> None:
        """Report a group frame that has just ended to its receivers."""
        seq, body = (0, None) if job is None else (job.seq, job.body)
        tables = self._tables
        signal = tables.signals[frame].tolist()
        fates, delays_ns = tables.ends[c.FATES].tolist(), tables.delays_ns[frame].tolist()
        powers_mw = tables.powers_mw[frame].tolist()
        stations = [station for station, fate in enumerate(fates) if fate == c.RECEIVED]
        self._on_group_frame(
            GroupReception(
                signal[c.SOURCE],
                seq,
                body,
                stations,
                [signal[c.END] + delays_ns[station] for station in stations],
                [powers_mw[station] for station in stations],
            )
        )

    def _report_ended(self, job: Job | None) -> None:
        """Report the frame that has ended, and free its row."""
        ended = self._head[c.ENDED]
        body = None if job is None else job.body
        transmission = transmission_of(self._tables, ended, self._config.bandwidth_mhz, body)
        loop.release(self._air, ended)
        if self._on_ended is not None:
            self._on_ended(transmission)


def _draw_ahead(stations: Integers, column: int, draws: Doubles, streams: list[Uniforms]) -> None:
    """Refill the draws of stations that have used more than half of theirs."""
    used_by = stations[:, column]
    for station in (used_by > c.BLOCK_DRAWS // 2).nonzero()[0].tolist():
        used = int(used_by[station])
        left = c.BLOCK_DRAWS - used
        draws[station, :left] = draws[station, used:].copy()
        draws[station, left:] = streams[station].take(used)
        used_by[station] = 0


class RadioStation:
    """MAC of one station; see `netsim.mac.jobs.FrameSender`."""

    def __init__(self, index: int, radios: Radios) -> None:
        self.index = index
        self.enqueue = partial(radios.enqueue, index)
        self.cancel = radios.cancel
        self.has_begun = radios.has_begun
        self.silence = partial(radios.silence, index)
