"""All that the radios and the air between them are at a moment: tables of numbers in one block of memory.

A frame is some ten events, and each concerns a few numbers of some stations. As objects those were spread
over hundreds of places in memory, and in a swarm's lockstep every step begins with cold caches. So what all
stations, queues, frames and events are is rows of tables, and `netsim.mac.loop` runs event after event over
them without Python, as long as nobody above the MAC has to hear of one.

Here is where everything lies, and nothing of what it means to 802.11: that is `netsim.phy`'s and
`netsim.mac`'s. Times are in nanoseconds, powers in milliwatt.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from netsim.phy.path_loss import Doubles

Integers = NDArray[np.int64]
NOTHING = -1
"""No row of a table; no station."""

# --- single numbers, at the beginning of the integers

(
    STATIONS, CATEGORIES, EVENT_ROWS, JOB_ROWS, SIGNAL_ROWS,  # how many rows the tables have
    NOW, SCHEDULED,  # the clock, and the events scheduled so far: `netsim.kernel.EventQueue`'s
    EVENTS, CALLS, RECORDS, ACTIVE, BURSTS,  # rows in use
    FREE_SIGNAL,  # first of the free rows of ``signals``, which are chained by `NEXT_SIGNAL`
    STARTED,  # frames so far
    BUSY_NS, BUSY_UNTIL_NS,  # time for which the medium carried a signal, counted up to then
    DRAWS_LOW,  # some station has hardly any draws left
    DUE, CHOSEN,  # the queue whose exchange begins now, or `NOTHING`; its frame has been given a mode
    WANTED,  # the sender whose link budget has to be computed
    QUEUE_FRAMES, CONTROL_MODE,  # settings
    OBSERVED,  # the end of every frame is told
    ENDED,  # the frame whose end is being told, and whose row is kept until then
    FIRST_TABLE,  # from here on, where the tables begin
) = range(25)  # fmt: skip
NUMBERS = 56

# --- columns of a station: what it senses of the medium, and its MAC

(
    BUSY_FROM, BUSY_UNTIL,  # the last busy period; it may begin later than now, by the propagation delay
    IDLE_BEFORE,  # end of the one before
    ENDED_BUSY,  # length of all before the last
    SENDING_FROM, SENDING_UNTIL,
    SENSED_AT_START,  # busy time when the own transmission began
    SENT_ALONE,  # time of the own transmissions that have ended in which nothing was sensed
    LOCK, LOCK_ARRIVED,  # number of the frame that is being received, or `NOTHING`; when it began here
    LOCKED,  # when a preamble was last found
    RESERVED_UNTIL, RESERVED_BY,  # the Duration field's (NAV, IEEE 802.11-2016, 10.3.2.4)
    BROKEN,  # when a frame ended here in errors; 0 if one has come through since
    DEAF,  # the radio is off for good
    RECEPTIONS,  # draws of ``receptions`` used
    PLANNED,  # the planned accesses follow from what is known of the medium
    CURRENT,  # the queue whose exchange is under way, or `NOTHING`
    PHASE,
    HELD,  # frames in its queues
    WAIT_UNTIL, TXOP_END,
    TIMEOUT,  # the event at which an awaited answer is missing, by its order; 0 for none
    TIMED_OUT,  # it has come, while a frame was being received that may be the answer
    SEQUENCE,  # of the last frame that has a number
    BACKOFFS,  # draws of ``backoffs`` used
    STATION_COLUMNS,
) = range(27)  # fmt: skip

# --- columns of a queue: that of category k of station s is row s * categories + k, the first before all

(
    IN_USE,
    FIRST, LAST,  # jobs
    WINDOW, BACKOFF,  # contention window; slots left
    BASE,  # while the medium is idle, where slot 0 begins: AIFS after it fell idle
    ACCESS, ACCESS_AT,  # the planned access by its event's order; 0 when frozen or with nothing to send
    FRESH,  # the frame found the medium idle and drew no backoff
    DEADLINE, DEADLINE_AT,  # likewise, when frames whose lifetime is over are looked for
    AIFS, WINDOW_LEAST, WINDOW_MOST, TXOP, AHEAD,  # `netsim.mac.access.AccessParameters`
    QUEUE_COLUMNS,
) = range(17)  # fmt: skip

# --- columns of a job, a frame to be delivered: `netsim.mac.jobs.Job`

(
    NEXT_JOB,
    JOB_KIND, JOB_TO, JOB_MODE, JOB_BYTES, JOB_EXPIRES,
    JOB_RETRIES,  # failed exchanges after which the next failure gives it up
    JOB_RTS,
    JOB_ADAPTS,  # its mode is chosen anew before each attempt
    JOB_SEQ, JOB_SEQUENCE,
    JOB_CANCELLED,
    JOB_ATTEMPTS, JOB_FAILURES,
    JOB_SENT_AT,
    JOB_COLUMNS,
) = range(16)  # fmt: skip

# --- columns of a signal: a frame on the air, or an interferer's burst

(
    SOURCE,  # negative for a burst
    START, END, LONGEST_DELAY,
    NUMBER,
    KIND, TO, MODE, BYTES,
    NAV,  # Duration field: how long the medium stays reserved after this frame
    LAPSE,  # time after it at which the reservation falls where nothing was heard since; 0 is never
    SEQ, FRAME_SEQUENCE,
    JOB,  # what it carries; `NOTHING` for control frames
    OVERLAPS,  # how many signals were on the air at some time with it
    HOLDERS,  # how many others' overlaps and events have this row
    OVER,
    NEXT_SIGNAL,
    SIGNAL_COLUMNS,
) = range(19)  # fmt: skip

# --- columns of an event, of a call to Python, of a mode, and of a link budget

AT, ORDER, WHAT, ABOUT, FURTHER, EVENT_COLUMNS = 0, 1, 2, 3, 4, 8
"""Events of one time are run in the order in which they were scheduled. They are about a station, a queue or
a signal; up to four numbers further."""
(
    CALL, CALL_STATION, CALL_JOB, CALL_DETAIL,
    CALL_SOURCE, CALL_START, CALL_END,  # of the frame, or of the ACK that ended the job
    CALL_COLUMNS,
) = range(8)  # fmt: skip
PREAMBLE, BITS_PER_SYMBOL, VHT, RESPONSE_MODE, HAZARDS, MODE_COLUMNS = range(6)
BUDGET_UNTIL, BUDGET_DELAY, BUDGET_COLUMNS = range(3)

# --- kinds of frames, in the order of `netsim.frames.FrameKind`

DATA, RTS, CTS, ACK, FTM_REQUEST, FTM, KINDS = range(7)

# --- events

ON_ACCESS, ON_DEADLINE, ON_TIMEOUT, START_EXCHANGE, SEND_JOB, SEND_FRAME = range(6)
DETECT, END_FRAME, LOOK_FOR_UNUSED, ON_UNUSED, END_BURST = range(6, 11)

# --- calls to Python

FRAME, GROUP_FRAME, DONE, FAILED, FRAME_ENDED = range(5)
"""A data or action frame has reached the one station that it is for (detail: again); one to all has reached
those whose fates say so (detail: its row of signals); a job has ended (detail: its outcome, in the order of
`netsim.mac.jobs.Outcome`); an attempt whose mode was chosen was not acknowledged; a frame has ended
everywhere."""
SENT, ACKNOWLEDGED, RETRY_LIMIT, EXPIRED = range(4)

# --- what becomes of a frame: at a station, and in the end where it was meant to arrive

ABSENT, MISSED, RECEIVED, BROKE = range(-1, 3)
"""It is the sender's own or the radio is off; not locked on to; received whole; ended in errors."""
NOT_MEANT, DELIVERED, COLLIDED, LOST = range(4)

