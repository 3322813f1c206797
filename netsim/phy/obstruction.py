"""When something stands between two stations: a two-state process in time for every unordered pair.

Clear and blocked times are exponentially distributed, as in the two-state channel of Lutz et al. (IEEE
Transactions on Vehicular Technology 40, 1991); their means follow from the share of blocked time and the
mean blocked time. A pair's switches are a function of seed and pair alone. Where the stations are has no
influence.
"""

from array import array
from bisect import bisect_right

import numpy as np

from netsim.model.event_queue import NEVER_NS
from netsim.model.random_streams import Model, RandomStreams

LONGEST_NS = 1e18
"""Mean time beyond which it makes no difference, 30 years."""
KEPT_NS = 100_000_000
"""Nobody asks for an earlier time than that before the latest: frames that have ended lasted 6 ms at most."""
MOST_SWITCHES = 64
"""So many make a pair look for those that are too old."""


class _Pair:
    """Switches of one pair, drawn as far as anybody has asked and kept for `KEPT_NS`."""

    __slots__ = ("_generator", "_means_ns", "_starts_blocked", "switches_ns")

    def __init__(
        self, fraction: float, means_ns: tuple[float, float], generator: np.random.Generator
    ) -> None:
        self._generator = generator
        self._means_ns = means_ns
        self._starts_blocked = bool(generator.random() < fraction)
        """Whether it is blocked after the first switch that is kept."""
        self.switches_ns = array("q", [0])

    def at(self, at_ns: int) -> tuple[bool, int]:
        """Whether it is blocked, and until when that stays so; `KEPT_NS` before the latest asked at most."""
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
        """Drop the switches by which nothing is told from ``before_ns`` on: in pairs, so that kinds stay."""
        old = bisect_right(self.switches_ns, before_ns) - 1
        if old > 1:
            del self.switches_ns[: old - old % 2]


class Obstruction:
    """Lines of sight of all pairs."""

    def __init__(self, *, fraction: float, duration_s: float, stations: int, streams: RandomStreams) -> None:
        self._fraction = fraction
        self._always = fraction == 1.0
        self._means_ns = (
            min(1e9 * duration_s * (1.0 - fraction) / max(fraction, 1e-300), LONGEST_NS),
            min(1e9 * duration_s, LONGEST_NS),
        )
        """Of clear and of blocked times."""
        self._streams = streams
        self._stations = stations
        self._pairs: dict[tuple[int, int], _Pair] = {}

    def blocked(self, a: int, b: int, at_ns: int) -> tuple[bool, int]:
        """Whether the line of sight is blocked, and until when that stays so."""
        if self._always or self._fraction == 0.0:
            return self._always, NEVER_NS
        key = (a, b) if a < b else (b, a)
        pair = self._pairs.get(key)
        if pair is None:
            generator = self._streams.generator(Model.OBSTRUCTION, *key)
            pair = self._pairs[key] = _Pair(self._fraction, self._means_ns, generator)
        return pair.at(at_ns)

    def row(self, source: int, at_ns: int) -> tuple[list[bool], int]:
        """Whom the station has no line of sight to, by station, and until when all of that stays so."""
        states = [
            (False, NEVER_NS) if other == source else self.blocked(source, other, at_ns)
            for other in range(self._stations)
        ]
        return [blocked for blocked, _ in states], min(until_ns for _, until_ns in states)
