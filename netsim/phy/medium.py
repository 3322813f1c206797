"""The shared medium: overlap of signals, preamble detection, capture, and reception of frames.

A frame takes three passes over all stations. At its start the carrier sense of every receiver is updated.
4 us later receivers detect its preamble or not. When its end has reached the last receiver, the outcomes are
determined from all overlapping signals. All times at a receiver include the propagation delay. Interferers'
bursts are signals without a preamble. Clear channel assessment is in `netsim.phy.sensing`.

A preamble is detected from -82 dBm and 4 dB above noise and interference, as in ns-3's
ThresholdPreambleDetection. A frame that is 5 dB stronger and begins within 16 us of the one being received
captures the receiver, as in its SimpleFrameCaptureModel.

Not modelled: adjacent channels; secondary channels, as every frame occupies the whole channel; propagation
delays above SIFS (4.8 km), for which the timing of 802.11 fails and no signal is received; abort of a
reception after a failed signal field: the receiver stays locked until the frame ends with errors.

The functions are compiled and work on `netsim.model.tables.Air`. Rows of `tables.ends` report to the caller
which MACs are affected: `NEWLY_BUSY`, or `FATES` and `UPSETS`.
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
"""Least SINR at which a preamble is detected, 4 dB."""
CAPTURE_RATIO = 10.0**0.5
"""A later frame captures a receiver during an earlier frame's preamble if it is 5 dB stronger."""
CAPTURE_WINDOW_NS = 16_000
FRAMES, BURSTS = 0, 1
"""Rows of `netsim.model.tables.on_air`."""


@njit(cache=True)
def start(air: Air, fading: Doubles, frame: int) -> int:
    """Start a frame now, a row of signals without powers; return the number of stations in `NEWLY_BUSY`.

    The sender's link budget must be valid.
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
    newly_busy = _radiate(air, frame, t.levels_mw(air, 0)[c.SENSED_MW])
    schedule(air, now + PREAMBLE_DETECTION_NS, c.DETECT, frame)
    schedule(air, sent[c.END] + sent[c.LONGEST_DELAY], c.END_FRAME, frame)
    return newly_busy


@njit(cache=True)
def start_burst(air: Air, burst: int) -> int:
    """Start an interferer's burst now, a row of signals with powers; return as `start`."""
    signal = t.signals(air, burst)
    _overlap(air, burst)
    bursts = t.on_air(air, BURSTS)
    for other in bursts[: air[c.BURSTS]]:
        if t.signals(air, other)[c.SOURCE] != signal[c.SOURCE]:
            _add_overlap(air, burst, other)
    bursts[air[c.BURSTS]] = burst
    air[c.BURSTS] += 1
    newly_busy = _radiate(air, burst, inf)
    # its overlaps are needed only now; if kept, each burst would keep all previous ones
    for other in t.overlaps(air, burst)[: signal[c.OVERLAPS]]:
        release(air, other)
    signal[c.OVERLAPS] = 0
    schedule(air, signal[c.END] + signal[c.LONGEST_DELAY], c.END_BURST, burst)
    return newly_busy


@njit(cache=True)
def end_burst(air: Air, burst: int) -> None:
    """End an interferer's burst."""
    air[c.BURSTS] = _remove(t.on_air(air, BURSTS), air[c.BURSTS], burst)
    end_signal(air, burst)


@njit(cache=True)
def _remove(rows: Integers, count: int, row: int) -> int:
    """Remove a row from the first ``count``, keeping their order; return the new count."""
    kept = 0
    for k in range(count):
        if rows[k] != row:
            rows[kept] = rows[k]
            kept += 1
    return kept


@njit(cache=True)
def _overlap(air: Air, signal: int) -> None:
    """Record the overlaps of a signal that begins now with the frames on the air, in both directions."""
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
    """Update the carrier sense of all stations for a signal that begins now.

    The signal is sensed by itself from ``sensed_mw``. Returns the number of stations in `NEWLY_BUSY`: those
    where the medium becomes busy beyond the NAV.
    """
    signal = t.signals(air, which)
    start_ns, end_ns = signal[c.START], signal[c.END]
    if end_ns > air[c.BUSY_UNTIL_NS]:
        air[c.BUSY_NS] += end_ns - max(start_ns, air[c.BUSY_UNTIL_NS])
        air[c.BUSY_UNTIL_NS] = end_ns
    count = 0
    newly_busy = t.ends(air, c.NEWLY_BUSY)
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
            newly_busy[count] = r
            count += 1
    return count


