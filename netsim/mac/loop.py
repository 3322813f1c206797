"""The air's events, one after the other: what each has the medium and the stations do.

`run` goes on without Python until it has to ask or to tell something. What is told is told after the event
in which it happens: what the layers above make of it then comes behind all that the event itself has caused.
"""

import numpy as np
from numba import njit

from netsim import tables as t
from netsim.borrowed import borrowed
from netsim.events import drop_next, is_off
from netsim.frames import GROUP
from netsim.mac import station as mac
from netsim.mac.channel import contend, is_full, on_deadline
from netsim.phy import medium, sensing
from netsim.phy.path_loss import Doubles
from netsim.tables import Air, Integers, end_signal

# Why `run` comes back.
REACHED, TELLS, WANTS_BUDGET, WANTS_MODE, WANTS_DRAWS, WANTS_ROOM = range(6)
"""It is through; has calls to be told; lacks the link budget of the station `netsim.tables.WANTED`, which
sends now; the mode of the next frame of the queue `netsim.tables.DUE`; draws; free rows."""


@njit(cache=True)
def run(air: Air, fading: Doubles, until_ns: int, until_order: int) -> int:
    """Run the events before a time and an order of scheduling; returns why it stops.

    What it has stopped for is to be there when it is called again.
    """
    air, fading = borrowed(air), borrowed(fading)
    while True:
        if air[t.DUE] != t.NOTHING:
            lack = _begin_due(air, fading)
        elif _next_is_due(air, until_ns, until_order):
            lack = _run_next(air, fading)
        else:
            return REACHED
        if lack != REACHED:
            return lack
        if air[t.CALLS] and air[t.DUE] == t.NOTHING:
            return TELLS


@njit(cache=True)
def _next_is_due(air: Air, until_ns: int, until_order: int) -> bool:
    """Whether there is an event before a time and an order, those taken back gone."""
    while air[t.EVENTS] and is_off(air):
        drop_next(air)
    if not air[t.EVENTS]:
        return False
    event = t.events(air, 0)
    return bool(event[t.AT] < until_ns or (event[t.AT] == until_ns and event[t.ORDER] <= until_order))


@njit(cache=True)
def _run_next(air: Air, fading: Doubles) -> int:
    """Run the next event, unless it lacks something, which is returned."""
    event = t.events(air, 0)
    what, about = event[t.WHAT], event[t.ABOUT]
    air[t.NOW] = event[t.AT]
    if air[t.DRAWS_LOW]:
        return WANTS_DRAWS
    if (
        air[t.FREE_SIGNAL] == t.NOTHING
        or air[t.EVENTS] + spare_events(air) > air[t.EVENT_ROWS]
        or air[t.RECORDS] == t.RECORD_ROWS
    ):
        return WANTS_ROOM
    if what in (t.SEND_JOB, t.SEND_FRAME):
        sender = mac.sender(air, what, about)
        if sender == t.NOTHING:
            drop_next(air)
            return REACHED
        if _lacks_budget(air, sender):
            return WANTS_BUDGET
    first, second = event[t.FURTHER], event[t.FURTHER + 1]
    third, fourth = event[t.FURTHER + 2], event[t.FURTHER + 3]
    drop_next(air)
    _act(air, fading, what, about, first, second, third, fourth)
    return REACHED


