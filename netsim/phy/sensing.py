"""Carrier sense of a station: the current busy period and the accumulated busy time.

Clear channel assessment (IEEE 802.11-2016, 17.3.10.6): the medium is busy while the total power is above -62
dBm, and during a frame above -82 dBm and 4 dB above the noise. Such a frame counts from its arrival,
regardless of other signals and of its reception: the short training fields of colliding frames are also
detected by a correlator, and ns-3 treats frames as busy from its CCA sensitivity. The detection time of 4 us
is applied by the MAC (`netsim.mac.access_parameters.CCA_NS`). Both thresholds apply to the power in the whole
channel, which is more sensitive than the standard requires for wide channels.
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
        row.busy_from_ns = from_ns
    elif until_ns <= row.busy_until_ns:
        return False
    row.busy_until_ns = max(until_ns, row.busy_until_ns)
    return True


@inner
def energy_until_ns(air: MediumHeader, signal: int, r: int, arrival_ns: int, last_ns: int) -> int:
    """Return the time until which the total power at ``r`` exceeds the energy threshold; 0 if it does not.

    To be called for a signal that arrives now, lasts until ``last_ns`` and is not sensed by itself. The
    total power without this signal was checked at the arrival of the others.
    """
    others = t.signal(air, signal).overlap_count
    count = 1
    ends_ns = np.empty(others + 1, np.int64)
    powers_mw = np.empty(others + 1)
    ends_ns[0], powers_mw[0] = last_ns, t.path(air, signal, r).power_mw
    last_mw = powers_mw[0]
    for k in range(others):
        which = t.overlap(air, signal, k).signal
        other, path = t.signal(air, which), t.path(air, which, r)
        end_ns = other.radiated_until_ns + path.delay_ns
        if other.source == r or end_ns <= arrival_ns:
            continue
        power_mw = path.power_mw
        if end_ns > last_ns:
            last_ns, last_mw = end_ns, power_mw
        # sorted by falling end, then by falling power
        i = count
        while i and (ends_ns[i - 1], powers_mw[i - 1]) < (end_ns, power_mw):
            ends_ns[i], powers_mw[i] = ends_ns[i - 1], powers_mw[i - 1]
            i -= 1
        ends_ns[i], powers_mw[i] = end_ns, power_mw
        count += 1
    if last_mw >= air.energy_mw:
        return last_ns
    total_mw = 0.0
    for i in range(count):
        total_mw += powers_mw[i]
        if total_mw >= air.energy_mw:
            return int(ends_ns[i])
    return 0


@inner
def begin_sending(row: Station, from_ns: int, until_ns: int) -> None:
    """Record the begin of a station's transmission; a reception under way is aborted."""
    row.locked_frame = c.NOTHING
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
