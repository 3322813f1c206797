"""Probability that a frame is received despite noise and interference: hazards of chunks of constant SINR.

The functions are compiled and work on `netsim.model.tables.Air`. Signal fields use the lowest rate, mode 0.
"""

from math import exp

import numpy as np
from numba import njit

from netsim.model import columns as c
from netsim.model import tables as t
from netsim.model.tables import Air
from netsim.phy.errors import hazard_per_bit
from netsim.phy.modes import NON_HT_PREAMBLE_NS

SIGNAL_MODE = 0
"""Row of the mode of L-SIG, 6 Mbit/s."""
SIGNAL_BITS = 24
"""Bits of L-SIG, at 6 Mbit/s."""
VHT_SIGNAL_BITS = 72
"""Bits of L-SIG and VHT-SIG-A."""


@njit(cache=True)
def clean_mw(air: Air, mode: int) -> float:
    """Return the power from which a frame without interference is received with certainty."""
    return float(
        max(t.hazards(air, SIGNAL_MODE)[0], t.hazards(air, mode)[0]) * t.levels_mw(air, 0)[c.NOISE_MW]
    )


@njit(cache=True)
def _hazard_per_bit(air: Air, mode: int, sinr: float) -> float:
    return hazard_per_bit(
        t.hazards(air, mode)[1 : 1 + t.modes(air, mode)[c.HAZARDS]], t.hazards(air, mode)[0], sinr
    )


@njit(cache=True)
def alone(air: Air, frame: int, power_mw: float) -> float:
    """Return the probability that a frame is received without interference, signal field included."""
    mode = t.signals(air, frame)[c.MODE]
    sinr = power_mw / t.levels_mw(air, 0)[c.NOISE_MW]
    signal_bits = VHT_SIGNAL_BITS if t.modes(air, mode)[c.VHT] else SIGNAL_BITS
    hazard = signal_bits * _hazard_per_bit(air, SIGNAL_MODE, sinr)
    hazard += 8 * t.signals(air, frame)[c.BYTES] * _hazard_per_bit(air, mode, sinr)
    return exp(-hazard) if hazard > 0.0 else 1.0


@njit(cache=True)
def among_others(air: Air, frame: int, r: int) -> float:
    """Return the probability that a frame is received with interference at receiver ``r``."""
    power_mw = t.powers_mw(air, frame)[r]
    if t.signals(air, frame)[c.OVERLAPS] == 0:
        return alone(air, frame, power_mw)
    hazard = _hazard(air, frame, r, power_mw)
    return exp(-hazard) if hazard > 0.0 else 1.0


@njit(cache=True)
def _hazard(air: Air, frame: int, r: int, power_mw: float) -> float:
    mode, noise_mw = t.signals(air, frame)[c.MODE], t.levels_mw(air, 0)[c.NOISE_MW]
    start_ns = t.signals(air, frame)[c.START] + t.delays_ns(air, frame)[r]
    end_ns = t.signals(air, frame)[c.END] + t.delays_ns(air, frame)[r]
    # the signal fields end where the payload begins; L-SIG is the last 4 us of the non-HT preamble
    signal_from_ns = start_ns + NON_HT_PREAMBLE_NS - 4_000
    payload_from_ns = start_ns + t.modes(air, mode)[c.PREAMBLE]
    signal_bits = VHT_SIGNAL_BITS if t.modes(air, mode)[c.VHT] else SIGNAL_BITS
    signal_rate = signal_bits / (payload_from_ns - signal_from_ns)
    payload_rate = 8 * t.signals(air, frame)[c.BYTES] / (end_ns - payload_from_ns)
    others = t.overlaps(air, frame)[: t.signals(air, frame)[c.OVERLAPS]]
    at_ns = np.empty(2 * len(others) + 2, np.int64)
    changes_mw = np.empty(2 * len(others) + 2)
    at_ns[0], changes_mw[0] = start_ns, 0.0
    count = 1
    for other in others:
        other_start_ns = t.signals(air, other)[c.START] + t.delays_ns(air, other)[r]
        other_end_ns = t.signals(air, other)[c.END] + t.delays_ns(air, other)[r]
        if t.signals(air, other)[c.SOURCE] == r or other_end_ns <= start_ns or other_start_ns >= end_ns:
            continue
        for when_ns, change_mw in (
            (max(other_start_ns, start_ns), t.powers_mw(air, other)[r]),
            (min(other_end_ns, end_ns), -t.powers_mw(air, other)[r]),
        ):
            # sorted by time, then by change of power
            i = count
            while i and (
                when_ns < at_ns[i - 1] or (when_ns == at_ns[i - 1] and change_mw < changes_mw[i - 1])
            ):
                at_ns[i], changes_mw[i] = at_ns[i - 1], changes_mw[i - 1]
                i -= 1
            at_ns[i], changes_mw[i] = when_ns, change_mw
            count += 1
    at_ns[count] = end_ns
    hazard, interference_mw = 0.0, 0.0
    for i in range(count):
        from_ns, to_ns = at_ns[i], at_ns[i + 1]
        interference_mw = max(0.0, interference_mw + changes_mw[i])
        if to_ns == from_ns:
            continue
        sinr = power_mw / (noise_mw + interference_mw)
        in_signal_ns = min(to_ns, payload_from_ns) - max(from_ns, signal_from_ns)
        if in_signal_ns > 0:
            hazard += in_signal_ns * signal_rate * _hazard_per_bit(air, SIGNAL_MODE, sinr)
        in_payload_ns = to_ns - max(from_ns, payload_from_ns)
        if in_payload_ns > 0:
            hazard += in_payload_ns * payload_rate * _hazard_per_bit(air, mode, sinr)
    return hazard
