"""Carrier sense of a station: the current busy period and the accumulated busy time.

Clear channel assessment (IEEE 802.11-2016, 17.3.10.6): the medium is busy while the total power is above -62
dBm, and during a frame above -82 dBm and 4 dB above the noise. Such a frame counts from its arrival,
regardless of other signals and of its reception: the short training fields of colliding frames are also
detected by a correlator, and ns-3 treats frames as busy from its CCA sensitivity. The detection time of 4 us
is applied by the MAC (`netsim.mac.access_parameters.CCA_NS`). Both thresholds apply to the power in the whole
channel, which is more sensitive than the standard requires for wide channels.
"""

import numpy as np
from numba import njit

from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.tables import Air, Integers


@njit(cache=True)
def occupy(row: Integers, from_ns: int, until_ns: int) -> bool:
    """Extend a station's busy period; return False if it already covers the time."""
    if from_ns > row[c.BUSY_UNTIL]:
        row[c.ENDED_BUSY] += row[c.BUSY_UNTIL] - row[c.BUSY_FROM]
        row[c.IDLE_BEFORE] = row[c.BUSY_UNTIL]
        row[c.BUSY_FROM] = from_ns
    elif from_ns < row[c.BUSY_FROM]:
        row[c.BUSY_FROM] = from_ns
    elif until_ns <= row[c.BUSY_UNTIL]:
        return False
    row[c.BUSY_UNTIL] = max(until_ns, row[c.BUSY_UNTIL])
    return True


@njit(cache=True)
def energy_until_ns(air: Air, signal: int, r: int, arrival_ns: int, last_ns: int) -> int:
    """Return the time until which the total power at ``r`` exceeds the energy threshold; 0 if it does not.

    To be called for a signal that arrives now, lasts until ``last_ns`` and is not sensed by itself. The
    total power without this signal was checked at the arrival of the others.
    """
    others = t.overlaps(air, signal)[: t.signals(air, signal)[c.OVERLAPS]]
    count = 1
    ends_ns = np.empty(len(others) + 1, np.int64)
    powers_mw = np.empty(len(others) + 1)
    ends_ns[0], powers_mw[0] = last_ns, t.powers_mw(air, signal)[r]
    last_mw = powers_mw[0]
    for other in others:
        end_ns = t.signals(air, other)[c.END] + t.delays_ns(air, other)[r]
        if t.signals(air, other)[c.SOURCE] == r or end_ns <= arrival_ns:
            continue
        power_mw = t.powers_mw(air, other)[r]
        if end_ns > last_ns:
            last_ns, last_mw = end_ns, power_mw
        # sorted by falling end, then by falling power
        i = count
        while i and (ends_ns[i - 1], powers_mw[i - 1]) < (end_ns, power_mw):
            ends_ns[i], powers_mw[i] = ends_ns[i - 1], powers_mw[i - 1]
            i -= 1
        ends_ns[i], powers_mw[i] = end_ns, power_mw
        count += 1
    if last_mw >= t.levels_mw(air, 0)[c.ENERGY_MW]:
        return int(last_ns)
    total_mw = 0.0
    for i in range(count):
        total_mw += powers_mw[i]
        if total_mw >= t.levels_mw(air, 0)[c.ENERGY_MW]:
            return int(ends_ns[i])
    return 0


@njit(cache=True)
def begin_sending(row: Integers, from_ns: int, until_ns: int) -> None:
    """Record the begin of a station's transmission; a reception under way is aborted."""
    row[c.LOCK] = c.NOTHING
    row[c.SENDING_FROM] = from_ns
    row[c.SENDING_UNTIL] = until_ns
    row[c.SENSED_AT_START] = _sensed_ns(row, from_ns)


@njit(cache=True)
def end_sending(row: Integers) -> None:
    """Record the end of a station's transmission, after it has ended at all stations."""
    row[c.SENT_ALONE] += _sending_alone_ns(row, row[c.SENDING_UNTIL])
    row[c.SENDING_FROM] = row[c.SENDING_UNTIL]


@njit(cache=True)
def surveyed_ns(row: Integers, at_ns: int) -> int:
    """Return the time up to now, ``at_ns``, for which the medium was sensed busy or the station sent."""
    return int(_sensed_ns(row, at_ns) + row[c.SENT_ALONE] + _sending_alone_ns(row, at_ns))


@njit(cache=True)
def _sensed_ns(row: Integers, at_ns: int) -> int:
    """Return the time up to ``at_ns`` for which the medium was sensed busy.

    At ``at_ns`` the last period or, before its begin, the last but one may be under way.
    """
    if at_ns >= row[c.BUSY_UNTIL]:
        return int(row[c.ENDED_BUSY] + row[c.BUSY_UNTIL] - row[c.BUSY_FROM])
    if at_ns >= row[c.BUSY_FROM]:
        return int(row[c.ENDED_BUSY] + at_ns - row[c.BUSY_FROM])
    return int(row[c.ENDED_BUSY] - max(0, row[c.IDLE_BEFORE] - at_ns))


@njit(cache=True)
def _sending_alone_ns(row: Integers, at_ns: int) -> int:
    """Return the time up to ``at_ns`` of the current own transmission in which no signal was sensed."""
    until_ns, from_ns = min(at_ns, row[c.SENDING_UNTIL]), row[c.SENDING_FROM]
    if until_ns <= from_ns:
        return 0
    return int(until_ns - from_ns - (_sensed_ns(row, until_ns) - row[c.SENSED_AT_START]))
