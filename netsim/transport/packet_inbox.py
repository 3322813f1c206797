"""Messages with packets between Zenoh's thread, which adds them, and the threads that take them."""

import contextlib
import threading
from collections import deque


class PacketInbox:
    """Messages in their order of arrival.

    At most ``most_waiting`` messages with ``most_bytes`` wait: further ones are dropped and counted. One
    thread adds messages; at any time one thread takes them, and one waits.
    """

    def __init__(self, *, most_waiting: int, most_bytes: int) -> None:
        self._most_waiting, self._most_bytes = most_waiting, most_bytes
        self._messages: deque[bytes] = deque()
        self._put_bytes = self._taken_bytes = 0
        """Each is written by one thread at a time."""
        self.dropped = 0
        """Number of messages that found it full."""
        self._idle = threading.Lock()
        """Unlocked by `wake`, and locked again at the end of `wait`."""
        self._idle.acquire()

    def put(self, payload: bytes) -> None:
        """Add a message, or drop and count it; does not wake the waiting thread."""
        waiting_bytes = self._put_bytes - self._taken_bytes + len(payload)
        if len(self._messages) >= self._most_waiting or waiting_bytes > self._most_bytes:
            self.dropped += 1
            return
        self._put_bytes += len(payload)
        self._messages.append(payload)

    def take(self) -> bytes | None:
        """Return the next message at once; None without any."""
        if not self._messages:
            return None
        payload = self._messages.popleft()
        self._taken_bytes += len(payload)
        return payload

    def wait(self, wall_limit_s: float) -> None:
        """Wait until `wake` has been called since the last wait, or for ``wall_limit_s``."""
        self._idle.acquire(timeout=wall_limit_s)

    def wake(self) -> None:
        """End the present or the next wait; called by the thread that adds messages."""
        with contextlib.suppress(RuntimeError):  # the last call has not ended a wait yet
            self._idle.release()