NOISE_MW, ENERGY_MW, PREAMBLE_MW, SENSED_MW, LEVELS = range(5)
"""The noise; from which powers on energy is sensed, a preamble can be found, a frame is sensed by itself."""

BLOCK_DRAWS, LEAST_DRAWS = 64, 16
"""Draws that lie ready for a station, and what one event takes of them at most."""
RECORD_ROWS, RECORD_COLUMNS = 256, 11
"""Frames that have ended and have not been taken: columns are `netsim.records.FrameRecord`'s."""
MODES, RATIOS = 18, 1_102
"""802.11's modes up to 80 MHz, and entries of a mode's hazards."""


Air = Integers
"""The block: first the single numbers, then the tables one after the other."""

# --- rows of the tables, for compiled code: where each table begins is among the single numbers


@njit(cache=True)
def _row(air: Air, which: int, row: int, columns: int) -> Integers:
    first = air[FIRST_TABLE + which] + row * columns
    return air[first : first + columns]


@njit(cache=True)
def _doubles(air: Air, which: int, row: int, columns: int) -> Doubles:
    first = air[FIRST_TABLE + which] + row * columns
    return air[first : first + columns].view(np.float64)


@njit(cache=True)
def stations(air: Air, row: int) -> Integers:
    """What the stations sense, and their MACs."""
    return _row(air, 0, row, STATION_COLUMNS)


