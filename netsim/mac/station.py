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

The functions are compiled and work on `netsim.model.tables.Air`.
"""

from numba import njit

from netsim.mac.access_parameters import CCA_NS, SIFS_NS, SLOT_NS
from netsim.mac.airtime import cts_ns, data_ns, duration_ns, exchange_ns, response_ns
from netsim.mac.contention import drop_expired, fail, freeze, give_up, resume, succeeded, unwatch, win
from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.events import schedule
from netsim.model.tables import Air, call, take_signal
from netsim.phy import medium
from netsim.phy.frames import ACK_BYTES, CTS_BYTES, GROUP, RTS_BYTES
from netsim.phy.modes import NON_HT_PREAMBLE_NS
from netsim.phy.path_loss import Doubles

RESPONSE_TIMEOUT_NS = SIFS_NS + SLOT_NS + NON_HT_PREAMBLE_NS
"""Time from the end of a frame to the latest begin of its CTS or ACK (10.3.2.9)."""
NEIGHBOUR_LIFETIME_NS = 1_000_000_000

# State of an exchange. SENDING: the frame itself is on the air or follows after SIFS; no response is awaited.
IDLE, AWAITING_CTS, SENDING, AWAITING_ACK = range(4)


# --- the station's own exchange


@njit(cache=True)
def sender(air: Air, what: int, about: int) -> int:
    """Return the station that sends at an event now; `netsim.model.columns.NOTHING` if it no longer can.

    The event is the frame of a job (`SEND_JOB`), whose exchange may have ended meanwhile, or a control frame
    (`SEND_FRAME`), whose station may have been switched off or be sending another frame.
    """
    if what == c.SEND_JOB:
        return about // air[c.CATEGORIES] if _may_send(air, about) else c.NOTHING
    row = t.stations(air, about)
    return c.NOTHING if row[c.RADIO_OFF] or row[c.SENDING_UNTIL] > air[c.NOW] else about


@njit(cache=True)
def on_access(air: Air, q: int) -> None:
    """Resolve the access planned by ``q`` and make the exchange of the winning queue due."""
    winner = win(air, q)
    if winner != c.NOTHING:
        t.stations(air, winner // air[c.CATEGORIES])[c.TXOP_END] = air[c.NOW] + t.queues(air, winner)[c.TXOP]
        schedule_access(air, winner)


@njit(cache=True)
def schedule_access(air: Air, q: int) -> None:
    """Make the exchange of a queue's first job due now, if the queue may still send and has one."""
    if _may_send(air, q):
        air[c.DUE], air[c.CHOSEN] = q, 0


