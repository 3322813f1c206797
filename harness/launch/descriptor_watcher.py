"""One thread that listens to many file descriptors, where each would need a thread of its own to wait at it.

Knows nothing of what is read: `harness.launch.supervisor` and `harness.launch.prefork_client` hear a run's
children with it.
"""

import contextlib
import os
import queue
import selectors
import threading
from collections.abc import Callable


class DescriptorWatcher:
    """Calls back for each descriptor that has something to be read, or has ended.

    All calls are made on one thread, one after the other, so they must not wait. The thread is there from the
    first `call` on until `close`.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._selector = selectors.DefaultSelector()
        self._asked: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._bell: int | None = None
        """An eventfd, written to when something is asked."""
        self._closed = False

    def call(self, action: Callable[[], None]) -> None:
        """From any thread: have something done on the listener's, in the order in which it is asked.

        Once the listener is closed nothing is done.
        """
        with self._lock:
            if self._closed:
                return
            self._asked.put(action)
            if self._bell is None:
                self._bell = os.eventfd(0)
                self._thread = threading.Thread(target=self._run, args=(self._bell,), name=self._name)
                self._thread.daemon = True
                self._thread.start()
            os.eventfd_write(self._bell, 1)

    def close(self) -> None:
        """From any other thread: do what has been asked, then listen no more. Harmless when repeated."""
        self.call(self._close)
        if self._thread is not None:
            self._thread.join()

    def watch(self, fd: int, on_readable: Callable[[], None]) -> None:
        """On its thread: call back whenever there is something to be read, until `forget`."""
        self._selector.register(fd, selectors.EVENT_READ, on_readable)

    def forget(self, fd: int) -> None:
        """On its thread: watch it no more; to be done before it is closed."""
        self._selector.unregister(fd)

    def _run(self, bell: int) -> None:
        self.watch(bell, lambda: self._answer(bell))
        while not self._closed:
            for key, _ in self._selector.select():
                # what came before in the same round may have had it forgotten
                if self._selector.get_map().get(key.fd) is key:
                    key.data()
        self._selector.close()
        os.close(bell)

    def _answer(self, bell: int) -> None:
        """Do what has been asked."""
        os.eventfd_read(bell)
        with contextlib.suppress(queue.Empty):
            while True:
                self._asked.get_nowait()()

    def _close(self) -> None:
        with self._lock:
            self._closed = True
