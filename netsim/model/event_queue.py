"""Discrete-event queue: calls at integer nanoseconds, ordered by time and then by scheduling."""

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any, Protocol, TypeVar

T = TypeVar("T")
NEVER_NS = 2**62
"""Later than any scheduled event."""


Event = list[Any]
"""A scheduled call: time, order of scheduling, action (None once run or cancelled), argument.

A plain list, since creating and comparing objects of a class took a tenth of the emulator's time.
"""
_ACTION = 2
_ARGUMENT = 3


class EventSource(Protocol):
    """Another source of events, run in a common order with the calls of the queue."""

    def begin(self) -> None:
        """Update to changes made since the last `run`."""

    def next_ns(self) -> int:
        """Return the time of its next event, or `NEVER_NS`."""

    def run(self, until_ns: int, until_order: int) -> bool:
        """Run its events before a time and, at that time, an order of scheduling.

        Return False if it stopped early, since its callbacks may have scheduled an earlier call.
        """

    def end(self) -> None:
        """Report what may be reported after the last `run` of a time span; it schedules nothing."""


class EventQueue:
    """Runs calls in order of (time, order of scheduling); its clock is the time of the running call.

    The events of ``machine`` (`netsim.mac.radios`) are run among them in their order.
    """

    __slots__ = ("_heap", "between", "machine", "now_ns", "scheduled")

    def __init__(self) -> None:
        self.now_ns = 0
        self.scheduled = 0
        """Number of calls and events scheduled so far."""
        self.machine: EventSource | None = None
        self.between: Callable[[], object] | None = None
        """Function called between calls; it must not change the simulation."""
        self._heap: list[Event] = []

    def at(self, time_ns: int, action: Callable[[T], None], argument: T) -> Event:
        """Schedule ``action(argument)``. Raises ValueError for a time before the clock."""
        if time_ns < self.now_ns:
            raise ValueError(f"cannot schedule at {time_ns} ns: the time is {self.now_ns} ns")
        self.scheduled += 1
        event: Event = [time_ns, self.scheduled, action, argument]
        heappush(self._heap, event)
        return event

    @staticmethod
    def cancel(event: Event) -> None:
        """Cancel a call; no effect if it has run or was cancelled before."""
        event[_ACTION] = event[_ARGUMENT] = None

    def next_ns(self) -> int:
        """Return the time of the next call or event, or `NEVER_NS`."""
        heap = self._heap
        while heap and heap[0][_ACTION] is None:
            heappop(heap)
        own_ns = int(heap[0][0]) if heap else NEVER_NS
        return own_ns if self.machine is None else min(own_ns, self.machine.next_ns())

    def run_until(self, time_ns: int) -> None:
        """Run all calls and events up to and including ``time_ns``, and set the clock to it."""
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
        if machine is not None:
            machine.end()
