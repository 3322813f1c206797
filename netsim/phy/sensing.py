"""What all stations sense of the medium: one array, and the passes over it that a frame's course takes.

A frame concerns every station, and most of them only in a few numbers: until when the medium is busy, which
frame the receiver is locked on to, until when somebody has reserved the medium. So these numbers are rows of
one array, and a frame is three compiled passes over all rows: `arrive` at its start, `find` when preambles
show, `settle` at its end. They say whose listener has to be told; who neither sends nor waits to send costs
nothing more.

The reservation is the Duration field's (NAV, IEEE 802.11-2016, 10.3.2.4). It belongs to the MAC, which reads
it here, and is kept here because every frame for somebody else sets it.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from netsim.frames import GROUP
from netsim.phy.path_loss import Doubles

Integers = NDArray[np.int64]

# Columns of a station's row. Times in nanoseconds.
BUSY_FROM = 0
"""The last period for which the medium was sensed busy; it may begin later than now by the propagation
delay."""
BUSY_UNTIL = 1
IDLE_BEFORE = 2
"""End of the busy period before that one."""
ENDED_BUSY = 3
"""Length of all busy periods before the last."""
SENDING_FROM = 4
SENDING_UNTIL = 5
SENSED_AT_START = 6
"""Busy time when the own transmission began."""
SENT_ALONE = 7
"""Time of the own transmissions that have ended in which nothing was sensed."""
LOCK = 8
"""Number of the frame that is being received, or `UNLOCKED`."""
LOCK_ARRIVED = 9
"""When it began here."""
LOCKED = 10
"""When a preamble was last found."""
RESERVED_UNTIL = 11
RESERVED_BY = 12
"""Who reserved the medium for that long."""
BROKEN = 13
"""When a frame ended here in errors; 0 if one has come through since."""
DEAF = 14
"""The radio is off for good."""
HEEDS_BUSY = 15
"""`Listener.on_busy` is wanted, and to be told of ends that upset a plan."""
HEEDS_END = 16
"""To be told of the end of every frame is wanted."""
UPSET = 17
"""What a plan rests on has changed since the station last cleared this: an error, the end of EIFS, a longer
reservation."""
COLUMNS = 18

UNLOCKED = -1
NOBODY = -1
NEVER_HEARD = -(2**62)

# What becomes of a frame at a station.
ABSENT, MISSED, RECEIVED, BROKE = -1, 0, 1, 2
"""It is the sender's own or the radio is off; not locked on to; received whole; ended in errors."""
IN_DOUBT = -1
"""What `settle` says if a frame may or may not survive somewhere."""


def first_state(stations: int) -> Integers:
    """Rows of stations that have neither sent nor heard anything, and are told of everything."""
    state = np.zeros((stations, COLUMNS), dtype=np.int64)
    state[:, (SENDING_FROM, SENDING_UNTIL, LOCKED)] = -1
    state[:, LOCK] = UNLOCKED
    state[:, RESERVED_BY] = NOBODY
    state[:, (HEEDS_BUSY, HEEDS_END)] = 1
    return state


@njit(cache=True)
def _occupy(state: Integers, r: int, from_ns: int, until_ns: int) -> bool:
    """Have a station sense the medium busy from now or soon on; False if it does so anyway."""
    row = state[r]
    if from_ns > row[BUSY_UNTIL]:
        row[ENDED_BUSY] += row[BUSY_UNTIL] - row[BUSY_FROM]
        row[IDLE_BEFORE] = row[BUSY_UNTIL]
        row[BUSY_FROM] = from_ns
    elif from_ns < row[BUSY_FROM]:
        row[BUSY_FROM] = from_ns
    elif until_ns <= row[BUSY_UNTIL]:
        return False
    if until_ns > row[BUSY_UNTIL]:
        row[BUSY_UNTIL] = until_ns
    return True