@njit(cache=True)
def _may_send(air: Air, q: int) -> bool:
    may = t.stations(air, q // air[c.CATEGORIES])[c.CURRENT] == q
    return bool(may and t.queues(air, q)[c.FIRST] != c.NOTHING)


@njit(cache=True)
def lacks_mode(air: Air, q: int) -> bool:
    """Whether the mode of a queue's next frame has to be chosen before its exchange begins."""
    return bool(t.jobs(air, t.queues(air, q)[c.FIRST])[c.JOB_ADAPTS] and not air[c.CHOSEN])


@njit(cache=True)
def has_time(air: Air, q: int) -> bool:
    """Whether the exchange of a queue's first job fits into the current TXOP.

    It may not fit in a mode that has just been selected; then it needs a new access.
    """
    txop_end_ns, queue = t.stations(air, q // air[c.CATEGORIES])[c.TXOP_END], t.queues(air, q)
    goes_on = air[c.NOW] > txop_end_ns - queue[c.TXOP]  # the TXOP has begun before
    late = air[c.CHOSEN] and goes_on and air[c.NOW] + exchange_ns(air, queue[c.FIRST]) > txop_end_ns
    return not late


@njit(cache=True)
def begin(air: Air, fading: Doubles, q: int) -> None:
    """Begin the exchange of a queue's first job: see `lacks_mode` and `has_time`."""
    station, job = q // air[c.CATEGORIES], t.queues(air, q)[c.FIRST]
    target = _rts_target(air, station, job) if t.jobs(air, job)[c.JOB_RTS] else c.NOTHING
    if target == c.NOTHING:
        send_job(air, fading, q)
        return
    t.stations(air, station)[c.PHASE] = AWAITING_CTS
    rts = _frame(air, c.RTS, station, target, air[c.CONTROL_MODE], RTS_BYTES)
    cts_end_ns = SIFS_NS + cts_ns(air)
    t.signals(air, rts)[c.NAV] = cts_end_ns + SIFS_NS + data_ns(air, job)
    t.signals(air, rts)[c.LAPSE] = cts_end_ns + SIFS_NS + NON_HT_PREAMBLE_NS + 2 * SLOT_NS
    _send(air, fading, rts)
    _await_response(air, station, rts)


@njit(cache=True)
def _rts_target(air: Air, station: int, job: int) -> int:
    if t.jobs(air, job)[c.JOB_TO] != GROUP:
        return int(t.jobs(air, job)[c.JOB_TO])
    oldest_ns = air[c.NOW] - NEIGHBOUR_LIFETIME_NS
    return medium.loudest(air, station, oldest_ns, t.jobs(air, job)[c.JOB_FAILURES])


@njit(cache=True)
def send_job(air: Air, fading: Doubles, q: int) -> None:
    """Send the data frame of a queue's exchange; requires that the queue may send: see `sender`."""
    station = q // air[c.CATEGORIES]
    row, queue = t.stations(air, station), t.queues(air, q)
    which = queue[c.FIRST]
    job = t.jobs(air, which)
    if job[c.JOB_ATTEMPTS] == 0:
        row[c.SEQUENCE] += 1
        job[c.JOB_SEQUENCE] = row[c.SEQUENCE]
    nav_ns = response_ns(air, which)
    if queue[c.TXOP] and job[c.NEXT_JOB] != c.NOTHING:
        next_ns = SIFS_NS + exchange_ns(air, job[c.NEXT_JOB])
        if air[c.NOW] + data_ns(air, which) + next_ns <= row[c.TXOP_END]:
            nav_ns += next_ns
    frame = _frame(air, job[c.JOB_KIND], station, job[c.JOB_TO], job[c.JOB_MODE], job[c.JOB_BYTES])
    sent = t.signals(air, frame)
    sent[c.NAV] = nav_ns
    sent[c.SEQ], sent[c.FRAME_SEQUENCE], sent[c.JOB] = job[c.JOB_SEQ], job[c.JOB_SEQUENCE], which
    job[c.JOB_ATTEMPTS] += 1
    job[c.JOB_SENT_AT] = air[c.NOW]
    row[c.PHASE] = SENDING if job[c.JOB_TO] == GROUP else AWAITING_ACK
    _send(air, fading, frame)
    if job[c.JOB_TO] != GROUP:
        _await_response(air, station, frame)


@njit(cache=True)
def _frame(air: Air, kind: int, source: int, to: int, mode: int, frame_bytes: int) -> int:
    """Allocate a row of signals for a frame that begins now, and fill the common fields."""
    row = take_signal(air)
    frame = t.signals(air, row)
    frame[c.SOURCE], frame[c.TO], frame[c.KIND] = source, to, kind
    frame[c.MODE], frame[c.BYTES] = mode, frame_bytes
    frame[c.START] = air[c.NOW]
    frame[c.END] = frame[c.START] + duration_ns(air, mode, frame_bytes)
    frame[c.NAV] = frame[c.LAPSE] = frame[c.SEQ] = frame[c.FRAME_SEQUENCE] = 0
    frame[c.JOB] = c.NOTHING
    return row


@njit(cache=True)
def _send(air: Air, fading: Doubles, frame: int) -> None:
    freeze(air, t.signals(air, frame)[c.SOURCE], air[c.NOW])
    on_busy(air, frame, medium.start(air, fading, frame))


@njit(cache=True)
def on_busy(air: Air, signal: int, count: int) -> None:
    """Freeze the backoffs of the ``count`` stations in `NEWLY_BUSY`, where the medium becomes busy."""
    for r in t.ends(air, c.NEWLY_BUSY)[:count]:
        if t.stations(air, r)[c.PLANNED]:
            freeze(air, r, t.signals(air, signal)[c.START] + t.delays_ns(air, signal)[r] + CCA_NS)


@njit(cache=True)
def _await_response(air: Air, station: int, frame: int) -> None:
    t.stations(air, station)[c.TIMED_OUT] = 0
    at_ns = t.signals(air, frame)[c.END] + RESPONSE_TIMEOUT_NS
    t.stations(air, station)[c.TIMEOUT] = schedule(air, at_ns, c.ON_TIMEOUT, station)


@njit(cache=True)
def _stop_waiting(air: Air, station: int) -> None:
    t.stations(air, station)[c.TIMED_OUT] = 0
    t.stations(air, station)[c.TIMEOUT] = 0


@njit(cache=True)
def _succeed(air: Air, station: int, outcome: int, end_ns: int) -> None:
    """End the exchange with success at ``end_ns``, and begin the next one of the TXOP if it fits."""
    q = t.stations(air, station)[c.CURRENT]
    if q == c.NOTHING:
        return
    _stop_waiting(air, station)
    give_up(air, q, outcome)
    if not (t.queues(air, q)[c.TXOP] and _goes_on(air, station, q, end_ns + SIFS_NS)):
        leave(air, q)


@njit(cache=True)
def leave(air: Air, q: int) -> None:
    """Release the medium after a success and back off."""
    station = q // air[c.CATEGORIES]
    t.stations(air, station)[c.CURRENT] = c.NOTHING
    t.stations(air, station)[c.PHASE] = IDLE
    succeeded(air, q)
    resume(air, station)


@njit(cache=True)
def _goes_on(air: Air, station: int, q: int, start_ns: int) -> bool:
    """Schedule the next exchange of a TXOP at ``start_ns`` if there is one that ends within the limit."""
    queue = t.queues(air, q)
    queue[c.WINDOW] = queue[c.WINDOW_LEAST]
    drop_expired(air, q)
    job = queue[c.FIRST]
    if job == c.NOTHING:
        return False
    # the duration of a frame without a mode is checked when the mode has been selected
    if (
        not t.jobs(air, job)[c.JOB_ADAPTS]
        and start_ns + exchange_ns(air, job) > t.stations(air, station)[c.TXOP_END]
    ):
        return False
    t.stations(air, station)[c.PHASE] = SENDING
    schedule(air, start_ns, c.START_EXCHANGE, q)
    return True


@njit(cache=True)
def _fail_exchange(air: Air, station: int) -> None:
    row = t.stations(air, station)
    q = row[c.CURRENT]
    if q == c.NOTHING:
        return
    job = t.queues(air, q)[c.FIRST]
    if row[c.PHASE] == AWAITING_ACK and t.jobs(air, job)[c.JOB_ADAPTS]:
        call(air, c.FAILED, station, job)
    _stop_waiting(air, station)
    row[c.CURRENT] = c.NOTHING
    row[c.PHASE] = IDLE
    row[c.WAIT_UNTIL] = air[c.NOW]
    fail(air, q)
    resume(air, station)


@njit(cache=True)
def on_timeout(air: Air, station: int) -> None:
    """Handle the time-out of a response: the exchange fails unless a frame is being received."""
    t.stations(air, station)[c.TIMEOUT] = 0
    if t.stations(air, station)[c.LOCK] != c.NOTHING:
        # a frame has begun in time: it is decided at its end whether it is the response
        t.stations(air, station)[c.TIMED_OUT] = 1
    else:
        _fail_exchange(air, station)


# --- reports of the receiver


@njit(cache=True)
def on_end(air: Air, frame: int, station: int) -> None:
    """Process the end of a frame at a station, after the medium has determined its outcome."""
    row, fate = t.stations(air, station), t.ends(air, c.FATES)[station]
    if t.ends(air, c.UPSETS)[station] and row[c.PLANNED]:
        freeze(air, station, air[c.NOW])
    if fate == c.RECEIVED and t.signals(air, frame)[c.TO] == station:
        _receive_own(air, frame, station)
    if fate != c.MISSED and row[c.TIMED_OUT]:
        _fail_exchange(air, station)
    on_air_changed(air, station)


@njit(cache=True)
def on_air_changed(air: Air, station: int) -> None:
    """Plan accesses of a station that has no plan."""
    if not t.stations(air, station)[c.PLANNED]:
        resume(air, station)


@njit(cache=True)
def on_unused(air: Air, station: int) -> None:
    """Plan accesses of a station again after its NAV has been reset."""
    if t.stations(air, station)[c.PLANNED]:
        freeze(air, station, air[c.NOW])
    resume(air, station)


@njit(cache=True)
def on_sent(air: Air, frame: int) -> None:
    """Continue after the own frame of a station has ended at all receivers."""
    station = t.signals(air, frame)[c.SOURCE]
    row = t.stations(air, station)
    if row[c.PHASE] == SENDING and t.signals(air, frame)[c.KIND] not in (c.CTS, c.ACK):
        _succeed(air, station, c.SENT, t.signals(air, frame)[c.END])
    elif row[c.TIMED_OUT] and row[c.LOCK] == c.NOTHING:
        # its own transmission has aborted a reception that might have been the response
        _fail_exchange(air, station)
    else:
        resume(air, station)


@njit(cache=True)
def _receive_own(air: Air, frame: int, station: int) -> None:
    row, kind = t.stations(air, station), t.signals(air, frame)[c.KIND]
    source = t.signals(air, frame)[c.SOURCE]
    end_ns = t.signals(air, frame)[c.END] + t.delays_ns(air, frame)[station]
    if kind == c.CTS:
        if row[c.PHASE] == AWAITING_CTS and row[c.CURRENT] != c.NOTHING:
            _stop_waiting(air, station)
            row[c.PHASE] = SENDING
            schedule(air, end_ns + SIFS_NS, c.SEND_JOB, row[c.CURRENT])
    elif kind == c.ACK:
        if row[c.PHASE] == AWAITING_ACK and row[c.CURRENT] != c.NOTHING:
            done = air[c.CALLS]
            _succeed(air, station, c.ACKNOWLEDGED, end_ns)
            t.calls(air, done)[c.CALL_SOURCE] = source
            t.calls(air, done)[c.CALL_START] = t.signals(air, frame)[c.START]
            t.calls(air, done)[c.CALL_END] = end_ns
            t.calls_mw(air, done)[0] = t.powers_mw(air, frame)[station]
    elif kind == c.RTS:
        # no CTS while the NAV is set, unless the sender of the RTS set it (10.22.2.4)
        free = row[c.RESERVED_UNTIL] <= end_ns or row[c.RESERVED_BY] == source
        if free and row[c.CURRENT] == c.NOTHING:
            _respond(air, frame, end_ns, station)
    else:
        _respond(air, frame, end_ns, station)
        sequence = t.signals(air, frame)[c.FRAME_SEQUENCE]
        again = t.last_sequences(air, station)[source * c.KINDS + kind] == sequence
        t.last_sequences(air, station)[source * c.KINDS + kind] = sequence
        _report_frame(air, frame, station, int(again))


@njit(cache=True)
def report_group_frame(air: Air, frame: int) -> None:
    """Report a group frame that has ended to the upper layer if any station has received it."""
    for fate in t.ends(air, c.FATES):
        if fate == c.RECEIVED:
            i = call(air, c.GROUP_FRAME, c.NOTHING, t.signals(air, frame)[c.JOB])
            t.calls(air, i)[c.CALL_DETAIL] = frame
            return


@njit(cache=True)
def _report_frame(air: Air, frame: int, station: int, again: int) -> None:
    """Report a frame to the upper layer of a station; ``again`` is 1 for a duplicate."""
    i = call(air, c.FRAME, station, t.signals(air, frame)[c.JOB])
    t.calls(air, i)[c.CALL_DETAIL] = again
    t.calls(air, i)[c.CALL_SOURCE] = t.signals(air, frame)[c.SOURCE]
    t.calls(air, i)[c.CALL_START] = t.signals(air, frame)[c.START]
    t.calls(air, i)[c.CALL_END] = t.signals(air, frame)[c.END] + t.delays_ns(air, frame)[station]
    t.calls_mw(air, i)[0] = t.powers_mw(air, frame)[station]


# --- responses


@njit(cache=True)
def _respond(air: Air, frame: int, end_ns: int, station: int) -> None:
    """Schedule the CTS or ACK of a frame that has ended at this station at ``end_ns``."""
    mode = t.modes(air, t.signals(air, frame)[c.MODE])[c.RESPONSE_MODE]
    if t.signals(air, frame)[c.KIND] == c.RTS:
        what, frame_bytes = c.CTS, CTS_BYTES
    else:
        what, frame_bytes = c.ACK, ACK_BYTES
    nav_ns = max(0, t.signals(air, frame)[c.NAV] - SIFS_NS - duration_ns(air, mode, frame_bytes))
    to = t.signals(air, frame)[c.SOURCE]
    schedule(air, end_ns + SIFS_NS, c.SEND_FRAME, station, to, what * c.MODES + mode, frame_bytes, nav_ns)


@njit(cache=True)
def send_frame(
    air: Air, fading: Doubles, station: int, to: int, what: int, frame_bytes: int, nav_ns: int
) -> None:
    """Send a control frame or one of `Radios.transmit`, which belongs to no job: see `sender`.

    ``what`` is its kind times the number of modes, plus its mode.
    """
    frame = _frame(air, what // c.MODES, station, to, what % c.MODES, frame_bytes)
    t.signals(air, frame)[c.NAV] = nav_ns
    _send(air, fading, frame)


# --- switching off


@njit(cache=True)
def silence(air: Air, station: int) -> None:
    """Switch a station's radio off for good: it no longer sends, responds or receives."""
    row = t.stations(air, station)
    row[c.RADIO_OFF] = 1
    row[c.LOCK] = c.NOTHING
    freeze(air, station, air[c.NOW] - 1)
    _stop_waiting(air, station)
    row[c.CURRENT] = c.NOTHING
    k = air[c.CATEGORIES]
    for q in range(station * k, station * k + k):
        if not t.queues(air, q)[c.IN_USE]:
            continue
        unwatch(air, q)
        while t.queues(air, q)[c.FIRST] != c.NOTHING:
            job = t.queues(air, q)[c.FIRST]
            # a group frame in the queue with an attempt is on the air and is completed
            gone = t.jobs(air, job)[c.JOB_TO] == GROUP and t.jobs(air, job)[c.JOB_ATTEMPTS] > 0
            give_up(air, q, c.SENT if gone else c.EXPIRED)
