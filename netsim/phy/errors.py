"""Packet error model: hazard per data bit as a function of mode and signal-to-noise ratio.

Non-HT modes use the hard-decision union bound of the NIST model (Pei and Henderson, "Validation of OFDM error
rate model in ns-3", 2010). VHT modes use the results of a link simulation with soft decisions
(`netsim.phy.vht_tables`). The hazard does not depend on the frame length: in simulations with 32, 100 and
1458 bytes it differs by less than 8 %, or 0.04 dB. The tables are for 80 MHz; the interleavers of 20 and 40
MHz gain up to 0.1 dB at MCS 4 and above, which is not modelled. At a packet error rate of 0.1 the results
match ns-3's tables within 0.06 dB, except for frames below 400 bytes at MCS 7 (0.23 dB), where ns-3's two
tables are inconsistent.

The simulation's ratio is per occupied subcarrier. The emulator's ratio, power over noise in the whole
channel, is 0.6, 0.5 and 0.2 dB lower at 20, 40 and 80 MHz, where 56 of 64, 114 of 128 and 242 of 256
subcarriers are occupied. Both are used as equal, as in ns-3; in return, the channel estimation loss of a
receiver is not modelled.
"""

from bisect import bisect_right
from collections.abc import Callable
from functools import cache
from math import erfc, exp, expm1, inf, log, log1p, log10, sqrt
from statistics import NormalDist

import numpy as np
from numba import njit

from netsim.phy.interfaces import ErrorModel
from netsim.phy.modes import PhyMode
from netsim.phy.path_loss import Doubles
from netsim.phy.vht_tables import VHT_COUNTS

# Information weights c_d of the code 133/171 (octal) and its punctured forms (Haccoun and Begin, 1989;
# Frenger et al., 1999):
# code rate -> (free distance, step of d, weights per puncturing period, information bits per period).
_SPECTRUM: dict[tuple[int, int], tuple[int, int, tuple[int, ...], int]] = {
    (1, 2): (10, 2, (36, 211, 1404, 11633, 77433, 502690, 3322763, 21292910, 134365911), 1),
    (2, 3): (6, 1, (3, 70, 285, 1276, 6160, 27128, 117019, 498860, 2103891, 8784123), 2),
    (3, 4): (5, 1, (42, 201, 1492, 10469, 62935, 379644, 2253373, 13073811, 75152755, 428005675), 3),
    (5, 6): (4, 1, (92, 528, 8694, 79453, 792114, 7375573, 67884974, 610875423, 5427275376, 47664215639), 5),
}
_STEP_DB = 0.05
_FIRST_DB = -10.0
_LAST_DB = 45.0
_NEGLIGIBLE = 1e-17
"""Negligible hazard: a frame of 10^5 bits fails once in 10^12."""
_GUESSING = log(2.0)
"""Hazard of a random decision: half of the bits are correct."""
_END_ROWS = 4
"""Rows at either end, over 1 dB, used to extrapolate a table; a single row is too noisy."""


def uncoded_bit_error_rate(bits_per_subcarrier: int, snr_linear: float) -> float:
    """Return the bit error rate of BPSK or square QAM at an SNR per symbol (Pei and Henderson, 2)."""
    if bits_per_subcarrier == 1:
        return 0.5 * erfc(sqrt(snr_linear))
    points = 2**bits_per_subcarrier
    side = sqrt(points)
    return (1.0 - 1.0 / side) / (0.5 * bits_per_subcarrier) * erfc(sqrt(1.5 * snr_linear / (points - 1)))


def hard_decision_bound(mode: PhyMode, snr_linear: float) -> float:
    """Return the union bound of the bit error rate after hard-decision decoding, at most 1.

    (1/2b) sum c_d D^d with D = sqrt(4 p (1 - p)), p the uncoded rate, b the information bits per period.
    """
    p = uncoded_bit_error_rate(mode.bits_per_subcarrier, snr_linear)
    bound = sqrt(4.0 * p * (1.0 - p))
    first, step, weights, period_bits = _SPECTRUM[mode.code_rate]
    total = sum(weight * bound ** (first + k * step) for k, weight in enumerate(weights))
    return min(1.0, 0.5 * total / period_bits)


def soft_decision_bound(mode: PhyMode, snr_linear: float) -> float:
    """Return the union bound of the bit error rate after soft-decision decoding, tight where it is small.

    (1/b) sum c_d Q(sqrt(2 d g)), where g is the SNR at which BPSK has the uncoded bit error rate of the mode.
    """
    p = uncoded_bit_error_rate(mode.bits_per_subcarrier, snr_linear)
    if p <= 0.0:
        return 0.0
    g = 0.5 * NormalDist().inv_cdf(p) ** 2
    first, step, weights, period_bits = _SPECTRUM[mode.code_rate]
    total = sum(weight * 0.5 * erfc(sqrt((first + k * step) * g)) for k, weight in enumerate(weights))
    return total / period_bits


