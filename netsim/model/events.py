"""Event heap of the tables, ordered by time and order of scheduling."""

from foundation.kernels.inner import inner
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.records import MediumHeader, ScheduledEvent


@inner
def _comes_before(air: MediumHeader, i: int, j: int) -> bool:
    one, other = t.event(air, i), t.event(air, j)
    if one.at_ns != other.at_ns:
        return one.at_ns < other.at_ns
    return one.order < other.order


@inner
def _swap(air: MediumHeader, i: int, j: int) -> None:
    one, other = t.event(air, i), t.event(air, j)
    one.at_ns, other.at_ns = other.at_ns, one.at_ns
    one.order, other.order = other.order, one.order
    one.what, other.what = other.what, one.what
    one.about, other.about = other.about, one.about
    one.first, other.first = other.first, one.first
    one.second, other.second = other.second, one.second
    one.third, other.third = other.third, one.third
    one.fourth, other.fourth = other.fourth, one.fourth


@inner
def begin_event(air: MediumHeader, at_ns: int, what: int, about: int) -> ScheduledEvent:
    """Write an event behind the heap; return it for its further numbers, then call `end_event`."""
    event = t.event(air, air.events)
    event.at_ns, event.order, event.what, event.about = at_ns, air.scheduled + 1, what, about
    return event


@inner
def end_event(air: MediumHeader) -> int:
    """Add the event of `begin_event` to the heap; return its order, which is unique."""
    air.scheduled += 1
    _add_last(air)
    return air.scheduled


@inner
def insert(air: MediumHeader, at_ns: int, order: int, what: int, about: int, first: int) -> None:
    """Add an event with an order that has been counted as scheduled before."""
    event = t.event(air, air.events)
    event.at_ns, event.order, event.what, event.about, event.first = at_ns, order, what, about, first
    _add_last(air)


@inner
def _add_last(air: MediumHeader) -> None:
    """Move the event behind the heap to its place in it."""
    i = air.events
    air.events += 1
    while i and _comes_before(air, i, (i - 1) // 2):
        _swap(air, i, (i - 1) // 2)
        i = (i - 1) // 2


@inner
def schedule(air: MediumHeader, at_ns: int, what: int, about: int) -> int:
    """Schedule an event without further numbers; return its order."""
    begin_event(air, at_ns, what, about)
    return end_event(air)


@inner
def drop_next(air: MediumHeader) -> None:
    """Remove the next event."""
    count = air.events - 1
    air.events = count
    i = 0
    _swap(air, i, count)
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and _comes_before(air, child + 1, child):
            child += 1
        if not _comes_before(air, child, i):
            break
        _swap(air, i, child)
        i = child


@inner
def is_off(air: MediumHeader) -> bool:
    """Whether the next event is cancelled: its station or queue no longer refers to its order."""
    event = t.event(air, 0)
    what, about, order = event.what, event.about, event.order
    if what == c.ON_ACCESS:
        return t.queue(air, about).access_event != order
    if what == c.ON_DEADLINE:
        return t.queue(air, about).deadline_event != order
    if what == c.ON_TIMEOUT:
        return t.station(air, about).timeout_event != order
    return False
