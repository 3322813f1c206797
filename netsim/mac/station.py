"""Frame exchanges of a station: RTS, CTS, data and ACK, their failures, and TXOPs of several exchanges.

After a success a queue with a TXOP limit continues after SIFS if its complete next exchange ends within the
limit (10.22.2.8). The Duration field of a frame covers the rest of its exchange and the next exchange of the
TXOP, as between fragments. So stations out of range of the response defer, and little time is reserved in
vain if the TXOP ends early. After a failure the TXOP ends and the queue backs off.

Group frames after RTS (not in the standard): the RTS is addressed to the neighbour with the highest received
power within the last second, and the group frame follows SIFS after its CTS. A station without a neighbour
within the last second sends without RTS. A missing CTS counts as a collision: the window is doubled, and the
next RTS goes to the neighbour with the next lower power, since the first may be gone. The frame is dropped
after the retry limit.

At the retry limit the window is reset to its minimum (10.3.3). The expiry of a frame does not change it.

Not modelled: fragmentation, power save, aggregation, block acknowledgement, CF-End.

The functions are compiled and work on the tables of `netsim.model.tables`.
"""

from foundation.kernels.inner import constant, inner
from netsim.mac.access_parameters import CCA_NS
from netsim.mac.airtime import cts_ns, data_ns, duration_ns, exchange_ns, response_ns
from netsim.mac.contention import drop_expired, fail, freeze, give_up, resume, succeeded, unwatch, win
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.events import begin_event, end_event, schedule
from netsim.model.records import MediumHeader
from netsim.model.tables import add_call, take_signal
from netsim.phy import medium
from netsim.phy.frames import ACK_BYTES, CTS_BYTES, GROUP, RTS_BYTES
from netsim.phy.path_loss import Doubles
from netsim.phy.timing import RX_START_DELAY_NS

NEIGHBOUR_LIFETIME_NS = 1_000_000_000

_RTS, _RTS_BYTES = constant(c.RTS), constant(RTS_BYTES)
# State of an exchange. SENDING: the frame itself is on the air or follows after SIFS; no response is awaited.
IDLE, AWAITING_CTS, SENDING, AWAITING_ACK = range(4)


# --- the station's own exchange


@inner
def sender(air: MediumHeader, what: int, about: int) -> int:
    """Return the station that sends at an event now; `netsim.model.codes.NOTHING` if it no longer can.

    The event is the frame of a job (`SEND_JOB`), whose exchange may have ended meanwhile, or a control frame
    (`SEND_FRAME`), whose station may have been switched off or be sending another frame.
    """
    if what == c.SEND_JOB:
        return about // air.categories if _may_send(air, about) else c.NOTHING
    row = t.station(air, about)
    return c.NOTHING if row.radio_off or row.sending_until_ns > air.now_ns else about


