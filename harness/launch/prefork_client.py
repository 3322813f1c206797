"""Client of a prefork server in the launcher: see `foundation.processes.prefork`."""

import contextlib
import os
import queue
import socket
import time
from collections.abc import Sequence
from concurrent.futures import Future
from typing import NamedTuple

import msgspec
import psutil

from foundation.processes.prefork import MOST_BYTES, Answer, Ended, Fork, Forked, NotForked
from harness.launch.descriptor_watcher import DescriptorWatcher
from harness.simulator.response_watchdog import ResponseWatchdog

FORK_LIMIT_S = 10.0
"""Wall time for which a server that is ready may sleep or be stopped while it owes a fork."""
POLL_S = 0.25
_SERVER = 0
"""Number of the server at its watchdog."""
_encoder = msgspec.json.Encoder()
_answers = msgspec.json.Decoder(Answer)


class ForkError(OSError):
    """A process could not be forked; the text is the reason."""


class ForkedProcess(NamedTuple):
    """A forked process."""

    pid: int
    ending: "Future[int | None]"
    """Exit status, or minus the signal that killed it; None if the prefork server ended before it."""


class _Living(NamedTuple):
    process: psutil.Process | None
    ending: "Future[int | None]"


class Forker:
    """Connection to one prefork server.

    ``theirs`` is the server's end of the socket pair; close it here once the server has inherited it.
    ``watcher`` receives the answers; the futures of endings are completed on its thread.
    """

    def __init__(self, watcher: DescriptorWatcher) -> None:
        self._line, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._answers: queue.SimpleQueue[ForkedProcess | NotForked] = queue.SimpleQueue()
        self._living: dict[int, _Living] = {}
        self._watcher = watcher
        self._watchdog = ResponseWatchdog(FORK_LIMIT_S)
        self._pid = 0

    def listen(self, pid: int) -> None:
        """Start to receive answers of the server with this process id."""
        self._pid = pid
        self._watchdog.set_pid(_SERVER, pid)
        self._watcher.call(lambda: self._watcher.watch(self._line.fileno(), self._on_line))

    def close(self) -> None:
        """Close the connection, before `listen` or after the watcher is closed."""
        self._line.close()

    def fork(self, request: Fork, fds: Sequence[int]) -> ForkedProcess:
        """Fork a process with these file descriptors, standard streams first. Raises ForkError.

        Not thread-safe: one request at a time.
        """
        try:
            socket.send_fds(self._line, [_encoder.encode(request)], fds)
        except OSError as error:
            raise ForkError(error.strerror or str(error)) from None
        answer = self._await_answer()
        if isinstance(answer, NotForked):
            raise ForkError(answer.reason)
        return answer

    def _await_answer(self) -> ForkedProcess | NotForked:
        """Wait for the answer as long as the server's process could give it. Raises ForkError."""
        self._watchdog.begin(time.monotonic())
        while True:
            with contextlib.suppress(queue.Empty):
                return self._answers.get(timeout=POLL_S)
            reason = self._watchdog.check(_SERVER, time.monotonic(), starting=False).give_up
            if reason is not None:
                # a late answer would be mistaken for that to the next request
                self._line.shutdown(socket.SHUT_RDWR)
                subject = f"its process (pid {self._pid})"
                raise ForkError(reason.replace("its process", subject).replace("it has", f"{subject} has"))

    def _on_line(self) -> None:
        """Process an answer; when the server closes its end, watch the processes that it leaves behind."""
        packet = self._receive()
        if packet is None:
            return
        if not packet:
            self._watcher.forget(self._line.fileno())
            self._line.close()
            self._answers.put(NotForked(reason="the prefork server has ended"))
            for pid in list(self._living):
                self._adopt(pid)
            return
        match answer := _answers.decode(packet):
            case Ended(pid=pid, returncode=returncode):
                self._living.pop(pid).ending.set_result(returncode)
            case Forked(pid=pid):
                living = self._living[pid] = _Living(process_of(pid), Future())
                self._answers.put(ForkedProcess(pid, living.ending))
            case NotForked():
                self._answers.put(answer)

    def _adopt(self, pid: int) -> None:
        """Watch for the end of a process whose server has ended; its exit status is unknown."""
        try:
            pidfd = os.pidfd_open(pid)
        except ProcessLookupError:
            self._living.pop(pid).ending.set_result(None)
            return

        def on_end() -> None:
            self._watcher.forget(pidfd)
            os.close(pidfd)
            self._living.pop(pid).ending.set_result(None)

        self._watcher.watch(pidfd, on_end)
        process = self._living[pid].process
        if process is None or not process.is_running():  # the id may belong to another process now
            on_end()

    def _receive(self) -> bytes | None:
        """Return a packet: empty at the end of the connection, None if there is none yet."""
        try:
            return self._line.recv(MOST_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        except ConnectionResetError:
            return b""


def process_of(pid: int) -> psutil.Process | None:
    """Return a handle that survives reuse of the process id; None if the process has ended."""
    try:
        return psutil.Process(pid)
    except psutil.NoSuchProcess:
        return None