@njit(cache=True)
def _begin_due(air: Air, fading: Doubles) -> int:
    """Begin the exchange that is due, unless it lacks something, which is returned."""
    q = air[t.DUE]
    if mac.lacks_mode(air, q):
        return WANTS_MODE
    if mac.has_time(air, q):
        if _lacks_budget(air, q // air[t.CATEGORIES]):
            return WANTS_BUDGET
        mac.begin(air, fading, q)
    else:
        mac.leave(air, q)
    air[t.DUE] = t.NOTHING
    return REACHED


@njit(cache=True)
def _lacks_budget(air: Air, sender: int) -> bool:
    """Whether the link budget of who sends now has to be computed.

    It holds for a while from then on, so it is never asked for ahead, nor for what may come to nothing.
    """
    air[t.WANTED] = sender
    return bool(air[t.NOW] > t.budgets(air, sender)[t.BUDGET_UNTIL])


@njit(cache=True)
def spare_events(air: Air) -> int:
    """Events that one event schedules at most: an access and a deadline of every queue, an answer."""
    return int(air[t.STATIONS] * (2 * air[t.CATEGORIES] + 2) + 8)


@njit(cache=True)
def _act(
    air: Air, fading: Doubles, what: int, about: int, first: int, second: int, third: int, fourth: int
) -> None:
    """Do what an event is."""
    if what == t.END_FRAME:
        _end_frame(air, about)
    elif what == t.DETECT:
        medium.find(air, about)
    elif what == t.ON_ACCESS:
        mac.on_access(air, about)
    elif what == t.SEND_FRAME:
        mac.send_frame(air, fading, about, first, second, third, fourth)
    elif what == t.SEND_JOB:
        mac.send_job(air, fading, about)
    elif what == t.START_EXCHANGE:
        mac.have_due(air, about)
    elif what == t.ON_TIMEOUT:
        mac.on_timeout(air, about)
    elif what == t.ON_DEADLINE:
        on_deadline(air, about)
    elif what == t.LOOK_FOR_UNUSED:
        medium.look_for_unused(air, about)
    elif what == t.ON_UNUSED:
        if medium.drop_reservation(air, about, first, second):
            mac.on_unused(air, about)
    elif what == t.END_BURST:
        medium.end_burst(air, about)
        for r in range(air[t.STATIONS]):
            mac.on_air_changed(air, r)


@njit(cache=True)
def _end_frame(air: Air, frame: int) -> None:
    medium.settle(air, frame)
    if t.signals(air, frame)[t.TO] == GROUP:
        mac.hand_up_to_all(air, frame)
    for r in range(air[t.STATIONS]):
        if t.ends(air, t.FATES)[r] != t.ABSENT:
            mac.on_end(air, frame, r)
    medium.conclude(air, frame)
    mac.on_sent(air, frame)
    if air[t.OBSERVED]:
        t.call(air, t.FRAME_ENDED, t.signals(air, frame)[t.SOURCE], t.signals(air, frame)[t.JOB])
        air[t.ENDED] = frame
    else:
        end_signal(air, frame)


# --- what Python does between the events


@njit(cache=True)
def enqueue(air: Air, station: int, q: int, job: int) -> bool:
    """Have a station take a job, which is a row of jobs; False if its queues are full or it is silent."""
    if t.stations(air, station)[t.DEAF] or is_full(air, station):
        return False
    contend(air, station, q, job)
    return True


@njit(cache=True)
def silence(air: Air, station: int) -> None:
    """End a station for good."""
    mac.silence(air, station)


@njit(cache=True)
def start_burst(air: Air, burst: int) -> None:
    """Put an interferer's burst on the air, which is a row of signals."""
    mac.on_busy(air, burst, medium.start_burst(air, burst))


@njit(cache=True)
def release(air: Air, frame: int) -> None:
    """Let go of a frame whose end has been told."""
    end_signal(air, frame)


@njit(cache=True)
def surveyed_ns(air: Air, at_ns: int) -> Integers:
    """Time up to ``at_ns``, which is now, for which each station, (n,), sensed the medium busy or sent."""
    busy_ns = np.empty(air[t.STATIONS], np.int64)
    for r in range(len(busy_ns)):
        busy_ns[r] = sensing.surveyed_ns(t.stations(air, r), at_ns)
    return busy_ns


@njit(cache=True)
def next_ns(air: Air, never_ns: int) -> int:
    """Time of the next event, or ``never_ns``."""
    while air[t.EVENTS]:
        if not is_off(air):
            return int(t.events(air, 0)[t.AT])
        drop_next(air)
    return never_ns
