"""Ties the life of a process to that of its parent, by the kernel.

The end of stdin (`foundation.processes.child_protocol`) ends a child that runs and has read its settings.
This also ends one that still imports its modules, is stopped, or blocks in a library.
"""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_libc = ctypes.CDLL(None) if sys.platform == "linux" else None
"""Loaded here, so that a forked process need not."""


def end_with_parent_process(parent_pid: int) -> None:
    """Let the kernel send this process SIGKILL when its parent ends; exits if that is no longer the parent.

    The kernel means the thread of the parent that started this process: it must live as long as the parent.
    Has an effect on Linux only.
    """
    if _libc is not None:
        _libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent_pid:  # it ended before this call
        os._exit(1)
