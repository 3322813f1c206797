"""All stations' radios and the medium between them: the tables, and Python's side of their events.

`netsim.mac.loop` runs the events; here are what it cannot have compiled (link budgets, adaptive modes,
interferers' and everybody's random streams) and whom it tells.
"""

from collections.abc import Callable, Mapping
from typing import Protocol, get_args

import numpy as np

from netsim import tables as t
from netsim.config import Mode, RadioConfig
from netsim.events import schedule
from netsim.frames import Frame, FrameKind
from netsim.kernel import NEVER_NS, EventQueue
from netsim.mac import loop
from netsim.mac.access import AccessParameters
from netsim.mac.jobs import GroupReception, Job, OnGroupFrame, Outcome, Reception, Upper
from netsim.phy.errors import error_model
from netsim.phy.fading import RicianFading
from netsim.phy.interferers import Interferer
from netsim.phy.medium import PREAMBLE_SINR
from netsim.phy.modes import PhyMode, phy_mode, response_mode
from netsim.phy.path_loss import Doubles
from netsim.phy.propagation import LinkRow, thermal_noise_mw
from netsim.phy.signals import Transmission
from netsim.streams import Model, Streams, Uniforms
from netsim.tables import Air, Integers

KINDS = list(FrameKind)
MODE_NAMES: list[Mode] = list(get_args(Mode))
"""In the order of the tables' rows; of each in ``response`` order."""
OUTCOMES = list(Outcome)
BURST_PART_NS = 20_000_000
"""A longer burst goes on the air in parts, each with the powers of its beginning: receivers move."""
_NO_FADING = np.empty(0)


class LinkBudgets(Protocol):
    """What signals lose on their ways: `netsim.phy.propagation.Links`."""

    fading: RicianFading | None

    @property
    def version(self) -> int:
        """Another number whenever budgets that were given do not hold any more."""

    def row(self, source: int, at_ns: int) -> LinkRow:
        """From a station to all others."""

    def interferer_row(self, index: int, at_ns: int) -> LinkRow:
        """From an interferer to all stations."""


