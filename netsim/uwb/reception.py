"""Packet errors by noise, and noise of time stamps, from the received power.

A data symbol carries two code bits: a position and a polarity of its burst. The code is systematic: the
position is the bit before, the polarity the parity of the bit and the one before the last (802.15.4-2020,
15.3.3.3). Error rates after it are those of a simulation with a maximum-likelihood decoder over white noise,
which tests/support/uwb_decoder.py repeats; from 6 dB on those of the union bound. The Reed-Solomon code then
corrects 4 of the 6-bit symbols of a block; the header's SECDED code corrects 1 of 19 bits.
"""

from functools import lru_cache
from math import comb, log10, pi, sqrt

import numpy as np

from netsim.phy.propagation import thermal_noise_mw
from netsim.uwb.config import DataRateKbps, UwbConfig
from netsim.uwb.frames import (
    CHIP_MHZ,
    HEADER_CHIPS,
    RS_INFORMATION_BITS,
    RS_PARITY_BITS,
    data_symbol_us,
    preamble_symbol_us,
)

_RS_SYMBOL_BITS, _RS_CORRECTED = 6, 4
_HEADER_BITS, _HEADER_CORRECTED = 19, 1
_STEP_DB = 0.01
"""Step of the signal-to-noise ratio for which packet errors are computed."""
_SQRT_12 = sqrt(12.0)
_ENERGIES_DB = (-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)
"""E / N0 of a symbol, for which `_LOG_RATES` has decimal logarithms of the rates of `error_rates`."""
_LOG_RATES = np.log10(
    [
        (0.5, 0.344, 0.292, 0.228, 0.158, 0.0905, 0.0410, 0.0145,
         3.41e-3, 6.14e-4, 7.73e-5, 7.3e-6, 3.8e-7, 1.1e-8, 1e-10),
        (1.0, 0.720, 0.629, 0.511, 0.372, 0.2291, 0.1135, 0.0443,
         1.17e-2, 2.38e-3, 3.43e-4, 3.2e-5, 1.7e-6, 5.1e-8, 5e-10),
    ]
)  # fmt: skip


def snr_linear(config: UwbConfig, power_mw: float) -> float:
    """Return the ratio of a received power to the noise in the channel, without implementation loss."""
    return power_mw / thermal_noise_mw(CHIP_MHZ, config.noise_figure_db)


def packet_error_probability(config: UwbConfig, payload_bytes: int, power_mw: float) -> float:
    """Return the probability that noise corrupts a frame, 0 to 1, to a step of 0.01 dB of power.

    The preamble is detected in every frame whose header is received.
    """
    snr = snr_linear(config, power_mw) * 10.0 ** (-config.implementation_loss_db / 10.0)
    if snr < 1e-6:
        return 1.0
    return _at(round(10.0 * log10(snr) / _STEP_DB), config.data_rate_kbps, payload_bytes)


@lru_cache(maxsize=4096)
def _at(step: int, data_rate_kbps: DataRateKbps, payload_bytes: int) -> float:
    snr = 10.0 ** (step * _STEP_DB / 10.0)
    header_error, _ = error_rates(snr * HEADER_CHIPS)
    passed = 1.0 - _more_errors(_HEADER_BITS, header_error, _HEADER_CORRECTED)
    _, symbol_error = error_rates(snr * data_symbol_us(data_rate_kbps) * CHIP_MHZ)
    bits = 8 * payload_bytes
    while bits > 0:
        block = min(bits, RS_INFORMATION_BITS)
        symbols = -(-(block + RS_PARITY_BITS) // _RS_SYMBOL_BITS)
        passed *= 1.0 - _more_errors(symbols, symbol_error, _RS_CORRECTED)
        bits -= block
    return 1.0 - passed


def error_rates(symbol_energy_ratio: float) -> tuple[float, float]:
    """Return the rates of wrong bits and of wrong 6-bit symbols after the convolutional code.

    ``symbol_energy_ratio`` is E / N0 of a symbol, above 0.
    """
    energy_db = 10.0 * log10(symbol_energy_ratio)
    bits, symbols = (10.0 ** float(np.interp(energy_db, _ENERGIES_DB, rates)) for rates in _LOG_RATES)
    return bits, symbols


def arrival_std_ps(config: UwbConfig, power_mw: float) -> float:
    """Return the standard deviation of a frame's time of arrival.

    It is the root sum of squares of ``time_stamp_std_ps`` and the Cramér-Rao bound 1 / (2 pi B_rms sqrt(2
    E/N0)), with B_rms = B / sqrt(12) for a flat spectrum and the energy of the preamble, less the
    implementation loss.
    """
    preamble_us = config.preamble_symbols * preamble_symbol_us(config.prf_mhz)
    loss = 10.0 ** (-config.implementation_loss_db / 10.0)
    energy_ratio = snr_linear(config, power_mw) * loss * CHIP_MHZ * preamble_us
    bound_ps = 1e6 / (2.0 * pi * CHIP_MHZ / _SQRT_12 * sqrt(2.0 * energy_ratio))
    return sqrt(config.time_stamp_std_ps**2 + bound_ps**2)


def _more_errors(count: int, probability: float, corrected: int) -> float:
    """Return the probability of more than ``corrected`` errors among ``count``."""
    fewer = sum(
        comb(count, k) * probability**k * (1.0 - probability) ** (count - k) for k in range(corrected + 1)
    )
    return max(0.0, 1.0 - fewer)
