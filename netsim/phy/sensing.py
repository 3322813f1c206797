"""What a station senses of the medium: since when it is busy and until when, and how long it has been.

Clear channel assessment (IEEE 802.11-2016, 17.3.10.6): the medium is busy while all signals together are over
-62 dBm, and while a frame lasts that is over -82 dBm and 4 dB over the noise. Such a frame counts from its
arrival on, whatever else is on the air and whatever the receiver makes of it: the short training fields of
frames that collide trip a correlator all the same, and ns-3 takes frames as busy from its CCA sensitivity on.
That it takes 4 us is the MAC's matter (`netsim.mac.access.CCA_NS`). Both thresholds apply to the power in the
whole channel, which is more alert than the standard asks of wide channels.
"""

import numpy as np
from numba import njit

from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.tables import Air, Integers


@njit(cache=True)
def occupy(row: Integers, from_ns: int, until_ns: int) -> bool:
    """Have a station sense the medium busy from now or soon on; False if it does so anyway."""
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
    """Until when all signals together keep up the energy threshold at ``r``; 0 if they do not reach it.

    For a signal that arrives now and lasts until ``last_ns``, and is not sensed by itself. What the others
    amount to without it has been added up before.
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
        # the later end first, and of equal ones the stronger
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
    """Note that a station sends from now on: what is being received is given up."""
    row[c.LOCK] = c.NOTHING
    row[c.SENDING_FROM] = from_ns
    row[c.SENDING_UNTIL] = until_ns
    row[c.SENSED_AT_START] = _sensed_ns(row, from_ns)


@njit(cache=True)
def end_sending(row: Integers) -> None:
    """Note that the own transmission is over, after it has ended everywhere."""
    row[c.SENT_ALONE] += _sending_alone_ns(row, row[c.SENDING_UNTIL])
    row[c.SENDING_FROM] = row[c.SENDING_UNTIL]


@njit(cache=True)
def surveyed_ns(row: Integers, at_ns: int) -> int:
    """Time up to ``at_ns``, which is now, for which the medium was sensed busy or the station sent."""
    return int(_sensed_ns(row, at_ns) + row[c.SENT_ALONE] + _sending_alone_ns(row, at_ns))


@njit(cache=True)
def _sensed_ns(row: Integers, at_ns: int) -> int:
    """Time up to ``at_ns`` for which the medium was sensed busy; the last but one period may be on."""
    if at_ns >= row[c.BUSY_UNTIL]:
        return int(row[c.ENDED_BUSY] + row[c.BUSY_UNTIL] - row[c.BUSY_FROM])
    if at_ns >= row[c.BUSY_FROM]:
        return int(row[c.ENDED_BUSY] + at_ns - row[c.BUSY_FROM])
    return int(row[c.ENDED_BUSY] - max(0, row[c.IDLE_BEFORE] - at_ns))


@njit(cache=True)
def _sending_alone_ns(row: Integers, at_ns: int) -> int:
    """Time up to ``at_ns`` of the own transmission under way in which nothing was sensed."""
    until_ns, from_ns = min(at_ns, row[c.SENDING_UNTIL]), row[c.SENDING_FROM]
    if until_ns <= from_ns:
        return 0
    return int(until_ns - from_ns - (_sensed_ns(row, until_ns) - row[c.SENSED_AT_START]))
