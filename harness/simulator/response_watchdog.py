"""How long a vehicle that does not answer is waited for.

A machine under load starves processes for seconds; a run must not come out differently for it. So silence
counts only while the process could have answered: stopped or dead it is given up at once; runnable but
without a processor its silence does not count; sleeping or computing it does, for nobody else can keep a
vehicle from answering: what its radio has brought is there before it is told so.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import psutil

LOOK_AFTER_S = 0.25
"""Silences shorter than this are nothing; from then on the process is looked at."""
REPORT_AFTER_S = 0.5
STARTING_LIMIT_S = 120.0
"""Before its first answer a vehicle may be compiling its kernels; that is no news either."""
COMPUTING_LIMIT_S = 30.0
"""One that computes may come to an end: what loops forever cannot be told from what takes long."""
LEAST_SHARE = 0.25
"""Part of a processor that tells computing from waiting, and below which a runnable process is starved."""
_HELD = {psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP}
_GONE = _HELD | {psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD}
_NOBODY: Mapping[int, float] = {}


@dataclass(frozen=True, slots=True, kw_only=True)
class SilenceFinding:
    """What to do about one silent vehicle."""

    wall_silence_s: float
    newly_silent: bool
    give_up: str | None
    """Reason, if it is to be waited for no longer."""


@dataclass(slots=True, kw_only=True)
class _Observation:
    """What the last look at a silent vehicle's process showed."""

    wall_s: float
    cpu_s: float
    waiting_s: float = 0.0
    computing_s: float = 0.0
    """Silence that counts against it, by what it did."""
    reported: bool = False


class ResponseWatchdog:
    """Judges silences against the processes behind them.

    A vehicle of unknown process id gets the plain limit.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._processes: dict[int, psutil.Process] = {}
        self._wall_begin_s = 0.0
        self._since_s: Mapping[int, float] = _NOBODY
        self._looked: dict[int, _Observation] = {}

    def set_pid(self, instance: int, pid: int) -> None:
        """Name the process of a vehicle; one that is gone counts as unknown."""
        try:
            self._processes[instance] = psutil.Process(pid)
        except psutil.NoSuchProcess:
            self._processes.pop(instance, None)

    def begin(self, wall_s: float, *, silent_since_s: Mapping[int, float] = _NOBODY) -> None:
        """Start of a wait for all vehicles; ``silent_since_s`` is of those whose silence goes on in it."""
        self._wall_begin_s = wall_s
        self._since_s = silent_since_s
        if silent_since_s:
            self._looked = {i: looked for i, looked in self._looked.items() if i in silent_since_s}
        else:
            self._looked.clear()

    def judge(self, instance: int, wall_s: float, *, starting: bool) -> SilenceFinding:
        """Decide on a vehicle that has not answered since `begin`; called a few times per second."""
        silence_s = wall_s - self._since_s.get(instance, self._wall_begin_s)
        if silence_s < LOOK_AFTER_S:
            return SilenceFinding(wall_silence_s=silence_s, newly_silent=False, give_up=None)
        status, cpu_s = self._look(instance)
        if status in _GONE:
            return SilenceFinding(
                wall_silence_s=silence_s, newly_silent=True, give_up=f"its process is {status}"
            )
        looked = self._looked.get(instance)
        if looked is None:
            self._looked[instance] = _Observation(wall_s=wall_s, cpu_s=cpu_s)
            return SilenceFinding(wall_silence_s=silence_s, newly_silent=False, give_up=None)
        elapsed_s = wall_s - looked.wall_s
        share = (cpu_s - looked.cpu_s) / elapsed_s if elapsed_s > 0.0 else 0.0
        looked.wall_s, looked.cpu_s = wall_s, cpu_s
        starved = status == psutil.STATUS_RUNNING and share < LEAST_SHARE
        if share >= LEAST_SHARE:
            looked.computing_s += elapsed_s
        elif not starved:
            looked.waiting_s += elapsed_s
        newly = not looked.reported and not starved and not starting and silence_s >= REPORT_AFTER_S
        looked.reported |= newly
        limit_s = STARTING_LIMIT_S if starting else self._limit_s
        over = looked.waiting_s > limit_s or looked.computing_s > max(limit_s, COMPUTING_LIMIT_S)
        reason = f"it has not answered for {silence_s:.1f} s" if over else None
        return SilenceFinding(wall_silence_s=silence_s, newly_silent=newly, give_up=reason)

    def _look(self, instance: int) -> tuple[str, float]:
        process = self._processes.get(instance)
        if process is None:
            return "unknown", 0.0
        try:
            with process.oneshot():
                times = process.cpu_times()
                return process.status(), times.user + times.system
        except psutil.NoSuchProcess:
            return psutil.STATUS_DEAD, 0.0
