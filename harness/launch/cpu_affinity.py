"""CPU affinities of a swarm's processes while other processes are idle.

In lockstep all processes wait for the slowest. The kernel's scheduler balances load without regard to that:
it may distribute eight vehicles unevenly over two processors, and migrate them away from their caches. A PX4
passes its work from thread to thread some 4,000 times in a simulated second; wakes across processors cost it
up to a third of its time. So each process is pinned to a processor. Affinities are dropped while other
processes use more than 25 % of a processor: a pinned process that competes with them would delay the whole
swarm.

The emulator yields to the vehicles between its events if its affinity is a single processor, which it shares
with vehicles (`netsim.transport.server`).
"""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import psutil

LOOK_PERIOD_S = 0.5
"""Wall time between two measurements of the load."""
OTHERS_MAX = 0.25
"""Load of other processes, in processors, above which affinities are dropped. Ticks of 4 ms make it uncertain
by 0.06 in a period."""
VEHICLES_PER_PROCESSOR = 2
"""With fewer vehicles per processor the placement is left to the scheduler."""


class Times(NamedTuple):
    """Times at one measurement."""

    wall_s: float
    machine_cpu_s: float
    """Time for which the processors were busy."""
    own_cpu_s: float


def others_idle(before: Times, now: Times) -> bool:
    """Whether the load of other processes was at most `OTHERS_MAX` between two measurements."""
    others_s = (now.machine_cpu_s - before.machine_cpu_s) - (now.own_cpu_s - before.own_cpu_s)
    return others_s <= OTHERS_MAX * (now.wall_s - before.wall_s)


def assign_processors(
    vehicles: Sequence[str], processors: Sequence[int], *, first: str, last: str
) -> dict[str, int] | None:
    """Return the processor of each process.

    Each processor has an equal share of the vehicles in their order; the process ``first`` is on the first
    processor and ``last`` on the last. None with a single processor or with few vehicles on each.
    """
    if len(processors) < 2 or len(vehicles) < VEHICLES_PER_PROCESSOR * len(processors):
        return None
    places = {name: processors[i * len(processors) // len(vehicles)] for i, name in enumerate(vehicles)}
    return places | {first: processors[0], last: processors[-1]}


def usable_processors() -> list[int]:
    """Return the processors that this process may use; empty if not on Linux or if their speeds differ."""
    if sys.platform != "linux":
        return []
    processors = sorted(os.sched_getaffinity(0))
    folder = Path("/sys/devices/system/cpu")
    speeds = set()
    for processor in processors:
        with contextlib.suppress(OSError):
            speeds.add((folder / f"cpu{processor}/cpufreq/cpuinfo_max_freq").read_text())
    return processors if len(speeds) <= 1 else []


def measure(processors: Sequence[int], pids: Iterable[int]) -> Times:
    """Return the busy time of the processors and the time of these processes; skips processes that ended.

    Time of processes of low priority is not counted, since they leave the processor to others.
    """
    machine = psutil.cpu_times(percpu=True)
    busy = [machine[processor] for processor in processors if processor < len(machine)]
    own_cpu_s = 0.0
    for pid in pids:
        with contextlib.suppress(psutil.Error):
            own = psutil.Process(pid).cpu_times()
            own_cpu_s += own.user + own.system
    return Times(time.monotonic(), sum(cpu.user + cpu.system for cpu in busy), own_cpu_s)


class CpuAffinity:
    """Pins processes to processors while other processes are idle, from a thread of its own.

    Pins the main thread of a process, which does its work, but not Zenoh's threads; of the programs that are
    ``threaded``, such as PX4s, all threads. ``pids`` returns the living processes by name; ``assignment`` is
    of `assign_processors`; ``count`` replaces `measure`.
    """

    def __init__(
        self,
        pids: Callable[[], Mapping[str, int]],
        assignment: Mapping[str, int],
        processors: Sequence[int],
        *,
        threaded: Collection[str] = (),
        count: Callable[[Sequence[int], Iterable[int]], Times] = measure,
        period_s: float = LOOK_PERIOD_S,
    ) -> None:
        self._pids = pids
        self._assignment = assignment
        self._processors = processors
        self._threaded = frozenset(threaded)
        self._count = count
        self._period_s = period_s
        self._ended = threading.Event()
        self.pinned = False
        """Whether the processes are pinned now."""
        self._thread = threading.Thread(target=self._watch, name="cpu affinity", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop; harmless when repeated. The affinities remain as they are."""
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        before = self._now()
        while not self._ended.wait(self._period_s):
            now = self._now()
            idle = others_idle(before, now)
            if idle != self.pinned:
                self.pinned = idle
                self._apply()
            before = now

    def _apply(self) -> None:
        """Pin every process to its processor, or allow it all processors."""
        for name, pid in self._pids().items():
            if name in self._assignment:
                with contextlib.suppress(OSError):  # it has ended, or is another user's
                    if not self.pinned:
                        _allow(pid, self._processors)
                    elif name in self._threaded:
                        _allow(pid, [self._assignment[name]])
                    else:
                        os.sched_setaffinity(pid, [self._assignment[name]])

    def _now(self) -> Times:
        return self._count(self._processors, (os.getpid(), *self._pids().values()))


def _allow(pid: int, processors: Sequence[int]) -> None:
    """Allow a process and all its threads these processors; new threads inherit them from their creators."""
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(ProcessLookupError):  # it has ended
            os.sched_setaffinity(int(thread.name), processors)
