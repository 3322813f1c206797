"""A queue between threads whose reader waits for other files too."""

import os
import queue
from typing import TypeVar

T = TypeVar("T")


class WakeableQueue(queue.SimpleQueue[T]):
    """A queue that makes a file descriptor readable while it may hold items; for one reader."""

    def __init__(self) -> None:
        self._wake_fd = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._wake_fd

    def put(self, item: T, block: bool = True, timeout: float | None = None) -> None:  # noqa: FBT001, FBT002
        """Add an item and wake the reader; the other arguments have no effect, as of `queue.SimpleQueue`."""
        super().put(item, block, timeout)
        os.eventfd_write(self._wake_fd, 1)

    def take_all(self) -> list[T]:
        """Return all items, in order, without waiting."""
        try:
            os.eventfd_read(self._wake_fd)
        except BlockingIOError:
            return []
        items = []
        try:
            while True:
                items.append(self.get_nowait())
        except queue.Empty:
            return items
