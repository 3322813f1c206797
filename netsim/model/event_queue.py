"""Discrete-event kernel: calls at integer nanoseconds, in order of time and then of scheduling."""

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any, Protocol, TypeVar

T = TypeVar("T")
NEVER_NS = 2**62
"""Later than anything that is ever scheduled."""


Event = list[Any]
"""A scheduled call as the heap orders it: time, order of scheduling, action (None once run or taken back),
argument. A plain list, for making and comparing objects of a class took a tenth of the emulator's time.
"""
_ACTION = 2
_ARGUMENT = 3


class EventSource(Protocol):
    """Something that has events of its own in the same order."""

    def begin(self) -> None:
        """Take note of what has changed since time last went on."""

    def next_ns(self) -> int:
        """Time of its next event, or `NEVER_NS`."""

    def run(self, until_ns: int, until_order: int) -> bool:
        """Run its events before a time and, at that time, an order of scheduling.

        False if it has stopped before, for what was done meanwhile may have scheduled something earlier.
        """


class EventQueue:
    """Runs calls in order of (time, order of scheduling); its clock is the time of the call that runs.

    A machine's events, such as those of the air (`netsim.mac.radios`), come among them in their order.
    """

    __slots__ = ("_heap", "between", "machine", "now_ns", "scheduled")

    def __init__(self) -> None:
        self.now_ns = 0
        self.scheduled = 0
        """Calls and events so far."""
        self.machine: EventSource | None = None
        self.between: Callable[[], object] | None = None
        """Done between calls; it may change nothing of what they know."""
        self._heap: list[Event] = []

    def at(self, time_ns: int, action: Callable[[T], None], argument: T) -> Event:
        """Schedule ``action(argument)``. Raises ValueError for a time before the clock."""
        if time_ns < self.now_ns:
            raise ValueError(f"cannot schedule at {time_ns} ns: it is {self.now_ns} ns")
        self.scheduled += 1
        event: Event = [time_ns, self.scheduled, action, argument]
        heappush(self._heap, event)
        return event

    @staticmethod
    def cancel(event: Event) -> None:
        """Take a call back; nothing happens if it has run or was taken back before."""
        event[_ACTION] = event[_ARGUMENT] = None

    def next_ns(self) -> int:
        """Time of the next call or event, or `NEVER_NS`."""
        heap = self._heap
        while heap and heap[0][_ACTION] is None:
            heappop(heap)
        own_ns = int(heap[0][0]) if heap else NEVER_NS
        return own_ns if self.machine is None else min(own_ns, self.machine.next_ns())

    def run_until(self, time_ns: int) -> None:
        """Run everything up to and including ``time_ns``, which the clock then shows."""
        heap, machine = self._heap, self.machine
        if machine is not None:
            machine.begin()
        while True:
            if self.between is not None:
                self.between()
            while heap and heap[0][_ACTION] is None:
                heappop(heap)
            due = bool(heap) and heap[0][0] <= time_ns
            limit = heap[0][:_ACTION] if due else (time_ns, NEVER_NS)
            if machine is not None and not machine.run(*limit):
                continue
            if not due:
                break
            event = heappop(heap)
            self.now_ns, _, action, argument = event
            event[_ACTION] = None
            action(argument)
        self.now_ns = max(self.now_ns, time_ns)
