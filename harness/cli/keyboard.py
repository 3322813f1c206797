"""Keys of the terminal that a run was started from, while it lasts.

An edge. Only where there is such a terminal, and while this process is in its foreground: who reads or sets
it from the background is stopped.
"""

import contextlib
import logging
import os
import select
import signal
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Self

LOOK_S = 0.2
"""Wall time after which the thread looks whether it is to end, and whose the terminal is."""
_LOCAL_FLAGS = 3
"""Place of the local modes in what termios.tcgetattr gives."""

logger = logging.getLogger(__name__)


class Keyboard:
    """Calls ``on_key`` with each key that is pressed, from a thread of its own, until it is closed.

    Ctrl-C and Ctrl-Z stay what they are. Without a terminal in the foreground nothing happens at all; a run
    that is sent to the background leaves the terminal alone, and hears keys again when it is back.
    """

    def __init__(self, on_key: Callable[[str], None]) -> None:
        self._on_key = on_key
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._terminal = -1
        self._before: list[Any] = []
        """Its modes, as they were found and are to be left."""

    def __enter__(self) -> Self:
        with contextlib.suppress(OSError, ValueError, termios.error):  # ValueError: stdin is closed
            terminal = sys.stdin.fileno()
            if os.isatty(terminal) and _is_ours(terminal):
                self._terminal, self._before = terminal, termios.tcgetattr(terminal)
                with _never_stopped():
                    tty.setcbreak(terminal, termios.TCSADRAIN)
                self._thread = threading.Thread(target=self._listen, name="keys", daemon=True)
                self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        if self._thread is None:
            return
        self._thread.join()
        with contextlib.suppress(OSError, termios.error), _never_stopped():
            if _is_ours(self._terminal):  # else it is as a shell wants it by now
                termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)

    @property
    def listening(self) -> bool:
        """Whether there is a terminal to listen to."""
        return self._thread is not None

    def _listen(self) -> None:
        # Signals are the main thread's: one that this thread takes, as when the terminal is closed, would not
        # wake it. Those that say that the terminal is another's would stop the process.
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        with contextlib.suppress(OSError, termios.error):  # a closed terminal says nothing
            while not self._ending.is_set():
                for key in self._pressed():
                    try:
                        self._on_key(key)
                    except Exception:
                        logger.exception("key %r", key)  # the next one may do better

    def _pressed(self) -> str:
        """Keys that were pressed, waiting `LOOK_S` at most. Raises OSError when the terminal is closed."""
        if not _is_ours(self._terminal):
            self._ending.wait(LOOK_S)
            return ""
        if termios.tcgetattr(self._terminal)[_LOCAL_FLAGS] & termios.ICANON:  # a shell has had it
            tty.setcbreak(self._terminal, termios.TCSADRAIN)
        readable, _, _ = select.select([self._terminal], [], [], LOOK_S)
        if not readable:
            return ""
        try:
            keys = os.read(self._terminal, 64)
        except OSError:
            if _is_ours(self._terminal):
                raise
            return ""  # it became another's just now
        if not keys:
            raise OSError("the terminal is closed")
        return keys.decode("ascii", "replace")


def _is_ours(terminal: int) -> bool:
    """Whether this process is in the terminal's foreground. Raises OSError for one that is closed."""
    return os.tcgetpgrp(terminal) == os.getpgrp()


@contextlib.contextmanager
def _never_stopped() -> Iterator[None]:
    """Have what this thread does to a terminal that is another's fail, and not stop the whole process."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTIN, signal.SIGTTOU})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
