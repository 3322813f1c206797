"""Prefork server: forks processes that share modules and memory loaded once.

The launcher sends JSON messages over a Unix packet socket: `Fork`, with the stdin, stdout and stderr of the
new process as file descriptors, and further ones that it has as 3, 4, ... The reply is `Forked` or
`NotForked`, and `Ended` follows when the process ends. A forked process has its own process group,
environment, name and file descriptors, and none of the server's open files; only its parent process is the
server instead of the launcher, and the kernel kills it when the server ends.

The standard library's forkserver is not suitable: there is one per program, with one environment, its
children have no stdin, and it can run only imports before it forks.
"""

import contextlib
import fcntl
import os
import selectors
import socket
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from foundation.processes.parent_death import end_with_parent_process

Main = Callable[[Sequence[str]], int]
"""Function that is called with command line arguments and returns an exit status."""


class Fork(Struct, frozen=True, kw_only=True, tag="fork", tag_field="request"):
    """Request to fork a process of this name; sent with its file descriptors."""

    name: str
    arguments: tuple[str, ...]
    environment: dict[str, str]
    """Variables added to the server's environment."""


class Forked(Struct, frozen=True, kw_only=True, tag="forked", tag_field="answer"):
    """The process has been started."""

    pid: int


class NotForked(Struct, frozen=True, kw_only=True, tag="not forked", tag_field="answer"):
    """The process could not be started."""

    reason: str


class Ended(Struct, frozen=True, kw_only=True, tag="ended", tag_field="answer"):
    """A forked process has ended and has been reaped."""

    pid: int
    returncode: int
    """Exit status, or minus the signal that killed it."""


Answer = Forked | NotForked | Ended
MOST_BYTES = 65_536
"""Longest message on the socket."""
FIRST_DESCRIPTOR = 3
"""Number of the first file descriptor after the standard streams in a forked process."""
_MOST_DESCRIPTORS = 8
_requests = msgspec.json.Decoder(Fork)
_encoder = msgspec.json.Encoder()


def serve(line: socket.socket, main: Main) -> None:
    """Fork a process for each request; it calls ``main`` and exits with the returned status.

    Returns when the socket or stdin has ended, or stdin has received any input (a command to stop), and all
    forked processes have ended. No other thread may run, since a forked process lacks it but not its locks.
    """
    living: dict[int, int] = {}  # process id by pidfd
    with selectors.DefaultSelector() as waiting:
        waiting.register(line, selectors.EVENT_READ)
        waiting.register(sys.stdin.fileno(), selectors.EVENT_READ)
        serving = True
        while serving or living:
            for key, _ in waiting.select():
                if key.fd in living:
                    waiting.unregister(key.fd)
                    os.close(key.fd)
                    _reply(line, _reap(living.pop(key.fd)))
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
    """Return the next request and its file descriptors; None at the end of the socket."""
    packet, fds, _, _ = socket.recv_fds(line, MOST_BYTES, _MOST_DESCRIPTORS)
    return (_requests.decode(packet), fds) if packet else None


def _fork(line: socket.socket, request: Fork, fds: list[int], main: Main) -> int | None:
    """Fork and reply; return the process id, or None on failure. Does not return in the child."""
    sys.stdout.flush()  # or the child writes it again
    sys.stderr.flush()
    server = os.getpid()
    try:
        pid = os.fork()
    except OSError as error:
        _reply(line, NotForked(reason=str(error)))
        return None
    if pid == 0:
        _become(request, fds, main, server)
    for fd in fds:
        os.close(fd)
    _reply(line, Forked(pid=pid))
    return pid


def _become(request: Fork, fds: list[int], main: Main, server: int) -> None:
    """Run the requested process; does not return."""
    status = 1
    try:
        end_with_parent_process(server)
        os.setpgid(0, 0)
        # first above all final numbers, so that none is overwritten before it is copied
        for number, fd in enumerate([fcntl.fcntl(fd, fcntl.F_DUPFD, len(fds)) for fd in fds]):
            os.dup2(fd, number)
        for fd in (int(path.name) for path in list(Path("/dev/fd").iterdir())):
            if fd >= len(fds):
                with contextlib.suppress(OSError):  # the descriptor of the listing is already closed
                    os.close(fd)
        os.environ.update(request.environment)
        show_name(request.name)
        status = main(request.arguments)
    except SystemExit as end:
        status = _status(end)
    except BaseException:  # noqa: BLE001  reported as by the interpreter
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        # the frames below this one belong to the server and must not run
        os._exit(status)


def _status(end: SystemExit) -> int:
    """Return the exit status of a SystemExit; a text is written to stderr."""
    if end.code is None or isinstance(end.code, int):
        return end.code or 0
    sys.stderr.write(f"{end.code}\n")
    return 1


def _reap(pid: int) -> Ended:
    return Ended(pid=pid, returncode=os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))


def _reply(line: socket.socket, answer: Answer) -> None:
    with contextlib.suppress(OSError):  # the launcher may have ended
        line.send(_encoder.encode(answer))


def show_name(name: str) -> None:
    """Set the name of this process in ``ps`` and ``top``; the kernel keeps 15 bytes."""
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(name)
