"""The shared medium: overlap of signals, preamble detection, capture, and reception of frames.

A frame takes three passes over all stations. At its start the carrier sense of every receiver is updated.
4 us later receivers detect its preamble or not. When its end has reached the last receiver, the outcomes are
determined from all overlapping signals. All times at a receiver include the propagation delay. Interferers'
bursts are signals without a preamble. Clear channel assessment is in `netsim.phy.sensing`.

A receiver that does not send detects a preamble from -82 dBm and 4 dB above noise and interference, as in
ns-3's ThresholdPreambleDetection. A frame that is 5 dB stronger and begins within 16 us of the one being
received captures the receiver, as in its SimpleFrameCaptureModel.

Not modelled: adjacent channels; secondary channels, as every frame occupies the whole channel; propagation
delays above SIFS (4.8 km, at 2.4 GHz 3.0 km), beyond which no signal is received or sensed; abort of a
reception after a failed signal field: the receiver stays locked until the frame ends with errors.

During the signal extension of a frame (`netsim.phy.timing`) no power is on the air. Stations that have sensed
the frame by its preamble treat the medium as busy until its end.

The functions are compiled and work on the tables of `netsim.model.tables`. Records of `tables.end` report
which MACs are affected: ``newly_busy`` at the begin of a signal and at the detection of a preamble,
``outcome`` and ``replan`` at the end.
"""

from math import inf

from foundation.kernels.inner import inner
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.events import begin_event, end_event, schedule
from netsim.model.records import MediumHeader
from netsim.model.tables import draw_reception, end_signal, release
from netsim.phy.fading import gain
from netsim.phy.frames import GROUP
from netsim.phy.path_loss import Doubles
from netsim.phy.sensing import begin_sending, break_off, end_sending, energy_until_ns, occupy
from netsim.phy.survival import alone, among_others, clean_mw

PREAMBLE_DETECTION_NS = 4_000
PREAMBLE_SINR = 10.0**0.4
"""Least SINR at which a preamble is detected, 4 dB."""
CAPTURE_RATIO = 10.0**0.5
"""A later frame captures a receiver during an earlier frame's preamble if it is 5 dB stronger."""
CAPTURE_WINDOW_NS = 16_000


@inner
def start(air: MediumHeader, fading: Doubles, frame: int) -> int:
    """Start a frame now, a row of signals without powers; return the number of `newly_busy` stations.

    The sender's link budget must be valid.
    """
    now = air.now_ns
    sent = t.signal(air, frame)
    sender = t.station(air, sent.source)
    for r in range(air.stations):
        path, budget = t.path(air, frame, r), t.budget(air, sent.source, r)
        path.delay_ns = budget.delay_ns
        path.power_mw = budget.power_mw
        if len(fading):
            path.power_mw *= gain(fading, air.stations, sent.source, r, now)
    air.frames_started += 1
    sent.number = air.frames_started
    sent.longest_delay_ns = sender.budget_longest_delay_ns
    _overlap(air, frame)
    for k in range(air.bursts_on_air):
        _add_overlap(air, frame, t.on_air(air, c.BURSTS, k).signal)
    t.on_air(air, c.FRAMES, air.frames_on_air).signal = frame
    air.frames_on_air += 1
    break_off(air, frame, sent.source, now)
    begin_sending(sender, now, sent.end_ns)
    newly_busy = _radiate(air, frame, air.missed_mw)
    schedule(air, now + PREAMBLE_DETECTION_NS, c.DETECT, frame)
    schedule(air, sent.end_ns + sent.longest_delay_ns, c.END_FRAME, frame)
    return newly_busy


@inner
def start_burst(air: MediumHeader, burst: int) -> int:
    """Start an interferer's burst now, a row of signals with powers; return as `start`."""
    signal = t.signal(air, burst)
    _overlap(air, burst)
    for k in range(air.bursts_on_air):
        other = t.on_air(air, c.BURSTS, k).signal
        if t.signal(air, other).source != signal.source:
            _add_overlap(air, burst, other)
    t.on_air(air, c.BURSTS, air.bursts_on_air).signal = burst
    air.bursts_on_air += 1
    newly_busy = _radiate(air, burst, air.energy_mw)
    # its overlaps are needed only now; if kept, each burst would keep all previous ones
    for k in range(signal.overlap_count):
        release(air, t.overlap(air, burst, k).signal)
    signal.overlap_count = 0
    schedule(air, signal.end_ns + signal.longest_delay_ns, c.END_BURST, burst)
    return newly_busy


