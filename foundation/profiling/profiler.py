"""Where a process's processor time goes, by part: a look at the stack after every few milliseconds of it.

The operating system interrupts the process whenever it has used some more processor time, and what runs then
is charged to the part whose module is innermost on the stack. So the parts are a table of modules, nothing is
wrapped, a run that is not profiled pays nothing, and one that is pays 3 us in 4 ms. A few thousand samples
tell shares to a percent. What is called in compiled code or by the operating system is its caller's.

Next to `foundation.processes.child_protocol`, for it is every process's; reads clocks, so it is for the
edges.
"""

import contextlib
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec
from msgspec import Struct

LINK = "link"
"""Part in which every process waits for the others: system calls of its sockets, and lines on pipes."""
REST = "other"
"""Of no part."""
THREADS = "Zenoh's threads"
"""Processor time of threads beside the main one."""
KEY = "profile"
"""In `foundation.processes.child_protocol.Finished.details`: what `Profile` says."""
PERIOD_S = 0.001
"""Processor time between two samples, or a tick of the operating system's clock where that is longer."""
_SCHEDULER = Path("/proc/self/schedstat")


class Profile(Struct, frozen=True, kw_only=True):
    """What one process did with its time, from the first sample to the last."""

    simulated_s: float
    wall_s: float
    cpu_s: float
    parts_cpu_s: dict[str, float]
    """Sums up to ``cpu_s``"""
    waiting_s: float
    """Wall time in which the main thread had nothing to do"""
    queueing_s: float
    """Wall time in which it had, and other processes had the processors; part of waiting where unknown"""
    samples: int


class _Mark(Struct, frozen=True):
    """An instant by every clock."""

    simulated_us: int
    wall_ns: int
    process_ns: int
    thread_ns: int


class Profiler:
    """Samples the thread that makes it, which must be the main one, between `start` and `stop`.

    ``parts`` gives names of modules and packages their part; a module that is in none of them is charged
    to its caller's. What is done before ``now_us()``, the simulated time, reaches ``from_us`` is not counted.
    """

    def __init__(self, parts: Mapping[str, str], *, now_us: Callable[[], int], from_us: int) -> None:
        self._parts = dict(parts)
        self._now_us = now_us
        self._from_us = from_us
        self._part_of: dict[str, str | None] = {}
        self._counts: Counter[str] = Counter()
        self._first: _Mark | None = None
        self._last: _Mark | None = None
        self._queued_ns = 0

    def start(self) -> None:
        """Begin to sample."""
        signal.signal(signal.SIGPROF, self._sample)
        signal.setitimer(signal.ITIMER_PROF, PERIOD_S, PERIOD_S)

    def stop(self) -> None:
        """End it."""
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, signal.SIG_IGN)  # one may be under way

    def _sample(self, _number: int, frame: FrameType | None) -> None:
        now_us = self._now_us()
        if now_us < self._from_us:
            return
        mark = _Mark(now_us, time.perf_counter_ns(), time.process_time_ns(), time.thread_time_ns())
        if self._first is None:
            self._first, self._queued_ns = mark, _queued_ns()
        else:
            self._last = mark
            self._counts[self.part_of(frame)] += 1

    def part_of(self, frame: FrameType | None) -> str:
        """Part of the innermost frame that is of one."""
        while frame is not None:
            spec = frame.f_globals.get("__spec__")
            module: str = spec.name if spec is not None else frame.f_globals.get("__name__", "")
            if module not in self._part_of:
                self._part_of[module] = part_of(module, self._parts)
            part = self._part_of[module]
            if part is not None:
                return part
            frame = frame.f_back
        return REST

    def profile(self) -> Profile | None:
        """What has been found; None if no time has passed."""
        first, last = self._first, self._last
        if first is None or last is None:
            return None
        wall_s = 1e-9 * (last.wall_ns - first.wall_ns)
        cpu_s = 1e-9 * (last.process_ns - first.process_ns)
        own_s = min(1e-9 * (last.thread_ns - first.thread_ns), cpu_s)
        queueing_s = min(1e-9 * (_queued_ns() - self._queued_ns), max(wall_s - own_s, 0.0))
        return Profile(
            simulated_s=1e-6 * (last.simulated_us - first.simulated_us),
            wall_s=wall_s,
            cpu_s=cpu_s,
            parts_cpu_s=shares_s(self._counts, cpu_s=cpu_s, threads_s=cpu_s - own_s),
            waiting_s=max(wall_s - own_s - queueing_s, 0.0),
            queueing_s=queueing_s,
            samples=self._counts.total(),
        )


def part_of(module: str, parts: Mapping[str, str]) -> str | None:
    """Part of the module, or of the nearest package around it that has one."""
    while module:
        if module in parts:
            return parts[module]
        module = module.rpartition(".")[0]
    return None


def shares_s(counts: Mapping[str, int], *, cpu_s: float, threads_s: float) -> dict[str, float]:
    """Processor time by part, which sums up to ``cpu_s``, the part with most of it first.

    The timer is the whole process's, so samples are also taken while other threads work: the main one waits
    in its link then, and what they used is taken off that part. The rest is divided as the samples say.
    """
    samples = sum(counts.values())
    if samples == 0:
        return {REST: cpu_s}
    theirs = min(samples * threads_s / cpu_s, counts.get(LINK, 0.0)) if cpu_s else 0.0
    own = {part: count - (theirs if part == LINK else 0.0) for part, count in counts.items()}
    total = sum(own.values())
    scale_s = (cpu_s - threads_s) / total if total else 0.0
    shares = {part: scale_s * count for part, count in own.items()} | {THREADS: threads_s}
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def _queued_ns() -> int:
    """Time that the main thread has waited for a processor so far; 0 where that is not told.

    Of bytes, for a codec would be imported, and the next sample may come in the middle of that.
    """
    try:
        return int(_SCHEDULER.read_bytes().split()[1])
    except (OSError, IndexError, ValueError):
        return 0


@contextlib.contextmanager
def profiled(
    parts: Mapping[str, str], *, now_us: Callable[[], int], from_us: int | None
) -> Iterator[dict[str, Any]]:
    """Profile what is done within, unless ``from_us`` is None.

    Gives a dictionary that is empty, and afterwards has the `Profile` under `KEY`, if there is one.
    """
    told: dict[str, Any] = {}
    if from_us is None:
        yield told
        return
    profiler = Profiler(parts, now_us=now_us, from_us=from_us)
    profiler.start()
    try:
        yield told
    finally:
        profiler.stop()
    profile = profiler.profile()
    if profile is not None:
        told[KEY] = msgspec.to_builtins(profile)