class Radios:
    """Stations that contend for one medium; see `netsim.channels.Channel`.

    ``on_ended`` is told of every frame that has ended everywhere.
    """

    def __init__(
        self,
        *,
        config: RadioConfig,
        access: Mapping[str, AccessParameters],
        queue: EventQueue,
        links: LinkBudgets,
        stations: int,
        streams: Streams,
        on_group_frame: OnGroupFrame,
        on_ended: Callable[[Transmission], None] | None = None,
    ) -> None:
        self._config = config
        self._queue = queue
        self._links = links
        self._streams = streams
        self._on_group_frame = on_group_frame
        self._on_ended = on_ended
        self._stations = stations
        parameters = list(dict.fromkeys(access.values()))
        self._categories = {category: parameters.index(access[category]) for category in access}
        """Those with the same parameters share a queue (DCF)."""
        self._air = t.new_air(stations=stations, categories=len(parameters))
        self._head = memoryview(self._air.data)
        self._tables = t.tables_of(self._air)
        self._fading = links.fading
        self._fading_block = _NO_FADING if self._fading is None else self._fading.block
        self._links_version = links.version
        self._spare_events = loop.spare_events(self._air)
        self._uppers: list[Upper] = []
        self._backoffs: list[Uniforms] = []
        self._receptions = [Uniforms(streams.generator(Model.RECEPTION, i)) for i in range(stations)]
        self._jobs: list[Job | None] = []
        """By row, and which rows are free."""
        self._free_jobs: list[int] = []
        self._taken: list[Integers] = []
        """Records that had to make room."""
        self._mode_rows: dict[str, int] = {}
        """Of those whose tables are there."""
        self._fill(parameters)
        for index, settings in enumerate(config.interferers):
            if settings.duty_cycle > 0.0:
                interferer = Interferer(index, settings, streams.generator(Model.INTERFERENCE, index))
                queue.at(queue.now_ns + interferer.first_ns(), self._begin_burst, interferer)
        queue.machine = self

    def _fill(self, parameters: list[AccessParameters]) -> None:
        config, air, tables = self._config, self._air, self._tables
        noise_mw = thermal_noise_mw(config.bandwidth_mhz, config.noise_figure_db)
        preamble_mw = max(10.0 ** (config.cca_preamble_dbm / 10.0), PREAMBLE_SINR * noise_mw)
        energy_mw = 10.0 ** (config.cca_energy_dbm / 10.0)
        tables.levels_mw[0, [t.NOISE_MW, t.ENERGY_MW, t.PREAMBLE_MW]] = noise_mw, energy_mw, preamble_mw
        tables.levels_mw[0, t.SENSED_MW] = min(energy_mw, preamble_mw)
        air[t.QUEUE_FRAMES] = config.queue_frames
        air[t.CONTROL_MODE] = self._mode_row(phy_mode(config.control_mode, config.bandwidth_mhz))
        self._mode_row(phy_mode("ofdm6", config.bandwidth_mhz))
        air[t.OBSERVED] = self._on_ended is not None
        air[t.DRAWS_LOW] = 1
        air[t.DUE] = t.NOTHING
        stations = tables.stations
        stations[:, [t.SENDING_FROM, t.SENDING_UNTIL, t.LOCKED]] = -1
        stations[:, [t.LOCK, t.RESERVED_BY, t.CURRENT]] = t.NOTHING
        stations[:, [t.BACKOFFS, t.RECEPTIONS]] = t.BLOCK_DRAWS
        queues = tables.queues
        queues[:, [t.FIRST, t.LAST]] = t.NOTHING
        queues[:, [t.BASE, t.ACCESS_AT, t.DEADLINE_AT]] = NEVER_NS
        for k, each in enumerate(parameters):
            columns = [t.AIFS, t.WINDOW, t.WINDOW_LEAST, t.WINDOW_MOST, t.TXOP, t.AHEAD]
            queues[k :: len(parameters), columns] = (
                each.aifs_ns, each.cw_min, each.cw_min, each.cw_max, each.txop_ns, each.edca,
            )  # fmt: skip
        tables.heard_ns[...] = -NEVER_NS
        tables.budgets[:, t.BUDGET_UNTIL] = -1

    def _mode_row(self, mode: PhyMode) -> int:
        """Row of a mode, which has its tables and those of its answers from now on."""
        row = self._mode_rows.get(mode.name)
        if row is None:
            row = self._mode_rows[mode.name] = MODE_NAMES.index(mode.name)
            tables, errors = self._tables, error_model(mode)
            columns = [t.PREAMBLE, t.BITS_PER_SYMBOL, t.VHT, t.HAZARDS]
            tables.modes[row, columns] = (
                mode.preamble_ns, mode.bits_per_symbol, mode.vht, len(errors.log_hazards),
            )  # fmt: skip
            tables.hazards[row, 0] = errors.clean_linear
            tables.hazards[row, 1 : 1 + len(errors.log_hazards)] = errors.log_hazards
            tables.modes[row, t.RESPONSE_MODE] = self._mode_row(response_mode(mode))
        return row

    # --- stations

    def join(self, station: int, upper: Upper, backoff: Uniforms | None = None) -> "Station":
        """Add a station, whose received frames go to ``upper``; they come in the order of their numbers.

        ``backoff`` is what its backoffs are drawn from, if not the stream of its own.
        """
        self._uppers.append(upper)
        self._backoffs.append(backoff or Uniforms(self._streams.generator(Model.BACKOFF, station)))
        return Station(station, self)

    def enqueue(self, station: int, category: str, job: Job) -> None:
        """See `netsim.mac.jobs.Sender`."""
        self._make_ready()
        row = self._free_jobs.pop() if self._free_jobs else self._new_job_row()
        self._jobs[row] = job
        job.row = row
        self._tables.jobs[row] = (
            t.NOTHING, KINDS.index(job.kind), job.destination, self._mode_row(job.mode), job.frame_bytes,
            job.expires_ns, job.retry_limit, job.rts, job.rates is not None, job.seq,
            0, job.cancelled, 0, 0, 0,  # what the exchanges make of it
        )  # fmt: skip
        q = station * self._head[t.CATEGORIES] + self._categories[category]
        taken = loop.enqueue(self._air, station, q, row)
        self._queue.scheduled = self._head[t.SCHEDULED]
        self._tell()
        if not taken:
            self._jobs[row] = job.row = None
            self._free_jobs.append(row)
            job.done(job, Outcome.OVERFLOW)

    def _new_job_row(self) -> int:
        row = len(self._jobs)
        self._jobs.append(None)
        if row == self._head[t.JOB_ROWS]:
            self._grow(jobs=2 * row)
        return row

    def cancel(self, job: Job) -> None:
        """See `netsim.mac.jobs.Sender`."""
        job.cancelled = True
        if job.row is not None:
            self._tables.jobs[job.row, t.JOB_CANCELLED] = 1

    def has_begun(self, job: Job) -> bool:
        """See `netsim.mac.jobs.Sender`."""
        if job.row is None:
            return job.attempts > 0
        return bool(self._tables.jobs[job.row, t.JOB_ATTEMPTS] > 0)

    def silence(self, station: int) -> None:
        """See `netsim.mac.jobs.Sender`."""
        self._make_ready()
        loop.silence(self._air, station)
        # a frame of its may be on the air: what it carries is still asked for
        self._tell(keep=True)

    def transmit(self, frame: Frame) -> None:
        """Have a station send a frame now, whatever it senses."""
        self._make_ready()
        what = KINDS.index(frame.kind) * t.MODES + self._mode_row(frame.mode)
        schedule(
            self._air,
            self._queue.now_ns,
            t.SEND_FRAME,
            frame.source,
            frame.destination,
            what,
            frame.bytes,
            frame.nav_ns,
        )
        self._queue.scheduled = self._head[t.SCHEDULED]

    # --- what is known of them

    @property
    def air(self) -> Air:
        """The tables, until they grow."""
        return self._air

    def busy_ns(self) -> int:
        """Time up to now for which the medium carried at least one signal."""
        return self._head[t.BUSY_NS] - max(0, self._head[t.BUSY_UNTIL_NS] - self._queue.now_ns)

    def surveyed_ns(self) -> list[int]:
        """Time up to now for which each station sensed the medium busy or was itself sending."""
        surveyed: list[int] = loop.surveyed_ns(self._air, self._queue.now_ns).tolist()
        return surveyed

    def frames_sent(self) -> list[int]:
        """Frames by kind."""
        sent: list[int] = self._tables.sent[0].tolist()
        return sent

    def broadcasts(self) -> Integers:
        """Datagrams to all, (n, 3) by receiver: delivered, collided, lost to noise."""
        return self._tables.counts.copy()

    def take_frames(self) -> Integers:
        """Give the frames that have ended since the last call: see `netsim.records`."""
        self._put_records_aside()
        taken, self._taken = self._taken, []
        return taken[0] if len(taken) == 1 else np.concatenate(taken)

    def _put_records_aside(self) -> None:
        count = self._head[t.RECORDS]
        self._head[t.RECORDS] = 0
        self._taken.append(self._tables.records[:count].copy())

    # --- the air's events

    def next_ns(self) -> int:
        """See `netsim.kernel.Machine`."""
        return int(loop.next_ns(self._air, NEVER_NS))

    def run(self, until_ns: int, until_order: int) -> bool:
        """See `netsim.kernel.Machine`."""
        queue, head = self._queue, self._head
        head[t.NOW] = queue.now_ns
        head[t.SCHEDULED] = queue.scheduled
        if self._links.version != self._links_version:
            self._links_version = self._links.version
            self._tables.budgets[:, t.BUDGET_UNTIL] = -1
        while (why := loop.run(self._air, self._fading_block, until_ns, until_order)) != loop.REACHED:
            queue.now_ns, queue.scheduled = head[t.NOW], head[t.SCHEDULED]
            if why == loop.WANTS_BUDGET:
                self._have_budget(head[t.WANTED], queue.now_ns)
            elif why == loop.TELLS:
                self._tell()
                return False
            elif why == loop.WANTS_MODE:
                self._choose_mode(head[t.DUE])
                return False
            else:
                self._make_ready()
                head = self._head  # of new tables, if they had to grow
        queue.scheduled = head[t.SCHEDULED]
        return True

    def _make_ready(self) -> None:
        """Have draws, and room for what an event may add, and the clock right."""
        head = self._head
        head[t.NOW] = self._queue.now_ns
        head[t.SCHEDULED] = self._queue.scheduled
        if head[t.DRAWS_LOW]:
            head[t.DRAWS_LOW] = 0
            tables = self._tables
            _draw_ahead(tables.stations, t.BACKOFFS, tables.backoffs, self._backoffs)
            _draw_ahead(tables.stations, t.RECEPTIONS, tables.receptions, self._receptions)
        if head[t.EVENTS] + self._spare_events > head[t.EVENT_ROWS]:
            self._grow(events=2 * head[t.EVENT_ROWS] + self._stations)
        if head[t.FREE_SIGNAL] == t.NOTHING:
            self._grow(signals=2 * head[t.SIGNAL_ROWS])
        if head[t.RECORDS] == t.RECORD_ROWS:
            self._put_records_aside()

    def _grow(self, *, events: int = 0, jobs: int = 0, signals: int = 0) -> None:
        self._air = t.grown(self._air, events=events, jobs=jobs, signals=signals)
        self._head = memoryview(self._air.data)
        self._tables = t.tables_of(self._air)

    def _have_budget(self, source: int, at_ns: int) -> None:
        row, tables = self._links.row(source, at_ns), self._tables
        tables.budgets_mw[source] = row.powers_mw
        tables.budget_delays_ns[source] = row.delays_ns
        tables.budgets[source] = max(row.until_ns, at_ns), row.longest_delay_ns
        if self._fading is not None:
            self._fading.prepare(source)

    def _choose_mode(self, q: int) -> None:
        self._tell()
        tables = self._tables
        row = int(tables.queues[q, t.FIRST])
        job = self._jobs[row]
        if job is None or job.rates is None:
            raise AssertionError("a frame that chooses no mode waits for one")
        job.mode = job.rates.mode_for(
            job.destination,
            frame_bytes=job.frame_bytes,
            failures=int(tables.jobs[row, t.JOB_FAILURES]),
            now_ns=self._queue.now_ns,
        )
        tables.jobs[row, t.JOB_MODE] = self._mode_row(job.mode)
        self._head[t.CHOSEN] = 1

    # --- interferers

    def _begin_burst(self, interferer: Interferer) -> None:
        self._go_on(interferer, self._queue.now_ns + interferer.burst_ns())

    def _on_rest(self, rest: tuple[Interferer, int]) -> None:
        self._go_on(*rest)

    def _go_on(self, interferer: Interferer, until_ns: int) -> None:
        """Put what is left of a burst on the air, or the next part of it."""
        now = self._queue.now_ns
        end_ns = min(until_ns, now + BURST_PART_NS)
        # what follows at once is on the air before this has ended everywhere
        if end_ns < until_ns:
            self._queue.at(end_ns, self._on_rest, (interferer, until_ns))
        else:
            self._queue.at(end_ns + interferer.pause_ns(), self._begin_burst, interferer)
        row = self._links.interferer_row(interferer.index, now)
        self._make_ready()
        tables = self._tables
        burst = t.take_signal(self._air)
        columns = [t.SOURCE, t.START, t.END, t.LONGEST_DELAY]
        tables.signals[burst, columns] = -1 - interferer.index, now, end_ns, row.longest_delay_ns
        tables.powers_mw[burst], tables.delays_ns[burst] = row.powers_mw, row.delays_ns
        loop.start_burst(self._air, burst)
        self._queue.scheduled = self._head[t.SCHEDULED]

    # --- who is told

    def _tell(self, *, keep: bool = False) -> None:
        """Tell what the last event has to tell; ``keep`` leaves the rows of jobs that have ended theirs."""
        count, tables = self._head[t.CALLS], self._tables
        if not count:
            return
        self._head[t.CALLS] = 0
        calls, powers_mw = tables.calls[:count].tolist(), tables.calls_mw[:count, 0].tolist()
        told = [(call, self._jobs[call[t.CALL_JOB]] if call[t.CALL_JOB] >= 0 else None) for call in calls]
        for call, job in told:
            if call[t.CALL] == t.DONE and job is not None:
                self._note_end(job, call[t.CALL_JOB], keep=keep)
        for (call, job), power_mw in zip(told, powers_mw, strict=True):
            what = call[t.CALL]
            if what == t.FRAME:
                reception = _received(call, power_mw, job)
                self._uppers[call[t.CALL_STATION]].on_frame(reception)
            elif what == t.GROUP_FRAME:
                self._tell_all(job, call[t.CALL_DETAIL])
            elif what == t.FRAME_ENDED:
                self._tell_ended(job)
            elif job is not None:
                self._tell_sender(job, call, power_mw)

    def _tell_all(self, job: Job | None, frame: int) -> None:
        """Tell of a frame to all that has just ended."""
        seq, body = (0, None) if job is None else (job.seq, job.body)
        tables = self._tables
        signal = tables.signals[frame].tolist()
        stations = (tables.ends[t.FATES] == t.RECEIVED).nonzero()[0]
        ends_ns, powers_mw = (
            signal[t.END] + tables.delays_ns[frame, stations],
            tables.powers_mw[frame, stations],
        )
        self._on_group_frame(
            GroupReception(
                signal[t.SOURCE], seq, body, stations.tolist(), ends_ns.tolist(), powers_mw.tolist()
            )
        )

    def _tell_sender(self, job: Job, call: list[int], power_mw: float) -> None:
        if call[t.CALL] == t.FAILED:
            self._report(job, acknowledged=False)
            return
        outcome = OUTCOMES[call[t.CALL_DETAIL]]
        if outcome is Outcome.ACKNOWLEDGED:
            job.ack = _received(call, power_mw, None)
            self._report(job, acknowledged=True)
        job.done(job, outcome)

    def _note_end(self, job: Job, row: int, *, keep: bool) -> None:
        kept = t.jobs(self._air, row).tolist()
        job.sequence, job.attempts, job.failures = (
            kept[t.JOB_SEQUENCE],
            kept[t.JOB_ATTEMPTS],
            kept[t.JOB_FAILURES],
        )
        if job.attempts:
            job.sent_ns = kept[t.JOB_SENT_AT]
        job.row = None
        if not keep:
            self._jobs[row] = None
            self._free_jobs.append(row)

    @staticmethod
    def _report(job: Job, *, acknowledged: bool) -> None:
        if job.rates is not None:
            job.rates.report(job.destination, job.mode, acknowledged=acknowledged)

    def _tell_ended(self, job: Job | None) -> None:
        """Tell of the frame that has ended, and let go of it."""
        tables, ended = self._tables, self._head[t.ENDED]
        signal = tables.signals[ended].tolist()
        frame = Frame(
            kind=KINDS[signal[t.KIND]],
            source=signal[t.SOURCE],
            destination=signal[t.TO],
            mode=phy_mode(MODE_NAMES[signal[t.MODE]], self._config.bandwidth_mhz),
            frame_bytes=signal[t.BYTES],
            nav_ns=signal[t.NAV],
            seq=signal[t.SEQ],
            sequence=signal[t.FRAME_SEQUENCE],
            body=None if job is None else job.body,
        )
        delays_ns = tables.delays_ns[ended].copy()
        row = LinkRow(tables.budgets_mw[frame.source].copy(), delays_ns, signal[t.LONGEST_DELAY])
        transmission = Transmission(frame, signal[t.START], row, tables.powers_mw[ended].copy())
        notes = tables.ends[t.NOTES]
        transmission.delivered = np.flatnonzero(notes == t.DELIVERED).tolist()
        transmission.collided = np.flatnonzero(notes == t.COLLIDED).tolist()
        transmission.lost_to_noise = np.flatnonzero(notes == t.LOST).tolist()
        loop.release(self._air, ended)
        if self._on_ended is not None:
            self._on_ended(transmission)


