"""Key presses during a run, from the terminal that started it.

An I/O module. Works only with a terminal and while this process is in its foreground: a background process
that reads or configures the terminal is stopped by the kernel.
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
from typing import Any, Self

LOOK_S = 0.2
"""Wall time after which the thread checks for its end and for the terminal's foreground process."""
_LOCAL_FLAGS = 3
"""Index of the local modes in the result of termios.tcgetattr."""

logger = logging.getLogger(__name__)


class Keyboard:
    """Calls ``on_key`` with each pressed key, from a thread of its own, until it is closed.

    Ctrl-C and Ctrl-Z keep their effect. Does nothing without a terminal in the foreground; a run in the
    background does not use the terminal, and receives keys again when it is back in the foreground.
    """

    def __init__(self, on_key: Callable[[str], None]) -> None:
        self._on_key = on_key
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._terminal = -1
        self._before: list[Any] = []
        """The terminal's original modes, which are restored at the end."""

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

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        if self._thread is None:
            return
        self._thread.join()
        with contextlib.suppress(OSError, termios.error), _never_stopped():
            if _is_ours(self._terminal):  # else its modes are the shell's
                termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)

    @property
    def listening(self) -> bool:
        """Whether there is a terminal to read keys from."""
        return self._thread is not None

    def _listen(self) -> None:
        # Signals are left to the main thread: one that this thread receives, as when the terminal is closed,
        # would not wake it. SIGTTIN and SIGTTOU would stop the process.
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        with contextlib.suppress(OSError, termios.error):  # the terminal is closed
            while not self._ending.is_set():
                for key in self._pressed():
                    try:
                        self._on_key(key)
                    except Exception:
                        logger.exception("key %r", key)  # continue with the next key

    def _pressed(self) -> str:
        """Return pressed keys, waiting at most `LOOK_S`. Raises OSError when the terminal is closed."""
        if not _is_ours(self._terminal):
            self._ending.wait(LOOK_S)
            return ""
        if termios.tcgetattr(self._terminal)[_LOCAL_FLAGS] & termios.ICANON:  # reset by a shell
            tty.setcbreak(self._terminal, termios.TCSADRAIN)
        readable, _, _ = select.select([self._terminal], [], [], LOOK_S)
        if not readable:
            return ""
        try:
            keys = os.read(self._terminal, 64)
        except OSError:
            if _is_ours(self._terminal):
                raise
            return ""  # this process has just left the foreground
        if not keys:
            raise OSError("the terminal is closed")
        return keys.decode("ascii", "replace")


def _is_ours(terminal: int) -> bool:
    """Whether this process is in the terminal's foreground. Raises OSError if the terminal is closed."""
    return os.tcgetpgrp(terminal) == os.getpgrp()


@contextlib.contextmanager
def _never_stopped() -> Iterator[None]:
    """Block SIGTTIN and SIGTTOU, so that using a terminal from the background fails instead of stopping."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTIN, signal.SIGTTOU})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
