"""Somebody else's transmitter: when its bursts begin and end.

Bursts and pauses are exponentially distributed, independent of all that happens on the channel: it senses
nothing and answers nobody.
"""

import numpy as np

from netsim.model.config import InterfererConfig

LONGEST_NS = 1e18


class Interferer:
    """One transmitter's bursts, drawn one after the other. Its duty cycle is over 0."""

    __slots__ = ("_burst_ns", "_generator", "_pause_ns", "duty_cycle", "index")

    def __init__(self, index: int, config: InterfererConfig, generator: np.random.Generator) -> None:
        self.index = index
        self.duty_cycle = config.duty_cycle
        self._generator = generator
        self._burst_ns = 1e3 * config.burst_us
        self._pause_ns = self._burst_ns * (1.0 - self.duty_cycle) / self.duty_cycle

    def first_ns(self) -> int:
        """Begin of the first burst after time 0, at which it sends already with the duty cycle's chance."""
        return 0 if self._generator.random() < self.duty_cycle else self.pause_ns()

    def burst_ns(self) -> int:
        """Length of the next burst; 1 ns at least."""
        return 1 + round(self._generator.exponential(self._burst_ns))

    def pause_ns(self) -> int:
        """Length of the pause after it."""
        return round(min(self._generator.exponential(self._pause_ns), LONGEST_NS))
