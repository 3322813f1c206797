"""Discrete-event kernel: calls at integer nanoseconds, in order of time and then of scheduling."""

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any, TypeVar

T = TypeVar("T")
NEVER_NS = 2**62
"""Later than anything that is ever scheduled."""


Event = list[Any]
"""A scheduled call as the heap orders it: time, order of scheduling, action (None once run or taken back),
argument. A plain list, for making and comparing objects of a class took a tenth of the emulator's time.
"""
_ACTION = 2
_ARGUMENT = 3


class EventQueue:
    """Runs calls in order of (time, order of scheduling); its clock is the time of the call that runs."""

    __slots__ = ("_heap", "_scheduled", "now_ns")

    def __init__(self) -> None:
        self.now_ns = 0
        self._heap: list[Event] = []
        self._scheduled = 0

    def at(self, time_ns: int, action: Callable[[T], None], argument: T) -> Event:
        """Schedule ``action(argument)``. Raises ValueError for a time before the clock."""
        if time_ns < self.now_ns:
            raise ValueError(f"cannot schedule at {time_ns} ns: it is {self.now_ns} ns")
        self._scheduled += 1
        event: Event = [time_ns, self._scheduled, action, argument]
        heappush(self._heap, event)
        return event

    @staticmethod
    def cancel(event: Event) -> None:
        """Take a call back; nothing happens if it has run or was taken back before."""
        event[_ACTION] = event[_ARGUMENT] = None

    def next_ns(self) -> int:
        """Time of the next call, or `NEVER_NS`."""
        heap = self._heap
        while heap and heap[0][_ACTION] is None:
            heappop(heap)
        return int(heap[0][0]) if heap else NEVER_NS

    def run_until(self, time_ns: int) -> None:
        """Run every call up to and including ``time_ns``, which the clock then shows."""
        heap = self._heap
        while heap and heap[0][0] <= time_ns:
            event = heappop(heap)
            self.now_ns, _, action, argument = event
            if action is not None:
                event[_ACTION] = None
                action(argument)
        self.now_ns = max(self.now_ns, time_ns)
