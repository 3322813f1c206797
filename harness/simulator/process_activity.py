"""What a process does while it is waited for: whether it is stopped, waits, computes, or gets no processor.

A core: times and states of the process are arguments. A machine under load starves processes for seconds, and
a run must not depend on that, so of a runnable process that gets no processor only its processor time counts.
"""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import psutil

LEAST_SHARE = 0.25
"""Share of a processor: above it a process computes; below it a runnable process is starved."""
BREAK_S = 1.5
"""Longer wall time between two looks: the observer itself did not run, so the observation begins again."""
HELD_UP_LIMIT_S = 60.0
"""Longest wall time for which the sleep of a process does not count because another one holds it up."""
STOPPED_LIMIT_S = 3.0
"""Wall time for which a process may be stopped: by a debugger, or for the suspension of a machine."""
HELD = frozenset({psutil.STATUS_STOPPED, psutil.STATUS_TRACING_STOP})
ENDED = frozenset({psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD})


class ProcessState(NamedTuple):
    """State of a process at one time."""

    status: str
    """One of psutil's."""
    cpu_s: float
    """Processor time of all its threads so far."""


DEAD = ProcessState(psutil.STATUS_DEAD, 0.0)


@dataclass(slots=True, kw_only=True)
class Activity:
    """Wall times since the observation of a process began, by what it did."""

    wall_s: float
    """Time of the newest look."""
    cpu_s: float
    status: str
    stopped_s: float = 0.0
    """Since it was stopped; 0 if it is not."""
    waiting_s: float = 0.0
    """It slept, and could have worked."""
    held_up_s: float = 0.0
    """It slept while another process, for which it may wait, had work; at most `HELD_UP_LIMIT_S`."""
    computing_s: float = 0.0
    """It computed, or waited for a disk; while it was starved, its processor time."""
    starved_s: float = 0.0
    """It was runnable and got no processor, without its processor time."""
    starved: bool = False
    """Whether it was runnable and got no processor before the newest look."""

    @classmethod
    def begin(cls, wall_s: float, state: ProcessState) -> "Activity":
        """Return the observation of a process that begins now."""
        return cls(wall_s=wall_s, cpu_s=state.cpu_s, status=state.status)

    def look(self, wall_s: float, state: ProcessState, *, held_up: bool = False) -> None:
        """Add the time since the last look, which counts as what the process is found to do now.

        ``held_up``: a process for which it may wait has work.
        """
        elapsed_s, spent_s = wall_s - self.wall_s, state.cpu_s - self.cpu_s
        self.wall_s, self.cpu_s, self.status = wall_s, state.cpu_s, state.status
        self.starved = False
        if elapsed_s > BREAK_S:
            self.on_progress()
            self.stopped_s = 0.0
            return
        share = spent_s / elapsed_s if elapsed_s > 0.0 else 0.0
        self.stopped_s = self.stopped_s + elapsed_s if state.status in HELD else 0.0
        if state.status in HELD:
            return
        self.starved = state.status == psutil.STATUS_RUNNING and share < LEAST_SHARE
        if share >= LEAST_SHARE or state.status == psutil.STATUS_DISK_SLEEP:
            self.computing_s += elapsed_s
        elif self.starved:
            self.computing_s += spent_s
            self.starved_s += elapsed_s - spent_s
        elif held_up and self.held_up_s < HELD_UP_LIMIT_S:
            self.held_up_s += elapsed_s
        else:
            self.waiting_s += elapsed_s

    def on_progress(self) -> None:
        """Begin the times without progress again."""
        self.waiting_s = self.held_up_s = self.computing_s = self.starved_s = 0.0


def state_of(process: psutil.Process) -> ProcessState:
    """Return the present state of a process; ``dead`` if it does not exist."""
    try:
        with process.oneshot():
            times = process.cpu_times()
            return ProcessState(process.status(), times.user + times.system)
    except psutil.NoSuchProcess:
        return DEAD


def has_work(pid: int) -> bool:
    """Return whether a thread of a process runs, would run if it got a processor, or waits for a disk."""
    with contextlib.suppress(OSError):  # it ends meanwhile
        for thread in Path(f"/proc/{pid}/task").iterdir():
            # pid (name) state ...; the name may have spaces and parentheses
            if (thread / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[
                0
            ] in "RD":
                return True
    return False
