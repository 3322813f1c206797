"""Starts processes from threads that live as long as this process.

A child that `foundation.processes.parent_death` binds to its parent ends with the thread that started it, and
a swarm may be started by a thread that ends before the swarm. A child inherits the processors and the
niceness of its thread, so there is a thread for each that callers have had; it inherits the caller's.
"""

import os
import queue
import subprocess
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

_Request = Callable[[], None]
_Scheduling = tuple[frozenset[int], int]
"""Processors and niceness, which Linux has for each thread."""


class _Spawner:
    """Daemon threads; a forked process, which has none of its parent's threads, starts others."""

    def __init__(self) -> None:
        self._begin_again()
        os.register_at_fork(after_in_child=self._begin_again)

    def _begin_again(self) -> None:
        self._lock = threading.Lock()
        self._requests: dict[_Scheduling, queue.SimpleQueue[_Request]] = {}
        """Of the threads by what they inherited."""

    def popen(self, command: Sequence[str], options: dict[str, Any]) -> "subprocess.Popen[bytes]":
        """Start a process on a thread as the caller's; raises the errors of `subprocess.Popen`."""
        started: Future[subprocess.Popen[bytes]] = Future()

        def start() -> None:
            try:
                started.set_result(subprocess.Popen(command, **options))
            except BaseException as error:  # noqa: BLE001  raised in the caller
                started.set_exception(error)

        scheduling = frozenset(os.sched_getaffinity(0)), os.getpriority(os.PRIO_PROCESS, 0)
        with self._lock:
            requests = self._requests.get(scheduling)
            if requests is None:
                requests = queue.SimpleQueue()
                threading.Thread(target=self._serve, args=(requests,), name="spawner", daemon=True).start()
                self._requests[scheduling] = requests
        requests.put(start)
        return started.result()

    @staticmethod
    def _serve(requests: "queue.SimpleQueue[_Request]") -> None:
        while True:
            requests.get()()


_spawner = _Spawner()


def spawn(command: Sequence[str], **options: Any) -> "subprocess.Popen[bytes]":  # noqa: ANN401  those of Popen
    """Start a process as `subprocess.Popen` does, from a thread that ends only with this process.

    It has the processors and the niceness of the calling thread.
    """
    return _spawner.popen(command, options)
