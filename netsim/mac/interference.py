"""Interferers: random bursts, scheduled as events of the queue.

Lengths of bursts and pauses are exponentially distributed and independent of the channel: an interferer has
no carrier sense and sends no responses. Long bursts are split into parts because receivers move.
"""

from collections.abc import Callable

import numpy as np

from netsim.model.config import InterfererConfig, RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import Model, RandomStreams

LONGEST_NS = 1e18
PART_NS = 20_000_000
"""A longer burst is sent in parts of this length; received powers are constant within a part."""


class Interferer:
    """Random bursts and pauses of one transmitter with a duty cycle above 0."""

    def __init__(self, index: int, config: InterfererConfig, generator: np.random.Generator) -> None:
        self.index = index
        self._duty_cycle = config.duty_cycle
        self._generator = generator
        self._burst_ns = 1e3 * config.burst_us
        self._pause_ns = self._burst_ns * (1.0 - config.duty_cycle) / config.duty_cycle

    def first_ns(self) -> int:
        """Return the begin of the first burst; 0 with the probability of the duty cycle."""
        return 0 if self._generator.random() < self._duty_cycle else self.pause_ns()

    def burst_ns(self) -> int:
        """Return the length of the next burst, at least 1 ns."""
        return 1 + round(self._generator.exponential(self._burst_ns))

    def pause_ns(self) -> int:
        """Return the length of the next pause."""
        return round(min(self._generator.exponential(self._pause_ns), LONGEST_NS))


class Bursts:
    """Bursts of all interferers; ``start(index, end_ns)`` starts a burst of an interferer now."""

    def __init__(
        self,
        config: RadioConfig,
        queue: EventQueue,
        streams: RandomStreams,
        start: Callable[[int, int], None],
    ) -> None:
        self._queue = queue
        self._start = start
        for index, settings in enumerate(config.interferers):
            if settings.duty_cycle > 0.0:
                interferer = Interferer(index, settings, streams.generator(Model.INTERFERENCE, index))
                queue.at(queue.now_ns + interferer.first_ns(), self._begin, interferer)

    def _begin(self, interferer: Interferer) -> None:
        self._continue((interferer, self._queue.now_ns + interferer.burst_ns()))

    def _continue(self, rest: tuple[Interferer, int]) -> None:
        """Start the next part of a burst."""
        interferer, until_ns = rest
        end_ns = min(until_ns, self._queue.now_ns + PART_NS)
        # the next part starts before this one has ended at all receivers
        if end_ns < until_ns:
            self._queue.at(end_ns, self._continue, rest)
        else:
            self._queue.at(end_ns + interferer.pause_ns(), self._begin, interferer)
        self._start(interferer.index, end_ns)
