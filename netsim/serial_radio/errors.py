"""Bit errors, packet errors, sensitivity and the modems' units of signal strength.

The modulation is 2-GFSK with a deviation near the bit rate, so the tones are nearly orthogonal. The bit error
rate is that of non-coherent detection of orthogonal binary FSK, Pb = exp(-Eb / 2 N0) / 2 (Proakis, Digital
Communications, 4th edition, section 5.4), where N0 includes noise figure and implementation loss.

Data sheet of the transceiver in the Si1000, the Si4432-B1 (table 3), at a bit error rate of 0.1 %: -121 dBm
at 2 kbit/s, -108 dBm at 40 kbit/s, -104 dBm at 100 kbit/s, -101 dBm at 125 kbit/s. Pb = 0.1 % needs Eb / N0 =
10.94 dB, so noise figure and implementation loss are together 9.05, 9.0, 9.1 and 11.1 dB: 9 dB, and 2 dB more
above 100 kbit/s. The data sheet's modulation index is 5 at 2 kbit/s and 1 elsewhere, the firmware's is 2; the
difference is left out.

A packet is received if no bit of sync word, header, length, data and CRC is wrong. A CRC of 16 bits accepts
one in 65536 erroneous packets, which is left out. With ECC each 3 bytes carry a word of the Golay code
(23, 12), of which up to 3 bits may be wrong; sync word and length are not encoded.
"""

from collections.abc import Sequence
from enum import Enum
from math import comb, exp, log, log1p, log10

from netsim.phy.propagation import thermal_noise_mw
from netsim.serial_radio.config import SerialRadioConfig
from netsim.serial_radio.hopping import occupied_hz
from netsim.serial_radio.timing import CRC_BYTES, HEADER_BYTES, LENGTH_BYTES, SYNC_BYTES, Timing

FAST_KBPS, FAST_LOSS_DB = 100, 2.0
"""Rate above which the loss of the demodulator is larger, and by how much."""
GOLAY_BITS, GOLAY_CORRECTED = 23, 3
_LEAST_RATE = 1e-15
"""Bit error rate below which packets have no errors."""


def noise_mw(config: SerialRadioConfig) -> float:
    """Return the noise power at the receiver's input in the bandwidth of its filter."""
    return thermal_noise_mw(occupied_hz(config.air_rate_kbps) * 1e-6, config.noise_figure_db)


def loss_db(config: SerialRadioConfig) -> float:
    """Return the implementation loss at the air rate."""
    return config.implementation_loss_db + (FAST_LOSS_DB if config.air_rate_kbps > FAST_KBPS else 0.0)


def sensitivity_dbm(config: SerialRadioConfig, bit_error_rate: float = 1e-3) -> float:
    """Return the received power at which bits have an error rate, without interference."""
    eb_n0 = -2.0 * log(2.0 * bit_error_rate)
    rate_mhz = config.air_rate_kbps * 1e-3
    return 10.0 * log10(eb_n0 * thermal_noise_mw(rate_mhz, config.noise_figure_db)) + loss_db(config)


def rssi(power_mw: float) -> int:
    """Return the signal strength in the modem's units, 0 to 255: 1.9 (P + 127) with P in dBm.

    ArduPilot's documentation of the SiK radio states it as an approximation.
    """
    return min(max(round(1.9 * (10.0 * log10(max(power_mw, 1e-30)) + 127.0)), 0), 255)


class Reception(Enum):
    """What a receiver makes of a packet on its channel."""

    CLEAN = 0
    CORRECTED = 1
    """Received after correction of bits."""
    ERROR = 2
    """Detected, and discarded for its errors."""
    MISSED = 3
    """Not detected."""


class PacketErrors:
    """Probabilities of reception of one kind of modem."""

    def __init__(self, config: SerialRadioConfig, timing: Timing) -> None:
        self._timing = timing
        bandwidth_hz = occupied_hz(config.air_rate_kbps)
        self._noise_mw = noise_mw(config)
        # of power over that of the noise in the filter
        self._eb_n0 = bandwidth_hz / (1e3 * config.air_rate_kbps) * 10.0 ** (-loss_db(config) / 10.0)

    def bit_error_rate(self, power_mw: float, interference_mw: float = 0.0) -> float:
        """Return the bit error rate of a signal beside noise and interference in the receiver's filter."""
        return 0.5 * exp(-0.5 * self._eb_n0 * power_mw / (self._noise_mw + interference_mw))

    def chances(self, data_bytes: int, rates: Sequence[float]) -> tuple[float, float, float]:
        """Return the probabilities that a packet is received clean, received at all, and detected.

        ``data_bytes`` are those with the trailer; ``rates`` are the bit error rates of equal parts of the
        packet.
        """
        if max(rates) < _LEAST_RATE:
            return 1.0, 1.0, 1.0
        part = 1.0 / len(rates)
        bits = sum(log1p(-rate) for rate in rates) * part
        """Mean logarithm of the probability that a bit is right."""
        if not self._timing.ecc:
            detected = exp(8 * (SYNC_BYTES + HEADER_BYTES) * bits)
            received = detected * exp(8 * (LENGTH_BYTES + data_bytes + CRC_BYTES) * bits)
            return received, received, detected
        words = self._timing.encoded_bytes(data_bytes) // 3
        detected = exp(8 * (SYNC_BYTES + LENGTH_BYTES) * bits)
        decoded = sum(log(max(_word_chance(rate), 1e-300)) for rate in rates) * part
        return detected * exp(GOLAY_BITS * words * bits), detected * exp(words * decoded), detected

    def outcome(self, uniform: float, data_bytes: int, rates: Sequence[float]) -> Reception:
        """Return what becomes of a packet, by a uniform random number."""
        clean, received, detected = self.chances(data_bytes, rates)
        if uniform < clean:
            return Reception.CLEAN
        if uniform < received:
            return Reception.CORRECTED
        return Reception.ERROR if uniform < detected else Reception.MISSED


def _word_chance(rate: float) -> float:
    """Return the probability that a word of the Golay code is decoded correctly."""
    return sum(
        comb(GOLAY_BITS, k) * rate**k * (1.0 - rate) ** (GOLAY_BITS - k) for k in range(GOLAY_CORRECTED + 1)
    )
