"""Event heap of the tables, ordered by time and order of scheduling."""

from numba import njit

from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.tables import Air


@njit(cache=True)
def _comes_before(air: Air, i: int, j: int) -> bool:
    one, other = t.events(air, i), t.events(air, j)
    if one[c.AT] != other[c.AT]:
        return bool(one[c.AT] < other[c.AT])
    return bool(one[c.ORDER] < other[c.ORDER])


@njit(cache=True)
def _swap(air: Air, i: int, j: int) -> None:
    one, other = t.events(air, i), t.events(air, j)
    for column in range(c.EVENT_COLUMNS):
        one[column], other[column] = other[column], one[column]


@njit(cache=True)
def schedule(
    air: Air,
    at_ns: int,
    what: int,
    about: int,
    first: int = 0,
    second: int = 0,
    third: int = 0,
    fourth: int = 0,
) -> int:
    """Schedule an event; return its order, which is unique."""
    air[c.SCHEDULED] += 1
    i = air[c.EVENTS]
    air[c.EVENTS] = i + 1
    event = t.events(air, i)
    event[c.AT], event[c.ORDER], event[c.WHAT], event[c.ABOUT] = at_ns, air[c.SCHEDULED], what, about
    event[c.FURTHER], event[c.FURTHER + 1] = first, second
    event[c.FURTHER + 2], event[c.FURTHER + 3] = third, fourth
    while i and _comes_before(air, i, (i - 1) // 2):
        _swap(air, i, (i - 1) // 2)
        i = (i - 1) // 2
    return int(air[c.SCHEDULED])


@njit(cache=True)
def drop_next(air: Air) -> None:
    """Remove the next event."""
    count = air[c.EVENTS] - 1
    air[c.EVENTS] = count
    _swap(air, 0, count)
    i = 0
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and _comes_before(air, child + 1, child):
            child += 1
        if not _comes_before(air, child, i):
            break
        _swap(air, i, child)
        i = child


@njit(cache=True)
def is_off(air: Air) -> bool:
    """Whether the next event is cancelled: its station or queue no longer refers to its order."""
    event = t.events(air, 0)
    what, about, order = event[c.WHAT], event[c.ABOUT], event[c.ORDER]
    if what == c.ON_ACCESS:
        return bool(t.queues(air, about)[c.ACCESS] != order)
    if what == c.ON_DEADLINE:
        return bool(t.queues(air, about)[c.DEADLINE] != order)
    if what == c.ON_TIMEOUT:
        return bool(t.stations(air, about)[c.TIMEOUT] != order)
    return False
