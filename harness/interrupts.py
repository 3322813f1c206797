"""Ctrl-C and SIGTERM: made to end a program in good order, and held back where it must not be cut short.

Python runs signal handlers in the main thread alone, between two of its instructions.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Have both raise KeyboardInterrupt in the block, which the main thread alone may enter.

    SIGINT as well where it would be ignored: a shell starts so what runs in its background, and `kill -INT`
    shall stop that too.
    """
    before = {number: signal.signal(number, signal.default_int_handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def interrupt_with_parent() -> None:
    """Have a thread interrupt this process when stdin ends: whoever holds its other end is gone."""

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 4_096):
            pass
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=wait, name="parent", daemon=True).start()


@contextlib.contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Hold back Ctrl-C, and a SIGTERM that has a handler, until the block is left. It must take bounded time.

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
