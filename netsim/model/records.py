"""Records of the radio medium: the fields of its header and of the rows of its tables.

Each class declares a record in memory (`foundation.kernels.records`), which kernels and Python code access by
the same names. Times are in nanoseconds since the start, powers in milliwatts. Flags are 0 or 1.
`netsim.model.tables` defines the tables, `netsim.model.codes` the values of coded fields.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from netsim.model.codes import KINDS, OUTCOMES, RATIOS

BUFFERED_DRAWS, LEAST_DRAWS = 64, 16
"""Random draws buffered per station, and the most that one event uses."""


class MediumHeader:
    """Header of the block: single numbers of the medium, settings, and the offsets of the tables in bytes."""

    stations: int
    """Number of stations n."""
    categories: int
    """Number of queues per station."""
    event_rows: int
    """Number of rows of a table, like the next two."""
    job_rows: int
    signal_rows: int
    now_ns: int
    """The clock, like the next one that of `netsim.model.event_queue.EventQueue`."""
    scheduled: int
    """Number of scheduled events."""
    events: int
    """Rows in use; also the next six."""
    calls: int
    records: int
    arrivals: int
    ended_jobs: int
    frames_on_air: int
    bursts_on_air: int
    free_signal: int
    """First free row of signals; free rows are linked by `Signal.next_signal`."""
    frames_started: int
    busy_ns: int
    """Time for which the medium carried a signal, counted up to ``busy_until_ns``."""
    busy_until_ns: int
    draws_low: bool
    """A station needs more random draws."""
    due_queue: int
    """The queue whose exchange begins now, or `codes.NOTHING`."""
    mode_chosen: bool
    """The mode of the exchange that is due has been selected."""
    budget_sender: int
    """The station whose link budget is needed."""
    queue_frames: int
    """Most frames in a station's queues."""
    control_mode: int
    slot_ns: int
    """This and the next four are those of `netsim.phy.timing.PhyTiming`."""
    sifs_ns: int
    signal_extension_ns: int
    eifs_extra_ns: int
    response_timeout_ns: int
    observed: bool
    """The end of every frame is reported."""
    ended_frame: int
    """The frame whose end is being reported; its row is kept until then."""
    noise_mw: float
    energy_mw: float
    """Least total power at which energy is detected."""
    preamble_mw: float
    """Least power at which a preamble is detected."""
    missed_mw: float
    """Least power at which a single frame without a detected preamble is sensed."""
    sent: Annotated[NDArray[np.int64], KINDS]
    """Number of ended frames by kind."""
    station_at: int
    draws_at: int
    queue_at: int
    end_at: int
    link_at: int
    budget_at: int
    mode_at: int
    record_at: int
    event_at: int
    job_at: int
    call_at: int
    arrival_at: int
    ended_job_at: int
    signal_at: int
    overlap_at: int
    on_air_at: int
    path_at: int


class Station:
    """Carrier sense, reception and MAC of a station."""

    busy_from_ns: int
    """Begin of the last busy period, which may be in the future by the propagation delay."""
    busy_until_ns: int
    idle_before_ns: int
    """End of the busy period before the last."""
    ended_busy_ns: int
    """Total length of all busy periods before the last."""
    sending_from_ns: int
    sending_until_ns: int
    sensed_at_start_ns: int
    """Busy time at the begin of the own transmission."""
    sent_alone_ns: int
    """Time of ended own transmissions without a sensed signal."""
    locked_frame: int
    """Number of the frame being received, or `codes.NOTHING`."""
    lock_arrived_ns: int
    """Arrival of that frame."""
    lock_mw: float
    """Received power of that frame."""
    last_detection_ns: int
    """Last detection of a preamble."""
    nav_until_ns: int
    """End of the reservation from a Duration field (IEEE 802.11-2016, 10.3.2.4)."""
    nav_set_by: int
    """Station for whose exchange the medium is reserved."""
    last_error_ns: int
    """End of the last frame received with errors; 0 after a correct one."""
    radio_off: bool
    """The radio is off for good."""
    planned: bool
    """The planned accesses match the state of the medium."""
    current_queue: int
    """The queue whose exchange is under way, or `codes.NOTHING`."""
    phase: int
    """State of that exchange: see `netsim.mac.station`."""
    queued_frames: int
    wait_until_ns: int
    """Time before which a new access is not planned, after a failed exchange."""
    txop_end_ns: int
    timeout_event: int
    """Order of the event at which an awaited response times out; 0: none."""
    timed_out: bool
    """The time-out has passed during a reception that may be the response."""
    sequence: int
    """Sequence number of the last numbered frame."""
    backoffs_used: int
    receptions_used: int
    """Used entries of `Draws`."""
    budget_until_ns: int
    """End of the validity of the station's link budget."""
    budget_longest_delay_ns: int
    """Longest delay to a station that can sense it."""
    broadcasts: Annotated[NDArray[np.int64], 3]
    """Broadcast datagrams to this receiver: delivered, collided, lost to noise."""
    repeated: Annotated[NDArray[np.int64], OUTCOMES]
    """Ends of jobs that repeat, by outcome."""


class Draws:
    """Next uniform draws in [0, 1) of a station."""

    backoffs: Annotated[NDArray[np.float64], BUFFERED_DRAWS]
    receptions: Annotated[NDArray[np.float64], BUFFERED_DRAWS]


