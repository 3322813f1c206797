"""State of all radios and of the medium: tables of records in one block of memory.

A frame takes about four events, and each event uses a few numbers of some stations. Stored in Python objects,
these were spread over hundreds of memory locations, and in lockstep every step begins with cold caches. So
stations, queues, frames and events are records of tables, and `netsim.mac.loop` runs events in compiled code
until one has to be reported to a layer above the MAC.

This module defines the tables and the allocation of rows; `netsim.model.records` defines the fields. The
802.11 models that use them are in `netsim.phy` and `netsim.mac`.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from foundation.kernels.inner import inner
from foundation.kernels.records import Block, opener, record_dtype, table
from netsim.model import codes as c
from netsim.model.records import (
    BUFFERED_DRAWS,
    LEAST_DRAWS,
    Arrival,
    Draws,
    End,
    EndedFrame,
    EndedJob,
    JobRow,
    Link,
    MediumHeader,
    Path,
    PhyModeRow,
    Queue,
    ScheduledEvent,
    Signal,
    SignalReference,
    Station,
    UpperCall,
)

Integers = NDArray[np.int64]
Records = NDArray[np.void]

# --- records of the tables, for compiled code

open_air = opener(MediumHeader)
"""``open_air(block)``: the header of a block, which the other functions take."""
station = table("station_at", Station)
draws = table("draws_at", Draws)
queue = table("queue_at", Queue)
end = table("end_at", End)
link = table("link_at", Link, columns="stations")
"""``link(air, receiver, sender)``"""
budget = table("budget_at", Path, columns="stations")
"""``budget(air, sender, station)``"""
mode = table("mode_at", PhyModeRow)
record = table("record_at", EndedFrame)
event = table("event_at", ScheduledEvent)
"""Event heap."""
job = table("job_at", JobRow)
call = table("call_at", UpperCall)
arrival = table("arrival_at", Arrival)
ended_job = table("ended_job_at", EndedJob)
signal = table("signal_at", Signal)
"""Signals that are or were on the air."""
overlap = table("overlap_at", SignalReference, columns="signal_rows")
"""``overlap(air, signal, k)``: the k-th signal that overlaps it, in order of their begin."""
on_air = table("on_air_at", SignalReference, columns="signal_rows")
"""``on_air(air, FRAMES or BURSTS of codes, k)``: the frames or bursts on the air, in order of their begin."""
path = table("path_at", Path, columns="stations")
"""``path(air, signal, station)``"""

# --- whole tables, for Python code

AIR = record_dtype(MediumHeader)
_SIZES = ("stations", "categories", "event_rows", "job_rows", "signal_rows")


class Tables(NamedTuple):
    """Arrays of records, in their order in memory; the header first."""

    air: Records
    """(1,) of `MediumHeader`"""
    stations: Records
    """(n,)"""
    draws: Records
    """(n,)"""
    queues: Records
    """(n * categories,)"""
    ends: Records
    """(n,)"""
    links: Records
    """(n, n), rows are receivers"""
    budgets: Records
    """(n, n), rows are senders"""
    modes: Records
    records: Records
    events: Records
    jobs: Records
    calls: Records
    arrivals: Records
    ended_jobs: Records
    signals: Records
    overlaps: Records
    """(signals, signals)"""
    on_air: Records
    """(2, signals)"""
    paths: Records
    """(signals, n)"""


def _shapes(stations: int, categories: int, events: int, jobs: int, signals: int) -> list[tuple[type, Any]]:
    """Return record class and shape of each table behind the header."""
    n = stations
    # most calls of one event: every job ends, every station's exchange fails, a frame is received
    calls = jobs + n + 8
    return [
        (Station, n), (Draws, n), (Queue, n * categories), (End, n), (Link, (n, n)), (Path, (n, n)),
        (PhyModeRow, c.MODES), (EndedFrame, c.RECORD_ROWS), (ScheduledEvent, events), (JobRow, jobs),
        (UpperCall, calls), (Arrival, c.RECORD_ROWS + n), (EndedJob, jobs), (Signal, signals),
        (SignalReference, (signals, signals)), (SignalReference, (2, signals)), (Path, (signals, n)),
    ]  # fmt: skip


def tables_of(block: Block) -> Tables:
    """Return the tables of a block as views."""
    header = block[: AIR.itemsize // 8].view(AIR)
    sizes = [int(header[name][0]) for name in _SIZES]
    views: list[Any] = [header]
    begin = AIR.itemsize
    for kind, shape in _shapes(*sizes):
        dtype = record_dtype(kind)
        view = np.ndarray(shape, dtype, block, begin)
        views.append(view)
        begin += view.nbytes
    return Tables(*views)


def new_block(*, stations: int, categories: int) -> Block:
    """Return a block of empty tables."""
    block = _allocate(stations, categories, 64, 16, 16 + stations)
    _chain(tables_of(block).signals, 0, c.NOTHING)
    return block


def grown(block: Block, *, events: int = 0, jobs: int = 0, signals: int = 0) -> Block:
    """Return a copy of the block with at least that many rows."""
    old = tables_of(block)
    air = old.air[0]
    new_block = _allocate(
        air.stations, air.categories, max(events, air.event_rows), max(jobs, air.job_rows),
        max(signals, air.signal_rows),
    )  # fmt: skip
    new = tables_of(new_block)
    for name in AIR.names or ():
        if not name.endswith(("_rows", "_at")):
            new.air[name] = old.air[name]
    for before, after in zip(old[1:], new[1:], strict=True):
        after[tuple(slice(length) for length in before.shape)] = before
    if signals > air.signal_rows:
        _chain(new.signals, int(air.signal_rows), int(air.free_signal))
        new.air["free_signal"] = air.signal_rows
    return new_block


def _allocate(stations: int, categories: int, events: int, jobs: int, signals: int) -> Block:
    shapes = _shapes(stations, categories, events, jobs, signals)
    lengths = [record_dtype(kind).itemsize * int(np.prod(shape)) for kind, shape in shapes]
    begins = AIR.itemsize + np.cumsum([0, *lengths])
    block = np.zeros(begins[-1] // 8, np.int64)
    header = block[: AIR.itemsize // 8].view(AIR)
    sizes = (stations, categories, events, jobs, signals)
    places = [name for name in AIR.names or () if name.endswith("_at")]
    for name, value in zip((*_SIZES, *places), (*sizes, *begins[:-1].tolist()), strict=True):
        header[name] = value
    return block


def _chain(signals: Records, first: int, then: int) -> None:
    """Link the rows from ``first`` on as free rows, followed by the row ``then``."""
    signals["next_signal"][first:] = np.arange(first + 1, len(signals) + 1)
    signals["next_signal"][-1] = then


# --- allocation of rows


@njit(cache=True)
def spare_events(of_stations: int, categories: int) -> int:
    """Return the most events that one event schedules: access and deadline per queue, a response."""
    return of_stations * (2 * categories + 2) + 8


@inner
def add_call(air: MediumHeader, what: int, station: int, job: int) -> UpperCall:
    """Add a call to Python and return its record, which the caller completes."""
    added = call(air, air.calls)
    air.calls += 1
    added.what, added.station, added.job = what, station, job
    return added


@inner
def add_ended_job(air: MediumHeader, row: int, outcome: int, ended_ns: int) -> None:
    """Report the outcome and the end of a deferred job."""
    added = ended_job(air, air.ended_jobs)
    air.ended_jobs += 1
    added.job, added.outcome, added.ended_ns = row, outcome, ended_ns
    added.attempts = job(air, row).attempts


@inner
def draw_backoff(air: MediumHeader, of_station: int) -> float:
    """Return the next uniform draw in [0, 1) for a station's backoff."""
    drawer = station(air, of_station)
    used = drawer.backoffs_used
    drawer.backoffs_used = used + 1
    if used + 1 > BUFFERED_DRAWS - LEAST_DRAWS:
        air.draws_low = True
    return float(draws(air, of_station).backoffs[used])