@inner
def on_access(air: MediumHeader, q: int) -> None:
    """Resolve the access planned by ``q`` and make the exchange of the winning queue due."""
    winner = win(air, q)
    if winner != c.NOTHING:
        t.station(air, winner // air.categories).txop_end_ns = air.now_ns + t.queue(air, winner).txop_ns
        schedule_access(air, winner)


@inner
def schedule_access(air: MediumHeader, q: int) -> None:
    """Make the exchange of a queue's first job due now, if the queue may still send and has one."""
    if _may_send(air, q):
        air.due_queue, air.mode_chosen = q, False


@inner
def _may_send(air: MediumHeader, q: int) -> bool:
    may = t.station(air, q // air.categories).current_queue == q
    return may and t.queue(air, q).first_job != c.NOTHING


@inner
def lacks_mode(air: MediumHeader, q: int) -> bool:
    """Whether the mode of a queue's next frame has to be chosen before its exchange begins."""
    return t.job(air, t.queue(air, q).first_job).adapts != 0 and air.mode_chosen == 0


@inner
def has_time(air: MediumHeader, q: int) -> bool:
    """Whether the exchange of a queue's first job fits into the current TXOP.

    It may not fit in a mode that has just been selected; then it needs a new access.
    """
    txop_end_ns, queue = t.station(air, q // air.categories).txop_end_ns, t.queue(air, q)
    goes_on = air.now_ns > txop_end_ns - queue.txop_ns  # the TXOP has begun before
    late = air.mode_chosen and goes_on and air.now_ns + exchange_ns(air, queue.first_job) > txop_end_ns
    return not late


@inner
def begin(air: MediumHeader, fading: Doubles, q: int) -> None:
    """Begin the exchange of a queue's first job: see `lacks_mode` and `has_time`."""
    station, job = q // air.categories, t.queue(air, q).first_job
    target = _rts_target(air, station, job) if t.job(air, job).rts else c.NOTHING
    if target == c.NOTHING:
        send_job(air, fading, q)
        return
    t.station(air, station).phase = AWAITING_CTS
    rts = _frame(air, _RTS, station, target, air.control_mode, _RTS_BYTES)
    sent, cts_end_ns = t.signal(air, rts), air.sifs_ns + cts_ns(air)
    sent.nav_ns = cts_end_ns + air.sifs_ns + data_ns(air, job)
    sent.lapse_ns = cts_end_ns + air.sifs_ns + RX_START_DELAY_NS + 2 * air.slot_ns
    _send(air, fading, rts)
    _await_response(air, station, rts)


@inner
def _rts_target(air: MediumHeader, station: int, job: int) -> int:
    data = t.job(air, job)
    if data.to != GROUP:
        return data.to
    return medium.neighbour_by_power(air, station, air.now_ns - NEIGHBOUR_LIFETIME_NS, data.failures)


@inner
def send_job(air: MediumHeader, fading: Doubles, q: int) -> None:
    """Send the data frame of a queue's exchange; requires that the queue may send: see `sender`."""
    station = q // air.categories
    row, queue = t.station(air, station), t.queue(air, q)
    which = queue.first_job
    job = t.job(air, which)
    if job.attempts == 0:
        row.sequence += 1
        job.sequence = row.sequence
    nav_ns = response_ns(air, which)
    if queue.txop_ns and job.next_job != c.NOTHING:
        next_ns = air.sifs_ns + exchange_ns(air, job.next_job)
        if air.now_ns + data_ns(air, which) + next_ns <= row.txop_end_ns:
            nav_ns += next_ns
    frame = _frame(air, job.kind, station, job.to, job.mode, job.frame_bytes)
    sent = t.signal(air, frame)
    sent.nav_ns = nav_ns
    sent.seq, sent.sequence, sent.job = job.seq, job.sequence, which
    job.attempts += 1
    job.sent_ns = air.now_ns
    row.phase = SENDING if job.to == GROUP else AWAITING_ACK
    _send(air, fading, frame)
    if job.to != GROUP:
        _await_response(air, station, frame)


@inner
def _frame(air: MediumHeader, kind: int, source: int, to: int, mode: int, frame_bytes: int) -> int:
    """Allocate a row of signals for a frame that begins now, and fill the common fields."""
    row = take_signal(air)
    frame = t.signal(air, row)
    frame.source, frame.to, frame.kind = source, to, kind
    frame.mode, frame.frame_bytes = mode, frame_bytes
    frame.start_ns = air.now_ns
    frame.end_ns = frame.start_ns + duration_ns(air, mode, frame_bytes)
    frame.radiated_until_ns = frame.end_ns - air.signal_extension_ns
    frame.nav_ns, frame.lapse_ns, frame.seq, frame.sequence = 0, 0, 0, 0
    frame.job = c.NOTHING
    return row


@inner
def _send(air: MediumHeader, fading: Doubles, frame: int) -> None:
    freeze(air, t.signal(air, frame).source, air.now_ns)
    on_busy(air, frame, medium.start(air, fading, frame))


@inner
def on_busy(air: MediumHeader, signal: int, count: int) -> None:
    """Freeze the backoffs of the first ``count`` stations of `records.End.newly_busy`."""
    for k in range(count):
        r = t.end(air, k).newly_busy
        if t.station(air, r).planned:
            freeze(air, r, t.signal(air, signal).start_ns + t.path(air, signal, r).delay_ns + CCA_NS)


@inner
def _await_response(air: MediumHeader, station: int, frame: int) -> None:
    row = t.station(air, station)
    row.timed_out = False
    at_ns = t.signal(air, frame).end_ns + air.response_timeout_ns
    row.timeout_event = schedule(air, at_ns, c.ON_TIMEOUT, station)


@inner
def _stop_waiting(air: MediumHeader, station: int) -> None:
    row = t.station(air, station)
    row.timed_out, row.timeout_event = False, 0


@inner
def _succeed(air: MediumHeader, station: int, outcome: int, end_ns: int) -> None:
    """End the exchange with success at ``end_ns``, and begin the next one of the TXOP if it fits."""
    q = t.station(air, station).current_queue
    if q == c.NOTHING:
        return
    _stop_waiting(air, station)
    give_up(air, q, outcome, end_ns)
    if not (t.queue(air, q).txop_ns and _goes_on(air, station, q, end_ns + air.sifs_ns)):
        leave(air, q)


@inner
def leave(air: MediumHeader, q: int) -> None:
    """Release the medium after a success and back off."""
    station = q // air.categories
    row = t.station(air, station)
    row.current_queue, row.phase = c.NOTHING, IDLE
    succeeded(air, q)
    resume(air, station)


@inner
def _goes_on(air: MediumHeader, station: int, q: int, start_ns: int) -> bool:
    """Schedule the next exchange of a TXOP at ``start_ns`` if there is one that ends within the limit."""
    queue = t.queue(air, q)
    queue.window = queue.window_min
    drop_expired(air, q)
    job = queue.first_job
    if job == c.NOTHING:
        return False
    # the duration of a frame without a mode is checked when the mode has been selected
    if not t.job(air, job).adapts and start_ns + exchange_ns(air, job) > t.station(air, station).txop_end_ns:
        return False
    t.station(air, station).phase = SENDING
    schedule(air, start_ns, c.START_EXCHANGE, q)
    return True


@inner
def _fail_exchange(air: MediumHeader, station: int) -> None:
    row = t.station(air, station)
    q = row.current_queue
    if q == c.NOTHING:
        return
    job = t.queue(air, q).first_job
    if row.phase == AWAITING_ACK and t.job(air, job).adapts:
        add_call(air, c.FAILED, station, job)
    _stop_waiting(air, station)
    row.current_queue = c.NOTHING
    row.phase = IDLE
    row.wait_until_ns = air.now_ns
    fail(air, q)
    resume(air, station)


@inner
def on_timeout(air: MediumHeader, station: int) -> None:
    """Handle the time-out of a response: the exchange fails unless a reception has begun in time.

    It begins with PHY-RXSTART.indication, at the end of the L-SIG field.
    """
    row = t.station(air, station)
    row.timeout_event = 0
    if row.locked_frame != c.NOTHING and row.lock_arrived_ns + RX_START_DELAY_NS <= air.now_ns:
        # it is decided at the end of the frame whether it is the response
        row.timed_out = True
    else:
        _fail_exchange(air, station)


# --- reports of the receiver


@inner
def on_end(air: MediumHeader, frame: int, station: int) -> None:
    """Process the end of a frame at a station, after the medium has determined its outcome."""
    row, end = t.station(air, station), t.end(air, station)
    if end.replan and row.planned:
        freeze(air, station, air.now_ns)
    if end.outcome == c.RECEIVED and t.signal(air, frame).to == station:
        _receive_own(air, frame, station)
    if end.outcome != c.MISSED and row.timed_out:
        _fail_exchange(air, station)
    on_air_changed(air, station)


@inner
def on_air_changed(air: MediumHeader, station: int) -> None:
    """Plan accesses of a station that has no plan."""
    if not t.station(air, station).planned:
        resume(air, station)


@inner
def on_unused(air: MediumHeader, station: int) -> None:
    """Plan accesses of a station again after its NAV has been reset."""
    if t.station(air, station).planned:
        freeze(air, station, air.now_ns)
    resume(air, station)


@inner
def on_sent(air: MediumHeader, frame: int) -> None:
    """Continue after the own frame of a station has ended at all receivers."""
    sent = t.signal(air, frame)
    station = sent.source
    row = t.station(air, station)
    if row.phase == SENDING and sent.kind not in (c.CTS, c.ACK):
        _succeed(air, station, c.SENT, sent.end_ns)
    else:
        resume(air, station)


@inner
def _receive_own(air: MediumHeader, frame: int, station: int) -> None:
    row, sent, path = t.station(air, station), t.signal(air, frame), t.path(air, frame, station)
    kind, source = sent.kind, sent.source
    end_ns = sent.end_ns + path.delay_ns
    if kind == c.CTS:
        if row.phase == AWAITING_CTS and row.current_queue != c.NOTHING:
            _stop_waiting(air, station)
            row.phase = SENDING
            schedule(air, end_ns + air.sifs_ns, c.SEND_JOB, row.current_queue)
    elif kind == c.ACK:
        if row.phase == AWAITING_ACK and row.current_queue != c.NOTHING:
            deferred = t.job(air, t.queue(air, row.current_queue).first_job).deferred
            done = t.call(air, air.calls)
            _succeed(air, station, c.ACKNOWLEDGED, end_ns)
            if not deferred:
                done.source, done.start_ns, done.end_ns = source, sent.start_ns, end_ns
                done.power_mw = path.power_mw
    elif kind == c.RTS:
        # no CTS while the NAV is set, unless the sender of the RTS set it (10.22.2.4)
        free = row.nav_until_ns <= end_ns or row.nav_set_by == source
        if free and row.current_queue == c.NOTHING:
            _respond(air, frame, end_ns, station)
    else:
        _respond(air, frame, end_ns, station)
        last_sequence = t.link(air, station, source).last_sequence
        again = last_sequence[kind] == sent.sequence
        last_sequence[kind] = sent.sequence
        _report_frame(air, frame, station, again)


@inner
def report_group_frame(air: MediumHeader, frame: int) -> None:
    """Add the arrivals of a group frame that has ended."""
    job = t.signal(air, frame).job
    if job != c.NOTHING and t.job(air, job).repeats:
        return
    for station in range(air.stations):
        if t.end(air, station).outcome == c.RECEIVED:
            _add_arrival(air, frame, station)


@inner
def _add_arrival(air: MediumHeader, frame: int, station: int) -> None:
    sent, path, arrival = t.signal(air, frame), t.path(air, frame, station), t.arrival(air, air.arrivals)
    air.arrivals += 1
    arrival.frame, arrival.job, arrival.station, arrival.source = sent.number, sent.job, station, sent.source
    arrival.end_ns, arrival.power_mw = sent.end_ns + path.delay_ns, path.power_mw


@inner
def _report_frame(air: MediumHeader, frame: int, station: int, again: int) -> None:
    """Report a unicast frame to the upper layer of a station; ``again``: it is a duplicate."""
    sent, path = t.signal(air, frame), t.path(air, frame, station)
    if sent.job != c.NOTHING and t.job(air, sent.job).deferred:
        if not (again or t.job(air, sent.job).repeats):
            _add_arrival(air, frame, station)
        return
    call = add_call(air, c.FRAME, station, sent.job)
    call.detail, call.source = again, sent.source
    call.start_ns, call.end_ns = sent.start_ns, sent.end_ns + path.delay_ns
    call.power_mw = path.power_mw


# --- responses


@inner
def _respond(air: MediumHeader, frame: int, end_ns: int, station: int) -> None:
    """Schedule the CTS or ACK of a frame that has ended at this station at ``end_ns``."""
    received = t.signal(air, frame)
    mode = t.mode(air, received.mode).response_mode
    if received.kind == c.RTS:
        kind, frame_bytes = c.CTS, CTS_BYTES
    else:
        kind, frame_bytes = c.ACK, ACK_BYTES
    nav_ns = max(0, received.nav_ns - air.sifs_ns - duration_ns(air, mode, frame_bytes))
    what = kind * c.MODES + mode
    schedule_frame(air, end_ns + air.sifs_ns, station, received.source, what, frame_bytes, nav_ns)


@inner
def schedule_frame(
    air: MediumHeader, at_ns: int, station: int, to: int, what: int, frame_bytes: int, nav_ns: int
) -> None:
    """Schedule `send_frame`."""
    event = begin_event(air, at_ns, c.SEND_FRAME, station)
    event.first, event.second, event.third, event.fourth = to, what, frame_bytes, nav_ns
    end_event(air)


@inner
def send_frame(
    air: MediumHeader, fading: Doubles, station: int, to: int, what: int, frame_bytes: int, nav_ns: int
) -> None:
    """Send a control frame, which belongs to no job: see `sender`.

    ``what`` is its kind times the number of modes, plus its mode.
    """
    frame = _frame(air, what // c.MODES, station, to, what % c.MODES, frame_bytes)
    t.signal(air, frame).nav_ns = nav_ns
    _send(air, fading, frame)


# --- switching off


@inner
def silence(air: MediumHeader, station: int) -> None:
    """Switch a station's radio off for good: it no longer sends, responds or receives."""
    row = t.station(air, station)
    row.radio_off = True
    row.locked_frame = c.NOTHING
    freeze(air, station, air.now_ns - 1)
    _stop_waiting(air, station)
    row.current_queue = c.NOTHING
    k = air.categories
    for q in range(station * k, station * k + k):
        if not t.queue(air, q).in_use:
            continue
        unwatch(air, q)
        while t.queue(air, q).first_job != c.NOTHING:
            job = t.job(air, t.queue(air, q).first_job)
            # a group frame in the queue with an attempt is on the air and is completed
            gone = job.to == GROUP and job.attempts > 0
            give_up(air, q, c.SENT if gone else c.EXPIRED, air.now_ns)
