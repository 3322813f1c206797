"""A child process's line to whoever started it: JSON events out on stdout, lines in on stdin, and an end with the parent.

With ``--supervised`` a child says `Ready` once it can work and `Finished` before it ends, and ends at once when its stdin
does: that is how no process outlives its launcher, however the launcher dies. Without it, stdin and stdout are a user's.
"""

import os
import queue
import sys
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
from msgspec import Struct


class Ready(Struct, frozen=True, kw_only=True, tag="ready", tag_field="event"):
    """The process can work."""

    name: str
    pid: int
    details: dict[str, Any] = {}
    """What it chose itself, such as ``endpoint`` or ``gcs_local_udp``."""


class Finished(Struct, frozen=True, kw_only=True, tag="finished", tag_field="event"):
    """The last event of a process that ends by itself or on request; counters and paths of what it leaves."""

    name: str
    details: dict[str, Any] = {}


T = TypeVar("T")
_encoder = msgspec.json.Encoder()


def emit(event: Struct) -> None:
    """Write one event as a line on stdout; a parent that is gone is no error, for the child is about to end."""
    try:
        sys.stdout.buffer.write(_encoder.encode(event) + b"\n")
        sys.stdout.buffer.flush()
    except (BrokenPipeError, ValueError):
        pass


def commands(kind: type[T]) -> "queue.SimpleQueue[T]":
    """Queue that a thread fills with the commands from stdin; the process ends when stdin does.

    A line that is no command is reported on stderr and skipped.
    """
    inbox: queue.SimpleQueue[T] = queue.SimpleQueue()
    decoder = msgspec.json.Decoder(kind)

    def read() -> None:
        for line in sys.stdin.buffer:
            try:
                inbox.put(decoder.decode(line))
            except msgspec.DecodeError as error:
                print(f"not a command: {line[:200]!r}: {error}", file=sys.stderr, flush=True)
        _end()

    threading.Thread(target=read, name="parent", daemon=True).start()
    return inbox


def end_with_parent(before: Callable[[], None] | None = None) -> None:
    """End this process when stdin does, after calling ``before`` (in a thread of its own)."""

    def wait() -> None:
        while sys.stdin.buffer.read(4096):
            pass
        if before is not None:
            before()
        _end()

    threading.Thread(target=wait, name="parent", daemon=True).start()


def _end() -> None:
    os._exit(0)
