"""Schedule interferers' bursts as events of the queue, split into parts because receivers move."""

from collections.abc import Callable

from netsim.model.config import RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.interferers import Interferer

PART_NS = 20_000_000
"""A longer burst is sent in parts of this length; received powers are constant within a part."""


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
        now = self._queue.now_ns
        end_ns = min(until_ns, now + PART_NS)
        # the next part starts before this one has ended at all receivers
        if end_ns < until_ns:
            self._queue.at(end_ns, self._continue, rest)
        else:
            self._queue.at(end_ns + interferer.pause_ns(), self._begin, interferer)
        self._start(interferer.index, end_ns)
