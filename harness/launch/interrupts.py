"""Ctrl-C, SIGTERM and a closed terminal: they end a program in good order, and not where it must not be cut.

Python runs signal handlers in the main thread alone, between two of its instructions.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Have all raise KeyboardInterrupt in the block, which the main thread alone may enter.

    SIGINT as well where it would be ignored: a shell starts so what runs in its background, and `kill -INT`
    shall stop that too. An ignored SIGHUP stays so: it is how nohup has a run outlive its terminal.
    """
    before = {
        number: signal.signal(number, _interrupt)
        for number in _SIGNALS
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if number == signal.SIGHUP:
        _mute_closed_terminal()
    signal.default_int_handler(number, frame)


def _mute_closed_terminal() -> None:
    """Have what is still said to a terminal that is gone get lost; to fail at it would cut the rest short."""
    for stream in (1, 2):
        try:
            os.write(stream, b"")  # nothing; yet of a terminal that was hung up it fails
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream)
            os.close(nowhere)


def interrupt_with_parent() -> None:
    """Have a thread interrupt this process when stdin ends: whoever holds its other end is gone."""

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 4_096):
            pass
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=wait, name="parent", daemon=True).start()


@contextlib.contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Hold back Ctrl-C, and SIGTERM and SIGHUP that have a handler, until the block is left.

    It must take bounded time.
    In any other thread than the main one there is nothing to hold back.
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
