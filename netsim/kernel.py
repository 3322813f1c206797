"""Discrete-event kernel: calls at integer nanoseconds, in order of time and then of scheduling."""

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any, TypeVar

T = TypeVar("T")
NEVER_NS = 2**62
"""Later than anything that is ever scheduled."""


class Event:
    """A scheduled call; `EventQueue.cancel` takes it back."""

    __slots__ = ("action", "argument", "time_ns")

    def __init__(self, time_ns: int, action: Callable[[Any], None], argument: object) -> None:
        self.time_ns = time_ns
        self.action: Callable[[Any], None] | None = action
        self.argument = argument


class EventQueue:
    """Runs calls in order of (time, order of scheduling); its clock is the time of the call that runs."""

    __slots__ = ("_heap", "_scheduled", "now_ns")

    def __init__(self) -> None:
        self.now_ns = 0
        self._heap: list[tuple[int, int, Event]] = []
        self._scheduled = 0

    def at(self, time_ns: int, action: Callable[[T], None], argument: T) -> Event:
        """Schedule ``action(argument)``. Raises ValueError for a time before the clock."""
        if time_ns < self.now_ns:
            raise ValueError(f"cannot schedule at {time_ns} ns: it is {self.now_ns} ns")
        event = Event(time_ns, action, argument)
        self._scheduled += 1
        heappush(self._heap, (time_ns, self._scheduled, event))
        return event

    @staticmethod
    def cancel(event: Event) -> None:
        """Take a call back; nothing happens if it has run or was taken back before."""
        event.action = None
        event.argument = None

    def next_ns(self) -> int:
        """Time of the next call, or `NEVER_NS`."""
        heap = self._heap
        while heap and heap[0][2].action is None:
            heappop(heap)
        return heap[0][0] if heap else NEVER_NS

    def run_until(self, time_ns: int) -> None:
        """Run every call up to and including ``time_ns``, which the clock then shows."""
        heap = self._heap
        while heap and heap[0][0] <= time_ns:
            self.now_ns, _, event = heappop(heap)
            action = event.action
            if action is not None:
                event.action = None
                action(event.argument)
        self.now_ns = max(self.now_ns, time_ns)
