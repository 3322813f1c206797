"""Channel access: contention of a station's queues by physical carrier sense, NAV and backoff.

The medium is busy from `CCA_NS` after energy arrives, while the station sends, while the NAV is set, and for
EIFS after a frame with errors. A station with empty queues completes its last backoff.

DCF decrements the backoff after an idle slot. With a backoff of 0 it sends at once if the medium has been
idle for DIFS, and backs off if the medium becomes busy before (10.3.4.2).

EDCA acts at slot boundaries alone: AIFS after the end of the last busy period, and every slot after that
(10.22.2.4). It decrements the backoff there, so also for a slot in which another station begins to send. A
frame with a backoff of 0 waits for the next boundary, however long the medium has been idle. If the medium
becomes busy first, it is sent AIFS after the busy period: a backoff is drawn only for a frame that finds the
medium busy, after transmissions and after collisions inside the station (10.22.2.2).

A frame whose lifetime is over leaves its queue at once, at any position and also while the medium is busy;
only an exchange that has begun is completed.

The functions are compiled and work on the tables of `netsim.model.tables`. Frame exchanges are in
`netsim.mac.station`.
"""

from foundation.kernels.inner import inner
from netsim.mac.access_parameters import CCA_NS
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.event_queue import NEVER_NS
from netsim.model.events import schedule
from netsim.model.records import MediumHeader
from netsim.model.tables import add_call, add_ended_job, draw_backoff

# --- queues


