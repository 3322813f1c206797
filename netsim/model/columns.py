"""What the numbers in the tables of the air mean: columns, kinds of events, of calls and of frames.

`netsim.model.tables` has the tables themselves. Times are in nanoseconds, powers in milliwatt.
"""

NOTHING = -1
"""No row of a table; no station."""

# --- single numbers, at the beginning of the integers

(
    STATIONS, CATEGORIES, EVENT_ROWS, JOB_ROWS, SIGNAL_ROWS,  # how many rows the tables have
    NOW, SCHEDULED,  # the clock, and the events scheduled so far: `netsim.model.event_queue.EventQueue`'s
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
    RADIO_OFF,  # the radio is off for good
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
    AIFS, WINDOW_LEAST, WINDOW_MOST, TXOP, SLOT_OFFSET,  # `netsim.mac.access.AccessParameters`
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

# --- kinds of frames, in the order of `netsim.phy.frames.FrameKind`

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

# --- rows of `netsim.model.tables.ends` and of the levels

FATES, UPSETS, NOTES, NEWLY_BUSY = range(4)
"""What became of the frame at each station; whether that upset a plan; where it was meant to arrive, how that
went. And, of any signal's beginning, the stations to which the medium falls busy."""

NOISE_MW, ENERGY_MW, PREAMBLE_MW, SENSED_MW, LEVELS = range(5)
"""The noise; from which powers on energy is sensed, a preamble can be found, a frame is sensed by itself."""

# --- how large things are

BLOCK_DRAWS, LEAST_DRAWS = 64, 16
"""Draws that lie ready for a station, and what one event takes of them at most."""
RECORD_ROWS, RECORD_COLUMNS = 256, 11
"""Frames that have ended and have not been taken: columns are `netsim.emulator.records.FrameRecord`'s."""
MODES, RATIOS = 18, 1_102
"""802.11's modes up to 80 MHz, and entries of a mode's hazards."""
