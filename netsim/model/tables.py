"""State of all radios and of the medium: tables of numbers in one block of memory.

A frame takes about four events, and each event uses a few numbers of some stations. Stored in Python objects,
these were spread over hundreds of memory locations, and in lockstep every step begins with cold caches. So
stations, queues, frames and events are rows of tables, and `netsim.mac.loop` runs events in compiled code
until one has to be reported to a layer above the MAC.

This module defines the layout and the allocation of rows; `netsim.model.columns` defines the columns. The
802.11 models that use them are in `netsim.phy` and `netsim.mac`.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from netsim.model import columns as c
from netsim.phy.path_loss import Doubles

Integers = NDArray[np.int64]
Air = Integers
"""The block: first the single numbers, then the tables one after the other."""

# --- rows of the tables, for compiled code; the begin of each table is one of the single numbers


@njit(cache=True)
def _row(air: Air, which: int, row: int, columns: int) -> Integers:
    first = air[c.FIRST_TABLE + which] + row * columns
    return air[first : first + columns]


@njit(cache=True)
def _doubles(air: Air, which: int, row: int, columns: int) -> Doubles:
    first = air[c.FIRST_TABLE + which] + row * columns
    return air[first : first + columns].view(np.float64)


@njit(cache=True)
def stations(air: Air, row: int) -> Integers:
    """Carrier sense, reception and MAC of each station."""
    return _row(air, 0, row, c.STATION_COLUMNS)


@njit(cache=True)
def queues(air: Air, row: int) -> Integers:
    """Queues of the stations."""
    return _row(air, 1, row, c.QUEUE_COLUMNS)


@njit(cache=True)
def ends(air: Air, row: int) -> Integers:
    """(4, n): data of the event being processed, see `netsim.model.columns.FATES`."""
    return _row(air, 2, row, air[c.STATIONS])


@njit(cache=True)
def last_sequences(air: Air, row: int) -> Integers:
    """(n, n x kinds): last sequence number by sender and kind; rows are receivers."""
    return _row(air, 3, row, air[c.STATIONS] * c.KINDS)


@njit(cache=True)
def counts(air: Air, row: int) -> Integers:
    """(n, 3): broadcast datagrams by receiver: delivered, collided, lost to noise."""
    return _row(air, 4, row, 3)


@njit(cache=True)
def sent(air: Air, row: int) -> Integers:
    """(1, kinds): number of ended frames."""
    return _row(air, 5, row, c.KINDS)


@njit(cache=True)
def last_received_ns(air: Air, row: int) -> Integers:
    """(n, n): end of the last frame, CTS and ACK excepted, by receiver (row) and sender."""
    return _row(air, 6, row, air[c.STATIONS])


@njit(cache=True)
def last_received_mw(air: Air, row: int) -> Doubles:
    """(n, n): received power of that frame."""
    return _doubles(air, 7, row, air[c.STATIONS])


@njit(cache=True)
def budgets(air: Air, row: int) -> Integers:
    """Link budgets by sender: validity and longest delay."""
    return _row(air, 8, row, c.BUDGET_COLUMNS)


@njit(cache=True)
def budget_delays_ns(air: Air, row: int) -> Integers:
    """(n, n): propagation delays by sender."""
    return _row(air, 9, row, air[c.STATIONS])


@njit(cache=True)
def budgets_mw(air: Air, row: int) -> Doubles:
    """(n, n): received powers before fading, by sender."""
    return _doubles(air, 10, row, air[c.STATIONS])


@njit(cache=True)
def modes(air: Air, row: int) -> Integers:
    """802.11 modes, in the order of `netsim.model.config.Mode`."""
    return _row(air, 11, row, c.MODE_COLUMNS)


@njit(cache=True)
def hazards(air: Air, row: int) -> Doubles:
    """By mode: SINR from which the hazard is 0, then `netsim.phy.errors.PacketErrorModel.log_hazards`."""
    return _doubles(air, 12, row, 1 + c.RATIOS)


@njit(cache=True)
def levels_mw(air: Air, row: int) -> Doubles:
    """(1, levels): power thresholds."""
    return _doubles(air, 13, row, c.LEVELS)


@njit(cache=True)
def locks_mw(air: Air, row: int) -> Doubles:
    """(1, n): power of the frame that each station is receiving."""
    return _doubles(air, 14, row, air[c.STATIONS])


@njit(cache=True)
def backoffs(air: Air, row: int) -> Doubles:
    """(n, draws): next uniform draws in [0, 1) for backoffs."""
    return _doubles(air, 15, row, c.BLOCK_DRAWS)


@njit(cache=True)
def receptions(air: Air, row: int) -> Doubles:
    """(n, draws): next uniform draws in [0, 1) for receptions."""
    return _doubles(air, 16, row, c.BLOCK_DRAWS)


@njit(cache=True)
def records(air: Air, row: int) -> Integers:
    """Ended frames; columns are the fields of `netsim.emulator.records.FrameRecord`."""
    return _row(air, 17, row, c.RECORD_COLUMNS)


@njit(cache=True)
def events(air: Air, row: int) -> Integers:
    """Event heap."""
    return _row(air, 18, row, c.EVENT_COLUMNS)


@njit(cache=True)
def jobs(air: Air, row: int) -> Integers:
    """Frames to be sent."""
    return _row(air, 19, row, c.JOB_COLUMNS)


@njit(cache=True)
def calls(air: Air, row: int) -> Integers:
    """Calls to report to Python."""
    return _row(air, 20, row, c.CALL_COLUMNS)


@njit(cache=True)
def calls_mw(air: Air, row: int) -> Doubles:
    """(calls, 1): received power of the frame of a call."""
    return _doubles(air, 21, row, 1)


@njit(cache=True)
def signals(air: Air, row: int) -> Integers:
    """Signals that are or were on the air."""
    return _row(air, 22, row, c.SIGNAL_COLUMNS)


@njit(cache=True)
def overlaps(air: Air, row: int) -> Integers:
    """(signals, signals): rows of the signals that overlap each signal, in order of their begin."""
    return _row(air, 23, row, air[c.SIGNAL_ROWS])


@njit(cache=True)
def on_air(air: Air, row: int) -> Integers:
    """(2, signals): rows of the frames, and of the bursts, on the air now, in order of their begin."""
    return _row(air, 24, row, air[c.SIGNAL_ROWS])


@njit(cache=True)
def delays_ns(air: Air, row: int) -> Integers:
    """(signals, n): propagation delay to each station."""
    return _row(air, 25, row, air[c.STATIONS])


@njit(cache=True)
def powers_mw(air: Air, row: int) -> Doubles:
    """(signals, n): received power at each station."""
    return _doubles(air, 26, row, air[c.STATIONS])


class Tables(NamedTuple):
    """Whole tables, (rows, columns) each, for Python code, in their order in memory."""

    stations: Integers
    queues: Integers
    ends: Integers
    last_sequences: Integers
    counts: Integers
    sent: Integers
    last_received_ns: Integers
    last_received_mw: Doubles
    budgets: Integers
    budget_delays_ns: Integers
    budgets_mw: Doubles
    modes: Integers
    hazards: Doubles
    levels_mw: Doubles
    locks_mw: Doubles
    backoffs: Doubles
    receptions: Doubles
    records: Integers
    events: Integers
    jobs: Integers
    calls: Integers
    calls_mw: Doubles
    signals: Integers
    overlaps: Integers
    on_air: Integers
    delays_ns: Integers
    powers_mw: Doubles


def _shapes(numbers: Integers) -> list[tuple[int, int]]:
    n, k, event_rows, job_rows, signal_rows = numbers[: c.SIGNAL_ROWS + 1].tolist()
    # most calls of one event: every job ends, every station's exchange fails, a frame is received
    call_rows = job_rows + n + 8
    return [
        (n, c.STATION_COLUMNS), (n * k, c.QUEUE_COLUMNS), (4, n), (n, n * c.KINDS), (n, 3), (1, c.KINDS),
        (n, n), (n, n), (n, c.BUDGET_COLUMNS), (n, n), (n, n), (c.MODES, c.MODE_COLUMNS),
        (c.MODES, 1 + c.RATIOS), (1, c.LEVELS), (1, n), (n, c.BLOCK_DRAWS), (n, c.BLOCK_DRAWS),
        (c.RECORD_ROWS, c.RECORD_COLUMNS), (event_rows, c.EVENT_COLUMNS), (job_rows, c.JOB_COLUMNS),
        (call_rows, c.CALL_COLUMNS), (call_rows, 1), (signal_rows, c.SIGNAL_COLUMNS),
        (signal_rows, signal_rows), (2, signal_rows), (signal_rows, n), (signal_rows, n),
    ]  # fmt: skip


def tables_of(air: Air) -> Tables:
    """Return the tables of a block as views."""
    begins = air[c.FIRST_TABLE :].tolist()
    views: list[Any] = []
    for kind, (rows, columns) in zip(Tables.__annotations__.values(), _shapes(air), strict=True):
        begin = begins[len(views)]
        numbers = air[begin : begin + rows * columns]
        views.append((numbers.view(np.float64) if kind == Doubles else numbers).reshape(rows, columns))
    return Tables(*views)


def new_air(*, stations: int, categories: int) -> Air:
    """Return a block of empty tables."""
    numbers = np.zeros(c.NUMBERS, np.int64)
    numbers[: c.SIGNAL_ROWS + 1] = stations, categories, 64, 16, 16 + stations
    air = _allocate(numbers)
    _chain(tables_of(air).signals, 0, c.NOTHING)
    return air


def grown(air: Air, *, events: int = 0, jobs: int = 0, signals: int = 0) -> Air:
    """Return a copy of the block with at least that many rows."""
    numbers = air[: c.NUMBERS].copy()
    for which, rows in ((c.EVENT_ROWS, events), (c.JOB_ROWS, jobs), (c.SIGNAL_ROWS, signals)):
        numbers[which] = max(rows, numbers[which])
    new = _allocate(numbers)
    for before, after in zip(tables_of(air), tables_of(new), strict=True):
        after[: before.shape[0], : before.shape[1]] = before
    if signals > air[c.SIGNAL_ROWS]:
        _chain(tables_of(new).signals, int(air[c.SIGNAL_ROWS]), int(air[c.FREE_SIGNAL]))
        new[c.FREE_SIGNAL] = air[c.SIGNAL_ROWS]
    return new


def _allocate(numbers: Integers) -> Air:
    begins = c.NUMBERS + np.cumsum([0] + [rows * columns for rows, columns in _shapes(numbers)])
    air = np.zeros(begins[-1], np.int64)
    air[: c.NUMBERS] = numbers
    air[c.FIRST_TABLE : c.FIRST_TABLE + len(begins)] = begins
    return air


def _chain(signals: Integers, first: int, then: int) -> None:
    """Link the rows from ``first`` on as free rows, followed by the row ``then``."""
    signals[first:, c.NEXT_SIGNAL] = np.arange(first + 1, len(signals) + 1)
    signals[-1, c.NEXT_SIGNAL] = then


@njit(cache=True)
def call(air: Air, what: int, station: int, job: int) -> int:
    """Add a call to Python; return its row, which the caller completes."""
    i = air[c.CALLS]
    air[c.CALLS] = i + 1
    calls(air, i)[c.CALL], calls(air, i)[c.CALL_STATION], calls(air, i)[c.CALL_JOB] = what, station, job
    return int(i)


@njit(cache=True)
def draw_backoff(air: Air, station: int) -> float:
    """Return the next uniform draw in [0, 1) for a station's backoff."""
    used = stations(air, station)[c.BACKOFFS]
    stations(air, station)[c.BACKOFFS] = used + 1
    if used + 1 > c.BLOCK_DRAWS - c.LEAST_DRAWS:
        air[c.DRAWS_LOW] = 1
    return float(backoffs(air, station)[used])


