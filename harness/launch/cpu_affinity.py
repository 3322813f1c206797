"""Which processors a swarm's processes keep to, as long as it has the machine for itself.

In lockstep everybody waits for the last, which a scheduler that balances load cannot know: it need not leave
four of eight vehicles on each of two processors, nor any of them where its caches are. So each process is
given a processor. While somebody else works too, all may go where they like: one that
is held where others work would hold up the whole swarm.

The emulator, told by the one processor it may use that it shares it with vehicles, gives way to them between
its events (`netsim.transport.server`).
"""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import psutil

LOOK_PERIOD_S = 0.5
"""Wall time between looks at who else works."""
OTHERS_MAX = 0.25
"""Processors that others may keep busy; what is counted in ticks of 4 ms is uncertain by 0.06 in a period."""
VEHICLES_PER_PROCESSOR = 2
"""With fewer there is room for the scheduler to do well by itself."""


class Times(NamedTuple):
    """What has been counted up to one look."""

    wall_s: float
    machine_cpu_s: float
    """Time for which the processors were busy, with whatever."""
    own_cpu_s: float


def leaves_room(before: Times, now: Times) -> bool:
    """Whether others left the processors to the swarm between two looks."""
    others_s = (now.machine_cpu_s - before.machine_cpu_s) - (now.own_cpu_s - before.own_cpu_s)
    return others_s <= OTHERS_MAX * (now.wall_s - before.wall_s)


def homes(
    vehicles: Sequence[str], processors: Sequence[int], *, first: str, last: str
) -> dict[str, int] | None:
    """Processor of each process: equal shares of vehicles in their order; ``first`` and ``last`` at the ends.

    None if the scheduler is to place them: with one processor, or with few vehicles on each.
    """
    if len(processors) < 2 or len(vehicles) < VEHICLES_PER_PROCESSOR * len(processors):
        return None
    places = {name: processors[i * len(processors) // len(vehicles)] for i, name in enumerate(vehicles)}
    return places | {first: processors[0], last: processors[-1]}


def own_processors() -> list[int]:
    """Processors that this process may use, if they can be chosen from: on Linux, and if all are as fast."""
    if sys.platform != "linux":
        return []
    processors = sorted(os.sched_getaffinity(0))
    folder = Path("/sys/devices/system/cpu")
    speeds = set()
    for processor in processors:
        with contextlib.suppress(OSError):
            speeds.add((folder / f"cpu{processor}/cpufreq/cpuinfo_max_freq").read_text())
    return processors if len(speeds) <= 1 else []


def counted(processors: Sequence[int], pids: Iterable[int]) -> Times:
    """What the processors have done so far, and what of it for these processes; those gone are left out."""
    machine = psutil.cpu_times(percpu=True)
    busy = [machine[processor] for processor in processors if processor < len(machine)]
    own_cpu_s = 0.0
    for pid in pids:
        with contextlib.suppress(psutil.Error):
            own = psutil.Process(pid).cpu_times()
            own_cpu_s += own.user + own.system
    return Times(time.monotonic(), sum(cpu.user + cpu.nice + cpu.system for cpu in busy), own_cpu_s)


class CpuAffinity:
    """Keeps processes on processors of their own as long as nobody else works, on a thread of its own.

    It places the thread that does a process's work, its first; Zenoh's go where there is room.
    ``pids`` tells the processes that there are now by name; ``places`` is of `homes`, ``count`` is `counted`.
    """

    def __init__(
        self,
        pids: Callable[[], Mapping[str, int]],
        places: Mapping[str, int],
        processors: Sequence[int],
        *,
        count: Callable[[Sequence[int], Iterable[int]], Times] = counted,
        period_s: float = LOOK_PERIOD_S,
    ) -> None:
        self._pids = pids
        self._places = places
        self._processors = processors
        self._count = count
        self._period_s = period_s
        self._ended = threading.Event()
        self.placed = False
        """Whether they keep to their processors now."""
        self._thread = threading.Thread(target=self._watch, name="placement", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Look no more; harmless when repeated. Processes stay where they are."""
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        before = self._now()
        while not self._ended.wait(self._period_s):
            now = self._now()
            room = leaves_room(before, now)
            if room != self.placed:
                self.placed = room
                self._place()
            before = now

    def _place(self) -> None:
        """Give every process its processor, or all of them again."""
        for name, pid in self._pids().items():
            if name in self._places:
                with contextlib.suppress(OSError):  # it is gone
                    if self.placed:
                        os.sched_setaffinity(pid, [self._places[name]])
                    else:
                        _free(pid, self._processors)

    def _now(self) -> Times:
        return self._count(self._processors, (os.getpid(), *self._pids().values()))


def _free(pid: int, processors: Sequence[int]) -> None:
    """Let a process go anywhere; those of its threads too that were started while it was placed."""
    for thread in Path(f"/proc/{pid}/task").iterdir():
        os.sched_setaffinity(int(thread.name), processors)
