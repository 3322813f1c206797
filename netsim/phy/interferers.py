"""Bursts of an interferer.

Lengths of bursts and pauses are exponentially distributed and independent of the channel: an interferer has
no carrier sense and sends no responses.
"""

import numpy as np

from netsim.model.config import InterfererConfig

LONGEST_NS = 1e18


class Interferer:
    """Random bursts and pauses of one transmitter with a duty cycle above 0."""

    __slots__ = ("_burst_ns", "_generator", "_pause_ns", "duty_cycle", "index")

    def __init__(self, index: int, config: InterfererConfig, generator: np.random.Generator) -> None:
        self.index = index
        self.duty_cycle = config.duty_cycle
        self._generator = generator
        self._burst_ns = 1e3 * config.burst_us
        self._pause_ns = self._burst_ns * (1.0 - self.duty_cycle) / self.duty_cycle

    def first_ns(self) -> int:
        """Return the begin of the first burst; 0 with the probability of the duty cycle."""
        return 0 if self._generator.random() < self.duty_cycle else self.pause_ns()

    def burst_ns(self) -> int:
        """Return the length of the next burst, at least 1 ns."""
        return 1 + round(self._generator.exponential(self._burst_ns))

    def pause_ns(self) -> int:
        """Return the length of the next pause."""
        return round(min(self._generator.exponential(self._pause_ns), LONGEST_NS))
