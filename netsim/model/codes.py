"""Values of coded fields of `netsim.model.records`: kinds of frames, events, calls and outcomes."""

NOTHING = -1
"""Index value for "no row" or "no station"."""

# --- kinds of frames, in the order of `netsim.phy.frames.FrameKind`

DATA, RTS, CTS, ACK, FTM_REQUEST, FTM, KINDS = range(7)

# --- events

ON_ACCESS, ON_DEADLINE, ON_TIMEOUT, START_EXCHANGE, SEND_JOB, SEND_FRAME = range(6)
DETECT, END_FRAME, LOOK_FOR_UNUSED, ON_UNUSED, END_BURST, ENQUEUE = range(6, 12)

# --- calls to Python

FRAME, DONE, FAILED, FRAME_ENDED = range(4)
"""FRAME: a unicast frame was received (detail: 1 if a duplicate). DONE: a job has ended (detail: its
outcome). FAILED: an attempt with rate control was not acknowledged. FRAME_ENDED: a frame has ended at all
stations."""
SENT, ACKNOWLEDGED, RETRY_LIMIT, EXPIRED, OVERFLOW, RADIO_OFF, OUTCOMES = range(7)
"""Outcomes of a job: those of `netsim.mac.jobs.JobOutcome` in its order; the radio was off before it reached
the queue."""

# --- outcome of a frame: at any station, and at an intended receiver

ABSENT, MISSED, RECEIVED, BROKE = range(-1, 3)
"""The station is the sender or its radio is off; not locked on to; received; received with errors."""
NOT_MEANT, DELIVERED, COLLIDED, LOST = range(4)

# --- rows of `netsim.model.tables.on_air`

FRAMES, BURSTS = range(2)

# --- sizes

RECORD_ROWS = 256
"""Buffered records of ended frames, and of arrivals besides one for each station."""
MODES, RATIOS = 18, 1_102
"""Number of 802.11 modes up to 80 MHz, and of entries of a mode's table of hazards."""
