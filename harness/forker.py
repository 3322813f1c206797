"""The launcher's end of the line to a process that forks others: see `netsim.forking`."""

import queue
import socket
import threading
import time
from collections.abc import Callable

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


class Forker:
    """One such process. Its methods may be called from any thread.

    ``theirs`` is its end of the line, to be closed here once the process has inherited it. ``on_end`` is told
    on a thread of its own how each forked process ended: its id, and exit status or minus the signal that
    killed it, or None if the forker died before and so nobody can know.
    """

    def __init__(self, on_end: Callable[[int, int | None], None]) -> None:
        self._on_end = on_end
        self._line, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._answers: queue.SimpleQueue[Forked | NotForked | None] = queue.SimpleQueue()
        self._living: dict[int, psutil.Process | None] = {}
        threading.Thread(target=self._listen, name="hear forker", daemon=True).start()

    def fork(self, request: Fork, stdio: tuple[int, int, int]) -> int:
        """Have a process forked with these standard streams; returns its id. Raises ForkError.

        One at a time: the caller sees to that.
        """
        try:
            socket.send_fds(self._line, [_encoder.encode(request)], stdio)
            answer = self._answers.get(timeout=FORK_LIMIT_S)
        except OSError as error:
            raise ForkError(error.strerror or str(error)) from None
        except queue.Empty:
            raise ForkError(f"no answer within {FORK_LIMIT_S:g} s") from None
        if isinstance(answer, Forked):
            return answer.pid
        raise ForkError("nobody is there to fork it" if answer is None else answer.reason)

    def _listen(self) -> None:
        """Take answers until the forker's end of the line is closed, then look after those it has left."""
        with self._line:
            while packet := self._receive():
                match answer := _answers.decode(packet):
                    case Ended(pid=pid, returncode=returncode):
                        self._living.pop(pid, None)
                        self._on_end(pid, returncode)
                    case Forked(pid=pid):
                        self._living[pid] = process_of(pid)
                        self._answers.put(answer)
                    case NotForked():
                        self._answers.put(answer)
        self._answers.put(None)
        while self._living:
            for pid, process in list(self._living.items()):
                if _is_gone(process):
                    del self._living[pid]
                    self._on_end(pid, None)
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
