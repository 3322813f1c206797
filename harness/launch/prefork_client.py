"""The launcher's end of the line to a process that forks others: see `foundation.processes.prefork`."""

import os
import queue
import socket
from concurrent.futures import Future
from typing import NamedTuple

import msgspec
import psutil

from foundation.processes.prefork import MOST_BYTES, Answer, Ended, Fork, Forked, NotForked
from harness.launch.descriptor_watcher import DescriptorWatcher

FORK_LIMIT_S = 30.0
"""Wall time within which a fork must be answered, by a forker that is ready."""
_encoder = msgspec.json.Encoder()
_answers = msgspec.json.Decoder(Answer)


class ForkError(OSError):
    """There is no new process; the text is why."""


class ForkedProcess(NamedTuple):
    """A process that was forked on request."""

    pid: int
    ending: "Future[int | None]"
    """Exit status or minus the signal that killed it; None if the forker, which would know, died before."""


class _Living(NamedTuple):
    process: psutil.Process | None
    ending: "Future[int | None]"


class Forker:
    """One such process. ``theirs`` is its end of the line, to be closed here once it has inherited that.

    ``listener``: what hears it, and on whose thread endings are told.
    """

    def __init__(self, listener: DescriptorWatcher) -> None:
        self._line, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._answers: queue.SimpleQueue[ForkedProcess | NotForked] = queue.SimpleQueue()
        self._living: dict[int, _Living] = {}
        self._listener = listener

    def listen(self) -> None:
        """Take answers from now on."""
        self._listener.call(lambda: self._listener.watch(self._line.fileno(), self._on_line))

    def close(self) -> None:
        """Hang up, when nobody listens: not yet, or not any more."""
        self._line.close()

    def fork(self, request: Fork, stdio: tuple[int, int, int]) -> ForkedProcess:
        """Have a process forked with these standard streams. Raises ForkError.

        One at a time: the caller sees to that.
        """
        try:
            socket.send_fds(self._line, [_encoder.encode(request)], stdio)
            answer = self._answers.get(timeout=FORK_LIMIT_S)
        except OSError as error:
            raise ForkError(error.strerror or str(error)) from None
        except queue.Empty:
            # an answer that came yet would be taken for that to the next request
            self._line.shutdown(socket.SHUT_RDWR)
            raise ForkError(f"no answer within {FORK_LIMIT_S:g} s") from None
        if isinstance(answer, NotForked):
            raise ForkError(answer.reason)
        return answer

    def _on_line(self) -> None:
        """Take an answer; once the forker's end of the line is closed, look after those it has left."""
        packet = self._receive()
        if packet is None:
            return
        if not packet:
            self._listener.forget(self._line.fileno())
            self._line.close()
            self._answers.put(NotForked(reason="nobody is there to fork it"))
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
        """Take note when a process ends whose forker has, and so nobody tells how."""
        try:
            pidfd = os.pidfd_open(pid)
        except ProcessLookupError:
            self._living.pop(pid).ending.set_result(None)
            return

        def look() -> None:
            self._listener.forget(pidfd)
            os.close(pidfd)
            self._living.pop(pid).ending.set_result(None)

        self._listener.watch(pidfd, look)
        process = self._living[pid].process
        if process is None or not process.is_running():  # whoever has that number now is a stranger
            look()

    def _receive(self) -> bytes | None:
        """Read a packet: empty at the line's end, None if there is none yet."""
        try:
            return self._line.recv(MOST_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        except ConnectionResetError:
            return b""


def process_of(pid: int) -> psutil.Process | None:
    """Handle that never takes a successor of the process id for it; None if it has ended."""
    try:
        return psutil.Process(pid)
    except psutil.NoSuchProcess:
        return None
