"""Finds processes of a run that are stopped, or that make no progress although they could.

A core: wall times and states of the processes are arguments, and the launcher looks a few times per second
while it waits for messages. A process that gets no processor time is not found, and neither is any if the
launcher itself did not run in the meantime (`harness.simulator.process_activity`).
"""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import psutil

from harness.simulator.process_activity import STOPPED_LIMIT_S, Activity, ProcessState
from harness.simulator.response_watchdog import COMPUTING_LIMIT_S

LOOK_PERIOD_S = 0.5
"""Wall time between two looks at the processes."""
RUN_STOPPED_LIMIT_S = STOPPED_LIMIT_S + 1.0
"""Wall time for which an indispensable process may be stopped; longer than that of a vehicle in flight."""
SILENT_LIMIT_S = 6.0
"""Wall time that a process may sleep without a message while it is to report progress, at least."""
SLOW_LIMIT_S = 8.0
"""Wall time without progress after which a process that could work is named; it may be given up later."""
_STOPPED = {
    psutil.STATUS_STOPPED: "is stopped (SIGSTOP)",
    psutil.STATUS_TRACING_STOP: "is stopped by a debugger",
}


class Finding(NamedTuple):
    """A process that keeps the run from going on, or has for some seconds."""

    name: str
    what: str
    """Predicate of a sentence."""
    status: str
    """psutil's."""
    given_up: bool = True
    """Whether the run ends; else the process may still go on."""

    @property
    def is_stopped(self) -> bool:
        """Whether the process is stopped, and not silent."""
        return self.status in _STOPPED


class ProcessWatch:
    """Looks at processes by name.

    Calls of a user's models within them may take ``call_limit_s``, after which the process ends by itself.
    """

    def __init__(self, *, call_limit_s: float = 0.0) -> None:
        self._seen: dict[str, Activity] = {}
        self._waiting_limit_s = max(SILENT_LIMIT_S, call_limit_s + 1.0)
        self._computing_limit_s = max(COMPUTING_LIMIT_S, self._waiting_limit_s)
        self._slow: set[str] = set()
        """Processes that were found slow since their last progress."""

    def on_progress(self, name: str) -> None:
        """Note progress of a process, or that it is to make progress from now on."""
        self._slow.discard(name)
        if (seen := self._seen.get(name)) is not None:
            seen.on_progress()

    def look(
        self,
        wall_s: float,
        states: Mapping[str, ProcessState],
        *,
        progressing: Collection[str] = (),
        stepping: Collection[str] = (),
    ) -> Finding | None:
        """Look at all processes now; returns the first that is found.

        ``progressing`` are those of which `on_progress` is to be called every second; ``stepping`` those of
        which it is to be called with each step of the run, for which they may have to wait. Both are found
        once if they compute, or get no processor, for `SLOW_LIMIT_S` without it.
        """
        self._seen = {name: seen for name, seen in self._seen.items() if name in states}
        for name, state in states.items():
            if name in self._seen:
                self._seen[name].look(wall_s, state)
            else:
                self._seen[name] = Activity.begin(wall_s, state)
        for name, seen in self._seen.items():
            if seen.stopped_s > RUN_STOPPED_LIMIT_S:
                return Finding(name, _STOPPED[seen.status], seen.status)
        for name in progressing:
            if (silent := self._seen.get(name)) is None:
                continue
            waiting_s, computing_s = silent.waiting_s, silent.computing_s
            if waiting_s > self._waiting_limit_s or computing_s > self._computing_limit_s:
                silent_s = max(waiting_s, computing_s)
                return Finding(name, f"has made no progress for {silent_s:.0f} s", silent.status)
        for name in (*progressing, *stepping):
            slow = self._seen.get(name)
            if slow is None or name in self._slow:
                continue
            slow_s = slow.computing_s + slow.starved_s
            if slow_s > SLOW_LIMIT_S:
                self._slow.add(name)
                what = f"has worked for {slow_s:.0f} s without progress"
                share = slow.computing_s / slow_s
                if share < 0.5:
                    what += f", with {100.0 * share:.0f} % of a processor"
                return Finding(name, what, slow.status, given_up=False)
        return None