@njit(cache=True)
def queues(air: Air, row: int) -> Integers:
    """Queues of the stations."""
    return _row(air, 1, row, QUEUE_COLUMNS)


@njit(cache=True)
def ends(air: Air, row: int) -> Integers:
    """(4, n): of the frame whose end is being looked at: see the rows' names."""
    return _row(air, 2, row, air[STATIONS])


FATES, UPSETS, NOTES, TOLD = range(4)
"""What became of it at each station; whether that upset a plan; where it was meant to arrive, how that went.
And, of any signal's beginning, the stations to which the medium falls busy."""


@njit(cache=True)
def last_sequences(air: Air, row: int) -> Integers:
    """(n, n x kinds): the last sequence number of each sender and kind, by receiver."""
    return _row(air, 3, row, air[STATIONS] * KINDS)


@njit(cache=True)
def counts(air: Air, row: int) -> Integers:
    """(n, 3): datagrams to all by receiver: delivered, collided, lost to noise."""
    return _row(air, 4, row, 3)


@njit(cache=True)
def sent(air: Air, row: int) -> Integers:
    """(1, kinds): frames that have ended."""
    return _row(air, 5, row, KINDS)


@njit(cache=True)
def heard_ns(air: Air, row: int) -> Integers:
    """(n, n): when each station, by row, last heard a frame of each other that was no answer."""
    return _row(air, 6, row, air[STATIONS])


@njit(cache=True)
def heard_mw(air: Air, row: int) -> Doubles:
    """(n, n): how loud that was."""
    return _doubles(air, 7, row, air[STATIONS])


@njit(cache=True)
def budgets(air: Air, row: int) -> Integers:
    """Of links, by sender: until when they hold."""
    return _row(air, 8, row, BUDGET_COLUMNS)


@njit(cache=True)
def budget_delays_ns(air: Air, row: int) -> Integers:
    """(n, n), by sender."""
    return _row(air, 9, row, air[STATIONS])


@njit(cache=True)
def budgets_mw(air: Air, row: int) -> Doubles:
    """(n, n), by sender: what arrives, before fading."""
    return _doubles(air, 10, row, air[STATIONS])


@njit(cache=True)
def modes(air: Air, row: int) -> Integers:
    """802.11's modes, in the order of `netsim.config.Mode`."""
    return _row(air, 11, row, MODE_COLUMNS)


@njit(cache=True)
def hazards(air: Air, row: int) -> Doubles:
    """By mode: the ratio from which on there are none, and `netsim.phy.errors.ErrorModel.log_hazards`."""
    return _doubles(air, 12, row, 1 + RATIOS)


@njit(cache=True)
def levels_mw(air: Air, row: int) -> Doubles:
    """(1, levels): powers that matter."""
    return _doubles(air, 13, row, LEVELS)


@njit(cache=True)
def locks_mw(air: Air, row: int) -> Doubles:
    """(1, n): power of the frame that each station is locked on to."""
    return _doubles(air, 14, row, air[STATIONS])


@njit(cache=True)
def backoffs(air: Air, row: int) -> Doubles:
    """(n, draws): uniforms in [0, 1) to come."""
    return _doubles(air, 15, row, BLOCK_DRAWS)