class Queue:
    """Queue of a station: row s * categories + k is category k of station s; the lowest k has priority."""

    in_use: bool
    first_job: int
    last_job: int
    window: int
    """Contention window in slots."""
    backoff_slots: int
    """Slots left."""
    slots_from_ns: int
    """Begin of slot 0 while the medium is idle: AIFS after the end of the busy period."""
    access_event: int
    """Order of the planned access event; 0 when frozen or empty."""
    access_ns: int
    found_idle: bool
    """The frame found the medium idle and has no backoff, by DCF."""
    deadline_event: int
    """Order of the check for expired frames; 0: none."""
    deadline_ns: int
    aifs_ns: int
    """This and the following fields are `netsim.mac.access_parameters.AccessParameters`."""
    window_min: int
    window_max: int
    txop_ns: int
    slot_offset: int
    """1: EDCA, which acts at slot boundaries; 0: DCF."""


class End:
    """Data of one event by station: the effects of a frame's end, or of a signal's begin."""

    outcome: int
    """Outcome of a frame at this station: `codes.ABSENT` to `codes.BROKE`."""
    replan: bool
    """The end of the frame changes the access plan."""
    receiver_outcome: int
    """Outcome at an intended receiver: `codes.NOT_MEANT` to `codes.LOST`."""
    newly_busy: int
    """k-th station at which the medium becomes busy, in row k."""


class Link:
    """Last frames that a receiver (row) has received from a sender (column)."""

    last_received_ns: int
    """End of the last frame, CTS and ACK excepted."""
    last_received_mw: float
    last_sequence: Annotated[NDArray[np.int64], KINDS]
    """Last sequence number by kind."""


class Path:
    """Power and delay of a signal, or of a sender's link budget before fading, at a station."""

    power_mw: float
    delay_ns: int


class PhyModeRow:
    """802.11 mode, in the order of `netsim.model.config.Mode`."""

    preamble_ns: int
    bits_per_symbol: int
    vht: bool
    response_mode: int
    hazard_count: int
    """Number of valid entries of ``log_hazards``."""
    clean_linear: float
    """SINR from which the hazard is 0."""
    log_hazards: Annotated[NDArray[np.float64], RATIOS]
    """`netsim.phy.errors.PacketErrorModel.log_hazards`."""


class EndedFrame:
    """A frame that has ended; the fields of `netsim.emulator.records.FrameRecord`."""

    start_ns: int
    end_ns: int
    source: int
    to: int
    kind: int
    mode: int
    frame_bytes: int
    seq: int
    outcomes: Annotated[NDArray[np.int64], 3]
    """Intended receivers by outcome: delivered, collided, lost to noise."""


class ScheduledEvent:
    """Event; those of equal time run in the order of scheduling."""

    at_ns: int
    order: int
    what: int
    """`codes.ON_ACCESS` to `codes.ENQUEUE`."""
    about: int
    """A station, a queue or a signal."""
    first: int
    """This and the next three: further numbers of the event."""
    second: int
    third: int
    fourth: int


class NewJob:
    """A job for the table of jobs, and the queue that it goes to."""

    at_ns: int
    """Time at which it is appended to its queue."""
    order: int
    """Order of scheduling of that event."""
    queue: int
    row: int
    """Row of the table of jobs."""
    kind: int
    """This and the following fields are those of `JobRow`."""
    to: int
    mode: int
    frame_bytes: int
    expires_ns: int
    retry_limit: int
    rts: bool
    adapts: bool
    deferred: bool
    repeats: bool
    seq: int
    cancelled: bool


class JobRow:
    """Frame to be sent: `netsim.mac.jobs.Job`."""

    next_job: int
    kind: int
    to: int
    mode: int
    frame_bytes: int
    expires_ns: int
    retry_limit: int
    """Failed exchanges after which the next failure drops it."""
    rts: bool
    adapts: bool
    """Its mode is selected before each attempt."""
    deferred: bool
    """Its end is reported in `EndedJob`, and its reception in `Arrival`, instead of by calls."""
    repeats: bool
    """It is appended to its queue again when it ends: its ends are counted in `Station.repeated`."""
    seq: int
    sequence: int
    cancelled: bool
    attempts: int
    failures: int
    sent_ns: int


class UpperCall:
    """Call to report to Python."""

    what: int
    """`codes.FRAME` to `codes.FRAME_ENDED`."""
    station: int
    job: int
    detail: int
    source: int
    """Source of the frame, or of the ACK of the job; also the next three fields."""
    start_ns: int
    end_ns: int
    power_mw: float


class Arrival:
    """A group frame, or the frame of a deferred job, at a station that has received it."""

    frame: int
    """Number of the frame; frames of several receivers are in consecutive rows."""
    job: int
    """`codes.NOTHING` for a frame without a job."""
    station: int
    source: int
    end_ns: int
    """End of the frame at the station's antenna."""
    power_mw: float


class EndedJob:
    """A deferred job that has ended."""

    job: int
    outcome: int
    """`codes.SENT` to `codes.RADIO_OFF`."""
    attempts: int
    ended_ns: int
    """End of its ACK, or of the group frame at its sender, or time at which it was dropped."""


class Signal:
    """Frame on the air, or an interferer's burst."""

    source: int
    """Negative for a burst."""
    start_ns: int
    end_ns: int
    """End at the sender, with the signal extension."""
    radiated_until_ns: int
    """End of its power: the same without the signal extension."""
    longest_delay_ns: int
    number: int
    kind: int
    to: int
    mode: int
    frame_bytes: int
    nav_ns: int
    """Duration field: time for which the medium is reserved after this frame."""
    lapse_ns: int
    """Time after it at which the NAV is reset where no frame was detected since; 0: never."""
    seq: int
    sequence: int
    job: int
    """Row of its job; `codes.NOTHING` for control frames."""
    overlap_count: int
    """Number of signals that overlap it in time."""
    references: int
    """Number of references to this row in overlaps and events."""
    over: bool
    next_signal: int


class SignalReference:
    """Row of a signal."""

    signal: int
