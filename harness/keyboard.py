"""Keys of the terminal that a run was started from, while it lasts.

An edge. Only where there is such a terminal and this process is in its foreground: reading it from the
background would stop the process.
"""

import contextlib
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable
from types import TracebackType
from typing import Self

LOOK_S = 0.2
"""Wall time after which the thread looks whether it is to end."""


class Keyboard:
    """Calls ``on_key`` with each key that is pressed, from a thread of its own, until it is closed.

    Ctrl-C stays what it is. Without a terminal in the foreground nothing happens at all.
    """

    def __init__(self, on_key: Callable[[str], None]) -> None:
        self._on_key = on_key
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._restore: Callable[[], None] | None = None

    def __enter__(self) -> Self:
        with contextlib.suppress(OSError, ValueError, termios.error):  # ValueError: stdin is closed
            terminal = sys.stdin.fileno()
            if os.isatty(terminal) and os.tcgetpgrp(terminal) == os.getpgrp():
                before = termios.tcgetattr(terminal)
                self._restore = lambda: termios.tcsetattr(terminal, termios.TCSADRAIN, before)
                tty.setcbreak(terminal, termios.TCSADRAIN)
                self._thread = threading.Thread(target=self._read, args=(terminal,), name="keys", daemon=True)
                self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
        if self._restore is not None:
            with contextlib.suppress(OSError, termios.error):
                self._restore()

    @property
    def listening(self) -> bool:
        """Whether there is a terminal to listen to."""
        return self._thread is not None

    def _read(self, terminal: int) -> None:
        with contextlib.suppress(OSError):  # a terminal that was closed says nothing more
            while not self._ending.is_set():
                readable, _, _ = select.select([terminal], [], [], LOOK_S)
                if readable:
                    keys = os.read(terminal, 64)
                    if not keys:
                        return
                    for key in keys.decode("ascii", "replace"):
                        self._on_key(key)
