"""The shared medium: which signals overlap at whom, what each receiver locks on to, and what survives.

A frame is three passes over all stations. At its start every receiver's energy detection learns of it; 4 us
later receivers find its preamble or not; when its end has reached the last of them, what they made of it is
settled, with every signal known that overlapped it. All times at a receiver include the propagation delay to
it. Interferers' bursts are signals that nobody can find a preamble in. Clear channel assessment is
`netsim.phy.sensing`'s.

Preambles are found from -82 dBm and 4 dB over noise and interference on, as with ns-3's
ThresholdPreambleDetection, and a frame 5 dB stronger that begins within 16 us of the one being received takes
its place, as with its SimpleFrameCaptureModel.

Left out: adjacent channels; secondary channels, as every frame occupies the whole channel; propagation longer
than SIFS (4.8 km), beyond which 802.11's own timing fails and nobody hears anybody; and giving up a frame
whose signal field failed: its receiver stays with it until it ends in errors.

The functions are compiled and work on `netsim.tables.Air`. Whose MAC has to hear of something is for the
caller to see: in ``told``, or in ``fates`` and ``upsets``.
"""

from math import inf

from numba import njit

from netsim import tables as t
from netsim.events import schedule
from netsim.frames import GROUP
from netsim.phy.fading import fade
from netsim.phy.path_loss import Doubles
from netsim.phy.sensing import begin_sending, end_sending, energy_until_ns, occupy
from netsim.phy.survival import alone, among_others, clean_mw
from netsim.tables import Air, Integers, draw_reception, end_signal, let_go

PREAMBLE_DETECTION_NS = 4_000
PREAMBLE_SINR = 10.0**0.4
"""Least ratio at which a preamble is found, 4 dB."""
CAPTURE_RATIO = 10.0**0.5
"""A later frame takes over a receiver that is in an earlier frame's preamble if it is 5 dB stronger."""
CAPTURE_WINDOW_NS = 16_000
FRAMES, BURSTS = 0, 1
"""Rows of `netsim.tables.on_air`."""


@njit(cache=True)
def start(air: Air, fading: Doubles, frame: int) -> int:
    """Put a frame on the air now, a row of signals that has all but its powers; returns how many are told.

    The sender's link budget holds. Told are the stations at which the medium falls busy.
    """
    now = air[t.NOW]
    sent = t.signals(air, frame)
    source = sent[t.SOURCE]
    powers_mw, delays_ns = t.powers_mw(air, frame), t.delays_ns(air, frame)
    powers_mw[:] = t.budgets_mw(air, source)
    delays_ns[:] = t.budget_delays_ns(air, source)
    if len(fading):
        fade(fading, source, now, powers_mw)
    air[t.STARTED] += 1
    sent[t.NUMBER] = air[t.STARTED]
    sent[t.LONGEST_DELAY] = t.budgets(air, source)[t.BUDGET_DELAY]
    _overlap(air, frame)
    for k in range(air[t.BURSTS]):
        _add_overlap(air, frame, t.on_air(air, BURSTS)[k])
    t.on_air(air, FRAMES)[air[t.ACTIVE]] = frame
    air[t.ACTIVE] += 1
    begin_sending(t.stations(air, source), now, sent[t.END])
    told = _radiate(air, frame, t.levels_mw(air, 0)[t.SENSED_MW])
    schedule(air, now + PREAMBLE_DETECTION_NS, t.DETECT, frame)
    schedule(air, sent[t.END] + sent[t.LONGEST_DELAY], t.END_FRAME, frame)
    return told


@njit(cache=True)
def start_burst(air: Air, burst: int) -> int:
    """Put an interferer's burst on the air now, powers and all; as `start`."""
    signal = t.signals(air, burst)
    _overlap(air, burst)
    bursts = t.on_air(air, BURSTS)
    for other in bursts[: air[t.BURSTS]]:
        if t.signals(air, other)[t.SOURCE] != signal[t.SOURCE]:
            _add_overlap(air, burst, other)
    bursts[air[t.BURSTS]] = burst
    air[t.BURSTS] += 1
    told = _radiate(air, burst, inf)
    # what overlaps it matters only now; kept, each burst would keep all before it
    for other in t.overlaps(air, burst)[: signal[t.OVERLAPS]]:
        let_go(air, other)
    signal[t.OVERLAPS] = 0
    schedule(air, signal[t.END] + signal[t.LONGEST_DELAY], t.END_BURST, burst)
    return told


