"""Event loop of the channel: runs the events of medium and stations in order.

`run` stays in compiled code until it needs data from Python or has calls to report. Calls are reported after
the event that causes them, so that reactions of the upper layers follow all effects of the event.
"""

import numpy as np
from numba import njit

from foundation.kernels.inner import inner
from foundation.kernels.records import Block
from netsim.mac import station as mac
from netsim.mac.contention import contend, is_full, on_deadline
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.events import drop_next, insert, is_off
from netsim.model.records import MediumHeader, NewJob
from netsim.model.tables import Integers, Records, add_call, add_ended_job, end_signal, take_signal
from netsim.phy import medium, sensing
from netsim.phy.frames import GROUP
from netsim.phy.path_loss import Doubles

# Reasons for which `run` returns.
REACHED, HAS_CALLS, NEEDS_BUDGET, NEEDS_MODE, NEEDS_ROOM = range(5)
"""No more events are due; there are calls to report; needed: the link budget of a station, which sends now;
the mode of the next frame of a queue; random draws or free rows."""

# Results of `enqueue`.
ACCEPTED, REJECTED, LACKS_ROOM = range(3)


@njit(cache=True)
def run(
    block: Block, fading: Doubles, now_ns: int, scheduled: int, until_ns: int, until_order: int
) -> tuple[int, int, int, int]:
    """Run the events before a time and an order of scheduling.

    ``now_ns`` and ``scheduled`` are the clock and the number of scheduled events. Returns the reason for
    stopping, both numbers afterwards, and the station or queue that needs data, which must be supplied
    before the next call.
    """
    air = t.open_air(block)
    air.now_ns, air.scheduled = now_ns, scheduled
    reason = _run_until(air, fading, until_ns, until_order)
    needed_by = air.budget_sender if reason == NEEDS_BUDGET else air.due_queue
    return reason, air.now_ns, air.scheduled, needed_by


@inner
def _run_until(air: MediumHeader, fading: Doubles, until_ns: int, until_order: int) -> int:
    """Run events; return the reason for stopping."""
    while True:
        if air.due_queue != c.NOTHING:
            reason = _begin_due(air, fading)
        elif _next_is_due(air, until_ns, until_order):
            reason = _run_next(air, fading)
        else:
            return REACHED
        if reason != REACHED:
            return reason
        if air.calls and air.due_queue == c.NOTHING:
            return HAS_CALLS


@inner
def _next_is_due(air: MediumHeader, until_ns: int, until_order: int) -> bool:
    """Whether there is an event before a time and an order; drops cancelled events."""
    while air.events and is_off(air):
        drop_next(air)
    if not air.events:
        return False
    event = t.event(air, 0)
    return event.at_ns < until_ns or (event.at_ns == until_ns and event.order <= until_order)


@inner
def _run_next(air: MediumHeader, fading: Doubles) -> int:
    """Run the next event; return `REACHED`, or what it needs first."""
    event = t.event(air, 0)
    what, about = event.what, event.about
    air.now_ns = event.at_ns
    if not has_room(air):
        return NEEDS_ROOM
    if what in (c.SEND_JOB, c.SEND_FRAME):
        sender = mac.sender(air, what, about)
        if sender == c.NOTHING:
            drop_next(air)
            return REACHED
        if _lacks_budget(air, sender):
            return NEEDS_BUDGET
    first, second, third, fourth = event.first, event.second, event.third, event.fourth
    drop_next(air)
    if what == c.SEND_FRAME:
        mac.send_frame(air, fading, about, first, second, third, fourth)
    elif what == c.SEND_JOB:
        mac.send_job(air, fading, about)
    elif what == c.ON_UNUSED:
        if medium.drop_reservation(air, about, first, second):
            mac.on_unused(air, about)
    elif what == c.ENQUEUE:
        _enqueue_planned(air, about, first)
    else:
        _act(air, what, about)
    return REACHED


