"""Whether a frame survives noise and interference: chunks of constant ratio, whose hazards add."""

from itertools import pairwise
from math import exp

from netsim.config import BandwidthMhz
from netsim.frames import Frame
from netsim.phy.errors import error_model
from netsim.phy.modes import NON_HT_PREAMBLE_NS, PhyMode, phy_mode
from netsim.phy.signals import Transmission

SIGNAL_BITS = 24
"""Bits of L-SIG, at 6 Mbit/s."""
VHT_SIGNAL_BITS = 72
"""Bits of L-SIG and VHT-SIG-A."""


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
        power_mw = transmission.powers_mw[r]
        if not transmission.overlaps:
            return self.alone(frame, power_mw)
        start_ns = transmission.start_ns + transmission.delays_ns[r]
        end_ns = start_ns + frame.duration_ns
        changes = [(start_ns, 0.0)]
        for other in transmission.overlaps:
            if other.source != r:
                other_start_ns = other.start_ns + other.delays_ns[r]
                other_end_ns = other.end_ns + other.delays_ns[r]
                if other_end_ns > start_ns and other_start_ns < end_ns:
                    changes.append((max(other_start_ns, start_ns), other.powers_mw[r]))
                    changes.append((min(other_end_ns, end_ns), -other.powers_mw[r]))
        changes.sort()
        changes.append((end_ns, 0.0))
        # the signal fields end where the payload begins; L-SIG is the last 4 us of the non-HT preamble
        signal_ns = (start_ns + NON_HT_PREAMBLE_NS - 4_000, start_ns + frame.mode.preamble_ns)
        payload_ns = (signal_ns[1], end_ns)
        signal_rate = (VHT_SIGNAL_BITS if frame.mode.vht else SIGNAL_BITS) / (signal_ns[1] - signal_ns[0])
        payload_rate = 8 * frame.bytes / (payload_ns[1] - payload_ns[0])
        payload_errors = error_model(frame.mode)
        hazard, interference_mw = 0.0, 0.0
        for (from_ns, change_mw), (to_ns, _) in pairwise(changes):
            interference_mw = max(0.0, interference_mw + change_mw)
            if to_ns == from_ns:
                continue
            sinr = power_mw / (self._noise_mw + interference_mw)
            in_signal_ns = min(to_ns, signal_ns[1]) - max(from_ns, signal_ns[0])
            if in_signal_ns > 0:
                hazard += in_signal_ns * signal_rate * self._signal_errors.hazard_per_bit(sinr)
            in_payload_ns = min(to_ns, payload_ns[1]) - max(from_ns, payload_ns[0])
            if in_payload_ns > 0:
                hazard += in_payload_ns * payload_rate * payload_errors.hazard_per_bit(sinr)
        return exp(-hazard) if hazard > 0.0 else 1.0