@njit(cache=True)
def draw_reception(air: Air, station: int) -> float:
    """Return the next uniform draw in [0, 1) for a station's reception."""
    used = stations(air, station)[c.RECEPTIONS]
    stations(air, station)[c.RECEPTIONS] = used + 1
    if used + 1 > c.BLOCK_DRAWS - c.LEAST_DRAWS:
        air[c.DRAWS_LOW] = 1
    return float(receptions(air, station)[used])


@njit(cache=True)
def take_signal(air: Air) -> int:
    """Allocate a row of ``signals``; the caller ensures that one is free."""
    row = air[c.FREE_SIGNAL]
    air[c.FREE_SIGNAL] = signals(air, row)[c.NEXT_SIGNAL]
    signals(air, row)[c.OVERLAPS] = signals(air, row)[c.HOLDERS] = signals(air, row)[c.OVER] = 0
    return int(row)


@njit(cache=True)
def end_signal(air: Air, row: int) -> None:
    """End a signal and release its overlapping signals; free rows that are no longer referenced."""
    for k in range(signals(air, row)[c.OVERLAPS]):
        release(air, overlaps(air, row)[k])
    signals(air, row)[c.OVERLAPS] = 0
    signals(air, row)[c.OVER] = 1
    _free_if_unused(air, row)


@njit(cache=True)
def release(air: Air, row: int) -> None:
    """Remove one reference to a signal; free its row if it is over and unreferenced."""
    signals(air, row)[c.HOLDERS] -= 1
    _free_if_unused(air, row)


@njit(cache=True)
def _free_if_unused(air: Air, row: int) -> None:
    if signals(air, row)[c.OVER] and signals(air, row)[c.HOLDERS] == 0:
        signals(air, row)[c.NEXT_SIGNAL] = air[c.FREE_SIGNAL]
        air[c.FREE_SIGNAL] = row
