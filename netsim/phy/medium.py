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

The functions are compiled and work on `netsim.model.tables.Air`. Whose MAC has to hear of something is for
the caller to see: in ``told``, or in ``fates`` and ``upsets``.
"""

from math import inf

from numba import njit

from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.events import schedule
from netsim.model.tables import Air, Integers, draw_reception, end_signal, release
from netsim.phy.fading import fade
from netsim.phy.frames import GROUP
from netsim.phy.path_loss import Doubles
from netsim.phy.sensing import begin_sending, end_sending, energy_until_ns, occupy
from netsim.phy.survival import alone, among_others, clean_mw

PREAMBLE_DETECTION_NS = 4_000
PREAMBLE_SINR = 10.0**0.4
"""Least ratio at which a preamble is found, 4 dB."""
CAPTURE_RATIO = 10.0**0.5
"""A later frame takes over a receiver that is in an earlier frame's preamble if it is 5 dB stronger."""
CAPTURE_WINDOW_NS = 16_000
FRAMES, BURSTS = 0, 1
"""Rows of `netsim.model.tables.on_air`."""


@njit(cache=True)
def start(air: Air, fading: Doubles, frame: int) -> int:
    """Put a frame on the air now, a row of signals that has all but its powers; returns how many are told.

    The sender's link budget holds. Told are the stations at which the medium falls busy.
    """
    now = air[c.NOW]
    sent = t.signals(air, frame)
    source = sent[c.SOURCE]
    powers_mw, delays_ns = t.powers_mw(air, frame), t.delays_ns(air, frame)
    powers_mw[:] = t.budgets_mw(air, source)
    delays_ns[:] = t.budget_delays_ns(air, source)
    if len(fading):
        fade(fading, source, now, powers_mw)
    air[c.STARTED] += 1
    sent[c.NUMBER] = air[c.STARTED]
    sent[c.LONGEST_DELAY] = t.budgets(air, source)[c.BUDGET_DELAY]
    _overlap(air, frame)
    for k in range(air[c.BURSTS]):
        _add_overlap(air, frame, t.on_air(air, BURSTS)[k])
    t.on_air(air, FRAMES)[air[c.ACTIVE]] = frame
    air[c.ACTIVE] += 1
    begin_sending(t.stations(air, source), now, sent[c.END])
    told = _radiate(air, frame, t.levels_mw(air, 0)[c.SENSED_MW])
    schedule(air, now + PREAMBLE_DETECTION_NS, c.DETECT, frame)
    schedule(air, sent[c.END] + sent[c.LONGEST_DELAY], c.END_FRAME, frame)
    return told


@njit(cache=True)
def start_burst(air: Air, burst: int) -> int:
    """Put an interferer's burst on the air now, powers and all; as `start`."""
    signal = t.signals(air, burst)
    _overlap(air, burst)
    bursts = t.on_air(air, BURSTS)
    for other in bursts[: air[c.BURSTS]]:
        if t.signals(air, other)[c.SOURCE] != signal[c.SOURCE]:
            _add_overlap(air, burst, other)
    bursts[air[c.BURSTS]] = burst
    air[c.BURSTS] += 1
    told = _radiate(air, burst, inf)
    # what overlaps it matters only now; kept, each burst would keep all before it
    for other in t.overlaps(air, burst)[: signal[c.OVERLAPS]]:
        release(air, other)
    signal[c.OVERLAPS] = 0
    schedule(air, signal[c.END] + signal[c.LONGEST_DELAY], c.END_BURST, burst)
    return told


@njit(cache=True)
def end_burst(air: Air, burst: int) -> None:
    """Take a burst off the air."""
    air[c.BURSTS] = _remove(t.on_air(air, BURSTS), air[c.BURSTS], burst)
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
    for other in t.on_air(air, FRAMES)[: air[c.ACTIVE]]:
        frame = t.signals(air, other)
        if frame[c.END] + frame[c.LONGEST_DELAY] > air[c.NOW]:
            _add_overlap(air, signal, other)
            _add_overlap(air, other, signal)


@njit(cache=True)
def _add_overlap(air: Air, signal: int, other: int) -> None:
    count = t.signals(air, signal)[c.OVERLAPS]
    t.overlaps(air, signal)[count] = other
    t.signals(air, signal)[c.OVERLAPS] = count + 1
    t.signals(air, other)[c.HOLDERS] += 1