@inner
def end_burst(air: MediumHeader, burst: int) -> None:
    """End an interferer's burst."""
    air.bursts_on_air = _remove(air, c.BURSTS, air.bursts_on_air, burst)
    end_signal(air, burst)


@inner
def _remove(air: MediumHeader, row: int, count: int, signal: int) -> int:
    """Remove a signal from the first ``count`` of a row of `tables.on_air`, keeping their order.

    Returns the new count.
    """
    kept = 0
    for k in range(count):
        other = t.on_air(air, row, k).signal
        if other != signal:
            t.on_air(air, row, kept).signal = other
            kept += 1
    return kept


@inner
def _overlap(air: MediumHeader, signal: int) -> None:
    """Record the overlaps of a signal that begins now with the frames on the air, in both directions."""
    for k in range(air.frames_on_air):
        other = t.on_air(air, c.FRAMES, k).signal
        frame = t.signal(air, other)
        if frame.end_ns + frame.longest_delay_ns > air.now_ns:
            _add_overlap(air, signal, other)
            _add_overlap(air, other, signal)


@inner
def _add_overlap(air: MediumHeader, signal: int, other: int) -> None:
    overlapped = t.signal(air, signal)
    t.overlap(air, signal, overlapped.overlap_count).signal = other
    overlapped.overlap_count += 1
    t.signal(air, other).references += 1


@inner
def _radiate(air: MediumHeader, which: int, alone_mw: float) -> int:
    """Update the carrier sense of all stations for a signal that begins now.

    The signal is sensed by itself from ``alone_mw``, preamble or not. Returns the number of `newly_busy`
    stations: those where the medium becomes busy beyond the NAV.
    """
    signal = t.signal(air, which)
    start_ns, end_ns = signal.start_ns, signal.end_ns
    radiated_until_ns = signal.radiated_until_ns
    if radiated_until_ns > air.busy_until_ns:
        air.busy_ns += radiated_until_ns - max(start_ns, air.busy_until_ns)
        air.busy_until_ns = radiated_until_ns
    count = 0
    for r in range(air.stations):
        row, path = t.station(air, r), t.path(air, which, r)
        if r == signal.source or row.radio_off:
            continue
        arrival_ns = start_ns + path.delay_ns
        # power alone says nothing about a signal extension
        until_ns = path.delay_ns + (end_ns if path.power_mw >= air.preamble_mw else radiated_until_ns)
        if path.power_mw < alone_mw:
            if signal.overlap_count == 0:
                continue
            until_ns = energy_until_ns(air, which, r, arrival_ns)
            if until_ns == 0:
                continue
        if occupy(row, arrival_ns, until_ns) and row.busy_until_ns > row.nav_until_ns:
            t.end(air, count).newly_busy = r
            count += 1
    return count