@njit(cache=True)
def _energy_until_ns(
    r: int,
    arrival_ns: int,
    last_ns: int,
    power_mw: float,
    energy_mw: float,
    others: Integers,
    others_mw: Doubles,
    others_delays_ns: Integers,
) -> int:
    """Until when all signals together keep up the energy threshold at ``r``; 0 if they do not reach it.

    For a signal that arrives now and is not sensed by itself. What the others amount to without it has been
    added up before.
    """
    count = 1
    ends_ns = np.empty(len(others) + 1, np.int64)
    powers_mw = np.empty(len(others) + 1)
    ends_ns[0], powers_mw[0] = last_ns, power_mw
    last_mw = power_mw
    for k in range(len(others)):
        end_ns = others[k, 1] + others_delays_ns[k, r]
        if others[k, 2] == r or end_ns <= arrival_ns:
            continue
        if end_ns > last_ns:
            last_ns, last_mw = end_ns, others_mw[k, r]
        # the later end first, and of equal ones the stronger
        i = count
        while i and (ends_ns[i - 1], powers_mw[i - 1]) < (end_ns, others_mw[k, r]):
            ends_ns[i], powers_mw[i] = ends_ns[i - 1], powers_mw[i - 1]
            i -= 1
        ends_ns[i], powers_mw[i] = end_ns, others_mw[k, r]
        count += 1
    if last_mw >= energy_mw:
        return last_ns
    total_mw = 0.0
    for i in range(count):
        total_mw += powers_mw[i]
        if total_mw >= energy_mw:
            return int(ends_ns[i])
    return 0


@njit(cache=True)
def arrive(
    state: Integers,
    source: int,
    start_ns: int,
    end_ns: int,
    powers_mw: Doubles,
    delays_ns: Integers,
    sensed_mw: float,
    energy_mw: float,
    others: Integers,
    others_mw: Doubles,
    others_delays_ns: Integers,
    told: Integers,
) -> int:
    """Have all stations sense a signal from its arrival on; returns how many are to be told.

    ``powers_mw`` and ``delays_ns`` are by station, from ``sensed_mw`` on it is sensed by itself. What is on
    the air besides are the k rows of ``others`` (start, end, source), ``others_mw`` and ``others_delays_ns``
    (k, stations). ``told`` becomes the stations to which the medium falls busy and who heed it: what a
    reservation covers changes nothing for them.
    """
    count = 0
    for r in range(len(state)):
        if r == source or state[r, DEAF]:
            continue
        arrival_ns, until_ns = start_ns + delays_ns[r], end_ns + delays_ns[r]
        if powers_mw[r] < sensed_mw:
            if len(others) == 0 and powers_mw[r] < energy_mw:
                continue
            until_ns = _energy_until_ns(
                r, arrival_ns, until_ns, powers_mw[r], energy_mw, others, others_mw, others_delays_ns
            )
            if until_ns == 0:
                continue
        if (
            _occupy(state, r, arrival_ns, until_ns)
            and state[r, HEEDS_BUSY]
            and state[r, BUSY_UNTIL] > state[r, RESERVED_UNTIL]
        ):
            told[count] = r
            count += 1
    return count


@njit(cache=True)
def find(
    state: Integers,
    number: int,
    source: int,
    start_ns: int,
    now_ns: int,
    powers_mw: Doubles,
    delays_ns: Integers,
    least_mw: float,
    noise_mw: float,
    least_ratio: float,
    capture_ratio: float,
    capture_window_ns: int,
    others: Integers,
    others_mw: Doubles,
    others_delays_ns: Integers,
    locks_mw: Doubles,
) -> None:
    """Have every free receiver look for the preamble of frame ``number``, at ``now_ns``.

    It takes ``least_mw``, and ``least_ratio`` over the noise and all other signals since the arrival. Who is
    locked on to another frame changes to one that is ``capture_ratio`` stronger than that and began within
    ``capture_window_ns`` of it. ``locks_mw`` is by station the power of what it is locked on to.
    """
    found_after_ns = now_ns - start_ns
    for r in range(len(state)):
        arrival_ns = start_ns + delays_ns[r]
        if r == source or powers_mw[r] < least_mw or state[r, SENDING_UNTIL] > arrival_ns or state[r, DEAF]:
            continue
        if len(others):
            floor_mw = 0.0
            for k in range(len(others)):
                delay_ns = others_delays_ns[k, r]
                if (
                    others[k, 2] != r
                    and others[k, 0] + delay_ns < arrival_ns + found_after_ns
                    and others[k, 1] + delay_ns > arrival_ns
                ):
                    floor_mw += others_mw[k, r]
            if powers_mw[r] < least_ratio * (noise_mw + floor_mw):
                continue
            if state[r, LOCK] != UNLOCKED and (
                powers_mw[r] < capture_ratio * locks_mw[r]
                or arrival_ns > state[r, LOCK_ARRIVED] + capture_window_ns
            ):
                continue
        state[r, LOCK] = number
        state[r, LOCK_ARRIVED] = arrival_ns
        state[r, LOCKED] = now_ns
        locks_mw[r] = powers_mw[r]