@njit(cache=True)
def receptions(air: Air, row: int) -> Doubles:
    """(n, draws): likewise."""
    return _doubles(air, 16, row, BLOCK_DRAWS)


@njit(cache=True)
def records(air: Air, row: int) -> Integers:
    """Frames that have ended: columns are `netsim.records.FrameRecord`'s."""
    return _row(air, 17, row, RECORD_COLUMNS)


@njit(cache=True)
def events(air: Air, row: int) -> Integers:
    """Give the heap."""
    return _row(air, 18, row, EVENT_COLUMNS)


@njit(cache=True)
def jobs(air: Air, row: int) -> Integers:
    """Frames to be delivered."""
    return _row(air, 19, row, JOB_COLUMNS)


@njit(cache=True)
def calls(air: Air, row: int) -> Integers:
    """What Python is to be told."""
    return _row(air, 20, row, CALL_COLUMNS)


@njit(cache=True)
def calls_mw(air: Air, row: int) -> Doubles:
    """(calls, 1): power of the frame that a call is about."""
    return _doubles(air, 21, row, 1)


@njit(cache=True)
def signals(air: Air, row: int) -> Integers:
    """What is on the air, or was."""
    return _row(air, 22, row, SIGNAL_COLUMNS)


@njit(cache=True)
def overlaps(air: Air, row: int) -> Integers:
    """(signals, signals): rows of those that were on the air with one, in order of their beginning."""
    return _row(air, 23, row, air[SIGNAL_ROWS])


@njit(cache=True)
def on_air(air: Air, row: int) -> Integers:
    """(2, signals): rows of the frames, and of the bursts, on the air now, in order of their beginning."""
    return _row(air, 24, row, air[SIGNAL_ROWS])


@njit(cache=True)
def delays_ns(air: Air, row: int) -> Integers:
    """(signals, n): how long a signal takes to each station."""
    return _row(air, 25, row, air[STATIONS])


@njit(cache=True)
def powers_mw(air: Air, row: int) -> Doubles:
    """(signals, n): what arrives of it."""
    return _doubles(air, 26, row, air[STATIONS])


class Tables(NamedTuple):
    """Whole tables, (rows, columns) each, for Python: in the order in which they lie."""

    stations: Integers
    queues: Integers
    ends: Integers
    last_sequences: Integers
    counts: Integers
    sent: Integers
    heard_ns: Integers
    heard_mw: Doubles
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
    n, k, event_rows, job_rows, signal_rows = numbers[: SIGNAL_ROWS + 1].tolist()
    # most calls that one event makes: every job ends, every station's exchange fails, a frame is heard
    call_rows = job_rows + n + 8
    return [
        (n, STATION_COLUMNS), (n * k, QUEUE_COLUMNS), (4, n), (n, n * KINDS), (n, 3), (1, KINDS), (n, n),
        (n, n), (n, BUDGET_COLUMNS), (n, n), (n, n), (MODES, MODE_COLUMNS), (MODES, 1 + RATIOS), (1, LEVELS),
        (1, n), (n, BLOCK_DRAWS), (n, BLOCK_DRAWS), (RECORD_ROWS, RECORD_COLUMNS),
        (event_rows, EVENT_COLUMNS), (job_rows, JOB_COLUMNS), (call_rows, CALL_COLUMNS), (call_rows, 1),
        (signal_rows, SIGNAL_COLUMNS), (signal_rows, signal_rows), (2, signal_rows), (signal_rows, n),
        (signal_rows, n),
    ]  # fmt: skip


def tables_of(air: Air) -> Tables:
    """Give the tables of a block, which they are views of."""
    begins = air[FIRST_TABLE:].tolist()
    views: list[Any] = []
    for kind, (rows, columns) in zip(Tables.__annotations__.values(), _shapes(air), strict=True):
        begin = begins[len(views)]
        numbers = air[begin : begin + rows * columns]
        views.append((numbers.view(np.float64) if kind == Doubles else numbers).reshape(rows, columns))
    return Tables(*views)


