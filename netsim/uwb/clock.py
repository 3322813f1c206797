"""Clocks of the ranging radios, and their time stamps.

A time stamp counts 1 / (128 x 499.2 MHz) = 15.65 ps in 40 bits, and wraps after 17.2 s. A programmed
departure is a multiple of 512 counts (8 ns). Source: DW1000 user manual 2.12 (registers SYS_TIME and
DX_TIME).
"""

from math import pi, sin

import numpy as np

TICKS_PER_US = 63_897.6
"""128 x 499.2."""
TICK_PS = 1e6 / TICKS_PER_US
_TICKS_NUMERATOR, _TICKS_DENOMINATOR = 638_976, 10_000_000
"""Ticks per picosecond as a fraction of integers."""
FIELD_TICKS = 2**40
DEPARTURE_TICKS = 512
"""Programmed departures are multiples of this."""
DRIFT_PERIOD_S = 60.0
"""Period with which a clock's error swings, as with the temperature of its crystal."""


class UwbClock:
    """Clock of one radio: a constant rate error and a slow sinusoidal one.

    ``max_ppm`` limits the constant error, ``max_drift_ppm_s`` the rate of change of the other. Each radio
    draws both, a phase and an offset from ``generator``.
    """

    def __init__(self, max_ppm: float, max_drift_ppm_s: float, generator: np.random.Generator) -> None:
        self._excess = 1e-6 * float(generator.uniform(-max_ppm, max_ppm))
        drift_s = 1e-6 * float(generator.uniform(-max_drift_ppm_s, max_drift_ppm_s))
        self._swing = drift_s * DRIFT_PERIOD_S / (2.0 * pi)
        """Amplitude of the sinusoidal rate error."""
        self._phase = float(generator.uniform(0.0, 2.0 * pi))
        self._offset_ps = int(generator.integers(2**48))

    def rate(self, true_ps: int) -> float:
        """Return seconds of this clock per second of true time."""
        return 1.0 + self._excess + self._swing * sin(self._phase + self._angle(true_ps))

    def reading_ps(self, true_ps: int) -> int:
        """Return the clock's reading, which does not wrap, in its own picoseconds."""
        # the integral of the sine, without the cancellation of cos(phase) - cos(phase + angle)
        half = 0.5 * self._angle(true_ps)
        swung_ps = (
            2.0 * self._swing * sin(half) * sin(self._phase + half) * DRIFT_PERIOD_S * 1e12 / (2.0 * pi)
        )
        return self._offset_ps + true_ps + round(true_ps * self._excess + swung_ps)

    def departure_ps(self, true_ps: int) -> int:
        """Return the true time of the last programmable departure that is not after ``true_ps``."""
        late_ticks = _ticks(self.reading_ps(true_ps)) % DEPARTURE_TICKS
        return true_ps - round(late_ticks * TICK_PS / self.rate(true_ps))

    def after_ps(self, true_ps: int, own_us: float) -> int:
        """Return the true time at which ``own_us`` of this clock have passed since ``true_ps``."""
        return true_ps + round(1e6 * own_us / self.rate(true_ps))

    @staticmethod
    def _angle(true_ps: int) -> float:
        return 2.0 * pi * (true_ps * 1e-12 / DRIFT_PERIOD_S)


def stamp(clock: UwbClock, true_ps: int, error_ps: float = 0.0) -> int:
    """Return the time stamp of an instant, with an error, in ticks modulo `FIELD_TICKS`."""
    return _ticks(clock.reading_ps(true_ps) + round(error_ps)) % FIELD_TICKS


def elapsed_ticks(begin: int, end: int) -> int:
    """Return the ticks from one stamp to another, which is at most 8.6 s earlier or later."""
    half = FIELD_TICKS // 2
    return (end - begin + half) % FIELD_TICKS - half


def _ticks(reading_ps: int) -> int:
    """Return the nearest whole number of ticks."""
    return (2 * reading_ps * _TICKS_NUMERATOR + _TICKS_DENOMINATOR) // (2 * _TICKS_DENOMINATOR)
