"""Relation of simulated and wall time in one interval, and the lateness of packets. No clock is read."""

from typing import NamedTuple

from netsim.wire.lockstep import Advance

LATE_MS = 20.0
"""Lateness from which a packet is counted as late: the travel time of a frame is a few milliseconds."""
_NS_PER_MS = 1e6


class Pace(NamedTuple):
    """Simulated time ``to_ns`` is due at wall time ``due_ns``, and passes ``speed`` times as fast."""

    to_ns: int
    due_ns: int
    speed: float

    def wall_ns(self, simulated_ns: int) -> int:
        """Return the wall time at which a simulated time is due."""
        return self.due_ns - round((self.to_ns - simulated_ns) / self.speed)

    def simulated_ns(self, wall_ns: int) -> int:
        """Return the simulated time that is due at a wall time."""
        return self.to_ns - round((self.due_ns - wall_ns) * self.speed)


def pace_of(request: Advance) -> Pace | None:
    """Return the pace of an interval, None if it has none."""
    if not request.due_ns or not request.speed:
        return None
    return Pace(1_000 * request.to_us, request.due_ns, request.speed)


class Lateness:
    """Statistics of the wall time by which packets are later than due."""

    def __init__(self) -> None:
        self.count = 0
        self.late = 0
        """Number that were later than `LATE_MS`."""
        self.largest_ms = 0.0
        self.sum_ms = 0.0

    def add(self, late_ns: float) -> None:
        """Count a packet; a negative lateness counts as 0."""
        late_ms = max(0.0, late_ns / _NS_PER_MS)
        self.count += 1
        self.late += late_ms > LATE_MS
        self.largest_ms = max(self.largest_ms, late_ms)
        self.sum_ms += late_ms

    @property
    def counters(self) -> dict[str, float]:
        """Numbers of packets and of those later than `LATE_MS`, and the mean and largest lateness, ms."""
        return {
            "packets": self.count,
            "late": self.late,
            "mean_ms": round(self.sum_ms / self.count, 3) if self.count else 0.0,
            "largest_ms": round(self.largest_ms, 3),
        }
