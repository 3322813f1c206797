"""Scheduling policy of the processes that a simulator serves."""

import contextlib
import ctypes
import os
import sys

_PR_SET_TIMERSLACK = 29  # linux/prctl.h


def yield_when_woken() -> None:
    """Let this process and its later children preempt no other process when they are woken.

    The physics server wakes a vehicle, and a vehicle its own threads, by writes to several of them in a row:
    without this policy the first to be woken displaces the writer, which has yet to wake the others.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # not permitted in some sandboxes; only slower
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def run_when_idle() -> None:
    """Let this process and its later children run only while no other process needs their processor."""
    with contextlib.suppress(OSError):
        os.nice(19)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def end_waits_on_time() -> None:
    """Let the time-outs of this thread's waits end when they are due.

    By default Linux ends them up to 50 us later, together with other timers. Has an effect on Linux only.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)  # ns; 0 would set the default