@inner
def _begin_due(air: MediumHeader, fading: Doubles) -> int:
    """Begin the exchange that is due; return `REACHED`, or what it needs first."""
    q = air.due_queue
    if mac.lacks_mode(air, q):
        return NEEDS_MODE
    if mac.has_time(air, q):
        if _lacks_budget(air, q // air.categories):
            return NEEDS_BUDGET
        mac.begin(air, fading, q)
    else:
        mac.leave(air, q)
    air.due_queue = c.NOTHING
    return REACHED


@inner
def _lacks_budget(air: MediumHeader, sender: int) -> bool:
    """Whether the link budget of a station that sends now has to be computed.

    It is valid for a limited time, so it is requested only when a transmission begins.
    """
    air.budget_sender = sender
    return air.now_ns > t.station(air, sender).budget_until_ns


@inner
def has_room(air: MediumHeader) -> bool:
    """Whether there are enough draws and free rows for any one event."""
    return (
        not air.draws_low
        and air.free_signal != c.NOTHING
        and air.events + t.spare_events(air.stations, air.categories) <= air.event_rows
        and air.records < c.RECORD_ROWS
        and air.arrivals < c.RECORD_ROWS
    )


@inner
def _act(air: MediumHeader, what: int, about: int) -> None:
    """Run one event that sends nothing."""
    if what == c.END_FRAME:
        _end_frame(air, about)
    elif what == c.DETECT:
        mac.on_busy(air, about, medium.detect_preambles(air, about))
    elif what == c.ON_ACCESS:
        mac.on_access(air, about)
    elif what == c.START_EXCHANGE:
        mac.schedule_access(air, about)
    elif what == c.ON_TIMEOUT:
        mac.on_timeout(air, about)
    elif what == c.ON_DEADLINE:
        on_deadline(air, about)
    elif what == c.LOOK_FOR_UNUSED:
        medium.look_for_unused(air, about)
    elif what == c.END_BURST:
        medium.end_burst(air, about)
        for r in range(air.stations):
            mac.on_air_changed(air, r)


@inner
def _end_frame(air: MediumHeader, frame: int) -> None:
    sent = t.signal(air, frame)
    medium.settle(air, frame)
    if sent.to == GROUP:
        mac.report_group_frame(air, frame)
    for r in range(air.stations):
        if t.end(air, r).outcome != c.ABSENT:
            mac.on_end(air, frame, r)
    medium.conclude(air, frame)
    mac.on_sent(air, frame)
    if air.observed:
        add_call(air, c.FRAME_ENDED, sent.source, sent.job)
        air.ended_frame = frame
    else:
        end_signal(air, frame)


# --- called from Python between events


@njit(cache=True)
def set_budget(
    block: Block, source: int, powers_mw: Doubles, delays_ns: Integers, until_ns: int, longest_delay_ns: int
) -> None:
    """Set the link budget of a station: powers and delays (n,), valid until a time."""
    air = t.open_air(block)
    for r in range(air.stations):
        budget = t.budget(air, source, r)
        budget.power_mw, budget.delay_ns = powers_mw[r], delays_ns[r]
    sender = t.station(air, source)
    sender.budget_until_ns, sender.budget_longest_delay_ns = until_ns, longest_delay_ns


@njit(cache=True)
def enqueue(block: Block, now_ns: int, scheduled: int, new_jobs: Records) -> tuple[int, int, int]:
    """Append a job, the only one of ``new_jobs`` (`netsim.model.records.NewJob`), to its queue now.

    Returns the result, the number of scheduled events and the number of calls. The result is `REJECTED` if
    the station's queues are full or its radio is off, and `LACKS_ROOM`, without any change, if `has_room` is
    False.
    """
    air, new = t.open_air(block), new_jobs[0]
    air.now_ns, air.scheduled = now_ns, scheduled
    if not has_room(air):
        return LACKS_ROOM, air.scheduled, air.calls
    _fill_job(air, new)
    station, result = new.queue // air.categories, ACCEPTED
    if t.station(air, station).radio_off or is_full(air, station):
        result = REJECTED
    else:
        contend(air, station, new.queue, new.row)
    return result, air.scheduled, air.calls


@njit(cache=True)
def plan(block: Block, new_jobs: Records) -> None:
    """Schedule the events at which deferred jobs are appended to their queues.

    The caller ensures that there are rows for the events.
    """
    air = t.open_air(block)
    for k in range(len(new_jobs)):
        new = new_jobs[k]
        _fill_job(air, new)
        insert(air, new.at_ns, new.order, c.ENQUEUE, new.queue, new.row)


@inner
def _fill_job(air: MediumHeader, new: NewJob) -> None:
    job = t.job(air, new.row)
    job.next_job, job.kind, job.to, job.mode = c.NOTHING, new.kind, new.to, new.mode
    job.frame_bytes, job.expires_ns, job.retry_limit = new.frame_bytes, new.expires_ns, new.retry_limit
    job.rts, job.adapts, job.cancelled = new.rts, new.adapts, new.cancelled
    job.deferred, job.repeats = new.deferred, new.repeats
    job.seq, job.sequence, job.attempts, job.failures, job.sent_ns = new.seq, 0, 0, 0, 0


@inner
def _enqueue_planned(air: MediumHeader, q: int, job: int) -> None:
    station = q // air.categories
    if t.station(air, station).radio_off:
        add_ended_job(air, job, c.RADIO_OFF, air.now_ns)
    elif is_full(air, station):
        add_ended_job(air, job, c.OVERFLOW, air.now_ns)
    else:
        contend(air, station, q, job)


@njit(cache=True)
def silence(block: Block, station: int) -> int:
    """Switch a station's radio off for good; return the number of calls."""
    air = t.open_air(block)
    mac.silence(air, station)
    return air.calls


@njit(cache=True)
def start_burst(
    block: Block, source: int, end_ns: int, powers_mw: Doubles, delays_ns: Integers, longest_delay_ns: int
) -> int:
    """Start an interferer's burst now with powers and delays (n,); return the number of scheduled events."""
    air = t.open_air(block)
    burst = take_signal(air)
    signal = t.signal(air, burst)
    signal.source, signal.longest_delay_ns = source, longest_delay_ns
    signal.start_ns, signal.end_ns = air.now_ns, end_ns
    signal.radiated_until_ns = end_ns
    for r in range(air.stations):
        path = t.path(air, burst, r)
        path.power_mw, path.delay_ns = powers_mw[r], delays_ns[r]
    mac.on_busy(air, burst, medium.start_burst(air, burst))
    return air.scheduled


@njit(cache=True)
def release(block: Block, frame: int) -> None:
    """Free the row of a frame whose end has been reported."""
    end_signal(t.open_air(block), frame)


@njit(cache=True)
def surveyed_ns(block: Block, at_ns: int) -> Integers:
    """Return the time (n,) up to now, ``at_ns``, for which each station sensed the medium busy or sent."""
    air = t.open_air(block)
    busy_ns = np.empty(air.stations, np.int64)
    for r in range(air.stations):
        busy_ns[r] = sensing.surveyed_ns(t.station(air, r), at_ns)
    return busy_ns


@njit(cache=True)
def next_ns(block: Block, never_ns: int) -> int:
    """Return the time of the next event, or ``never_ns``."""
    air = t.open_air(block)
    while air.events:
        if not is_off(air):
            return t.event(air, 0).at_ns
        drop_next(air)
    return never_ns
