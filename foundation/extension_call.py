"""Calls of the user's code in flight: exceptions become `ExtensionFailure`, endless calls are ended.

Each caller has an `ExtensionCall`, which it enters around every call. `watched` observes the calls of its
thread from another one. Of a call that does not return, it raises an exception in the call; that ends every
loop of Python, but no call that blocks or computes outside of Python: ``on_stuck`` is called for these. Of
calls that increase the memory of the process too much, it ends the caller with the largest increase.
"""

import contextlib
import ctypes
import faulthandler
import os
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from resource import getpagesize
from types import TracebackType
from typing import NoReturn

from foundation.extension_failure import ExtensionFailure, failure

PERIOD_S = 0.25
"""Wall time between two looks at the present call."""
MOST_BYTES = 1 << 30
"""Increase of the process's memory in flight beyond which a caller is ended."""
MEASURED_BYTES = MOST_BYTES // 2
"""Increase beyond which that of each call is measured."""
ENDED_SHARE, STUCK_SHARE = 0.6, 0.9
"""Shares of the limit after which a call is ended, and after which it is stuck."""
FAILED_STATUS = 2
"""Exit status of a process after a failure of the user's code."""
_PAGE_BYTES = getpagesize()


class CallEnded(BaseException):
    """Raised in the user's code, to end it; no Exception, because code may catch all of those."""


class _Thread:
    """The calls of one thread."""

    def __init__(self) -> None:
        self.ident = threading.get_ident()
        self.call: ExtensionCall | None = None
        """The present call."""
        self.entries = 0
        """Calls so far: distinguishes two calls of one caller."""
        self.measured: set[ExtensionCall] | None = None
        """Callers since the memory is measured; None: it is not."""


class _Local(threading.local):
    def __init__(self) -> None:
        self.thread = _Thread()


_LOCAL = _Local()


class ExtensionCall:
    """Calls of one object of the user, in the thread that creates this; a context manager, not nested.

    ``title`` begins the lines of its failures, such as ``autopilot.controller my_package.control:Lqr``.
    Raises ExtensionFailure in place of an exception of the code.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.grown_bytes = 0
        """Memory that its calls have taken since it is measured."""
        self.ended: str | None = None
        """Why its next call is refused."""
        self._thread = _LOCAL.thread
        self._before_bytes = 0

    def __enter__(self) -> None:
        """Begin a call."""
        thread = self._thread
        if self.ended is not None:
            raise ExtensionFailure(f"{self.title}: {self.ended}")
        if thread.measured is not None:
            thread.measured.add(self)
            self._before_bytes = memory_bytes()
        thread.entries += 1
        thread.call = self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the call; raises ExtensionFailure for an exception of the code."""
        thread = self._thread
        thread.call = None
        if thread.measured is not None and self._before_bytes:
            self.grown_bytes += memory_bytes() - self._before_bytes
        if error is None or isinstance(error, ExtensionFailure):
            return
        if isinstance(error, Exception | CallEnded):
            raise failure(self.title, error) from error

    def refused(self, what: str) -> ExtensionFailure:
        """Return the failure for a wrong value that the code has returned."""
        return ExtensionFailure(f"{self.title}: {what}")


@contextlib.contextmanager
def watched(limit_s: float, *, on_stuck: Callable[[str], None]) -> Iterator[None]:
    """Watch the calls of this thread in the block.

    Args:
        limit_s: Wall time within which a call must return, without the time in which the process is stopped
            or its thread gets no processor.
        on_stuck: Receives a line, in another thread, if a call cannot be ended.

    """
    done = threading.Event()
    scheduling = partial(_scheduling_s, threading.get_native_id())
    watch = threading.Thread(
        target=_watch, args=(_LOCAL.thread, scheduling, limit_s, on_stuck, done), name="calls", daemon=True
    )
    watch.start()
    try:
        yield
    finally:
        done.set()
        watch.join()


def end_stuck(program: str, line: str) -> NoReturn:
    """End this process: all threads' traces and the line are written to stderr; for `watched`."""
    faulthandler.dump_traceback(sys.stderr)
    sys.stderr.write(f"{program}: {line}\n")
    sys.stderr.flush()
    os._exit(FAILED_STATUS)


def memory_bytes() -> int:
    """Return the resident memory of this process."""
    return int(Path("/proc/self/statm").read_bytes().split()[1]) * _PAGE_BYTES


def _scheduling_s(native_id: int) -> tuple[float, float]:
    """Return the times so far in which a thread had a processor, and in which it could run and had none.

    Both are 0 where they are not known.
    """
    try:
        fields = Path(f"/proc/self/task/{native_id}/schedstat").read_bytes().split()
        return int(fields[0]) * 1e-9, int(fields[1]) * 1e-9
    except (OSError, IndexError):
        return 0.0, 0.0


def _watch(
    thread: _Thread,
    scheduling: Callable[[], tuple[float, float]],
    limit_s: float,
    on_stuck: Callable[[str], None],
    done: threading.Event,
) -> None:
    """Look at the present call periodically; adds the periods, of which a stopped process has none."""
    entries, call_s, most_bytes = -1, 0.0, memory_bytes() + MOST_BYTES
    ran_s, starved_s = scheduling()
    while not done.wait(PERIOD_S):
        call, ran_before_s, starved_before_s = thread.call, ran_s, starved_s
        ran_s, starved_s = scheduling()
        is_same = call is not None and thread.entries == entries
        counted_s = max(ran_s - ran_before_s, PERIOD_S - (starved_s - starved_before_s))
        call_s = call_s + counted_s if is_same else 0.0
        entries = thread.entries
        if call is not None and call_s >= STUCK_SHARE * limit_s:
            on_stuck(f"{call.title}: a call has not returned for {call_s:.1f} s, and cannot be ended")
            return
        if call is not None and call_s >= ENDED_SHARE * limit_s:
            _end(thread, call, f"the call has not returned for {call_s:.1f} s")
        used_bytes = memory_bytes()
        if thread.measured is None and used_bytes > most_bytes - MEASURED_BYTES:
            thread.measured = set()
        if thread.measured is not None and used_bytes > most_bytes:
            grown = max(thread.measured, key=lambda each: each.grown_bytes, default=None)
            largest = call if is_same else grown
            if largest is not None:
                most_bytes = used_bytes + MOST_BYTES
                largest.ended = f"its calls have taken more than {MOST_BYTES >> 20} MiB of memory"
                _end(thread, largest, largest.ended)


def _end(thread: _Thread, call: ExtensionCall, what: str) -> None:
    """Raise CallEnded in the present call, if it is this one."""
    if thread.call is call:
        kind = type("CallEnded", (CallEnded,), {"__str__": lambda _: what})
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident), ctypes.py_object(kind))