def _counted_hazard(mode: PhyMode) -> Callable[[float], float]:
    """Return the hazard as a function of the SNR in dB, from the counts of a VHT mode.

    It is -ln(1 - lost/sent) per bit in the rows, and log-linear between them. Below the first row it is
    extrapolated up to the hazard of a random decision. In the last rows, where few frames were lost, and
    above, it is the soft-decision bound, scaled to the total count of lost frames in these rows.
    """
    rows = VHT_COUNTS[mode.name]
    snrs_db = [row[0] for row in rows]
    logs = [log(-log1p(-lost / frames) / (8 * frame_bytes)) for _, frame_bytes, frames, lost in rows]
    slope = (logs[_END_ROWS] - logs[0]) / (snrs_db[_END_ROWS] - snrs_db[0])
    bounds = [soft_decision_bound(mode, 10.0 ** (snr_db / 10.0)) for snr_db in snrs_db]
    tail = range(len(rows) - _END_ROWS, len(rows))
    expected = sum(rows[k][2] * 8 * rows[k][1] * bounds[k] for k in tail)
    scale = sum(rows[k][3] for k in tail) / expected
    for k in tail:
        logs[k] = log(scale * bounds[k])

    def hazard(snr_db: float) -> float:
        if snr_db >= snrs_db[tail[0]]:
            return scale * soft_decision_bound(mode, 10.0 ** (snr_db / 10.0))
        if snr_db <= snrs_db[0]:
            return min(_GUESSING, exp(logs[0] + slope * (snr_db - snrs_db[0])))
        k = bisect_right(snrs_db, snr_db) - 1
        share = (snr_db - snrs_db[k]) / (snrs_db[k + 1] - snrs_db[k])
        return exp(logs[k] + share * (logs[k + 1] - logs[k]))

    return hazard


class PublishedErrors:
    """The built-in error model: union bounds of non-HT modes, results of a link simulation for VHT modes."""

    def hazard(self, mode: PhyMode) -> Callable[[float], float]:
        """See `netsim.phy.interfaces.ErrorModel`."""
        if mode.vht:
            return _counted_hazard(mode)
        return lambda snr_db: -log1p(-min(hard_decision_bound(mode, 10.0 ** (snr_db / 10.0)), 1.0 - 1e-12))


ERRORS: ErrorModel = PublishedErrors()
"""The built-in error model; `error_table` caches its tables."""


@njit(cache=True)
def hazard_per_bit(log_hazards: Doubles, clean_linear: float, sinr_linear: float) -> float:
    """Return the hazard of one data bit from the table of a `PacketErrorModel`, log-linearly interpolated."""
    if sinr_linear >= clean_linear:
        return 0.0
    if sinr_linear <= 0.0:
        return exp(log_hazards[0])
    position = (10.0 * log10(sinr_linear) - _FIRST_DB) / _STEP_DB
    if position <= 0.0:
        return exp(log_hazards[0])
    k = int(position)
    if k + 1 >= len(log_hazards):
        return exp(log_hazards[-1])
    return exp(log_hazards[k] + (position - k) * (log_hazards[k + 1] - log_hazards[k]))


class PacketErrorModel:
    """Table of an error model's hazard per data bit of a mode over the SINR.

    Hazards add over bits and over chunks of different interference: the probability of success of a frame is
    exp(-sum of hazard times bits).
    """

    __slots__ = ("clean_linear", "log_hazards")

    def __init__(self, mode: PhyMode, errors: ErrorModel) -> None:
        self.clean_linear = inf
        """SINR from which the hazard is 0."""
        log_hazards: list[float] = []
        hazard_at = errors.hazard(mode)
        for k in range(round((_LAST_DB - _FIRST_DB) / _STEP_DB) + 1):
            snr_db = _FIRST_DB + k * _STEP_DB
            hazard = hazard_at(snr_db)
            if hazard < _NEGLIGIBLE:
                self.clean_linear = 10.0 ** (snr_db / 10.0)
                break
            log_hazards.append(log(hazard))
        self.log_hazards = np.array(log_hazards)
        """Log of the hazard in steps of 0.05 dB."""

    def hazard_per_bit(self, sinr_linear: float) -> float:
        """Return the hazard of one data bit."""
        return float(hazard_per_bit(self.log_hazards, self.clean_linear, sinr_linear))


@cache
def _published(mode: PhyMode) -> PacketErrorModel:
    return PacketErrorModel(mode, ERRORS)


def error_table(mode: PhyMode, errors: ErrorModel = ERRORS) -> PacketErrorModel:
    """Return the table of an error model for a mode; those of the built-in one are cached."""
    return _published(mode) if errors is ERRORS else PacketErrorModel(mode, errors)


def packet_error_rate(mode: PhyMode, frame_bytes: int, snr_linear: float) -> float:
    """Return the loss probability of a frame at a constant SNR, without preamble errors."""
    return -expm1(-8 * frame_bytes * error_table(mode).hazard_per_bit(snr_linear))
