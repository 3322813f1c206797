"""The launcher's end of the line to a process that forks others: see `netsim.forking`."""

import queue
import socket
import threading
import time
from concurrent.futures import Future
from typing import NamedTuple

import msgspec
import psutil

from netsim.forking import MOST_BYTES, Answer, Ended, Fork, Forked, NotForked

FORK_LIMIT_S = 30.0
"""Wall time within which a fork must be answered, by a forker that is ready."""
_POLL_S = 0.02
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

    What is to be done at the end of what was forked is done on a thread of its own, one end after the other.
    """

    def __init__(self) -> None:
        self._line, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._answers: queue.SimpleQueue[ForkedProcess | NotForked] = queue.SimpleQueue()
        self._living: dict[int, _Living] = {}
        threading.Thread(target=self._listen, name="hear forker", daemon=True).start()

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

    def _listen(self) -> None:
        """Take answers until the forker's end of the line is closed, then look after those it has left."""
        with self._line:
            while packet := self._receive():
                match answer := _answers.decode(packet):
                    case Ended(pid=pid, returncode=returncode):
                        self._living.pop(pid).ending.set_result(returncode)
                    case Forked(pid=pid):
                        living = self._living[pid] = _Living(process_of(pid), Future())
                        self._answers.put(ForkedProcess(pid, living.ending))
                    case NotForked():
                        self._answers.put(answer)
        self._answers.put(NotForked(reason="nobody is there to fork it"))
        while self._living:
            for pid, living in list(self._living.items()):
                if _is_gone(living.process):
                    del self._living[pid]
                    living.ending.set_result(None)
            # polled, for a process that is not a child of this one can be waited for in no other way
            time.sleep(_POLL_S)

    def _receive(self) -> bytes:
        try:
            return self._line.recv(MOST_BYTES)
        except ConnectionResetError:
            return b""


def process_of(pid: int) -> psutil.Process | None:
    """Handle that never takes a successor of the process id for it; None if it has ended."""
    try:
        return psutil.Process(pid)
    except psutil.NoSuchProcess:
        return None


def _is_gone(process: psutil.Process | None) -> bool:
    try:
        return process is None or not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
