"""Channel access: contention of a station's queues by physical carrier sense, NAV and backoff.

The medium is busy from `CCA_NS` after energy arrives, while the station sends, while the NAV is set, and for
EIFS after a frame with errors. A frame is sent at once if the medium has been idle for AIFS and the backoff
is 0 (10.3.4.2). EDCA's alignment of this access to slots since the last busy period is not modelled: after a
long idle time the slots of different stations would not coincide.

DCF decrements the backoff after an idle slot. EDCA decrements it at slot boundaries, so also for a slot in
which another station begins to send (10.22.2.4). A station with empty queues completes its last backoff.

A frame whose lifetime is over leaves its queue at once, at any position and also while the medium is busy;
only an exchange that has begun is completed.

The functions are compiled and work on `netsim.model.tables.Air`. Frame exchanges are in `netsim.mac.station`.
"""

from numba import njit

from netsim.mac.access_parameters import CCA_NS, EIFS_EXTRA_NS, SLOT_NS
from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.event_queue import NEVER_NS
from netsim.model.events import schedule
from netsim.model.tables import Air, call, draw_backoff

# --- queues


@njit(cache=True)
def push(air: Air, q: int, job: int) -> None:
    """Append a job to a queue."""
    queue = t.queues(air, q)
    t.jobs(air, job)[c.NEXT_JOB] = c.NOTHING
    if queue[c.FIRST] == c.NOTHING:
        queue[c.FIRST] = job
    else:
        t.jobs(air, queue[c.LAST])[c.NEXT_JOB] = job
    queue[c.LAST] = job
    t.stations(air, q // air[c.CATEGORIES])[c.HELD] += 1


@njit(cache=True)
def give_up(air: Air, q: int, outcome: int) -> None:
    """Remove the first job of a queue and report its outcome."""
    queue = t.queues(air, q)
    job = queue[c.FIRST]
    queue[c.FIRST] = t.jobs(air, job)[c.NEXT_JOB]
    t.stations(air, q // air[c.CATEGORIES])[c.HELD] -= 1
    if queue[c.FIRST] == c.NOTHING:
        unwatch(air, q)
    _report_done(air, q, job, outcome)


@njit(cache=True)
def _report_done(air: Air, q: int, job: int, outcome: int) -> None:
    i = call(air, c.DONE, q // air[c.CATEGORIES], job)
    t.calls(air, i)[c.CALL_DETAIL] = outcome
    t.calls(air, i)[c.CALL_SOURCE] = c.NOTHING


@njit(cache=True)
def drop_expired(air: Air, q: int) -> None:
    """Remove expired and cancelled jobs from the head of a queue."""
    queue = t.queues(air, q)
    while queue[c.FIRST] != c.NOTHING:
        job = t.jobs(air, queue[c.FIRST])
        if job[c.JOB_EXPIRES] > air[c.NOW] and not job[c.JOB_CANCELLED]:
            break
        give_up(air, q, c.EXPIRED)


@njit(cache=True)
def is_full(air: Air, station: int) -> bool:
    """Whether a station's queues are full after removing expired frames."""
    if t.stations(air, station)[c.HELD] >= air[c.QUEUE_FRAMES]:
        k = air[c.CATEGORIES]
        for q in range(station * k, station * k + k):
            if t.queues(air, q)[c.IN_USE] and q != t.stations(air, station)[c.CURRENT]:
                drop_expired(air, q)
    return bool(t.stations(air, station)[c.HELD] >= air[c.QUEUE_FRAMES])


@njit(cache=True)
def watch(air: Air, q: int, expires_ns: int) -> None:
    """Schedule the check for expired frames at ``expires_ns``, earlier than the scheduled one."""
    t.queues(air, q)[c.DEADLINE_AT] = expires_ns
    t.queues(air, q)[c.DEADLINE] = schedule(air, max(expires_ns, air[c.NOW]), c.ON_DEADLINE, q)


@njit(cache=True)
def unwatch(air: Air, q: int) -> None:
    """Cancel the check for expired frames."""
    t.queues(air, q)[c.DEADLINE] = 0
    t.queues(air, q)[c.DEADLINE_AT] = NEVER_NS


@njit(cache=True)
def on_deadline(air: Air, q: int) -> None:
    """Remove all expired frames of a queue except one whose exchange is under way."""
    unwatch(air, q)
    queue, station = t.queues(air, q), t.stations(air, q // air[c.CATEGORIES])
    spared = queue[c.FIRST] if station[c.CURRENT] == q else c.NOTHING
    next_ns = NEVER_NS
    before, job = c.NOTHING, queue[c.FIRST]
    while job != c.NOTHING:
        behind, expires_ns = t.jobs(air, job)[c.NEXT_JOB], t.jobs(air, job)[c.JOB_EXPIRES]
        if expires_ns > air[c.NOW]:
            next_ns = min(next_ns, expires_ns)
        if expires_ns > air[c.NOW] or job == spared:
            before = job
        else:
            if before == c.NOTHING:
                queue[c.FIRST] = behind
            else:
                t.jobs(air, before)[c.NEXT_JOB] = behind
            station[c.HELD] -= 1
            _report_done(air, q, job, c.EXPIRED)
        job = behind
    queue[c.LAST] = before
    if next_ns < NEVER_NS:
        watch(air, q, next_ns)


# --- backoff


@njit(cache=True)
def _back_off(air: Air, q: int) -> None:
    """Draw a new backoff, uniform in 0..CW slots."""
    queue = t.queues(air, q)
    draw = draw_backoff(air, q // air[c.CATEGORIES])
    queue[c.BACKOFF] = int(draw * (queue[c.WINDOW] + 1))
    queue[c.FRESH] = 0


@njit(cache=True)
def succeeded(air: Air, q: int) -> None:
    """Reset the contention window and back off, after a success or at the retry limit (10.3.3)."""
    t.queues(air, q)[c.WINDOW] = t.queues(air, q)[c.WINDOW_LEAST]
    _back_off(air, q)


@njit(cache=True)
def fail(air: Air, q: int) -> None:
    """Double the contention window and back off after a failed exchange.

    The frame is dropped if its retry limit is exceeded or its lifetime is over.
    """
    job = t.queues(air, q)[c.FIRST]
    t.jobs(air, job)[c.JOB_FAILURES] += 1
    if t.jobs(air, job)[c.JOB_FAILURES] > t.jobs(air, job)[c.JOB_RETRIES]:
        succeeded(air, q)
        give_up(air, q, c.RETRY_LIMIT)
        return
    t.queues(air, q)[c.WINDOW] = min(2 * t.queues(air, q)[c.WINDOW] + 1, t.queues(air, q)[c.WINDOW_MOST])
    _back_off(air, q)
    if t.jobs(air, job)[c.JOB_EXPIRES] <= air[c.NOW]:
        give_up(air, q, c.EXPIRED)


@njit(cache=True)
def freeze(air: Air, station: int, from_ns: int) -> None:
    """Freeze all backoffs: the medium is busy from ``from_ns``; accesses until then still take place."""
    t.stations(air, station)[c.PLANNED] = 0
    k = air[c.CATEGORIES]
    for q in range(station * k, station * k + k):
        if t.queues(air, q)[c.IN_USE]:
            _freeze_queue(air, q, from_ns)


@njit(cache=True)
def _freeze_queue(air: Air, q: int, from_ns: int) -> None:
    """Subtract the elapsed slots from a queue's backoff."""
    queue = t.queues(air, q)
    if queue[c.ACCESS]:
        if queue[c.ACCESS_AT] <= from_ns:
            return
        queue[c.ACCESS] = 0
        if queue[c.FRESH]:
            _back_off(air, q)
            queue[c.BASE] = NEVER_NS
            return
    if queue[c.BACKOFF] and from_ns >= queue[c.BASE]:
        passed_slots = (from_ns - queue[c.BASE]) // SLOT_NS + queue[c.SLOT_OFFSET]
        queue[c.BACKOFF] = max(0, queue[c.BACKOFF] - passed_slots)
    queue[c.BASE] = NEVER_NS


# --- accesses


@njit(cache=True)
def contend(air: Air, station: int, q: int, job: int) -> None:
    """Enqueue a frame, and plan its access if it is the first."""
    queue, now = t.queues(air, q), air[c.NOW]
    queue[c.IN_USE] = 1
    first = queue[c.FIRST] == c.NOTHING
    push(air, q, job)
    if t.jobs(air, job)[c.JOB_EXPIRES] < queue[c.DEADLINE_AT]:
        watch(air, q, t.jobs(air, job)[c.JOB_EXPIRES])
    if not first or t.stations(air, station)[c.CURRENT] == q:
        return
    busy = _is_busy(air, station)
    remaining_ns = queue[c.BACKOFF] * SLOT_NS
    if remaining_ns == 0 or (not busy and now >= queue[c.BASE] + remaining_ns):
        queue[c.BACKOFF] = 0
        queue[c.FRESH] = not busy
        if busy:
            _back_off(air, q)
    resume(air, station)


@njit(cache=True)
def _is_busy(air: Air, station: int) -> bool:
    now, row = air[c.NOW], t.stations(air, station)
    return bool(
        row[c.CURRENT] != c.NOTHING
        or row[c.BUSY_FROM] + CCA_NS < now < row[c.BUSY_UNTIL]
        or now < row[c.RESERVED_UNTIL]
        or now < row[c.SENDING_UNTIL]
    )


@njit(cache=True)
def resume(air: Air, station: int) -> None:
    """Plan each queue's next access from the state of the medium; to be called after each change of it."""
    now, row = air[c.NOW], t.stations(air, station)
    if row[c.CURRENT] != c.NOTHING or row[c.SENDING_UNTIL] > now or row[c.RADIO_OFF]:
        return
    idle_ns = row[c.BUSY_UNTIL]
    unsensed = False
    # a busy period within the NAV does not prevent planning an access after the NAV
    if idle_ns > now and idle_ns > row[c.RESERVED_UNTIL]:
        # a busy period that the station cannot have sensed yet does not prevent an access
        unsensed = now <= row[c.BUSY_FROM] + CCA_NS
        if not unsensed:
            return
        idle_ns = row[c.IDLE_BEFORE]
    idle_ns = max(idle_ns, row[c.SENDING_UNTIL], row[c.RESERVED_UNTIL], row[c.WAIT_UNTIL])
    if row[c.BROKEN]:
        idle_ns = max(idle_ns, row[c.BROKEN] + EIFS_EXTRA_NS)
    row[c.PLANNED] = 1
    k = air[c.CATEGORIES]
    for q in range(station * k, station * k + k):
        queue = t.queues(air, q)
        # if unsensed, the slots before that busy period were subtracted when the backoff was frozen
        frozen = queue[c.BACKOFF] and queue[c.BASE] == NEVER_NS
        if queue[c.IN_USE] and not (unsensed and frozen):
            _plan(air, q, idle_ns + queue[c.AIFS])
    if unsensed:
        freeze(air, station, row[c.BUSY_FROM] + CCA_NS)


@njit(cache=True)
def _plan(air: Air, q: int, base_ns: int) -> None:
    """Plan one queue's access to a medium that is idle, AIFS included, from ``base_ns``."""
    queue = t.queues(air, q)
    queue[c.BASE] = base_ns
    if queue[c.FIRST] == c.NOTHING:
        return
    access_ns = max(base_ns + queue[c.BACKOFF] * SLOT_NS, air[c.NOW])
    if not queue[c.ACCESS] or queue[c.ACCESS_AT] != access_ns:
        queue[c.ACCESS_AT] = access_ns
        queue[c.ACCESS] = schedule(air, access_ns, c.ON_ACCESS, q)


@njit(cache=True)
def win(air: Air, q: int) -> int:
    """Return the queue that gets the access planned by ``q``, or `columns.NOTHING`.

    It may be a queue of higher priority of the same station.
    """
    queue, now = t.queues(air, q), air[c.NOW]
    queue[c.ACCESS] = 0
    k = air[c.CATEGORIES]
    station = q // k
    row = t.stations(air, station)
    if row[c.CURRENT] != c.NOTHING or row[c.SENDING_UNTIL] > now:
        queue[c.BASE] = NEVER_NS
        return c.NOTHING
    drop_expired(air, q)
    if queue[c.FIRST] == c.NOTHING:
        resume(air, station)
        return c.NOTHING
    winner = _collide_inside(air, station, q)
    row[c.CURRENT] = winner
    t.queues(air, winner)[c.BACKOFF] = 0
    t.queues(air, winner)[c.FRESH] = 0
    return winner


@njit(cache=True)
def _collide_inside(air: Air, station: int, q: int) -> int:
    """Resolve an internal collision: the queue of highest priority wins, the access of the others fails."""
    k = air[c.CATEGORIES]
    winner = c.NOTHING
    for rival in range(station * k, station * k + k):
        queue = t.queues(air, rival)
        if rival != q and not (queue[c.ACCESS] and queue[c.ACCESS_AT] <= air[c.NOW]):
            continue
        drop_expired(air, rival)
        if queue[c.FIRST] == c.NOTHING:
            continue
        queue[c.ACCESS] = 0
        if winner == c.NOTHING:
            winner = rival
            t.stations(air, station)[c.CURRENT] = winner
        else:
            queue[c.BASE] = NEVER_NS
            fail(air, rival)
    return winner
