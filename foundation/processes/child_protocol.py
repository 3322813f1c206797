"""Protocol between a child process and its parent.

Events are JSON lines on stdout, commands are JSON lines on stdin.

With ``--supervised`` a child emits `Ready` when it is ready and `Finished` before it exits. It exits at once
at the end of its stdin, so no process outlives its launcher, even if the launcher is killed. Without this
option stdin and stdout belong to the user.
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
    """The process is ready."""

    name: str
    pid: int
    details: dict[str, Any] = {}
    """Values chosen by the process, such as ``endpoint`` or ``gcs_local_udp``."""


class Influenced(Struct, frozen=True, kw_only=True, tag="influenced", tag_field="event"):
    """The run is about to depend on more than scenario and seed; emitted once."""

    name: str
    by: str


class Warned(Struct, frozen=True, kw_only=True, tag="warned", tag_field="event"):
    """A warning or more severe message for the user, as the process has sent it over its links."""

    name: str
    time_us: int
    text: str


class Stop(Struct, frozen=True, kw_only=True, tag="stop", tag_field="command"):
    """Command to a child: write all files, emit `Finished` and exit."""


class Finished(Struct, frozen=True, kw_only=True, tag="finished", tag_field="event"):
    """Last event of a process that ends by itself or on request, with counters and paths of its files."""

    name: str
    details: dict[str, Any] = {}


logger = logging.getLogger(__name__)

T = TypeVar("T")
_encoder = msgspec.json.Encoder()


def emit(event: Struct) -> None:
    """Write one event as a line to stdout.

    A closed stdout is not an error: the parent has ended, and the child is about to end.
    """
    try:
        sys.stdout.buffer.write(_encoder.encode(event) + b"\n")
        sys.stdout.buffer.flush()
    except (BrokenPipeError, ValueError):
        pass


def commands(kind: type[T], inbox: "queue.SimpleQueue[T]") -> None:
    """Start a thread that puts commands from stdin into the queue, and exits the process at the end of stdin.

    An invalid line is reported on stderr and skipped.
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
    """Start a thread that exits the process at the end of stdin, for a child without commands."""

    def wait() -> None:
        for _ in _stdin_lines():
            pass
        _end()

    threading.Thread(target=wait, name="parent", daemon=True).start()


def _stdin_lines() -> Iterator[bytes]:
    """Yield the lines of stdin.

    It bypasses Python's buffer, whose lock aborts the interpreter if it exits while a thread waits.
    """
    rest = b""
    while chunk := os.read(sys.stdin.fileno(), 65_536):
        *lines, rest = (rest + chunk).split(b"\n")
        yield from lines


def _end() -> None:
    # at once, also while the main thread waits: no process is left to receive `Finished`
    os._exit(0)