@njit(cache=True)
def find(air: Air, frame: int) -> None:
    """Detect a frame's preamble at all receivers, now.

    Detection requires the least power, and 4 dB above the noise and all other signals since the arrival. A
    receiver that is locked on to another frame changes to a stronger one that began soon after it.
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
    """Return the total power at ``r`` of all other signals present since a frame's arrival."""
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
    """Determine the outcomes of a frame that has ended at all stations, and update the stations.

    `FATES` become the outcomes at all stations, `NOTES` those at intended receivers: delivered, collided
    (it would have been received without other signals) or lost. One draw decides whether it is received, and
    whether it would have been without the others; there is no draw if reception is certain. `UPSETS` mark
    stations that must plan their accesses again: after an error, at the end of EIFS, with a longer NAV.
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
    """Update a station that was locked on to a frame at its end; return whether its plan must change."""
    row, sent = t.stations(air, r), t.signals(air, frame)
    end_here_ns = sent[c.END] + t.delays_ns(air, frame)[r]
    row[c.LOCK] = c.NOTHING
    if fate == c.BROKE:
        row[c.BROKEN] = end_here_ns
        return True
    upset = row[c.BROKEN] != 0
    row[c.BROKEN] = 0
    is_answer = sent[c.KIND] in (c.CTS, c.ACK)
    # other stations than the addressed one set their NAV
    if r != sent[c.TO] and sent[c.NAV] and end_here_ns + sent[c.NAV] > row[c.RESERVED_UNTIL]:
        row[c.RESERVED_UNTIL] = end_here_ns + sent[c.NAV]
        row[c.RESERVED_BY] = sent[c.TO] if is_answer else sent[c.SOURCE]
        upset = True
    if not is_answer:
        t.last_received_ns(air, r)[sent[c.SOURCE]] = end_here_ns
        t.last_received_mw(air, r)[sent[c.SOURCE]] = t.powers_mw(air, frame)[r]
    return bool(upset)


@njit(cache=True)
def _judge(air: Air, frame: int, r: int, fate: int, draw: float) -> int:
    """Return the outcome at an intended receiver: `DELIVERED`, `COLLIDED` or `LOST`."""
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
    """Count and record a frame that has ended, and end its transmission at the sender.

    Schedules the check for an unused reservation.
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


# --- unused reservations


@njit(cache=True)
def look_for_unused(air: Air, frame: int) -> None:
    """Schedule a NAV reset at stations that detected no frame after the one that set it (10.3.2.4)."""
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
    """Reset the NAV if it is unchanged and still unused; return whether it was reset."""
    row = t.stations(air, r)
    if row[c.RESERVED_UNTIL] == until_ns and row[c.LOCKED] <= end_here_ns:
        row[c.RESERVED_UNTIL] = air[c.NOW]
        return True
    return False


@njit(cache=True)
def loudest(air: Air, station: int, oldest_ns: int, turn: int) -> int:
    """Return a neighbour received since ``oldest_ns``; `netsim.model.columns.NOTHING` without any.

    ``turn`` selects cyclically among them, in order of falling received power and then of their numbers.
    """
    last_received_ns, last_received_mw = t.last_received_ns(air, station), t.last_received_mw(air, station)
    count = 0
    for other in range(len(last_received_ns)):
        count += last_received_ns[other] >= oldest_ns
    if count == 0:
        return c.NOTHING
    rank = turn % count
    for other in range(len(last_received_ns)):
        if last_received_ns[other] < oldest_ns:
            continue
        ahead = 0
        for rival in range(len(last_received_ns)):
            if last_received_ns[rival] >= oldest_ns and (
                last_received_mw[rival] > last_received_mw[other]
                or (last_received_mw[rival] == last_received_mw[other] and rival < other)
            ):
                ahead += 1
                if ahead > rank:
                    break
        if ahead == rank:
            return other
    return c.NOTHING
