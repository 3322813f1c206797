"""A process that makes its like by fork: what all of them need is loaded once, into memory that they share.

Its launcher asks for each of them over a Unix socket of packets, a JSON message each: `Fork`, with the new
process's stdin, stdout and stderr beside it, is answered `Forked` or `NotForked`, and `Ended` follows when
it ends. What is forked is a child of its launcher in all but parentage: a session, environment, name and
standard streams of its own, and nothing open that was the forker's.

The standard library's forkserver does not do: a program has one, with one environment, its children have no
stdin, and it runs nothing but imports before it forks.
"""

import contextlib
import os
import selectors
import socket
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

Main = Callable[[Sequence[str]], int]
"""Gets the arguments of a command line and returns an exit status."""


class Fork(Struct, frozen=True, kw_only=True, tag="fork", tag_field="request"):
    """To a forker: fork a process of this name. Three file descriptors come along."""

    name: str
    arguments: tuple[str, ...]
    environment: dict[str, str]
    """What is added to the forker's own."""


class Forked(Struct, frozen=True, kw_only=True, tag="forked", tag_field="answer"):
    """The process lives."""

    pid: int


class NotForked(Struct, frozen=True, kw_only=True, tag="not forked", tag_field="answer"):
    """There is no new process, and why."""

    reason: str


class Ended(Struct, frozen=True, kw_only=True, tag="ended", tag_field="answer"):
    """A process that was forked has ended, and is no zombie any more."""

    pid: int
    returncode: int
    """Exit status, or minus the signal that killed it."""


Answer = Forked | NotForked | Ended
MOST_BYTES = 65_536
"""Longest message on the line."""
_STDIO = 3
_requests = msgspec.json.Decoder(Fork)
_encoder = msgspec.json.Encoder()


def serve(line: socket.socket, main: Main) -> None:
    """Fork a process for each request, which calls ``main`` and ends with the status that this returns.

    Returns when the line or stdin has ended (or said anything: a command to stop) and every process that was
    forked has ended as well. No other thread may run, for a fork leaves it behind with the locks it holds.
    """
    living: dict[int, int] = {}  # a pidfd's process
    with selectors.DefaultSelector() as waiting:
        waiting.register(line, selectors.EVENT_READ)
        waiting.register(sys.stdin.fileno(), selectors.EVENT_READ)
        serving = True
        while serving or living:
            for key, _ in waiting.select():
                if key.fd in living:
                    waiting.unregister(key.fd)
                    os.close(key.fd)
                    _tell(line, _reap(living.pop(key.fd)))
                elif serving and key.fileobj is line and (request := _receive(line)) is not None:
                    pid = _fork(line, *request, main)
                    if pid is not None:
                        living[pidfd := os.pidfd_open(pid)] = pid
                        waiting.register(pidfd, selectors.EVENT_READ)
                elif serving:
                    serving = False
                    waiting.unregister(line)
                    waiting.unregister(sys.stdin.fileno())


def _receive(line: socket.socket) -> tuple[Fork, list[int]] | None:
    """Next request and its file descriptors; None when the line has ended."""
    packet, fds, _, _ = socket.recv_fds(line, MOST_BYTES, _STDIO)
    return (_requests.decode(packet), fds) if packet else None


def _fork(line: socket.socket, request: Fork, stdio: list[int], main: Main) -> int | None:
    """Fork and tell of it. Returns the process id in the parent, and never in the child."""
    sys.stdout.flush()  # or the child says it once more
    sys.stderr.flush()
    try:
        pid = os.fork()
    except OSError as error:
        _tell(line, NotForked(reason=str(error)))
        return None
    if pid == 0:
        _become(request, stdio, main)
    for fd in stdio:
        os.close(fd)
    _tell(line, Forked(pid=pid))
    return pid


def _become(request: Fork, stdio: list[int], main: Main) -> None:
    """Be the process that was asked for; does not return."""
    status = 1
    try:
        os.setpgid(0, 0)
        for number, fd in enumerate(stdio):
            os.dup2(fd, number)
        for fd in (int(path.name) for path in list(Path("/dev/fd").iterdir())):
            if fd >= _STDIO:
                with contextlib.suppress(OSError):  # the listing's own is closed already
                    os.close(fd)
        os.environ.update(request.environment)
        show_name(request.name)
        status = main(request.arguments)
    except SystemExit as end:
        status = _status(end)
    except BaseException:  # noqa: BLE001  told as the interpreter would
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        # the forker's frames are below this one, and their end is the forker's
        os._exit(status)


def _status(end: SystemExit) -> int:
    """Exit status of a process that ends with it; a reason in words is told on stderr."""
    if end.code is None or isinstance(end.code, int):
        return end.code or 0
    sys.stderr.write(f"{end.code}\n")
    return 1


def _reap(pid: int) -> Ended:
    return Ended(pid=pid, returncode=os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))


def _tell(line: socket.socket, answer: Answer) -> None:
    with contextlib.suppress(OSError):  # a launcher that is gone has ended the line
        line.send(_encoder.encode(answer))


def show_name(name: str) -> None:
    """Have ``ps`` and ``top`` show a name for this process, of which the kernel keeps 15 bytes."""
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(name)