@inner
def detect_preambles(air: MediumHeader, frame: int) -> int:
    """Detect a frame's preamble at all receivers, now; return the number of `newly_busy` stations.

    Detection requires the least power, and 4 dB above the noise and all other signals since the arrival. A
    receiver that is locked on to another frame changes to a stronger one that began soon after it. A detected
    frame keeps the medium busy from its arrival to its end.
    """
    sent = t.signal(air, frame)
    count = 0
    for r in range(air.stations):
        row, path = t.station(air, r), t.path(air, frame, r)
        arrival_ns = sent.start_ns + path.delay_ns
        if (
            r == sent.source
            or path.power_mw < air.preamble_mw
            or row.sending_until_ns > arrival_ns
            or row.radio_off
        ):
            continue
        if sent.overlap_count:
            floor_mw = _floor_mw(air, frame, r, arrival_ns)
            if path.power_mw < PREAMBLE_SINR * (air.noise_mw + floor_mw):
                continue
            if row.locked_frame != c.NOTHING and (
                path.power_mw < CAPTURE_RATIO * row.lock_mw
                or arrival_ns > row.lock_arrived_ns + CAPTURE_WINDOW_NS
            ):
                continue
        end_here_ns = sent.end_ns + path.delay_ns
        sensed = path.power_mw < air.missed_mw and occupy(row, arrival_ns, end_here_ns)
        if sensed and row.busy_until_ns > row.nav_until_ns:
            t.end(air, count).newly_busy = r
            count += 1
        break_off(air, frame, r, end_here_ns)
        row.locked_frame = sent.number
        row.lock_arrived_ns = arrival_ns
        row.last_detection_ns = air.now_ns
        row.lock_mw = path.power_mw
    return count


@inner
def _floor_mw(air: MediumHeader, frame: int, r: int, arrival_ns: int) -> float:
    """Return the total power at ``r`` of all other signals present since a frame's arrival."""
    sent = t.signal(air, frame)
    floor_mw = 0.0
    for k in range(sent.overlap_count):
        which = t.overlap(air, frame, k).signal
        other, path = t.signal(air, which), t.path(air, which, r)
        if (
            other.source != r
            and other.start_ns + path.delay_ns < arrival_ns + air.now_ns - sent.start_ns
            and other.radiated_until_ns + path.delay_ns > arrival_ns
        ):
            floor_mw += path.power_mw
    return floor_mw


@inner
def settle(air: MediumHeader, frame: int) -> None:
    """Determine the outcomes of a frame that has ended at all stations, and update the stations.

    In `records.End`, ``outcome`` is that at each station, ``receiver_outcome`` that at intended receivers:
    delivered, collided (it would have been received without other signals) or lost. One draw decides whether
    it is received, and whether it would have been without the others; there is no draw if reception is
    certain. ``replan`` marks stations that must plan their accesses again: after an error, at the end of
    EIFS, with a longer NAV.
    """
    air.frames_on_air = _remove(air, c.FRAMES, air.frames_on_air, frame)
    sent = t.signal(air, frame)
    doubtful_mw = inf if sent.overlap_count else clean_mw(air, sent.mode)
    for r in range(air.stations):
        row, end, power_mw = t.station(air, r), t.end(air, r), t.path(air, frame, r).power_mw
        end.receiver_outcome, end.replan = c.NOT_MEANT, False
        if r == sent.source or row.radio_off:
            end.outcome = c.ABSENT
            continue
        draw = -1.0
        if row.locked_frame != sent.number:
            end.outcome = c.MISSED
        else:
            end.outcome = c.RECEIVED
            if power_mw < doubtful_mw:
                survival = among_others(air, frame, r)
                if survival < 1.0:
                    draw = draw_reception(air, r)
                    if draw >= survival:
                        end.outcome = c.BROKE
            end.replan = _update_receiver(air, frame, r, end.outcome)
        if sent.to in (r, GROUP):
            end.receiver_outcome = _receiver_outcome(air, frame, r, end.outcome, draw)


@inner
def _update_receiver(air: MediumHeader, frame: int, r: int, outcome: int) -> bool:
    """Update a station that was locked on to a frame at its end; return whether its plan must change."""
    row, sent, path = t.station(air, r), t.signal(air, frame), t.path(air, frame, r)
    end_here_ns = sent.end_ns + path.delay_ns
    row.locked_frame = c.NOTHING
    if outcome == c.BROKE:
        row.last_error_ns = end_here_ns
        return True
    replan = row.last_error_ns != 0
    row.last_error_ns = 0
    is_answer = sent.kind in (c.CTS, c.ACK)
    # other stations than the addressed one set their NAV
    if r != sent.to and sent.nav_ns and end_here_ns + sent.nav_ns > row.nav_until_ns:
        row.nav_until_ns = end_here_ns + sent.nav_ns
        row.nav_set_by = sent.to if is_answer else sent.source
        replan = True
    if not is_answer:
        link = t.link(air, r, sent.source)
        link.last_received_ns, link.last_received_mw = end_here_ns, path.power_mw
    return replan


