"""Ctrl-C, SIGTERM and a closed terminal: handlers that end a program in order, and deferral of signals.

Python runs signal handlers only in the main thread, between two of its instructions.
"""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

from foundation.standard_streams import to_null

SAME_REQUEST_S = 1.0
"""Wall time after an interrupt within which further signals are the same request: closed terminals, service
managers and impatient users send several, and a second exception would break off the orderly end."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextlib.contextmanager
def interruptible() -> Iterator["Interrupt"]:
    """Raise KeyboardInterrupt on each of these signals in the block; only for the main thread.

    Signals within `SAME_REQUEST_S` after one that has raised it are ignored. Yields the handler.

    SIGINT is handled even if it was ignored: shells start background jobs so, and `kill -INT` must stop those
    too. An ignored SIGHUP stays ignored: nohup uses it to let a run outlive its terminal.
    """
    interrupt = Interrupt()
    before = {
        number: signal.signal(number, interrupt)
        for number in _SIGNALS
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ignore_interrupts() -> None:
    """Ignore these signals from now on: the result of the program is complete, and its process ends."""
    if threading.current_thread() is threading.main_thread():
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def exiting_at_once(line: str) -> Iterator[None]:
    """Exit this process with status 130 and a line on stderr on a signal in the block, which only imports.

    An exception would be one of the module that is being imported, some of which convert it to another. Has
    no effect in threads other than the main one.
    """

    def leave(_number: int, _frame: FrameType | None) -> None:
        with contextlib.suppress(OSError):  # a closed terminal
            os.write(2, f"{line}\n".encode())
        os._exit(128 + signal.SIGINT)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {
        number: signal.signal(number, leave)
        for number in _SIGNALS
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Interrupt:
    """Handler of the signals of one program."""

    def __init__(self) -> None:
        self._wall_last_s = float("-inf")
        self._is_over = False

    def finish(self) -> None:
        """Give further signals no effect: the program has its result."""
        self._is_over = True

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal. Raises KeyboardInterrupt."""
        if number == signal.SIGHUP:
            _mute_closed_terminal()
        wall_s = time.monotonic()
        if not self._is_over and wall_s - self._wall_last_s >= SAME_REQUEST_S:
            self._wall_last_s = wall_s
            signal.default_int_handler(number, frame)


def _mute_closed_terminal() -> None:
    """Redirect stdout and stderr of a closed terminal to /dev/null, so that later output does not fail."""
    for stream in (1, 2):
        try:
            os.write(stream, b"")  # writes nothing, but fails on a closed terminal
        except OSError:
            to_null(stream)


@contextlib.contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Defer Ctrl-C, and SIGTERM and SIGHUP if they have a handler, until the block is left.

    The block must take bounded time. Has no effect in threads other than the main one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers: dict[int, Callable[[int, FrameType | None], object]] = {}
    for number in map(int, _SIGNALS):
        handler = signal.getsignal(number)
        if callable(handler):
            handlers[number] = handler
    pending: list[tuple[int, FrameType | None]] = []
    for number in handlers:
        signal.signal(number, lambda *arrived: pending.append(arrived))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number, frame in pending[:1]:
            handlers[number](number, frame)
