"""Indices of the tables in `netsim.model.tables`: columns, kinds of events, calls and frames.

Times are in nanoseconds, powers in milliwatts.
"""

NOTHING = -1
"""Index value for "no row" or "no station"."""

# --- single numbers, at the beginning of the block

(
    STATIONS, CATEGORIES, EVENT_ROWS, JOB_ROWS, SIGNAL_ROWS,  # numbers of rows of the tables
    NOW, SCHEDULED,  # the clock and the count of scheduled events, of `netsim.model.event_queue.EventQueue`
    EVENTS, CALLS, RECORDS, ACTIVE, BURSTS,  # rows in use
    FREE_SIGNAL,  # first free row of ``signals``; free rows are linked by `NEXT_SIGNAL`
    STARTED,  # number of frames started
    BUSY_NS, BUSY_UNTIL_NS,  # time for which the medium carried a signal, counted up to BUSY_UNTIL_NS
    DRAWS_LOW,  # a station needs more random draws
    DUE, CHOSEN,  # the queue whose exchange begins now, or `NOTHING`; whether its mode has been selected
    BUDGET_SENDER,  # the station whose link budget is needed
    QUEUE_FRAMES, CONTROL_MODE,  # settings
    OBSERVED,  # whether the end of every frame is reported
    ENDED,  # the frame whose end is being reported; its row is kept until then
    FIRST_TABLE,  # from here on: begin of each table in the block
) = range(25)  # fmt: skip
NUMBERS = 56

# --- columns of a station: carrier sense, reception, and MAC

(
    BUSY_FROM, BUSY_UNTIL,  # the last busy period; its begin may be in the future by the propagation delay
    IDLE_BEFORE,  # end of the busy period before the last
    ENDED_BUSY,  # total length of all busy periods before the last
    SENDING_FROM, SENDING_UNTIL,
    SENSED_AT_START,  # busy time at the begin of the own transmission
    SENT_ALONE,  # time of ended own transmissions without a sensed signal
    LOCK, LOCK_ARRIVED,  # number of the frame being received, or `NOTHING`; time of its arrival
    LOCKED,  # time of the last preamble detection
    RESERVED_UNTIL, RESERVED_BY,  # NAV from the Duration field (IEEE 802.11-2016, 10.3.2.4)
    BROKEN,  # end of the last frame received with errors; 0 after a correct one
    RADIO_OFF,  # the radio is off for good
    RECEPTIONS,  # draws of ``receptions`` used
    PLANNED,  # the planned accesses match the state of the medium
    CURRENT,  # the queue whose exchange is under way, or `NOTHING`
    PHASE,
    HELD,  # number of frames in its queues
    WAIT_UNTIL, TXOP_END,
    TIMEOUT,  # order of the event at which an awaited response times out; 0: none
    TIMED_OUT,  # the time-out has passed during a reception that may be the response
    SEQUENCE,  # sequence number of the last numbered frame
    BACKOFFS,  # draws of ``backoffs`` used
    STATION_COLUMNS,
) = range(27)  # fmt: skip

# --- columns of a queue: row s * categories + k is category k of station s, the lowest k first in priority

(
    IN_USE,
    FIRST, LAST,  # jobs
    WINDOW, BACKOFF,  # contention window; slots left
    BASE,  # begin of slot 0 while the medium is idle: AIFS after the end of the busy period
    ACCESS, ACCESS_AT,  # order and time of the planned access event; 0 when frozen or empty
    FRESH,  # the frame found the medium idle and has no backoff
    DEADLINE, DEADLINE_AT,  # order and time of the check for expired frames
    AIFS, WINDOW_LEAST, WINDOW_MOST, TXOP, SLOT_OFFSET,  # `netsim.mac.access_parameters.AccessParameters`
    QUEUE_COLUMNS,
) = range(17)  # fmt: skip

# --- columns of a job: `netsim.mac.jobs.Job`

(
    NEXT_JOB,
    JOB_KIND, JOB_TO, JOB_MODE, JOB_BYTES, JOB_EXPIRES,
    JOB_RETRIES,  # failed exchanges after which the next failure drops it
    JOB_RTS,
    JOB_ADAPTS,  # its mode is selected before each attempt
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
    NAV,  # Duration field: time for which the medium is reserved after this frame
    LAPSE,  # time after it at which the NAV is reset where no frame was detected since; 0: never
    SEQ, FRAME_SEQUENCE,
    JOB,  # row of its job; `NOTHING` for control frames
    OVERLAPS,  # number of signals that overlap it in time
    HOLDERS,  # number of references to this row in overlaps and events
    OVER,
    NEXT_SIGNAL,
    SIGNAL_COLUMNS,
) = range(19)  # fmt: skip

# --- columns of an event, of a call to Python, of a mode, and of a link budget

AT, ORDER, WHAT, ABOUT, FURTHER, EVENT_COLUMNS = 0, 1, 2, 3, 4, 8
"""Events of equal time run in the order of scheduling. ``ABOUT`` is a station, a queue or a signal;
``FURTHER`` are up to four more numbers."""
(
    CALL, CALL_STATION, CALL_JOB, CALL_DETAIL,
    CALL_SOURCE, CALL_START, CALL_END,  # of the frame, or of the ACK of the job
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
"""FRAME: a unicast data or action frame was received (detail: 1 if a duplicate). GROUP_FRAME: a group frame
has ended; its receivers are in ``FATES`` (detail: its row of signals). DONE: a job has ended (detail: its
outcome, in the order of `netsim.mac.jobs.JobOutcome`). FAILED: an attempt with rate control was not
acknowledged. FRAME_ENDED: a frame has ended at all stations."""
SENT, ACKNOWLEDGED, RETRY_LIMIT, EXPIRED = range(4)

# --- outcome of a frame: at any station, and at an intended receiver

ABSENT, MISSED, RECEIVED, BROKE = range(-1, 3)
"""The station is the sender or its radio is off; not locked on to; received; received with errors."""
NOT_MEANT, DELIVERED, COLLIDED, LOST = range(4)

# --- rows of `netsim.model.tables.ends` and of the levels

FATES, UPSETS, NOTES, NEWLY_BUSY = range(4)
"""Of the end of a frame, by station: outcome; whether it changes the access plan; outcome at intended
receivers. Of the begin of a signal: the stations at which the medium becomes busy."""

NOISE_MW, ENERGY_MW, PREAMBLE_MW, SENSED_MW, LEVELS = range(5)
"""Noise power, and least powers of: energy detection, preamble detection, sensing of a single frame."""

# --- sizes

BLOCK_DRAWS, LEAST_DRAWS = 64, 16
"""Random draws buffered per station, and the most that one event uses."""
RECORD_ROWS, RECORD_COLUMNS = 256, 11
"""Buffered records of ended frames; columns are the fields of `netsim.emulator.records.FrameRecord`."""
MODES, RATIOS = 18, 1_102
"""Number of 802.11 modes up to 80 MHz, and of entries of a mode's table of hazards."""