@inner
def _receiver_outcome(air: MediumHeader, frame: int, r: int, outcome: int, draw: float) -> int:
    """Return the outcome at an intended receiver: `DELIVERED`, `COLLIDED` or `LOST`."""
    if outcome == c.RECEIVED:
        return c.DELIVERED
    power_mw = t.path(air, frame, r).power_mw
    if t.signal(air, frame).overlap_count and power_mw >= air.preamble_mw:
        if outcome != c.BROKE:
            draw = draw_reception(air, r)
        if draw < alone(air, frame, power_mw):
            return c.COLLIDED
    return c.LOST


@inner
def conclude(air: MediumHeader, frame: int) -> None:
    """Count and record a frame that has ended, and end its transmission at the sender.

    Schedules the check for an unused reservation.
    """
    sent = t.signal(air, frame)
    if sent.lapse_ns:
        sent.references += 1
        schedule(air, sent.end_ns + sent.lapse_ns, c.LOOK_FOR_UNUSED, frame)
    air.sent[sent.kind] += 1
    record = t.record(air, air.records)
    air.records += 1
    record.start_ns, record.end_ns = sent.start_ns, sent.end_ns
    record.source, record.to, record.kind = sent.source, sent.to, sent.kind
    record.mode, record.frame_bytes, record.seq = sent.mode, sent.frame_bytes, sent.seq
    outcomes = record.outcomes
    outcomes[0] = outcomes[1] = outcomes[2] = 0
    for r in range(air.stations):
        outcome = t.end(air, r).receiver_outcome
        if outcome != c.NOT_MEANT:
            outcomes[outcome - 1] += 1
            if sent.kind == c.DATA and sent.to == GROUP:
                t.station(air, r).broadcasts[outcome - 1] += 1
    end_sending(t.station(air, sent.source))


# --- unused reservations


@inner
def look_for_unused(air: MediumHeader, frame: int) -> None:
    """Schedule a NAV reset at stations that detected no frame after the one that set it (10.3.2.4)."""
    sent = t.signal(air, frame)
    for r in range(air.stations):
        row = t.station(air, r)
        end_here_ns = sent.end_ns + t.path(air, frame, r).delay_ns
        if row.nav_until_ns == end_here_ns + sent.nav_ns and row.last_detection_ns <= end_here_ns:
            event = begin_event(air, end_here_ns + sent.lapse_ns, c.ON_UNUSED, r)
            event.first, event.second = end_here_ns, end_here_ns + sent.nav_ns
            end_event(air)
    release(air, frame)


@inner
def drop_reservation(air: MediumHeader, r: int, end_here_ns: int, until_ns: int) -> bool:
    """Reset the NAV if it is unchanged and still unused; return whether it was reset."""
    row = t.station(air, r)
    if row.nav_until_ns == until_ns and row.last_detection_ns <= end_here_ns:
        row.nav_until_ns = air.now_ns
        return True
    return False


@inner
def neighbour_by_power(air: MediumHeader, station: int, oldest_ns: int, turn: int) -> int:
    """Return a neighbour received since ``oldest_ns``; `codes.NOTHING` without any.

    ``turn`` selects cyclically among them, in order of falling received power and then of their numbers.
    """
    count = 0
    for other in range(air.stations):
        count += t.link(air, station, other).last_received_ns >= oldest_ns
    if count == 0:
        return c.NOTHING
    rank = turn % count
    for other in range(air.stations):
        link = t.link(air, station, other)
        if link.last_received_ns < oldest_ns:
            continue
        ahead = 0
        for rival in range(air.stations):
            rivals = t.link(air, station, rival)
            if rivals.last_received_ns >= oldest_ns and (
                rivals.last_received_mw > link.last_received_mw
                or (rivals.last_received_mw == link.last_received_mw and rival < other)
            ):
                ahead += 1
                if ahead > rank:
                    break
        if ahead == rank:
            return other
    return c.NOTHING
