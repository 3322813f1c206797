"""One thread that watches many file descriptors.

Independent of the data: `harness.launch.supervisor` and `harness.launch.prefork_client` use it for a run's
children.
"""

import contextlib
import os
import queue
import selectors
import threading
from collections.abc import Callable


class DescriptorWatcher:
    """Calls back for each descriptor that is readable or has ended.

    All callbacks run one after the other on one thread, so they must not block. The thread runs from the
    first `call` until `close`.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._selector = selectors.DefaultSelector()
        self._requested: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._wake_fd: int | None = None
        """An eventfd, written to for each request."""
        self._closed = False

    def call(self, action: Callable[[], None]) -> None:
        """Run an action on the watcher's thread, in the order of the requests; from any thread.

        Does nothing once the watcher is closed.
        """
        with self._lock:
            if self._closed:
                return
            self._requested.put(action)
            if self._wake_fd is None:
                self._wake_fd = os.eventfd(0)
                self._thread = threading.Thread(target=self._run, args=(self._wake_fd,), name=self._name)
                self._thread.daemon = True
                self._thread.start()
            os.eventfd_write(self._wake_fd, 1)

    def close(self) -> None:
        """Complete all requests, then stop the thread; from any other thread. Harmless when repeated."""
        self.call(self._close)
        if self._thread is not None:
            self._thread.join()

    def watch(self, fd: int, on_readable: Callable[[], None]) -> None:
        """Call back whenever the descriptor is readable, until `forget`; only on the watcher's thread."""
        self._selector.register(fd, selectors.EVENT_READ, on_readable)

    def forget(self, fd: int) -> None:
        """Stop watching a descriptor, before it is closed; only on the watcher's thread."""
        self._selector.unregister(fd)

    def _run(self, wake_fd: int) -> None:
        self.watch(wake_fd, lambda: self._run_requests(wake_fd))
        while not self._closed:
            for key, _ in self._selector.select():
                # an earlier callback of this round may have removed it
                if self._selector.get_map().get(key.fd) is key:
                    key.data()
        self._selector.close()
        os.close(wake_fd)

    def _run_requests(self, wake_fd: int) -> None:
        """Run all requested actions."""
        os.eventfd_read(wake_fd)
        with contextlib.suppress(queue.Empty):
            while True:
                self._requested.get_nowait()()

    def _close(self) -> None:
        with self._lock:
            self._closed = True
