"""Carrier sense of a station: the current busy period and the accumulated busy time.

Clear channel assessment (IEEE 802.11-2016, 17.3.10.6): the medium is busy during a frame whose preamble was
detected (`netsim.phy.medium.detect_preambles`), and while the total power of all signals is at least the
energy threshold. A frame whose preamble was missed, because the station sent, received another frame or found
several preambles at once, counts by itself from `MediumHeader.missed_mw` on. So does one whose reception was
broken off by an own transmission or a stronger frame, before its length was known. The standard requires
this for 20 dB above the sensitivity, -62 dBm; ns-3 3.37 has -82 dBm, the default of
`netsim.model.config.RadioConfig.cca_missed_dbm`.

A frame counts from its arrival, also if it is detected 4 us later. This detection time is applied by the MAC
(`netsim.mac.access_parameters.CCA_NS`). All thresholds apply to the power in the whole channel, which is more
sensitive than the standard requires for wide channels.
"""

import numpy as np

from foundation.kernels.inner import inner
from netsim.model import codes as c
from netsim.model import tables as t
from netsim.model.records import MediumHeader, Station


@inner
def occupy(row: Station, from_ns: int, until_ns: int) -> bool:
    """Extend a station's busy period; return False if it already covers the time."""
    if from_ns > row.busy_until_ns:
        row.ended_busy_ns += row.busy_until_ns - row.busy_from_ns
        row.idle_before_ns = row.busy_until_ns
        row.busy_from_ns = from_ns
    elif from_ns < row.busy_from_ns:
        row.busy_from_ns = max(from_ns, row.idle_before_ns)
    elif until_ns <= row.busy_until_ns:
        return False
    row.busy_until_ns = max(until_ns, row.busy_until_ns)
    return True


@inner
def energy_until_ns(air: MediumHeader, signal: int, r: int, at_ns: int) -> int:
    """Return the time until which the total power at ``r`` exceeds the energy threshold; 0 if it does not.

    The total is that of a signal, unless ``r`` sends it, and of all that overlap it and end after ``at_ns``.
    """
    others = t.signal(air, signal).overlap_count
    count = 0
    ends_ns = np.empty(others + 1, np.int64)
    powers_mw = np.empty(others + 1)
    for k in range(-1, others):
        which = signal if k < 0 else t.overlap(air, signal, k).signal
        other, path = t.signal(air, which), t.path(air, which, r)
        end_ns, power_mw = other.radiated_until_ns + path.delay_ns, path.power_mw
        if other.source == r or end_ns <= at_ns:
            continue
        # sorted by falling end, then by falling power
        i = count
        while i and (ends_ns[i - 1], powers_mw[i - 1]) < (end_ns, power_mw):
            ends_ns[i], powers_mw[i] = ends_ns[i - 1], powers_mw[i - 1]
            i -= 1
        ends_ns[i], powers_mw[i] = end_ns, power_mw
        count += 1
    total_mw = 0.0
    for i in range(count):
        total_mw += powers_mw[i]
        if total_mw >= air.energy_mw:
            return int(ends_ns[i])
    return 0


@inner
def break_off(air: MediumHeader, signal: int, r: int, from_ns: int) -> None:
    """End the reception under way at ``r``, if any, because of a signal that ``r`` sends or receives instead.

    The medium stays busy until ``from_ns``, and as long as other signals are sensed without their preambles.
    """
    row = t.station(air, r)
    if row.locked_frame != c.NOTHING and row.lock_mw < air.missed_mw:
        until_ns = max(from_ns, row.busy_from_ns, energy_until_ns(air, signal, r, air.now_ns))
        for k in range(t.signal(air, signal).overlap_count):
            which = t.overlap(air, signal, k).signal
            other, path = t.signal(air, which), t.path(air, which, r)
            if r != other.source >= 0 and path.power_mw >= air.missed_mw:
                until_ns = max(until_ns, other.end_ns + path.delay_ns)
        row.busy_until_ns = until_ns
    row.locked_frame = c.NOTHING


@inner
def begin_sending(row: Station, from_ns: int, until_ns: int) -> None:
    """Record the begin of a station's transmission; see also `break_off`."""
    row.sending_from_ns = from_ns
    row.sending_until_ns = until_ns
    row.sensed_at_start_ns = _sensed_ns(row, from_ns)


@inner
def end_sending(row: Station) -> None:
    """Record the end of a station's transmission, after it has ended at all stations."""
    row.sent_alone_ns += _sending_alone_ns(row, row.sending_until_ns)
    row.sending_from_ns = row.sending_until_ns


@inner
def surveyed_ns(row: Station, at_ns: int) -> int:
    """Return the time up to now, ``at_ns``, for which the medium was sensed busy or the station sent."""
    return _sensed_ns(row, at_ns) + row.sent_alone_ns + _sending_alone_ns(row, at_ns)


@inner
def _sensed_ns(row: Station, at_ns: int) -> int:
    """Return the time up to ``at_ns`` for which the medium was sensed busy.

    At ``at_ns`` the last period or, before its begin, the last but one may be under way.
    """
    if at_ns >= row.busy_until_ns:
        return row.ended_busy_ns + row.busy_until_ns - row.busy_from_ns
    if at_ns >= row.busy_from_ns:
        return row.ended_busy_ns + at_ns - row.busy_from_ns
    return row.ended_busy_ns - max(0, row.idle_before_ns - at_ns)


@inner
def _sending_alone_ns(row: Station, at_ns: int) -> int:
    """Return the time up to ``at_ns`` of the current own transmission in which no signal was sensed."""
    until_ns, from_ns = min(at_ns, row.sending_until_ns), row.sending_from_ns
    if until_ns <= from_ns:
        return 0
    return until_ns - from_ns - (_sensed_ns(row, until_ns) - row.sensed_at_start_ns)
