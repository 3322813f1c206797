"""Blockage of lines of sight: a two-state random process in time for every unordered pair of stations.

Clear and blocked times are exponentially distributed, as in the two-state channel of Lutz et al. (IEEE
Transactions on Vehicular Technology 40, 1991). Their means follow from the fraction of blocked time and the
mean blocked time. The process depends only on seed and pair, not on the positions of the stations.
"""

from array import array
from bisect import bisect_right

import numpy as np

from netsim.model.event_queue import NEVER_NS
from netsim.model.random_streams import Model, RandomStreams

LONGEST_NS = 1e18
"""Upper limit of mean times, 30 years."""
KEPT_NS = 100_000_000
"""Time for which past switches are kept. Queries go back by the length of a frame, at most 6 ms."""
MOST_SWITCHES = 64
"""Number of switches from which old ones are removed."""


class _Pair:
    """Switches of one pair, drawn up to the latest query and kept for `KEPT_NS`."""

    __slots__ = ("_generator", "_means_ns", "_starts_blocked", "switches_ns")

    def __init__(
        self, fraction: float, means_ns: tuple[float, float], generator: np.random.Generator
    ) -> None:
        self._generator = generator
        self._means_ns = means_ns
        self._starts_blocked = bool(generator.random() < fraction)
        """Whether the pair is blocked after the first kept switch."""
        self.switches_ns = array("q", [0])

    def at(self, at_ns: int) -> tuple[bool, int]:
        """Return whether the pair is blocked, and until when; ``at_ns`` may be `KEPT_NS` in the past."""
        switches_ns = self.switches_ns
        while switches_ns[-1] <= at_ns:
            # the interval after an even number of switches is of the first kind
            blocked = self._starts_blocked == (len(switches_ns) % 2 == 1)
            length_ns = 1 + round(self._generator.exponential(self._means_ns[blocked]))
            switches_ns.append(min(switches_ns[-1] + length_ns, NEVER_NS))
            if len(switches_ns) >= MOST_SWITCHES:
                self._forget(at_ns - KEPT_NS)
        k = bisect_right(switches_ns, at_ns)
        return self._starts_blocked == (k % 2 == 1), switches_ns[k]

    def _forget(self, before_ns: int) -> None:
        """Remove the switches not needed from ``before_ns`` on, in pairs, to keep their parity."""
        old = bisect_right(self.switches_ns, before_ns) - 1
        if old > 1:
            del self.switches_ns[: old - old % 2]


class Obstruction:
    """Blockage of the lines of sight of all pairs."""

    def __init__(self, *, fraction: float, duration_s: float, stations: int, streams: RandomStreams) -> None:
        self._fraction = fraction
        self._always = fraction == 1.0
        self._means_ns = (
            min(1e9 * duration_s * (1.0 - fraction) / max(fraction, 1e-300), LONGEST_NS),
            min(1e9 * duration_s, LONGEST_NS),
        )
        """Means of clear and of blocked times."""
        self._streams = streams
        self._stations = stations
        self._pairs: dict[tuple[int, int], _Pair] = {}

    def blocked(self, a: int, b: int, at_ns: int) -> tuple[bool, int]:
        """Return whether the line of sight is blocked, and until when this is valid."""
        if self._always or self._fraction == 0.0:
            return self._always, NEVER_NS
        key = (a, b) if a < b else (b, a)
        pair = self._pairs.get(key)
        if pair is None:
            generator = self._streams.generator(Model.OBSTRUCTION, *key)
            pair = self._pairs[key] = _Pair(self._fraction, self._means_ns, generator)
        return pair.at(at_ns)

    def row(self, source: int, at_ns: int) -> tuple[list[bool], int]:
        """Return whether the lines of sight to all stations are blocked, and until when this is valid."""
        states = [
            (False, NEVER_NS) if other == source else self.blocked(source, other, at_ns)
            for other in range(self._stations)
        ]
        return [blocked for blocked, _ in states], min(until_ns for _, until_ns in states)