@njit(cache=True)
def conclude(
    state: Integers,
    fates: Integers,
    destination: int,
    end_ns: int,
    reserved_ns: int,
    reserved_by: int,
    near: int,
    powers_mw: Doubles,
    delays_ns: Integers,
    heard_ns: Integers,
    heard_mw: Doubles,
    told: Integers,
) -> int:
    """Have all stations take note of a frame that has ended; returns how many are to be told.

    ``fates`` is what has become of it at each. Whom it is not for keeps the medium reserved for
    ``reserved_ns`` after its end, by ``reserved_by``. Who hears it may take ``near`` for near, or `NOBODY`:
    when and how loud is noted in the columns of ``heard_ns`` and ``heard_mw`` (stations, stations), by who
    hears in the rows. ``told`` becomes the stations that have got a frame for them, or that heed its end.
    """
    count = 0
    for r in range(len(state)):
        fate = fates[r]
        if fate == ABSENT:
            continue
        end_here_ns = end_ns + delays_ns[r]
        tell, upset = state[r, HEEDS_END] != 0, False
        if fate == RECEIVED:
            state[r, LOCK] = UNLOCKED
            upset = state[r, BROKEN] != 0
            state[r, BROKEN] = 0
            if destination in (r, GROUP):
                tell = True
            if r != destination and reserved_ns and end_here_ns + reserved_ns > state[r, RESERVED_UNTIL]:
                state[r, RESERVED_UNTIL] = end_here_ns + reserved_ns
                state[r, RESERVED_BY] = reserved_by
                upset = True
            if near != NOBODY:
                heard_ns[r, near] = end_here_ns
                heard_mw[r, near] = powers_mw[r]
        elif fate == BROKE:
            state[r, LOCK] = UNLOCKED
            state[r, BROKEN] = end_here_ns
            upset = True
        if upset:
            state[r, UPSET] = 1
            tell = tell or state[r, HEEDS_BUSY] != 0
        if tell:
            told[count] = r
            count += 1
    return count


@njit(cache=True)
def settle(
    state: Integers,
    fates: Integers,
    number: int,
    source: int,
    doubtful_mw: float,
    destination: int,
    end_ns: int,
    reserved_ns: int,
    reserved_by: int,
    near: int,
    powers_mw: Doubles,
    delays_ns: Integers,
    heard_ns: Integers,
    heard_mw: Doubles,
    told: Integers,
) -> int:
    """Find out what has become of frame ``number`` at each station, and `conclude` with that.

    But if somebody receives it with less than ``doubtful_mw``, whether it survives there is the caller's to
    find out: `IN_DOUBT` is returned, nobody has taken note, and ``fates`` has such stations as receivers.
    """
    in_doubt = False
    for r in range(len(state)):
        if r == source or state[r, DEAF]:
            fates[r] = ABSENT
        elif state[r, LOCK] != number:
            fates[r] = MISSED
        else:
            fates[r] = RECEIVED
            in_doubt = in_doubt or powers_mw[r] < doubtful_mw
    if in_doubt:
        return IN_DOUBT
    return conclude(
        state, fates, destination, end_ns, reserved_ns, reserved_by, near, powers_mw, delays_ns,
        heard_ns, heard_mw, told,
    )  # fmt: skip


@njit(cache=True)
def unused(state: Integers, end_ns: int, reserved_ns: int, delays_ns: Integers, told: Integers) -> int:
    """Find the stations that a frame's reservation still holds back though they heard nothing after it.

    ``told`` becomes those; returns how many there are.
    """
    count = 0
    for r in range(len(state)):
        end_here_ns = end_ns + delays_ns[r]
        if state[r, RESERVED_UNTIL] == end_here_ns + reserved_ns and state[r, LOCKED] <= end_here_ns:
            told[count] = r
            count += 1
    return count


@njit(cache=True)
def loudest(heard_ns: Integers, heard_mw: Doubles, oldest_ns: int, turn: int) -> int:
    """Who is heard loudest since ``oldest_ns``, of one station's rows; `NOBODY` if nobody is.

    ``turn`` counts through all of them, in order of falling power and then of their numbers, again and again.
    """
    count = 0
    for other in range(len(heard_ns)):
        count += heard_ns[other] >= oldest_ns
    if count == 0:
        return NOBODY
    rank = turn % count
    for other in range(len(heard_ns)):
        if heard_ns[other] < oldest_ns:
            continue
        ahead = 0
        for rival in range(len(heard_ns)):
            if heard_ns[rival] >= oldest_ns and (
                heard_mw[rival] > heard_mw[other] or (heard_mw[rival] == heard_mw[other] and rival < other)
            ):
                ahead += 1
                if ahead > rank:
                    break
        if ahead == rank:
            return other
    return NOBODY
