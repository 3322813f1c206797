"""Whether a frame survives noise and interference: chunks of constant ratio, whose hazards add."""

from math import exp

import numpy as np
from numba import njit

from netsim.config import BandwidthMhz
from netsim.frames import Frame
from netsim.phy.errors import error_model, hazard_per_bit
from netsim.phy.modes import NON_HT_PREAMBLE_NS, PhyMode, phy_mode
from netsim.phy.path_loss import Doubles
from netsim.phy.sensing import Integers
from netsim.phy.signals import Transmission

SIGNAL_BITS = 24
"""Bits of L-SIG, at 6 Mbit/s."""
VHT_SIGNAL_BITS = 72
"""Bits of L-SIG and VHT-SIG-A."""


@njit(cache=True)
def _hazard(
    r: int,
    start_ns: int,
    signal_ns: tuple[int, int],
    end_ns: int,
    rates: tuple[float, float],
    power_mw: float,
    noise_mw: float,
    signal_errors: tuple[Doubles, float],
    payload_errors: tuple[Doubles, float],
    others: Integers,
    others_mw: Doubles,
    others_delays_ns: Integers,
) -> float:
    """Hazard of a frame at receiver ``r``, where it lasts from ``start_ns`` to ``end_ns``.

    The signal fields last over ``signal_ns`` and the payload from then on; ``rates`` are the bits per
    nanosecond of both, and their errors each table and clean ratio of `netsim.phy.errors.ErrorModel`.
    """
    at_ns = np.empty(2 * len(others) + 2, np.int64)
    changes_mw = np.empty(2 * len(others) + 2)
    at_ns[0], changes_mw[0] = start_ns, 0.0
    count = 1
    for k in range(len(others)):
        other_start_ns = others[k, 0] + others_delays_ns[k, r]
        other_end_ns = others[k, 1] + others_delays_ns[k, r]
        if others[k, 2] == r or other_end_ns <= start_ns or other_start_ns >= end_ns:
            continue
        for when_ns, change_mw in (
            (max(other_start_ns, start_ns), others_mw[k, r]),
            (min(other_end_ns, end_ns), -others_mw[k, r]),
        ):
            # in order of time and, of equal times, of power
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
        in_signal_ns = min(to_ns, signal_ns[1]) - max(from_ns, signal_ns[0])
        if in_signal_ns > 0:
            hazard += in_signal_ns * rates[0] * hazard_per_bit(signal_errors[0], signal_errors[1], sinr)
        in_payload_ns = to_ns - max(from_ns, signal_ns[1])
        if in_payload_ns > 0:
            hazard += in_payload_ns * rates[1] * hazard_per_bit(payload_errors[0], payload_errors[1], sinr)
    return hazard


class Survival:
    """Probabilities that frames are received, on one channel."""

    def __init__(self, bandwidth_mhz: BandwidthMhz, noise_mw: float) -> None:
        self._noise_mw = noise_mw
        self._signal_errors = error_model(phy_mode("ofdm6", bandwidth_mhz))
        self._clean_mw: dict[str, float] = {}

    def clean_mw(self, mode: PhyMode) -> float:
        """Power from which on neither signal field nor payload of a frame can fail without interference."""
        clean_mw = self._clean_mw.get(mode.name)
        if clean_mw is None:
            clean_linear = max(self._signal_errors.clean_linear, error_model(mode).clean_linear)
            clean_mw = self._clean_mw[mode.name] = clean_linear * self._noise_mw
        return clean_mw

    def alone(self, frame: Frame, power_mw: float) -> float:
        """Probability that a frame survives the noise, its signal field included."""
        mode = frame.mode
        sinr = power_mw / self._noise_mw
        signal_bits = VHT_SIGNAL_BITS if mode.vht else SIGNAL_BITS
        hazard = signal_bits * self._signal_errors.hazard_per_bit(sinr)
        hazard += 8 * frame.bytes * error_model(mode).hazard_per_bit(sinr)
        return exp(-hazard) if hazard > 0.0 else 1.0

    def among_others(self, transmission: Transmission, r: int) -> float:
        """Probability that a frame survives noise and each chunk's interference at receiver ``r``."""
        frame = transmission.frame
        power_mw = transmission.power_mw(r)
        if not transmission.overlaps:
            return self.alone(frame, power_mw)
        start_ns = transmission.start_ns + transmission.delay_ns(r)
        end_ns = start_ns + frame.duration_ns
        # the signal fields end where the payload begins; L-SIG is the last 4 us of the non-HT preamble
        signal_ns = (start_ns + NON_HT_PREAMBLE_NS - 4_000, start_ns + frame.mode.preamble_ns)
        rates = (
            (VHT_SIGNAL_BITS if frame.mode.vht else SIGNAL_BITS) / (signal_ns[1] - signal_ns[0]),
            8 * frame.bytes / (end_ns - signal_ns[1]),
        )
        signal_errors, payload_errors = self._signal_errors, error_model(frame.mode)
        hazard = _hazard(
            r,
            start_ns,
            signal_ns,
            end_ns,
            rates,
            power_mw,
            self._noise_mw,
            (signal_errors.log_hazards, signal_errors.clean_linear),
            (payload_errors.log_hazards, payload_errors.clean_linear),
            *transmission.others(),
        )
        return exp(-hazard) if hazard > 0.0 else 1.0
