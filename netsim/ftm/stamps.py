"""The clocks and time stamps that ranging is made of: offset and drift of clocks, noise of arrivals.

A round trip is (t4 - t1) - (t3 - t2). Offsets cancel in it. Drift does not quite: t3 - t2 spans a frame and
SIFS, about 75 us, in which clocks 40 ppm apart part by 3 ns or 0.4 m; chips take that out with the carrier
frequency offset that the receiver has to measure anyway, because carrier and time stamps come from one
crystal.
"""

from math import pi, sqrt

import numpy as np

from netsim.model.config import BandwidthMhz, FtmConfig
from netsim.phy.propagation import SPEED_OF_LIGHT_M_S

FIELD_PS = 2**48
"""Time stamps are 48-bit counts of picoseconds and wrap after 281 s."""
_HALF_FIELD_PS = FIELD_PS // 2
_ROUND_TRIP_M_PER_PS = 0.5 * SPEED_OF_LIGHT_M_S * 1e-12
_SQRT_12 = sqrt(12.0)
MEASURED_ROUND_TRIP_STD_PS = {20: 2563.0, 40: 1075.0}
"""Over cable, at high SNR (Zubow et al., WONS 2022)."""
LONG_TRAINING_S = 6.4e-6
"""The two repetitions of L-LTF, from which time of arrival and carrier offset are estimated."""


def round_trip_std_ps(config: FtmConfig, bandwidth_mhz: BandwidthMhz) -> float:
    """Return the standard deviation of a round trip at high SNR.

    80 MHz has not been measured: the figure of 40 MHz scaled by the inverse of the bandwidth, as the
    Cramér-Rao bound has it for a given energy. (From 20 to 40 MHz the measurements gained more, 2.4.)
    """
    if config.round_trip_std_ps is not None:
        return config.round_trip_std_ps
    measured = MEASURED_ROUND_TRIP_STD_PS.get(bandwidth_mhz)
    return MEASURED_ROUND_TRIP_STD_PS[40] * 40.0 / bandwidth_mhz if measured is None else measured


def arrival_std_ps(floor_ps: float, bandwidth_mhz: float, snr_linear: float) -> float:
    """Return the standard deviation of one time of arrival.

    The floor and, independent of it, the Cramér-Rao bound 1 / (2 pi B_rms sqrt(2 E/N0)), with B_rms = B /
    sqrt(12) of a flat spectrum and E/N0 = SNR B T gathered over the long training field.
    """
    bandwidth_hz = bandwidth_mhz * 1e6
    energy_ratio = snr_linear * bandwidth_hz * LONG_TRAINING_S
    bound_ps = 1e12 / (2.0 * pi * bandwidth_hz / _SQRT_12 * sqrt(2.0 * energy_ratio))
    return sqrt(floor_ps**2 + bound_ps**2)


def frequency_ratio_std(carrier_hz: float, bandwidth_mhz: float, snr_linear: float) -> float:
    """Return the standard deviation of a ratio of two clocks' rates estimated from the carrier offset.

    Over the long training field: Cramér-Rao bound of a frequency over N = B T samples: sqrt(6 / (SNR N)) / (2
    pi T) (Rife and Boorstyn, 1974).
    """
    samples = bandwidth_mhz * 1e6 * LONG_TRAINING_S
    return sqrt(6.0 / (snr_linear * samples)) / (2.0 * pi * LONG_TRAINING_S * carrier_hz)


class Clock:
    """A radio's clock, which stamps in picoseconds: it has an offset and runs at ``rate`` times true time."""

    __slots__ = ("_excess", "_offset_ps", "rate")

    def __init__(self, max_ppm: float, generator: np.random.Generator) -> None:
        self._excess = float(generator.uniform(-max_ppm, max_ppm)) * 1e-6
        self.rate = 1.0 + self._excess
        """Picoseconds of this clock in one of true time."""
        self._offset_ps = int(generator.integers(FIELD_PS))

    def stamp_ps(self, true_ps: int) -> int:
        """Return what the clock shows, without noise, in the width of the field."""
        return (self._offset_ps + true_ps + round(true_ps * self._excess)) % FIELD_PS


def distance_m(round_trip_ps: float) -> float:
    """Distance that a round trip stands for, c/2 times it."""
    return _ROUND_TRIP_M_PER_PS * round_trip_ps


def measured_m(t1_ps: int, t2_ps: int, t3_ps: int, t4_ps: int, rate_ratio: float) -> float:
    """Distance that the round trip (t4 - t1) - (t3 - t2) stands for.

    Differences are across the field's wrap, in [-2^47, 2^47). ``rate_ratio`` is the rate of the clock of t1
    and t4 in terms of that of t2 and t3.
    """
    there_ps = (t4_ps - t1_ps + _HALF_FIELD_PS) % FIELD_PS - _HALF_FIELD_PS
    here_ps = (t3_ps - t2_ps + _HALF_FIELD_PS) % FIELD_PS - _HALF_FIELD_PS
    return _ROUND_TRIP_M_PER_PS * (there_ps - here_ps * rate_ratio)