@njit(cache=True)
def end_burst(air: Air, burst: int) -> None:
    """Take a burst off the air."""
    air[t.BURSTS] = _remove(t.on_air(air, BURSTS), air[t.BURSTS], burst)
    end_signal(air, burst)


@njit(cache=True)
def _remove(rows: Integers, count: int, row: int) -> int:
    """Take a row out of the first ``count``, whose order stays; returns how many are left."""
    kept = 0
    for k in range(count):
        if rows[k] != row:
            rows[kept] = rows[k]
            kept += 1
    return kept


@njit(cache=True)
def _overlap(air: Air, signal: int) -> None:
    """Note the frames that a signal which begins now is on the air with, and it with them."""
    for other in t.on_air(air, FRAMES)[: air[t.ACTIVE]]:
        frame = t.signals(air, other)
        if frame[t.END] + frame[t.LONGEST_DELAY] > air[t.NOW]:
            _add_overlap(air, signal, other)
            _add_overlap(air, other, signal)


@njit(cache=True)
def _add_overlap(air: Air, signal: int, other: int) -> None:
    count = t.signals(air, signal)[t.OVERLAPS]
    t.overlaps(air, signal)[count] = other
    t.signals(air, signal)[t.OVERLAPS] = count + 1
    t.signals(air, other)[t.HOLDERS] += 1


@njit(cache=True)
def _radiate(air: Air, which: int, sensed_mw: float) -> int:
    """Have the stations sense a signal that begins now, from ``sensed_mw`` on by itself.

    Returns how many are told: those to which the medium falls busy, but for what a reservation covers.
    """
    signal = t.signals(air, which)
    start_ns, end_ns = signal[t.START], signal[t.END]
    if end_ns > air[t.BUSY_UNTIL_NS]:
        air[t.BUSY_NS] += end_ns - max(start_ns, air[t.BUSY_UNTIL_NS])
        air[t.BUSY_UNTIL_NS] = end_ns
    count = 0
    told = t.ends(air, t.TOLD)
    powers_mw, delays_ns = t.powers_mw(air, which), t.delays_ns(air, which)
    energy_mw = t.levels_mw(air, 0)[t.ENERGY_MW]
    for r in range(air[t.STATIONS]):
        row = t.stations(air, r)
        if r == signal[t.SOURCE] or row[t.DEAF]:
            continue
        arrival_ns, until_ns = start_ns + delays_ns[r], end_ns + delays_ns[r]
        if powers_mw[r] < sensed_mw:
            if signal[t.OVERLAPS] == 0 and powers_mw[r] < energy_mw:
                continue
            until_ns = energy_until_ns(air, which, r, arrival_ns, until_ns)
            if until_ns == 0:
                continue
        if occupy(row, arrival_ns, until_ns) and row[t.BUSY_UNTIL] > row[t.RESERVED_UNTIL]:
            told[count] = r
            count += 1
    return count


@njit(cache=True)
def find(air: Air, frame: int) -> None:
    """Have every free receiver look for a frame's preamble, now.

    It takes the least power, and 4 dB over the noise and all other signals since the arrival. Who is locked
    on to another frame changes to one that is stronger and began soon after it.
    """
    sent = t.signals(air, frame)
    powers_mw, delays_ns, locks_mw = t.powers_mw(air, frame), t.delays_ns(air, frame), t.locks_mw(air, 0)
    levels_mw = t.levels_mw(air, 0)
    for r in range(air[t.STATIONS]):
        row = t.stations(air, r)
        arrival_ns = sent[t.START] + delays_ns[r]
        if (
            r == sent[t.SOURCE]
            or powers_mw[r] < levels_mw[t.PREAMBLE_MW]
            or row[t.SENDING_UNTIL] > arrival_ns
            or row[t.DEAF]
        ):
            continue
        if sent[t.OVERLAPS]:
            floor_mw = _floor_mw(air, frame, r, arrival_ns)
            if powers_mw[r] < PREAMBLE_SINR * (levels_mw[t.NOISE_MW] + floor_mw):
                continue
            if row[t.LOCK] != t.NOTHING and (
                powers_mw[r] < CAPTURE_RATIO * locks_mw[r]
                or arrival_ns > row[t.LOCK_ARRIVED] + CAPTURE_WINDOW_NS
            ):
                continue
        row[t.LOCK] = sent[t.NUMBER]
        row[t.LOCK_ARRIVED] = arrival_ns
        row[t.LOCKED] = air[t.NOW]
        locks_mw[r] = powers_mw[r]


