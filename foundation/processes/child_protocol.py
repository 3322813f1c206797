"""A child process's line to whoever started it.

JSON events out on stdout, lines in on stdin, and an end with the parent.

With ``--supervised`` a child says `Ready` once it can work and `Finished` before it ends, and ends at once
when its stdin does: that is how no process outlives its launcher, however the launcher dies. Without it,
stdin and stdout are a user's.
"""

import logging
import os
import queue
import sys
import threading
from collections.abc import Iterator
from typing import Any, TypeVar

import msgspec
from msgspec import Struct


class Ready(Struct, frozen=True, kw_only=True, tag="ready", tag_field="event"):
    """The process can work."""

    name: str
    pid: int
    details: dict[str, Any] = {}
    """What it chose itself, such as ``endpoint`` or ``gcs_local_udp``."""


class Influenced(Struct, frozen=True, kw_only=True, tag="influenced", tag_field="event"):
    """From here on the run depends on more than scenario and seed; said before it does, and once."""

    name: str
    by: str


class Warned(Struct, frozen=True, kw_only=True, tag="warned", tag_field="event"):
    """A warning or worse that people should see, as it was said over the process's own links."""

    name: str
    time_us: int
    text: str


class Stop(Struct, frozen=True, kw_only=True, tag="stop", tag_field="command"):
    """To a child: write what is to be written and end, after `Finished`."""


class Finished(Struct, frozen=True, kw_only=True, tag="finished", tag_field="event"):
    """The last event of a process that ends by itself or on request; counters and paths of what it leaves."""

    name: str
    details: dict[str, Any] = {}


logger = logging.getLogger(__name__)

T = TypeVar("T")
_encoder = msgspec.json.Encoder()


def emit(event: Struct) -> None:
    """Write one event as a line on stdout.

    A parent that is gone is no error, for the child is about to end.
    """
    try:
        sys.stdout.buffer.write(_encoder.encode(event) + b"\n")
        sys.stdout.buffer.flush()
    except (BrokenPipeError, ValueError):
        pass


def commands(kind: type[T], inbox: "queue.SimpleQueue[T]") -> None:
    """Have a thread fill the queue with the commands from stdin; the process ends when stdin does.

    A line that is no command is reported on stderr and skipped.
    """
    decoder = msgspec.json.Decoder(kind)

    def read() -> None:
        for line in _stdin_lines():
            try:
                inbox.put(decoder.decode(line))
            except msgspec.DecodeError as error:
                logger.warning("not a command: %r: %s", line[:200], error)
        _end()

    threading.Thread(target=read, name="parent", daemon=True).start()


def end_with_parent() -> None:
    """Have a thread end this process when stdin does, for a child that takes no commands."""

    def wait() -> None:
        for _ in _stdin_lines():
            pass
        _end()

    threading.Thread(target=wait, name="parent", daemon=True).start()


def _stdin_lines() -> Iterator[bytes]:
    """Lines of stdin.

    Read past Python's buffer, whose lock makes an interpreter abort that ends while a thread waits.
    """
    rest = b""
    while chunk := os.read(sys.stdin.fileno(), 65_536):
        *lines, rest = (rest + chunk).split(b"\n")
        yield from lines


def _end() -> None:
    # at once, whatever the main thread waits for: whoever would want a farewell is gone
    os._exit(0)
