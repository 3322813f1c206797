"""Event loop of the channel: runs the events of medium and stations in order.

`run` stays in compiled code until it needs data from Python or has calls to report. Calls are reported after
the event that causes them, so that reactions of the upper layers follow all effects of the event.
"""

import numpy as np
from numba import njit

from netsim.mac import station as mac
from netsim.mac.borrowed import borrowed
from netsim.mac.contention import contend, is_full, on_deadline
from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.events import drop_next, is_off
from netsim.model.tables import Air, Integers, end_signal
from netsim.phy import medium, sensing
from netsim.phy.frames import GROUP
from netsim.phy.path_loss import Doubles

# Reasons for which `run` returns.
REACHED, HAS_CALLS, NEEDS_BUDGET, NEEDS_MODE, NEEDS_ROOM = range(5)
"""No more events are due; there are calls to report; needed: the link budget of the station
`columns.BUDGET_SENDER`, which sends now; the mode of the next frame of the queue `columns.DUE`; random draws
or free rows."""

# Results of `enqueue`.
ACCEPTED, REJECTED, LACKS_ROOM = range(3)


@njit(cache=True)
def run(air: Air, fading: Doubles, until_ns: int, until_order: int) -> int:
    """Run the events before a time and an order of scheduling; return the reason for stopping.

    The missing data must be supplied before the next call.
    """
    air, fading = borrowed(air), borrowed(fading)
    while True:
        if air[c.DUE] != c.NOTHING:
            lack = _begin_due(air, fading)
        elif _next_is_due(air, until_ns, until_order):
            lack = _run_next(air, fading)
        else:
            return REACHED
        if lack != REACHED:
            return lack
        if air[c.CALLS] and air[c.DUE] == c.NOTHING:
            return HAS_CALLS


@njit(cache=True)
def _next_is_due(air: Air, until_ns: int, until_order: int) -> bool:
    """Whether there is an event before a time and an order; drops cancelled events."""
    while air[c.EVENTS] and is_off(air):
        drop_next(air)
    if not air[c.EVENTS]:
        return False
    event = t.events(air, 0)
    return bool(event[c.AT] < until_ns or (event[c.AT] == until_ns and event[c.ORDER] <= until_order))


@njit(cache=True)
def _run_next(air: Air, fading: Doubles) -> int:
    """Run the next event; return `REACHED`, or what it needs first."""
    event = t.events(air, 0)
    what, about = event[c.WHAT], event[c.ABOUT]
    air[c.NOW] = event[c.AT]
    if not has_room(air):
        return NEEDS_ROOM
    if what in (c.SEND_JOB, c.SEND_FRAME):
        sender = mac.sender(air, what, about)
        if sender == c.NOTHING:
            drop_next(air)
            return REACHED
        if _lacks_budget(air, sender):
            return NEEDS_BUDGET
    first, second = event[c.FURTHER], event[c.FURTHER + 1]
    third, fourth = event[c.FURTHER + 2], event[c.FURTHER + 3]
    drop_next(air)
    _act(air, fading, what, about, first, second, third, fourth)
    return REACHED


