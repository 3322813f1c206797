"""Probability that a frame is received despite noise and interference: hazards of chunks of constant SINR.

The functions are compiled and work on the tables of `netsim.model.tables`. Signal fields use the lowest
rate, mode 0.
"""

from math import exp

import numpy as np

from foundation.kernels.inner import inner
from netsim.model import tables as t
from netsim.model.records import MediumHeader, PhyModeRow
from netsim.phy.errors import hazard_per_bit
from netsim.phy.modes import NON_HT_PREAMBLE_NS

SIGNAL_MODE = 0
"""Row of the mode of L-SIG, 6 Mbit/s."""
SIGNAL_BITS = 24
"""Bits of L-SIG, at 6 Mbit/s."""
VHT_SIGNAL_BITS = 72
"""Bits of L-SIG and VHT-SIG-A."""


@inner
def clean_mw(air: MediumHeader, mode: int) -> float:
    """Return the power from which a frame without interference is received with certainty."""
    return max(t.mode(air, SIGNAL_MODE).clean_linear, t.mode(air, mode).clean_linear) * air.noise_mw


@inner
def _hazard_per_bit(mode: PhyModeRow, sinr: float) -> float:
    return hazard_per_bit(mode.log_hazards[: mode.hazard_count], mode.clean_linear, sinr)


@inner
def alone(air: MediumHeader, frame: int, power_mw: float) -> float:
    """Return the probability that a frame is received without interference, signal field included."""
    sent = t.signal(air, frame)
    mode = t.mode(air, sent.mode)
    sinr = power_mw / air.noise_mw
    signal_bits = VHT_SIGNAL_BITS if mode.vht else SIGNAL_BITS
    hazard = signal_bits * _hazard_per_bit(t.mode(air, SIGNAL_MODE), sinr)
    hazard += 8 * sent.frame_bytes * _hazard_per_bit(mode, sinr)
    return exp(-hazard) if hazard > 0.0 else 1.0


@inner
def among_others(air: MediumHeader, frame: int, r: int) -> float:
    """Return the probability that a frame is received with interference at receiver ``r``."""
    power_mw = t.path(air, frame, r).power_mw
    if t.signal(air, frame).overlap_count == 0:
        return alone(air, frame, power_mw)
    hazard = _hazard(air, frame, r, power_mw)
    return exp(-hazard) if hazard > 0.0 else 1.0


@inner
def _hazard(air: MediumHeader, frame: int, r: int, power_mw: float) -> float:
    sent, delay_ns = t.signal(air, frame), t.path(air, frame, r).delay_ns
    signal_mode, mode = t.mode(air, SIGNAL_MODE), t.mode(air, sent.mode)
    start_ns, end_ns = sent.start_ns + delay_ns, sent.radiated_until_ns + delay_ns
    # the signal fields end where the payload begins; L-SIG is the last 4 us of the non-HT preamble
    signal_from_ns = start_ns + NON_HT_PREAMBLE_NS - 4_000
    payload_from_ns = start_ns + mode.preamble_ns
    signal_bits = VHT_SIGNAL_BITS if mode.vht else SIGNAL_BITS
    signal_rate = signal_bits / (payload_from_ns - signal_from_ns)
    payload_rate = 8 * sent.frame_bytes / (end_ns - payload_from_ns)
    at_ns = np.empty(2 * sent.overlap_count + 2, np.int64)
    changes_mw = np.empty(2 * sent.overlap_count + 2)
    at_ns[0], changes_mw[0] = start_ns, 0.0
    count = 1
    for k in range(sent.overlap_count):
        which = t.overlap(air, frame, k).signal
        other, path = t.signal(air, which), t.path(air, which, r)
        other_start_ns = other.start_ns + path.delay_ns
        other_end_ns = other.radiated_until_ns + path.delay_ns
        if other.source == r or other_end_ns <= start_ns or other_start_ns >= end_ns:
            continue
        for when_ns, change_mw in (
            (max(other_start_ns, start_ns), path.power_mw),
            (min(other_end_ns, end_ns), -path.power_mw),
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
        sinr = power_mw / (air.noise_mw + interference_mw)
        in_signal_ns = min(to_ns, payload_from_ns) - max(from_ns, signal_from_ns)
        if in_signal_ns > 0:
            hazard += in_signal_ns * signal_rate * _hazard_per_bit(signal_mode, sinr)
        in_payload_ns = to_ns - max(from_ns, payload_from_ns)
        if in_payload_ns > 0:
            hazard += in_payload_ns * payload_rate * _hazard_per_bit(mode, sinr)
    return hazard
