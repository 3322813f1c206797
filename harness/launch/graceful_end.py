"""Wait for processes that have been asked to end, while a loaded machine lets them.

The wall time of a process that gets no processor time does not count, as in
`harness.simulator.response_watchdog`; one that computes, because it writes its records, has more of it. One
that is stopped though it has been continued is given up within a second.
"""

import threading
import time
from collections.abc import Mapping

import psutil

from harness.simulator.response_watchdog import ResponseWatchdog

POLL_S = 0.25
LONGEST_S = 40.0
"""Limit of the whole wait, wall time, whatever the processes get."""


def wait_for_ends(ends: Mapping[int, threading.Event], limit_s: float) -> None:
    """Wait until all processes have ended, by process id and event of its end, or have had their time."""
    watchdog = ResponseWatchdog(limit_s, stopped_limit_s=POLL_S)
    begin_s = wall_s = time.monotonic()
    watchdog.begin(begin_s)
    for pid in ends:
        watchdog.set_pid(pid, pid)
    remaining = dict(ends)
    while remaining and wall_s - begin_s < LONGEST_S:
        next(iter(remaining.values())).wait(POLL_S)
        wall_s = time.monotonic()
        remaining = {
            pid: ended
            for pid, ended in remaining.items()
            if not ended.is_set() and not (_runs(pid) and _is_over(watchdog, pid, wall_s))
        }


def _runs(pid: int) -> bool:
    """Whether a process has not ended; the event of one that has is about to be set."""
    try:
        return bool(psutil.Process(pid).status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD))
    except psutil.NoSuchProcess:
        return False


def _is_over(watchdog: ResponseWatchdog, pid: int, wall_s: float) -> bool:
    return watchdog.check(pid, wall_s, starting=False).give_up is not None