def _received(call: list[int], power_mw: float, job: Job | None) -> Reception:
    _, _, _, detail, source, start_ns, end_ns = call[: t.CALL_END + 1]
    if job is None:
        return Reception(source, start_ns, end_ns, power_mw)
    return Reception(source, start_ns, end_ns, power_mw, job.seq, job.body, bool(detail))


def _draw_ahead(stations: Integers, column: int, draws: Doubles, streams: list[Uniforms]) -> None:
    """Fill up the draws of those that have used most of theirs."""
    used_by = stations[:, column]
    for station in (used_by > t.BLOCK_DRAWS // 2).nonzero()[0].tolist():
        used = int(used_by[station])
        left = t.BLOCK_DRAWS - used
        draws[station, :left] = draws[station, used:].copy()
        draws[station, left:] = streams[station].take(used)
        used_by[station] = 0


class Station:
    """MAC of one station; see `netsim.mac.jobs.Sender`."""

    def __init__(self, index: int, radios: Radios) -> None:
        self.index = index
        self.cancel = radios.cancel
        self.has_begun = radios.has_begun
        self._radios = radios

    def enqueue(self, category: str, job: Job) -> None:
        """Take a frame for transmission. A full queue, and a station that is silent, ends the job at once."""
        self._radios.enqueue(self.index, category, job)

    def silence(self) -> None:
        """End for good: nothing is sent, answered or heard any more."""
        self._radios.silence(self.index)