@njit(cache=True)
def _floor_mw(air: Air, frame: int, r: int, arrival_ns: int) -> float:
    """Power of all other signals at ``r`` that were there at some time since a frame's arrival."""
    sent = t.signals(air, frame)
    floor_mw = 0.0
    for k in t.overlaps(air, frame)[: sent[t.OVERLAPS]]:
        other, delay_ns = t.signals(air, k), t.delays_ns(air, k)[r]
        if (
            other[t.SOURCE] != r
            and other[t.START] + delay_ns < arrival_ns + air[t.NOW] - sent[t.START]
            and other[t.END] + delay_ns > arrival_ns
        ):
            floor_mw += t.powers_mw(air, k)[r]
    return floor_mw


@njit(cache=True)
def settle(air: Air, frame: int) -> None:
    """Find out what has become of a frame that has ended everywhere, and have all stations take note.

    Fates become what each made of it, notes whether it has arrived where it was meant to, and if not, whether
    it would have alone. One draw decides whether it survives, and whether it would have without the others;
    nothing is drawn for one that is certain to survive. Upset are stations whose plans cannot stay: it was an
    error, the end of EIFS, a longer reservation.
    """
    air[t.ACTIVE] = _remove(t.on_air(air, FRAMES), air[t.ACTIVE], frame)
    sent, powers_mw = t.signals(air, frame), t.powers_mw(air, frame)
    fates, notes, upsets = t.ends(air, t.FATES), t.ends(air, t.NOTES), t.ends(air, t.UPSETS)
    doubtful_mw = inf if sent[t.OVERLAPS] else clean_mw(air, sent[t.MODE])
    for r in range(air[t.STATIONS]):
        row = t.stations(air, r)
        notes[r], upsets[r] = t.NOT_MEANT, 0
        if r == sent[t.SOURCE] or row[t.DEAF]:
            fates[r] = t.ABSENT
            continue
        draw = -1.0
        if row[t.LOCK] != sent[t.NUMBER]:
            fates[r] = t.MISSED
        else:
            fates[r] = t.RECEIVED
            if powers_mw[r] < doubtful_mw:
                survival = among_others(air, frame, r)
                if survival < 1.0:
                    draw = draw_reception(air, r)
                    if draw >= survival:
                        fates[r] = t.BROKE
            upsets[r] = _take_note(air, frame, r, fates[r])
        if sent[t.TO] in (r, GROUP):
            notes[r] = _judge(air, frame, r, fates[r], draw)


@njit(cache=True)
def _take_note(air: Air, frame: int, r: int, fate: int) -> bool:
    """Have a station that was locked on to a frame take note of how it ended; True if that upsets a plan."""
    row, sent = t.stations(air, r), t.signals(air, frame)
    end_here_ns = sent[t.END] + t.delays_ns(air, frame)[r]
    row[t.LOCK] = t.NOTHING
    if fate == t.BROKE:
        row[t.BROKEN] = end_here_ns
        return True
    upset = row[t.BROKEN] != 0
    row[t.BROKEN] = 0
    is_answer = sent[t.KIND] in (t.CTS, t.ACK)
    # whom it is not for keeps the medium reserved
    if r != sent[t.TO] and sent[t.NAV] and end_here_ns + sent[t.NAV] > row[t.RESERVED_UNTIL]:
        row[t.RESERVED_UNTIL] = end_here_ns + sent[t.NAV]
        row[t.RESERVED_BY] = sent[t.TO] if is_answer else sent[t.SOURCE]
        upset = True
    if not is_answer:
        t.heard_ns(air, r)[sent[t.SOURCE]] = end_here_ns
        t.heard_mw(air, r)[sent[t.SOURCE]] = t.powers_mw(air, frame)[r]
    return bool(upset)