@inner
def push(air: MediumHeader, q: int, job: int) -> None:
    """Append a job to a queue."""
    queue = t.queue(air, q)
    t.job(air, job).next_job = c.NOTHING
    if queue.first_job == c.NOTHING:
        queue.first_job = job
    else:
        t.job(air, queue.last_job).next_job = job
    queue.last_job = job
    t.station(air, q // air.categories).queued_frames += 1


@inner
def give_up(air: MediumHeader, q: int, outcome: int, ended_ns: int) -> None:
    """Remove the first job of a queue and report its outcome and end."""
    queue = t.queue(air, q)
    job = queue.first_job
    queue.first_job = t.job(air, job).next_job
    t.station(air, q // air.categories).queued_frames -= 1
    if queue.first_job == c.NOTHING:
        unwatch(air, q)
    _report_done(air, q, job, outcome, ended_ns)


@inner
def _report_done(air: MediumHeader, q: int, job: int, outcome: int, ended_ns: int) -> None:
    ended, station = t.job(air, job), t.station(air, q // air.categories)
    if ended.repeats and not station.radio_off:
        station.repeated[outcome] += 1
        ended.attempts = ended.failures = 0
        ended.seq += 1
        push(air, q, job)
    elif ended.deferred:
        add_ended_job(air, job, outcome, ended_ns)
    else:
        call = add_call(air, c.DONE, q // air.categories, job)
        call.detail, call.source = outcome, c.NOTHING


@inner
def drop_expired(air: MediumHeader, q: int) -> None:
    """Remove expired and cancelled jobs from the head of a queue."""
    queue = t.queue(air, q)
    while queue.first_job != c.NOTHING:
        job = t.job(air, queue.first_job)
        if job.expires_ns > air.now_ns and not job.cancelled:
            break
        give_up(air, q, c.EXPIRED, air.now_ns)


@inner
def is_full(air: MediumHeader, station: int) -> bool:
    """Whether a station's queues are full after removing expired frames."""
    if t.station(air, station).queued_frames >= air.queue_frames:
        k = air.categories
        for q in range(station * k, station * k + k):
            if t.queue(air, q).in_use and q != t.station(air, station).current_queue:
                drop_expired(air, q)
    return t.station(air, station).queued_frames >= air.queue_frames


@inner
def watch(air: MediumHeader, q: int, expires_ns: int) -> None:
    """Schedule the check for expired frames at ``expires_ns``, earlier than the scheduled one."""
    queue = t.queue(air, q)
    queue.deadline_ns = expires_ns
    queue.deadline_event = schedule(air, max(expires_ns, air.now_ns), c.ON_DEADLINE, q)


@inner
def unwatch(air: MediumHeader, q: int) -> None:
    """Cancel the check for expired frames."""
    queue = t.queue(air, q)
    queue.deadline_event, queue.deadline_ns = 0, NEVER_NS


@inner
def on_deadline(air: MediumHeader, q: int) -> None:
    """Remove all expired frames of a queue except one whose exchange is under way."""
    unwatch(air, q)
    queue, station = t.queue(air, q), t.station(air, q // air.categories)
    spared = queue.first_job if station.current_queue == q else c.NOTHING
    next_ns = NEVER_NS
    before, job = c.NOTHING, queue.first_job
    while job != c.NOTHING:
        behind, expires_ns = t.job(air, job).next_job, t.job(air, job).expires_ns
        if expires_ns > air.now_ns:
            next_ns = min(next_ns, expires_ns)
        if expires_ns > air.now_ns or job == spared:
            before = job
        else:
            if before == c.NOTHING:
                queue.first_job = behind
            else:
                t.job(air, before).next_job = behind
            station.queued_frames -= 1
            _report_done(air, q, job, c.EXPIRED, air.now_ns)
        job = behind
    queue.last_job = before
    if next_ns < NEVER_NS:
        watch(air, q, next_ns)


# --- backoff


@inner
def _back_off(air: MediumHeader, q: int) -> None:
    """Draw a new backoff, uniform in 0..CW slots."""
    queue = t.queue(air, q)
    draw = draw_backoff(air, q // air.categories)
    queue.backoff_slots = int(draw * (queue.window + 1))
    queue.found_idle = False


@inner
def succeeded(air: MediumHeader, q: int) -> None:
    """Reset the contention window and back off, after a success or at the retry limit (10.3.3)."""
    queue = t.queue(air, q)
    queue.window = queue.window_min
    _back_off(air, q)


@inner
def fail(air: MediumHeader, q: int) -> None:
    """Double the contention window and back off after a failed exchange.

    The frame is dropped if its retry limit is exceeded or its lifetime is over.
    """
    queue = t.queue(air, q)
    job = t.job(air, queue.first_job)
    job.failures += 1
    if job.failures > job.retry_limit:
        succeeded(air, q)
        give_up(air, q, c.RETRY_LIMIT, air.now_ns)
        return
    queue.window = min(2 * queue.window + 1, queue.window_max)
    _back_off(air, q)
    if job.expires_ns <= air.now_ns:
        give_up(air, q, c.EXPIRED, air.now_ns)


@inner
def freeze(air: MediumHeader, station: int, from_ns: int) -> None:
    """Freeze all backoffs: the medium is busy from ``from_ns``; accesses until then still take place."""
    t.station(air, station).planned = False
    k = air.categories
    for q in range(station * k, station * k + k):
        if t.queue(air, q).in_use:
            _freeze_queue(air, q, from_ns)


@inner
def _freeze_queue(air: MediumHeader, q: int, from_ns: int) -> None:
    """Subtract the elapsed slots from a queue's backoff."""
    queue = t.queue(air, q)
    if queue.access_event:
        if queue.access_ns <= from_ns:
            return
        queue.access_event = 0
        if queue.found_idle:
            _back_off(air, q)
            queue.slots_from_ns = NEVER_NS
            return
    if queue.backoff_slots and from_ns >= queue.slots_from_ns:
        passed_slots = (from_ns - queue.slots_from_ns) // air.slot_ns + queue.slot_offset
        queue.backoff_slots = max(0, queue.backoff_slots - passed_slots)
    queue.slots_from_ns = NEVER_NS


# --- accesses


@inner
def contend(air: MediumHeader, station: int, q: int, job: int) -> None:
    """Enqueue a frame, and plan its access if it is the first."""
    queue, now = t.queue(air, q), air.now_ns
    queue.in_use = True
    first = queue.first_job == c.NOTHING
    push(air, q, job)
    if t.job(air, job).expires_ns < queue.deadline_ns:
        watch(air, q, t.job(air, job).expires_ns)
    if not first or t.station(air, station).current_queue == q:
        return
    busy = _is_busy(air, station)
    remaining_ns = queue.backoff_slots * air.slot_ns
    if remaining_ns == 0 or (not busy and now >= queue.slots_from_ns + remaining_ns):
        queue.backoff_slots = 0
        queue.found_idle = not busy and not queue.slot_offset
        if busy:
            _back_off(air, q)
    resume(air, station)


@inner
def _is_busy(air: MediumHeader, station: int) -> bool:
    now, row = air.now_ns, t.station(air, station)
    return (
        row.current_queue != c.NOTHING
        or row.busy_from_ns + CCA_NS < now < row.busy_until_ns
        or now < row.nav_until_ns
        or now < row.sending_until_ns
    )


@inner
def resume(air: MediumHeader, station: int) -> None:
    """Plan each queue's next access from the state of the medium; to be called after each change of it."""
    now, row = air.now_ns, t.station(air, station)
    if row.current_queue != c.NOTHING or row.sending_until_ns > now or row.radio_off:
        return
    idle_ns = row.busy_until_ns
    unsensed = False
    # a busy period within the NAV does not prevent planning an access after the NAV
    if idle_ns > now and idle_ns > row.nav_until_ns:
        # a busy period that the station cannot have sensed yet does not prevent an access
        unsensed = now <= row.busy_from_ns + CCA_NS
        if not unsensed:
            return
        idle_ns = row.idle_before_ns
    idle_ns = max(idle_ns, row.sending_until_ns, row.nav_until_ns, row.wait_until_ns)
    if row.last_error_ns:
        idle_ns = max(idle_ns, row.last_error_ns + air.eifs_extra_ns)
    row.planned = True
    k = air.categories
    for q in range(station * k, station * k + k):
        queue = t.queue(air, q)
        # if unsensed, the slots before that busy period were subtracted when the backoff was frozen
        frozen = queue.backoff_slots and queue.slots_from_ns == NEVER_NS
        if queue.in_use and not (unsensed and frozen):
            _plan(air, q, idle_ns + queue.aifs_ns)
    if unsensed:
        freeze(air, station, row.busy_from_ns + CCA_NS)


@inner
def _plan(air: MediumHeader, q: int, base_ns: int) -> None:
    """Plan one queue's access to a medium that is idle, AIFS included, from ``base_ns``."""
    queue = t.queue(air, q)
    queue.slots_from_ns = base_ns
    if queue.first_job == c.NOTHING:
        return
    access_ns = base_ns + queue.backoff_slots * air.slot_ns
    late_ns = air.now_ns - access_ns
    if late_ns > 0:
        access_ns += -(-late_ns // air.slot_ns) * air.slot_ns if queue.slot_offset else late_ns
    if not queue.access_event or queue.access_ns != access_ns:
        queue.access_ns = access_ns
        queue.access_event = schedule(air, access_ns, c.ON_ACCESS, q)


@inner
def win(air: MediumHeader, q: int) -> int:
    """Return the queue that gets the access planned by ``q``, or `codes.NOTHING`.

    It may be a queue of higher priority of the same station.
    """
    queue, now = t.queue(air, q), air.now_ns
    queue.access_event = 0
    k = air.categories
    station = q // k
    row = t.station(air, station)
    if row.current_queue != c.NOTHING or row.sending_until_ns > now:
        queue.slots_from_ns = NEVER_NS
        return c.NOTHING
    drop_expired(air, q)
    if queue.first_job == c.NOTHING:
        resume(air, station)
        return c.NOTHING
    winner = _collide_inside(air, station, q)
    row.current_queue = winner
    won = t.queue(air, winner)
    won.backoff_slots, won.found_idle = 0, False
    return winner


@inner
def _collide_inside(air: MediumHeader, station: int, q: int) -> int:
    """Resolve an internal collision: the queue of highest priority wins, the access of the others fails."""
    k = air.categories
    winner = c.NOTHING
    for rival in range(station * k, station * k + k):
        queue = t.queue(air, rival)
        if rival != q and not (queue.access_event and queue.access_ns <= air.now_ns):
            continue
        drop_expired(air, rival)
        if queue.first_job == c.NOTHING:
            continue
        queue.access_event = 0
        if winner == c.NOTHING:
            winner = rival
            t.station(air, station).current_queue = winner
        else:
            queue.slots_from_ns = NEVER_NS
            fail(air, rival)
    return winner