@njit(cache=True)
def _radiate(air: Air, which: int, sensed_mw: float) -> int:
    """Have the stations sense a signal that begins now, from ``sensed_mw`` on by itself.

    Returns how many are told: those to which the medium falls busy, but for what a reservation covers.
    """
    signal = t.signals(air, which)
    start_ns, end_ns = signal[c.START], signal[c.END]
    if end_ns > air[c.BUSY_UNTIL_NS]:
        air[c.BUSY_NS] += end_ns - max(start_ns, air[c.BUSY_UNTIL_NS])
        air[c.BUSY_UNTIL_NS] = end_ns
    count = 0
    told = t.ends(air, c.NEWLY_BUSY)
    powers_mw, delays_ns = t.powers_mw(air, which), t.delays_ns(air, which)
    energy_mw = t.levels_mw(air, 0)[c.ENERGY_MW]
    for r in range(air[c.STATIONS]):
        row = t.stations(air, r)
        if r == signal[c.SOURCE] or row[c.RADIO_OFF]:
            continue
        arrival_ns, until_ns = start_ns + delays_ns[r], end_ns + delays_ns[r]
        if powers_mw[r] < sensed_mw:
            if signal[c.OVERLAPS] == 0 and powers_mw[r] < energy_mw:
                continue
            until_ns = energy_until_ns(air, which, r, arrival_ns, until_ns)
            if until_ns == 0:
                continue
        if occupy(row, arrival_ns, until_ns) and row[c.BUSY_UNTIL] > row[c.RESERVED_UNTIL]:
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
    for r in range(air[c.STATIONS]):
        row = t.stations(air, r)
        arrival_ns = sent[c.START] + delays_ns[r]
        if (
            r == sent[c.SOURCE]
            or powers_mw[r] < levels_mw[c.PREAMBLE_MW]
            or row[c.SENDING_UNTIL] > arrival_ns
            or row[c.RADIO_OFF]
        ):
            continue
        if sent[c.OVERLAPS]:
            floor_mw = _floor_mw(air, frame, r, arrival_ns)
            if powers_mw[r] < PREAMBLE_SINR * (levels_mw[c.NOISE_MW] + floor_mw):
                continue
            if row[c.LOCK] != c.NOTHING and (
                powers_mw[r] < CAPTURE_RATIO * locks_mw[r]
                or arrival_ns > row[c.LOCK_ARRIVED] + CAPTURE_WINDOW_NS
            ):
                continue
        row[c.LOCK] = sent[c.NUMBER]
        row[c.LOCK_ARRIVED] = arrival_ns
        row[c.LOCKED] = air[c.NOW]
        locks_mw[r] = powers_mw[r]


