"""Starts processes from a thread that lives as long as this process.

A child that `foundation.processes.parent_death` binds to its parent ends with the thread that started it, and
a swarm may be started by a thread that ends before the swarm.
"""

import os
import queue
import subprocess
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

_Request = Callable[[], None]


class _Spawner:
    """One daemon thread; a forked process, which has none of its parent's threads, starts another."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._requests: queue.SimpleQueue[_Request] = queue.SimpleQueue()
        self._thread_pid = 0
        """Process whose thread serves the queue."""
        os.register_at_fork(after_in_child=self._begin_again)

    def _begin_again(self) -> None:
        self._lock, self._requests, self._thread_pid = threading.Lock(), queue.SimpleQueue(), 0

    def popen(self, command: Sequence[str], options: dict[str, Any]) -> "subprocess.Popen[bytes]":
        """Start a process on the thread; raises the errors of `subprocess.Popen`."""
        started: Future[subprocess.Popen[bytes]] = Future()

        def start() -> None:
            try:
                started.set_result(subprocess.Popen(command, **options))
            except BaseException as error:  # noqa: BLE001  raised in the caller
                started.set_exception(error)

        with self._lock:
            if self._thread_pid != os.getpid():
                self._thread_pid = os.getpid()
                threading.Thread(
                    target=self._serve, args=(self._requests,), name="spawner", daemon=True
                ).start()
        self._requests.put(start)
        return started.result()

    @staticmethod
    def _serve(requests: "queue.SimpleQueue[_Request]") -> None:
        while True:
            requests.get()()


_spawner = _Spawner()


def spawn(command: Sequence[str], **options: Any) -> "subprocess.Popen[bytes]":  # noqa: ANN401  those of Popen
    """Start a process as `subprocess.Popen` does, from a thread that ends only with this process."""
    return _spawner.popen(command, options)
