"""Clocks and time stamps of ranging: clock offset and drift, noise of arrival times.

A round trip is (t4 - t1) - (t3 - t2). Clock offsets cancel, drift does not fully: t3 - t2 spans a frame and
SIFS, about 75 us, in which clocks 40 ppm apart diverge by 3 ns or 0.4 m. Chips correct this with the carrier
frequency offset, which the receiver measures anyway, because carrier and time stamps come from one crystal.
"""

from math import pi, sqrt

import numpy as np

from netsim.model.config import BandwidthMhz, FtmConfig
from netsim.phy.modes import phy_mode
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S

FIELD_PS = 2**48
"""Time stamps are 48-bit counts of picoseconds and wrap after 281 s."""
_HALF_FIELD_PS = FIELD_PS // 2
_ROUND_TRIP_M_PER_PS = 0.5 * SPEED_OF_LIGHT_M_S * 1e-12
_SQRT_12 = sqrt(12.0)
MEASURED_ROUND_TRIP_STD_PS = {20: 2563.0, 40: 1075.0}
"""Standard deviation by bandwidth in MHz, over cable at high SNR (Zubow et al., WONS 2022)."""
LONG_TRAINING_S = 6.4e-6
"""The two repetitions of L-LTF, from which time of arrival and carrier offset are estimated."""


def stamped_mhz(config: FtmConfig, channel_mhz: BandwidthMhz) -> BandwidthMhz:
    """Return the bandwidth that time stamps are taken from, MHz: that of the format of ``config.mode``.

    It is the channel's width for a VHT frame and 20 for a non-HT frame, of which a wider channel has a copy
    in every 20 MHz: a receiver with the format non-HT 20 MHz takes the time of one of them.
    """
    return channel_mhz if phy_mode(config.mode, channel_mhz).vht else 20


def format_name(config: FtmConfig, channel_mhz: BandwidthMhz) -> str:
    """Return the format and bandwidth of the time stamps: "VHT, 80 MHz", "non-HT, 20 MHz"."""
    kind = "VHT" if phy_mode(config.mode, channel_mhz).vht else "non-HT"
    return f"{kind}, {stamped_mhz(config, channel_mhz)} MHz"


def round_trip_std_ps(config: FtmConfig, channel_mhz: BandwidthMhz) -> float:
    """Return the standard deviation of a round trip at high SNR, by the format of the measurement frames.

    80 MHz has not been measured: the value of 40 MHz is scaled by the inverse of the bandwidth, as the
    Cramér-Rao bound for a given energy. (From 20 to 40 MHz the measured gain is higher, 2.4.)
    """
    if config.round_trip_std_ps is not None:
        return config.round_trip_std_ps
    bandwidth_mhz = stamped_mhz(config, channel_mhz)
    measured = MEASURED_ROUND_TRIP_STD_PS.get(bandwidth_mhz)
    return MEASURED_ROUND_TRIP_STD_PS[40] * 40.0 / bandwidth_mhz if measured is None else measured


def arrival_std_ps(floor_ps: float, bandwidth_mhz: float, snr_linear: float) -> float:
    """Return the standard deviation of one time of arrival.

    It is the root sum of squares of the floor and the Cramér-Rao bound 1 / (2 pi B_rms sqrt(2 E/N0)), with
    B_rms = B / sqrt(12) for a flat spectrum and E/N0 = SNR B T over the long training field.
    """
    bandwidth_hz = bandwidth_mhz * 1e6
    energy_ratio = snr_linear * bandwidth_hz * LONG_TRAINING_S
    bound_ps = 1e12 / (2.0 * pi * bandwidth_hz / _SQRT_12 * sqrt(2.0 * energy_ratio))
    return sqrt(floor_ps**2 + bound_ps**2)


def frequency_ratio_std(carrier_hz: float, bandwidth_mhz: float, snr_linear: float) -> float:
    """Return the standard deviation of the clock rate ratio estimated from the carrier offset.

    Cramér-Rao bound of a frequency over the N = B T samples of the long training field:
    sqrt(6 / (SNR N)) / (2 pi T) (Rife and Boorstyn, 1974), divided by the carrier frequency.
    """
    samples = bandwidth_mhz * 1e6 * LONG_TRAINING_S
    return sqrt(6.0 / (snr_linear * samples)) / (2.0 * pi * LONG_TRAINING_S * carrier_hz)


class Clock:
    """A radio's clock in picoseconds, with an offset and ``rate`` times the rate of true time."""

    __slots__ = ("_excess", "_offset_ps", "rate")

    def __init__(self, max_ppm: float, generator: np.random.Generator) -> None:
        self._excess = float(generator.uniform(-max_ppm, max_ppm)) * 1e-6
        self.rate = 1.0 + self._excess
        """Picoseconds of this clock per picosecond of true time."""
        self._offset_ps = int(generator.integers(FIELD_PS))

    def stamp_ps(self, true_ps: int) -> int:
        """Return the clock's reading without noise, modulo the width of the field."""
        return (self._offset_ps + true_ps + round(true_ps * self._excess)) % FIELD_PS


def distance_m(round_trip_ps: float) -> float:
    """Return the distance of a round trip: c/2 times its duration."""
    return _ROUND_TRIP_M_PER_PS * round_trip_ps


def measured_m(t1_ps: int, t2_ps: int, t3_ps: int, t4_ps: int, rate_ratio: float) -> float:
    """Return the distance of the round trip (t4 - t1) - (t3 - t2).

    Differences are taken modulo the field's width, in [-2^47, 2^47). ``rate_ratio`` is the rate of the clock
    of t1 and t4 divided by that of t2 and t3.
    """
    there_ps = (t4_ps - t1_ps + _HALF_FIELD_PS) % FIELD_PS - _HALF_FIELD_PS
    here_ps = (t3_ps - t2_ps + _HALF_FIELD_PS) % FIELD_PS - _HALF_FIELD_PS
    return _ROUND_TRIP_M_PER_PS * (there_ps - here_ps * rate_ratio)