@njit(cache=True)
def _floor_mw(air: Air, frame: int, r: int, arrival_ns: int) -> float:
    """Power of all other signals at ``r`` that were there at some time since a frame's arrival."""
    sent = t.signals(air, frame)
    floor_mw = 0.0
    for k in t.overlaps(air, frame)[: sent[c.OVERLAPS]]:
        other, delay_ns = t.signals(air, k), t.delays_ns(air, k)[r]
        if (
            other[c.SOURCE] != r
            and other[c.START] + delay_ns < arrival_ns + air[c.NOW] - sent[c.START]
            and other[c.END] + delay_ns > arrival_ns
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
    air[c.ACTIVE] = _remove(t.on_air(air, FRAMES), air[c.ACTIVE], frame)
    sent, powers_mw = t.signals(air, frame), t.powers_mw(air, frame)
    fates, notes, upsets = t.ends(air, c.FATES), t.ends(air, c.NOTES), t.ends(air, c.UPSETS)
    doubtful_mw = inf if sent[c.OVERLAPS] else clean_mw(air, sent[c.MODE])
    for r in range(air[c.STATIONS]):
        row = t.stations(air, r)
        notes[r], upsets[r] = c.NOT_MEANT, 0
        if r == sent[c.SOURCE] or row[c.RADIO_OFF]:
            fates[r] = c.ABSENT
            continue
        draw = -1.0
        if row[c.LOCK] != sent[c.NUMBER]:
            fates[r] = c.MISSED
        else:
            fates[r] = c.RECEIVED
            if powers_mw[r] < doubtful_mw:
                survival = among_others(air, frame, r)
                if survival < 1.0:
                    draw = draw_reception(air, r)
                    if draw >= survival:
                        fates[r] = c.BROKE
            upsets[r] = _take_note(air, frame, r, fates[r])
        if sent[c.TO] in (r, GROUP):
            notes[r] = _judge(air, frame, r, fates[r], draw)


@njit(cache=True)
def _take_note(air: Air, frame: int, r: int, fate: int) -> bool:
    """Have a station that was locked on to a frame take note of how it ended; True if that upsets a plan."""
    row, sent = t.stations(air, r), t.signals(air, frame)
    end_here_ns = sent[c.END] + t.delays_ns(air, frame)[r]
    row[c.LOCK] = c.NOTHING
    if fate == c.BROKE:
        row[c.BROKEN] = end_here_ns
        return True
    upset = row[c.BROKEN] != 0
    row[c.BROKEN] = 0
    is_answer = sent[c.KIND] in (c.CTS, c.ACK)
    # whom it is not for keeps the medium reserved
    if r != sent[c.TO] and sent[c.NAV] and end_here_ns + sent[c.NAV] > row[c.RESERVED_UNTIL]:
        row[c.RESERVED_UNTIL] = end_here_ns + sent[c.NAV]
        row[c.RESERVED_BY] = sent[c.TO] if is_answer else sent[c.SOURCE]
        upset = True
    if not is_answer:
        t.heard_ns(air, r)[sent[c.SOURCE]] = end_here_ns
        t.heard_mw(air, r)[sent[c.SOURCE]] = t.powers_mw(air, frame)[r]
    return bool(upset)


@njit(cache=True)
def _judge(air: Air, frame: int, r: int, fate: int, draw: float) -> int:
    """Whether an intended receiver has got a frame, and if not, whether it would have got it alone."""
    if fate == c.RECEIVED:
        return c.DELIVERED
    power_mw = t.powers_mw(air, frame)[r]
    if t.signals(air, frame)[c.OVERLAPS] and power_mw >= t.levels_mw(air, 0)[c.PREAMBLE_MW]:
        if fate != c.BROKE:
            draw = draw_reception(air, r)
        if draw < alone(air, frame, power_mw):
            return c.COLLIDED
    return c.LOST


@njit(cache=True)
def conclude(air: Air, frame: int) -> None:
    """Count a frame that has ended, put it down among the records, and note that its sender has sent it.

    A reservation that nobody uses will be seen.
    """
    sent, notes = t.signals(air, frame), t.ends(air, c.NOTES)
    if sent[c.LAPSE]:
        sent[c.HOLDERS] += 1
        schedule(air, sent[c.END] + sent[c.LAPSE], c.LOOK_FOR_UNUSED, frame)
    t.sent(air, 0)[sent[c.KIND]] += 1
    record = t.records(air, air[c.RECORDS])
    air[c.RECORDS] += 1
    record[0], record[1], record[2], record[3] = sent[c.START], sent[c.END], sent[c.SOURCE], sent[c.TO]
    record[4], record[5], record[6], record[7] = sent[c.KIND], sent[c.MODE], sent[c.BYTES], sent[c.SEQ]
    record[8] = record[9] = record[10] = 0
    for r in range(air[c.STATIONS]):
        if notes[r] != c.NOT_MEANT:
            record[7 + notes[r]] += 1
            if sent[c.KIND] == c.DATA and sent[c.TO] == GROUP:
                t.counts(air, r)[notes[r] - 1] += 1
    end_sending(t.stations(air, sent[c.SOURCE]))


# --- reservations that nobody uses


@njit(cache=True)
def look_for_unused(air: Air, frame: int) -> None:
    """Have a reservation fall where nothing was heard after the frame that made it (10.3.2.4)."""
    nav_ns, lapse_ns = t.signals(air, frame)[c.NAV], t.signals(air, frame)[c.LAPSE]
    for r in range(air[c.STATIONS]):
        end_here_ns = t.signals(air, frame)[c.END] + t.delays_ns(air, frame)[r]
        if (
            t.stations(air, r)[c.RESERVED_UNTIL] == end_here_ns + nav_ns
            and t.stations(air, r)[c.LOCKED] <= end_here_ns
        ):
            schedule(air, end_here_ns + lapse_ns, c.ON_UNUSED, r, end_here_ns, end_here_ns + nav_ns)
    release(air, frame)


@njit(cache=True)
def drop_reservation(air: Air, r: int, end_here_ns: int, until_ns: int) -> bool:
    """Have a reservation fall if it is still the same and still unused."""
    row = t.stations(air, r)
    if row[c.RESERVED_UNTIL] == until_ns and row[c.LOCKED] <= end_here_ns:
        row[c.RESERVED_UNTIL] = air[c.NOW]
        return True
    return False


@njit(cache=True)
def loudest(air: Air, station: int, oldest_ns: int, turn: int) -> int:
    """Who is heard loudest by a station since ``oldest_ns``; `netsim.model.columns.NOTHING` if nobody is.

    ``turn`` counts through all of them, in order of falling power and then of their numbers, again and again.
    """
    heard_ns, heard_mw = t.heard_ns(air, station), t.heard_mw(air, station)
    count = 0
    for other in range(len(heard_ns)):
        count += heard_ns[other] >= oldest_ns
    if count == 0:
        return c.NOTHING
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
    return c.NOTHING