@njit(cache=True)
def _judge(air: Air, frame: int, r: int, fate: int, draw: float) -> int:
    """Whether an intended receiver has got a frame, and if not, whether it would have got it alone."""
    if fate == t.RECEIVED:
        return t.DELIVERED
    power_mw = t.powers_mw(air, frame)[r]
    if t.signals(air, frame)[t.OVERLAPS] and power_mw >= t.levels_mw(air, 0)[t.PREAMBLE_MW]:
        if fate != t.BROKE:
            draw = draw_reception(air, r)
        if draw < alone(air, frame, power_mw):
            return t.COLLIDED
    return t.LOST


@njit(cache=True)
def conclude(air: Air, frame: int) -> None:
    """Count a frame that has ended, put it down among the records, and note that its sender has sent it.

    A reservation that nobody uses will be seen.
    """
    sent, notes = t.signals(air, frame), t.ends(air, t.NOTES)
    if sent[t.LAPSE]:
        sent[t.HOLDERS] += 1
        schedule(air, sent[t.END] + sent[t.LAPSE], t.LOOK_FOR_UNUSED, frame)
    t.sent(air, 0)[sent[t.KIND]] += 1
    record = t.records(air, air[t.RECORDS])
    air[t.RECORDS] += 1
    record[0], record[1], record[2], record[3] = sent[t.START], sent[t.END], sent[t.SOURCE], sent[t.TO]
    record[4], record[5], record[6], record[7] = sent[t.KIND], sent[t.MODE], sent[t.BYTES], sent[t.SEQ]
    record[8] = record[9] = record[10] = 0
    for r in range(air[t.STATIONS]):
        if notes[r] != t.NOT_MEANT:
            record[7 + notes[r]] += 1
            if sent[t.KIND] == t.DATA and sent[t.TO] == GROUP:
                t.counts(air, r)[notes[r] - 1] += 1
    end_sending(t.stations(air, sent[t.SOURCE]))


# --- reservations that nobody uses


@njit(cache=True)
def look_for_unused(air: Air, frame: int) -> None:
    """Have a reservation fall where nothing was heard after the frame that made it (10.3.2.4)."""
    nav_ns, lapse_ns = t.signals(air, frame)[t.NAV], t.signals(air, frame)[t.LAPSE]
    for r in range(air[t.STATIONS]):
        end_here_ns = t.signals(air, frame)[t.END] + t.delays_ns(air, frame)[r]
        if (
            t.stations(air, r)[t.RESERVED_UNTIL] == end_here_ns + nav_ns
            and t.stations(air, r)[t.LOCKED] <= end_here_ns
        ):
            schedule(air, end_here_ns + lapse_ns, t.ON_UNUSED, r, end_here_ns, end_here_ns + nav_ns)
    let_go(air, frame)


@njit(cache=True)
def drop_reservation(air: Air, r: int, end_here_ns: int, until_ns: int) -> bool:
    """Have a reservation fall if it is still the same and still unused."""
    row = t.stations(air, r)
    if row[t.RESERVED_UNTIL] == until_ns and row[t.LOCKED] <= end_here_ns:
        row[t.RESERVED_UNTIL] = air[t.NOW]
        return True
    return False


@njit(cache=True)
def loudest(air: Air, station: int, oldest_ns: int, turn: int) -> int:
    """Who is heard loudest by a station since ``oldest_ns``; `netsim.tables.NOTHING` if nobody is.

    ``turn`` counts through all of them, in order of falling power and then of their numbers, again and again.
    """
    heard_ns, heard_mw = t.heard_ns(air, station), t.heard_mw(air, station)
    count = 0
    for other in range(len(heard_ns)):
        count += heard_ns[other] >= oldest_ns
    if count == 0:
        return t.NOTHING
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
    return t.NOTHING
