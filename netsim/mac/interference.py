"""When interferers send: bursts as events of Python's queue, cut into parts that fit moving receivers."""

from collections.abc import Callable

from netsim.model.config import RadioConfig
from netsim.model.event_queue import EventQueue
from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.interferers import Interferer

PART_NS = 20_000_000
"""A longer burst goes on the air in parts, each with the powers of its beginning: receivers move."""


class Bursts:
    """Bursts of all interferers: ``start`` puts one on the air, by its interferer's index, until a time."""

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
        self._go_on((interferer, self._queue.now_ns + interferer.burst_ns()))

    def _go_on(self, rest: tuple[Interferer, int]) -> None:
        """Put what is left of a burst on the air, or the next part of it."""
        interferer, until_ns = rest
        now = self._queue.now_ns
        end_ns = min(until_ns, now + PART_NS)
        # what follows at once is on the air before this has ended everywhere
        if end_ns < until_ns:
            self._queue.at(end_ns, self._go_on, rest)
        else:
            self._queue.at(end_ns + interferer.pause_ns(), self._begin, interferer)
        self._start(interferer.index, end_ns)