@njit(cache=True)
def _begin_due(air: Air, fading: Doubles) -> int:
    """Begin the exchange that is due; return `REACHED`, or what it needs first."""
    q = air[c.DUE]
    if mac.lacks_mode(air, q):
        return NEEDS_MODE
    if mac.has_time(air, q):
        if _lacks_budget(air, q // air[c.CATEGORIES]):
            return NEEDS_BUDGET
        mac.begin(air, fading, q)
    else:
        mac.leave(air, q)
    air[c.DUE] = c.NOTHING
    return REACHED


@njit(cache=True)
def _lacks_budget(air: Air, sender: int) -> bool:
    """Whether the link budget of a station that sends now has to be computed.

    It is valid for a limited time, so it is requested only when a transmission begins.
    """
    air[c.BUDGET_SENDER] = sender
    return bool(air[c.NOW] > t.budgets(air, sender)[c.BUDGET_UNTIL])


@njit(cache=True)
def has_room(air: Air) -> bool:
    """Whether there are enough draws and free rows for any one event."""
    return bool(
        not air[c.DRAWS_LOW]
        and air[c.FREE_SIGNAL] != c.NOTHING
        and air[c.EVENTS] + spare_events(air) <= air[c.EVENT_ROWS]
        and air[c.RECORDS] < c.RECORD_ROWS
    )


@njit(cache=True)
def spare_events(air: Air) -> int:
    """Return the most events that one event schedules: access and deadline per queue, a response."""
    return int(air[c.STATIONS] * (2 * air[c.CATEGORIES] + 2) + 8)


@njit(cache=True)
def _act(
    air: Air, fading: Doubles, what: int, about: int, first: int, second: int, third: int, fourth: int
) -> None:
    """Run one event."""
    if what == c.END_FRAME:
        _end_frame(air, about)
    elif what == c.DETECT:
        medium.find(air, about)
    elif what == c.ON_ACCESS:
        mac.on_access(air, about)
    elif what == c.SEND_FRAME:
        mac.send_frame(air, fading, about, first, second, third, fourth)
    elif what == c.SEND_JOB:
        mac.send_job(air, fading, about)
    elif what == c.START_EXCHANGE:
        mac.schedule_access(air, about)
    elif what == c.ON_TIMEOUT:
        mac.on_timeout(air, about)
    elif what == c.ON_DEADLINE:
        on_deadline(air, about)
    elif what == c.LOOK_FOR_UNUSED:
        medium.look_for_unused(air, about)
    elif what == c.ON_UNUSED:
        if medium.drop_reservation(air, about, first, second):
            mac.on_unused(air, about)
    elif what == c.END_BURST:
        medium.end_burst(air, about)
        for r in range(air[c.STATIONS]):
            mac.on_air_changed(air, r)


@njit(cache=True)
def _end_frame(air: Air, frame: int) -> None:
    medium.settle(air, frame)
    if t.signals(air, frame)[c.TO] == GROUP:
        mac.report_group_frame(air, frame)
    for r in range(air[c.STATIONS]):
        if t.ends(air, c.FATES)[r] != c.ABSENT:
            mac.on_end(air, frame, r)
    medium.conclude(air, frame)
    mac.on_sent(air, frame)
    if air[c.OBSERVED]:
        t.call(air, c.FRAME_ENDED, t.signals(air, frame)[c.SOURCE], t.signals(air, frame)[c.JOB])
        air[c.ENDED] = frame
    else:
        end_signal(air, frame)


# --- called from Python between events


@njit(cache=True)
def set_budget(
    air: Air, source: int, powers_mw: Doubles, delays_ns: Integers, until_ns: int, longest_delay_ns: int
) -> None:
    """Set the link budget of a station: powers and delays (n,), valid until a time."""
    t.budgets_mw(air, source)[:] = powers_mw
    t.budget_delays_ns(air, source)[:] = delays_ns
    budget = t.budgets(air, source)
    budget[c.BUDGET_UNTIL], budget[c.BUDGET_DELAY] = until_ns, longest_delay_ns


@njit(cache=True)
def enqueue(
    air: Air,
    q: int,
    job: int,
    kind: int,
    to: int,
    mode: int,
    frame_bytes: int,
    expires_ns: int,
    retries: int,
    rts: int,
    adapts: int,
    seq: int,
    cancelled: int,
) -> int:
    """Fill a free row of jobs and append it to a queue.

    Returns `REJECTED` if the station's queues are full or its radio is off, and `LACKS_ROOM` without any
    change if `has_room` is False.
    """
    if not has_room(air):
        return LACKS_ROOM
    row = t.jobs(air, job)
    row[:] = 0
    row[c.NEXT_JOB], row[c.JOB_KIND], row[c.JOB_TO], row[c.JOB_MODE] = c.NOTHING, kind, to, mode
    row[c.JOB_BYTES], row[c.JOB_EXPIRES], row[c.JOB_RETRIES] = frame_bytes, expires_ns, retries
    row[c.JOB_RTS], row[c.JOB_ADAPTS], row[c.JOB_SEQ], row[c.JOB_CANCELLED] = rts, adapts, seq, cancelled
    station = q // air[c.CATEGORIES]
    if t.stations(air, station)[c.RADIO_OFF] or is_full(air, station):
        return REJECTED
    contend(air, station, q, job)
    return ACCEPTED


@njit(cache=True)
def silence(air: Air, station: int) -> None:
    """Switch a station's radio off for good."""
    mac.silence(air, station)


@njit(cache=True)
def start_burst(air: Air, burst: int) -> None:
    """Start an interferer's burst, a row of signals."""
    mac.on_busy(air, burst, medium.start_burst(air, burst))


@njit(cache=True)
def release(air: Air, frame: int) -> None:
    """Free the row of a frame whose end has been reported."""
    end_signal(air, frame)


@njit(cache=True)
def surveyed_ns(air: Air, at_ns: int) -> Integers:
    """Return the time (n,) up to now, ``at_ns``, for which each station sensed the medium busy or sent."""
    busy_ns = np.empty(air[c.STATIONS], np.int64)
    for r in range(len(busy_ns)):
        busy_ns[r] = sensing.surveyed_ns(t.stations(air, r), at_ns)
    return busy_ns


@njit(cache=True)
def next_ns(air: Air, never_ns: int) -> int:
    """Return the time of the next event, or ``never_ns``."""
    while air[c.EVENTS]:
        if not is_off(air):
            return int(t.events(air, 0)[c.AT])
        drop_next(air)
    return never_ns
