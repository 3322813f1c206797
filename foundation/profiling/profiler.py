"""Sampling profiler of a process's CPU time by part.

The operating system interrupts the process after every few milliseconds of CPU time, and the sample is
attributed to the part whose module is innermost on the stack. So parts are defined by a table of modules, no
function is wrapped, a run without profiling has no cost, and one with profiling costs 3 us in 4 ms. A few
thousand samples resolve shares to 1 %. Compiled code and system calls are attributed to their caller.

It reads the wall clock, so it must not be used in the simulation itself.
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
"""Part in which a process waits for others: system calls of its sockets and pipes."""
REST = "other"
"""Samples outside all parts."""
THREADS = "Zenoh's threads"
"""CPU time of all threads except the main one."""
KEY = "profile"
"""Key of the `Profile` in `foundation.processes.child_protocol.Finished.details`."""
PERIOD_S = 0.001
"""CPU time between two samples; at least one tick of the operating system."""
_SCHEDULER = Path("/proc/self/schedstat")


class Profile(Struct, frozen=True, kw_only=True):
    """Times of one process from the first sample to the last."""

    simulated_s: float
    wall_s: float
    cpu_s: float
    parts_cpu_s: dict[str, float]
    """CPU time by part; the sum is ``cpu_s``"""
    waiting_s: float
    """Wall time in which the main thread was waiting"""
    queueing_s: float
    """Wall time in which it was runnable but not running; included in waiting where unavailable"""
    samples: int


class KindProfile(Struct, frozen=True, kw_only=True):
    """Profile of all processes of one kind."""

    processes: int
    """Number of processes that reported."""
    cpu_s_per_simulated_s: float
    """Sum of all processes."""
    parts_cpu_s_per_simulated_s: dict[str, float]
    """Its parts, the largest first."""
    waiting_fraction: float
    """Fraction of wall time in which a process was idle; mean of the processes."""
    queueing_fraction: float
    """Fraction in which it was ready but not running; included in waiting if the system does not report
    it."""
    samples: int


class _Mark(Struct, frozen=True):
    """Readings of all clocks at one instant."""

    simulated_us: int
    wall_ns: int
    process_ns: int
    thread_ns: int


class Profiler:
    """Samples the main thread, which must create it, between `start` and `stop`.

    ``parts`` maps names of modules and packages to parts; other modules are attributed to the part of their
    caller. Samples count from when ``now_us()``, the simulated time, has reached ``from_us``.
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
        """Start sampling."""
        signal.signal(signal.SIGPROF, self._sample)
        signal.setitimer(signal.ITIMER_PROF, PERIOD_S, PERIOD_S)

    def stop(self) -> None:
        """Stop sampling."""
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, signal.SIG_IGN)  # a signal may be pending

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
        """Return the part of the innermost frame that belongs to one."""
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
        """Return the result; None without two samples."""
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
    """Return the part of a module, or of its nearest parent package with a part; else None."""
    while module:
        if module in parts:
            return parts[module]
        module = module.rpartition(".")[0]
    return None


def shares_s(counts: Mapping[str, int], *, cpu_s: float, threads_s: float) -> dict[str, float]:
    """Return the CPU time by part, largest first, with the sum ``cpu_s``.

    The timer counts the whole process, so samples are also taken while other threads run and the main one
    waits in its link: their time is subtracted from that part. The rest is divided in proportion to samples.
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
    """Return the time that the main thread has waited for a processor so far; 0 where unavailable.

    It reads bytes, since decoding may import a codec, and the next sample may interrupt that import.
    """
    try:
        return int(_SCHEDULER.read_bytes().split()[1])
    except (OSError, IndexError, ValueError):
        return 0


@contextlib.contextmanager
def profiled(
    parts: Mapping[str, str], *, now_us: Callable[[], int], from_us: int | None
) -> Iterator[dict[str, Any]]:
    """Profile the body of the with statement, unless ``from_us`` is None.

    Yields an empty dictionary, which afterwards contains the `Profile` under `KEY`, if there is one.
    """
    details: dict[str, Any] = {}
    if from_us is None:
        yield details
        return
    profiler = Profiler(parts, now_us=now_us, from_us=from_us)
    profiler.start()
    try:
        yield details
    finally:
        profiler.stop()
    profile = profiler.profile()
    if profile is not None:
        details[KEY] = msgspec.to_builtins(profile)
