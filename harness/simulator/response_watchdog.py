"""Response watchdog: decides how long to wait for a vehicle that does not answer.

A machine under load starves processes for seconds, and the result of a run must not depend on that. Silence
therefore counts only while the process could have answered. A process that is stopped or dead is given up at
once. Silence of one that is runnable but starved does not count. Silence of one that sleeps or computes
counts, because a vehicle waits for nothing but its sensors: its radio's deliveries precede their notice.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import psutil

LOOK_AFTER_S = 0.25
"""Shorter silences are ignored; from then on the process is examined."""
REPORT_AFTER_S = 0.5
STARTING_LIMIT_S = 120.0
"""Limit before a vehicle's first answer: it may be compiling its kernels. Such a silence is not reported."""
COMPUTING_LIMIT_S = 30.0
"""Least limit for a process that computes: an endless loop and a long computation look the same."""
LEAST_SHARE = 0.25
"""Share of a processor: above it a process computes; below it a runnable process is starved."""
_HELD = {psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP}
_GONE = _HELD | {psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD}
_NO_SILENCES: Mapping[int, float] = {}


@dataclass(frozen=True, slots=True, kw_only=True)
class SilenceFinding:
    """Result of checking one silent vehicle."""

    wall_silence_s: float
    newly_silent: bool = False
    give_up: str | None = None
    """Reason to remove the vehicle; None: continue to wait."""


@dataclass(slots=True, kw_only=True)
class _Observation:
    """State of a silent vehicle's process at its last check."""

    wall_s: float
    cpu_s: float
    waiting_s: float = 0.0
    computing_s: float = 0.0
    """Silence that counts, by what the process did."""
    reported: bool = False


class ResponseWatchdog:
    """Decides on silent vehicles by the state of their processes.

    A vehicle whose process id is unknown is given up after ``limit_s`` of silence.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._processes: dict[int, psutil.Process] = {}
        self._wall_begin_s = 0.0
        self._since_s: Mapping[int, float] = _NO_SILENCES
        self._observations: dict[int, _Observation] = {}

    def set_pid(self, instance: int, pid: int) -> None:
        """Set the process id of a vehicle; a process that does not exist counts as unknown."""
        try:
            self._processes[instance] = psutil.Process(pid)
        except psutil.NoSuchProcess:
            self._processes.pop(instance, None)

    def begin(self, wall_s: float, *, silent_since_s: Mapping[int, float] = _NO_SILENCES) -> None:
        """Begin a wait for all vehicles; ``silent_since_s``: starts of silences that continue in it."""
        self._wall_begin_s = wall_s
        self._since_s = silent_since_s
        if silent_since_s:
            self._observations = {i: seen for i, seen in self._observations.items() if i in silent_since_s}
        else:
            self._observations.clear()

    def check(self, instance: int, wall_s: float, *, starting: bool) -> SilenceFinding:
        """Decide on a vehicle that has not answered since `begin`; call this a few times per second."""
        silence_s = wall_s - self._since_s.get(instance, self._wall_begin_s)
        if silence_s < LOOK_AFTER_S:
            return SilenceFinding(wall_silence_s=silence_s)
        status, cpu_s = self._process_state(instance)
        if status in _GONE:
            give_up = f"its process is {status}"
            return SilenceFinding(wall_silence_s=silence_s, newly_silent=True, give_up=give_up)
        last = self._observations.get(instance)
        if last is None:
            self._observations[instance] = _Observation(wall_s=wall_s, cpu_s=cpu_s)
            return SilenceFinding(wall_silence_s=silence_s)
        elapsed_s = wall_s - last.wall_s
        share = (cpu_s - last.cpu_s) / elapsed_s if elapsed_s > 0.0 else 0.0
        last.wall_s, last.cpu_s = wall_s, cpu_s
        starved = status == psutil.STATUS_RUNNING and share < LEAST_SHARE
        if share >= LEAST_SHARE:
            last.computing_s += elapsed_s
        elif not starved:
            last.waiting_s += elapsed_s
        newly = not last.reported and not starved and not starting and silence_s >= REPORT_AFTER_S
        last.reported |= newly
        limit_s = STARTING_LIMIT_S if starting else self._limit_s
        over = last.waiting_s > limit_s or last.computing_s > max(limit_s, COMPUTING_LIMIT_S)
        reason = f"it has not answered for {silence_s:.1f} s" if over else None
        return SilenceFinding(wall_silence_s=silence_s, newly_silent=newly, give_up=reason)

    def _process_state(self, instance: int) -> tuple[str, float]:
        process = self._processes.get(instance)
        if process is None:
            return "unknown", 0.0
        try:
            with process.oneshot():
                times = process.cpu_times()
                return process.status(), times.user + times.system
        except psutil.NoSuchProcess:
            return psutil.STATUS_DEAD, 0.0