@inner
def draw_reception(air: MediumHeader, of_station: int) -> float:
    """Return the next uniform draw in [0, 1) for a station's reception."""
    drawer = station(air, of_station)
    used = drawer.receptions_used
    drawer.receptions_used = used + 1
    if used + 1 > BUFFERED_DRAWS - LEAST_DRAWS:
        air.draws_low = True
    return float(draws(air, of_station).receptions[used])


@inner
def take_signal(air: MediumHeader) -> int:
    """Allocate a row of signals; the caller ensures that one is free."""
    row = air.free_signal
    taken = signal(air, row)
    air.free_signal = taken.next_signal
    taken.overlap_count = taken.references = 0
    taken.over = False
    return row


@inner
def end_signal(air: MediumHeader, row: int) -> None:
    """End a signal and release its overlapping signals; free rows that are no longer referenced."""
    ended = signal(air, row)
    for k in range(ended.overlap_count):
        release(air, overlap(air, row, k).signal)
    ended.overlap_count = 0
    ended.over = True
    _free_if_unused(air, row)


@inner
def release(air: MediumHeader, row: int) -> None:
    """Remove one reference to a signal; free its row if it is over and unreferenced."""
    signal(air, row).references -= 1
    _free_if_unused(air, row)


@inner
def _free_if_unused(air: MediumHeader, row: int) -> None:
    unused = signal(air, row)
    if unused.over and unused.references == 0:
        unused.next_signal = air.free_signal
        air.free_signal = row