def new_air(*, stations: int, categories: int) -> Air:
    """Tables with nothing in them."""
    numbers = np.zeros(NUMBERS, np.int64)
    numbers[: SIGNAL_ROWS + 1] = stations, categories, 64, 16, 16 + stations
    air = _allocate(numbers)
    _chain(tables_of(air).signals, 0, NOTHING)
    return air


def grown(air: Air, *, events: int = 0, jobs: int = 0, signals: int = 0) -> Air:
    """Give the same tables with at least so many rows."""
    numbers = air[:NUMBERS].copy()
    for which, rows in ((EVENT_ROWS, events), (JOB_ROWS, jobs), (SIGNAL_ROWS, signals)):
        numbers[which] = max(rows, numbers[which])
    new = _allocate(numbers)
    for before, after in zip(tables_of(air), tables_of(new), strict=True):
        after[: before.shape[0], : before.shape[1]] = before
    if signals > air[SIGNAL_ROWS]:
        _chain(tables_of(new).signals, int(air[SIGNAL_ROWS]), int(air[FREE_SIGNAL]))
        new[FREE_SIGNAL] = air[SIGNAL_ROWS]
    return new


def _allocate(numbers: Integers) -> Air:
    begins = NUMBERS + np.cumsum([0] + [rows * columns for rows, columns in _shapes(numbers)])
    air = np.zeros(begins[-1], np.int64)
    air[:NUMBERS] = numbers
    air[FIRST_TABLE : FIRST_TABLE + len(begins)] = begins
    return air


def _chain(signals: Integers, first: int, then: int) -> None:
    """Chain the rows from ``first`` on as free, and behind them the row ``then``."""
    signals[first:, NEXT_SIGNAL] = np.arange(first + 1, len(signals) + 1)
    signals[-1, NEXT_SIGNAL] = then


@njit(cache=True)
def call(air: Air, what: int, station: int, job: int) -> int:
    """Have Python told; returns the call's row, for the caller to complete."""
    i = air[CALLS]
    air[CALLS] = i + 1
    calls(air, i)[CALL], calls(air, i)[CALL_STATION], calls(air, i)[CALL_JOB] = what, station, job
    return int(i)


@njit(cache=True)
def draw_backoff(air: Air, station: int) -> float:
    """Next uniform in [0, 1) of a station's backoff."""
    used = stations(air, station)[BACKOFFS]
    stations(air, station)[BACKOFFS] = used + 1
    if used + 1 > BLOCK_DRAWS - LEAST_DRAWS:
        air[DRAWS_LOW] = 1
    return float(backoffs(air, station)[used])


@njit(cache=True)
def draw_reception(air: Air, station: int) -> float:
    """Next uniform in [0, 1) of a station's reception."""
    used = stations(air, station)[RECEPTIONS]
    stations(air, station)[RECEPTIONS] = used + 1
    if used + 1 > BLOCK_DRAWS - LEAST_DRAWS:
        air[DRAWS_LOW] = 1
    return float(receptions(air, station)[used])


@njit(cache=True)
def take_signal(air: Air) -> int:
    """Take a free row of ``signals``; there is one."""
    row = air[FREE_SIGNAL]
    air[FREE_SIGNAL] = signals(air, row)[NEXT_SIGNAL]
    signals(air, row)[OVERLAPS] = signals(air, row)[HOLDERS] = signals(air, row)[OVER] = 0
    return int(row)


@njit(cache=True)
def end_signal(air: Air, row: int) -> None:
    """Let go of a signal that is over, and of those that it had on the air with it."""
    for k in range(signals(air, row)[OVERLAPS]):
        let_go(air, overlaps(air, row)[k])
    signals(air, row)[OVERLAPS] = 0
    signals(air, row)[OVER] = 1
    _free_if_unused(air, row)


@njit(cache=True)
def let_go(air: Air, row: int) -> None:
    """Note one holder less of a signal, which may be over."""
    signals(air, row)[HOLDERS] -= 1
    _free_if_unused(air, row)


@njit(cache=True)
def _free_if_unused(air: Air, row: int) -> None:
    if signals(air, row)[OVER] and signals(air, row)[HOLDERS] == 0:
        signals(air, row)[NEXT_SIGNAL] = air[FREE_SIGNAL]
        air[FREE_SIGNAL] = row
