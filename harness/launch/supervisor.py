"""Supervisor of child processes: starts them, receives their events, and stops them without leftovers.

Independent of swarms. A child is a command with a name; it implements the protocol of
`foundation.processes.child_protocol`: JSON events on stdout, commands on stdin, exit at the end of stdin.
One thread receives the events and endings of all children and puts them into one queue. A child may be a
prefork server (`harness.launch.prefork_client`), from which other children are forked.

Ctrl-C is deferred while a process is being started or stopped.
"""

import collections
import contextlib
import os
import queue
import signal
import subprocess
import threading
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

import msgspec
import psutil
from msgspec import Struct

from foundation.processes.child_protocol import Finished, Influenced, Ready, Stop, Warned
from foundation.processes.prefork import Fork
from foundation.processes.socket_owners import MARK
from harness.launch.death_report import ending, last_words
from harness.launch.descriptor_watcher import DescriptorWatcher
from harness.launch.graceful_end import wait_for_ends
from harness.launch.interrupts import interrupts_deferred
from harness.launch.prefork_client import Forker, ForkError, process_of
from harness.launch.spawner import spawn
from harness.simulator.messages import AnyCommand, AnyEvent
from harness.simulator.process_activity import DEAD, ENDED, HELD, ProcessState, state_of
from netsim.network.messages import ProgramEnded, ProgramStarted, StartPrograms

INPUT_GRACE_S = 1.0
"""Wall time that a child has to end after the end of its stdin."""
TERM_GRACE_S = 2.0
"""Wall time between SIGTERM and SIGKILL."""
WAKE_S = 0.1
"""Wall time after which a process runs that was continued."""
TRACE_GRACE_S = 1.0
"""Wall time between SIGABRT, for a trace, and SIGKILL."""
KILL_GRACE_S = 5.0
"""Wall time that the kernel has to end a process after SIGKILL."""
LAST_WORDS_S = 0.2
"""Wall time to read on from the stdout of ended children whose descendants hold it open."""
PIPE_BYTES = 65_536
"""Capacity of a pipe."""
TAIL_LINES = 8
TRACE_LINES = 2_000
"""Last lines of a log in which a trace of faulthandler is searched."""
TAIL_BYTES = 64 * 1024


class Exited(Struct, frozen=True, kw_only=True):
    """A child has ended; this is its last message."""

    name: str
    pid: int
    returncode: int | None
    """Exit status, or minus the signal that killed it; None if its prefork server ended before it."""
    log_tail: str
    """Last lines of its log, if it failed."""
    last_words: str = ""
    """What the child itself wrote about its end on stderr (`harness.launch.death_report.last_words`): some
    libraries print on stdout, for instance when imported."""
    sequel: str = ""
    """When it ended and what follows from it, if the run goes on; from the launcher."""

    def describe(self) -> str:
        """Return one line: the process and how it ended."""
        return f"{self.name} (pid {self.pid}) {ending(self.returncode)}"


ChildCommand = AnyCommand | StartPrograms
ChildMessage = Ready | Finished | Influenced | Warned | ProgramStarted | ProgramEnded | AnyEvent
NamedMessage = tuple[str, ChildMessage | Exited]
"""A child's name, and an event of it or its end."""
_decoder = msgspec.json.Decoder(ChildMessage)
_encoder = msgspec.json.Encoder()


class SupervisorError(Exception):
    """A child could not be started or ended; one line."""


class _Child:
    """One process with its pipes. ``forker``: the prefork server that forked it and reports its end."""

    def __init__(self, name: str, pid: int, stdin: IO[bytes], stdout: IO[bytes], forker: str | None) -> None:
        self.name = name
        self.pid = pid
        self.forker = forker
        self.process = process_of(pid)
        self.stdin = stdin
        self.stdout = stdout
        self.gone = threading.Event()
        """It has ended, and its last messages are in the queue."""
        self.silent = threading.Event()
        """Its stdout has ended."""
        self.printed: collections.deque[bytes] = collections.deque(maxlen=TAIL_LINES)
        """Last lines of its stdout that were no events."""
        self._unfinished = b""
        """Beginning of a line that is not complete yet."""
        self._stdin_lock = threading.Lock()
        for pipe in (self.stdin, self.stdout):  # a child must not block its launcher
            os.set_blocking(pipe.fileno(), False)

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"

    def write(self, line: bytes) -> None:
        """Write a line of at most PIPE_BUF bytes to its stdin; does nothing if the child has ended."""
        with self._stdin_lock:
            if self.stdin.closed:
                return
            try:
                os.write(self.stdin.fileno(), line)
            except BrokenPipeError:
                pass
            except BlockingIOError:
                raise SupervisorError(f"{self} takes no commands any more") from None

    def end_input(self) -> None:
        with self._stdin_lock:
            self.stdin.close()

    def read_lines(self) -> list[bytes]:
        """Return complete lines of at most `PIPE_BYTES`; sets `silent` at the end of stdout."""
        if self.silent.is_set():
            return []
        try:
            data = os.read(self.stdout.fileno(), PIPE_BYTES)
        except BlockingIOError:
            return []
        if not data:
            self.silent.set()
        *lines, self._unfinished = (self._unfinished + data).split(b"\n")
        return lines if data or not self._unfinished else [self._unfinished]

    def state(self) -> ProcessState:
        """Return the present state of its process."""
        return DEAD if self.process is None else state_of(self.process)

    def signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(psutil.NoSuchProcess):
            if self.process is not None:
                self.process.send_signal(number)


class Supervisor:
    """The children of one run. Its methods may be called from any thread.

    ``log_folder`` gets ``<name>.log`` of each child: its stderr, and lines of its stdout that are no events.
    ``environment`` is added to the inherited environment of the children.
    """

    def __init__(self, log_folder: Path, *, environment: Mapping[str, str] | None = None) -> None:
        self.log_folder = log_folder
        self.token = uuid.uuid4().hex
        self._environment = dict(environment or {})
        self._received: queue.SimpleQueue[NamedMessage] = queue.SimpleQueue()
        self._children: dict[str, _Child] = {}
        self._forkers: dict[str, Forker] = {}
        self._watcher = DescriptorWatcher("children")
        self._lock = threading.Lock()
        self._stopping = False

    @property
    def pids(self) -> dict[str, int]:
        """Process id of every child ever started, by name."""
        return {name: child.pid for name, child in self._children.items()}

    def alive(self, name: str) -> bool:
        """Whether a child was started and has not ended."""
        return name in self._children and not self._children[name].gone.is_set()

    def states(self, names: Iterable[str]) -> dict[str, ProcessState]:
        """Return the present states of those of these children that have been started and not ended."""
        return {name: self._children[name].state() for name in names if self.alive(name)}

    def start(self, name: str, command: Sequence[str], *, pass_fds: Iterable[int] = ()) -> int:
        """Start a child in a process group of its own and return its process id.

        Its own group keeps Ctrl-C from it. It stays in this session because Linux (autogroup) divides the
        processors among sessions first, so time that a process yields goes to others of its session.
        ``pass_fds`` are the only file descriptors that it inherits, under the same numbers.
        Raises SupervisorError if the command cannot be run, or if the children are being stopped.
        """
        with self._starting(name) as log:
            try:
                popen = spawn(
                    list(command),
                    bufsize=0,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    process_group=0,
                    pass_fds=tuple(pass_fds),
                    env=os.environ | self._environment | self._mark(name),
                )
            except OSError as error:
                raise SupervisorError(f"{name}: cannot be started: {error}") from None
            assert popen.stdin is not None and popen.stdout is not None  # noqa: PT018, S101  both are PIPE
            try:
                pidfd = os.pidfd_open(popen.pid)
            except OSError as error:
                popen.kill()
                popen.wait()
                raise SupervisorError(f"{name}: cannot be watched: {error}") from None
            child = self._add(_Child(name, popen.pid, popen.stdin, popen.stdout, None))
            self._watcher.call(lambda: self._watch_end(child, popen, pidfd))
            return child.pid

    def start_forker(self, name: str, command: Sequence[str]) -> int:
        """Start a prefork server, with the option ``--fork-fd``. Returns and raises as `start`."""
        forker = Forker(self._watcher)
        try:
            with forker.theirs as line:
                pid = self.start(name, [*command, "--fork-fd", str(line.fileno())], pass_fds=[line.fileno()])
        except SupervisorError:
            forker.close()
            raise
        forker.listen(pid)
        self._forkers[name] = forker
        return pid

    def fork(self, name: str, arguments: Sequence[str], *, forker: str, pass_fds: Sequence[int] = ()) -> int:
        """Fork a child from a prefork server, in a process group of its own, and return its process id.

        ``arguments`` are its command line; it has ``pass_fds`` from `FIRST_DESCRIPTOR` on. Raises
        SupervisorError if it cannot be forked, or if the children are being stopped.
        """
        with self._starting(name) as log, contextlib.ExitStack() as theirs:
            (stdin, our_stdin), (our_stdout, stdout) = os.pipe(), os.pipe()
            for fd in (stdin, stdout):
                theirs.callback(os.close, fd)
            ours = os.fdopen(our_stdin, "wb", buffering=0), os.fdopen(our_stdout, "rb", buffering=0)
            request = Fork(name=name, arguments=tuple(arguments), environment=self._mark(name))
            try:
                forked = self._forkers[forker].fork(request, (stdin, stdout, log.fileno(), *pass_fds))
            except ForkError as error:
                for pipe in ours:
                    pipe.close()
                raise SupervisorError(f"{name}: cannot be forked by {forker}: {error}") from None
            child = self._add(_Child(name, forked.pid, *ours, forker))
            forked.ending.add_done_callback(
                lambda ending: self._watcher.call(lambda: self._on_end(child, ending.result()))
            )
            return child.pid

    @contextlib.contextmanager
    def _starting(self, name: str) -> Iterator[IO[bytes]]:
        """Yield the log of a child that is being started; defers signals and stops."""
        with interrupts_deferred(), self._lock:
            if self._stopping:
                raise SupervisorError(f"{name}: not started because the run is being stopped")
            with self.log_path(name).open("ab", buffering=0) as log:  # shared with the child
                yield log

    def _mark(self, name: str) -> dict[str, str]:
        return {MARK: f"{self.token}/{name}"}

    def _add(self, child: _Child) -> _Child:
        """Register a new child and watch its stdout."""
        self._children[child.name] = child
        stdout = child.stdout.fileno()
        self._watcher.call(lambda: self._watcher.watch(stdout, lambda: self._receive(child)))
        return child

    def _receive(self, child: _Child) -> None:
        """Queue each line that is an event, and log the others: native libraries print too."""
        if child.silent.is_set():
            return
        for line in child.read_lines():
            try:
                self._received.put((child.name, _decoder.decode(line)))
            except (msgspec.DecodeError, UnicodeDecodeError):
                child.printed.append(line)
                # continue with events when the disk is full
                with contextlib.suppress(OSError), self.log_path(child.name).open("ab") as log:
                    log.write(line + b"\n")
        if child.silent.is_set():
            self._watcher.forget(child.stdout.fileno())
            child.stdout.close()

    def _watch_end(self, child: _Child, process: "subprocess.Popen[bytes]", pidfd: int) -> None:
        """Watch for the end of a child of this process."""

        def on_readable() -> None:
            returncode = process.poll()
            if returncode is not None:
                self._watcher.forget(pidfd)
                os.close(pidfd)
                self._on_end(child, returncode)

        self._watcher.watch(pidfd, on_readable)

    def _on_end(self, child: _Child, returncode: int | None) -> None:
        """Queue a child's end after its last events, which may still be in the pipe."""
        child.end_input()
        self._receive(child)
        failed = returncode != 0
        printed = {line.decode(errors="replace").rstrip() for line in child.printed}
        lines = self.log_tail(child.name, TRACE_LINES).splitlines() if failed else []
        errors = [line.rstrip() for line in lines if line.rstrip() not in printed]
        if returncode is not None and returncode > 0:
            errors = errors[-TAIL_LINES:]
        exited = Exited(
            name=child.name,
            pid=child.pid,
            returncode=returncode,
            log_tail="\n".join(lines[-TAIL_LINES:]),
            last_words=last_words(errors, returncode),
        )
        self._received.put((child.name, exited))
        child.gone.set()

    def receive(self, timeout_s: float) -> NamedMessage | None:
        """Return the oldest message in the queue; None if none arrives within ``timeout_s``."""
        try:
            return self._received.get(timeout=max(0.0, timeout_s))
        except queue.Empty:
            return None

    def send(self, name: str, command: ChildCommand) -> None:
        """Write a command to a child's stdin. No effect if it has ended, which the queue reports.

        Raises SupervisorError for a child that was never started.
        """
        child = self._children.get(name)
        if child is None:
            raise SupervisorError(f"{name} has not been started")
        child.write(_encoder.encode(command) + b"\n")

    def kill(self, name: str, *, after_trace: bool = False) -> None:
        """SIGKILL a child and return when it has ended.

        ``after_trace``: it is sent SIGABRT before, at which faulthandler writes the traces of its threads.
        """
        child = self._children[name]
        if after_trace:
            child.signal(signal.SIGABRT)
            self._wake([child])
            child.gone.wait(TRACE_GRACE_S)
        child.signal(signal.SIGKILL)
        self._wake([child])
        if not child.gone.wait(KILL_GRACE_S):
            raise SupervisorError(f"{child} does not end on SIGKILL")

    def continue_or_kill(self, forker: str, *, after_forks_s: float) -> None:
        """Continue a stopped prefork server; one that stays stopped is killed.

        Its forks, which end with it, have ``after_forks_s`` of wall time to end before.
        """
        child = self._children[forker]
        self._wake([child])
        time.sleep(WAKE_S)
        if child.state().status not in HELD:
            return
        forks = [each for each in self._children.values() if each.forker == forker]
        deadline = time.monotonic() + after_forks_s
        while any(each.state().status not in ENDED for each in forks) and time.monotonic() < deadline:
            time.sleep(WAKE_S)
        with contextlib.suppress(SupervisorError):
            self.kill(forker)

    def end(
        self, names: Iterable[str], *, grace_s: float = 0.0, input_grace_s: float = INPUT_GRACE_S
    ) -> list[str]:
        """End these children in parallel, and return a line for each that had to be forced.

        They receive `Stop` and have ``grace_s`` to write their data, more if they are busy or get no
        processor time (`graceful_end`); then their stdin is closed, and SIGTERM
        and SIGKILL follow, after ``input_grace_s`` and `TERM_GRACE_S`. Children stopped by SIGSTOP are
        continued; those that are stopped all the same, by a debugger, are killed without further waits.
        """
        with interrupts_deferred():
            children = [self._children[name] for name in names if self.alive(name)]
            self._wake(children)
            for child in children:
                with contextlib.suppress(SupervisorError):
                    child.write(_encoder.encode(Stop()) + b"\n")
            forced = []
            if grace_s:
                wait_for_ends({child.pid: child.gone for child in children}, grace_s)
                forced = [f"{child} did not stop when asked" for child in children if not child.gone.is_set()]
            for child in children:
                if not child.gone.is_set() and child.state().status in HELD:
                    forced.append(f"{child} is stopped and cannot end: {signal.SIGKILL.name}")
                    child.signal(signal.SIGKILL)
                child.end_input()
            _wait_gone(children, input_grace_s)
            for number, limit_s in ((signal.SIGTERM, TERM_GRACE_S), (signal.SIGKILL, KILL_GRACE_S)):
                late = [child for child in children if not child.gone.is_set()]
                for child in late:
                    forced.append(f"{child} did not end in time: {number.name}")
                    child.signal(number)
                _wait_gone(late, limit_s)
            return forced

    def _wake(self, children: Iterable[_Child]) -> None:
        """Continue children stopped by SIGSTOP, and their prefork servers, which report their ends."""
        for name in {name for child in children for name in (child.name, child.forker) if name}:
            self._children[name].signal(signal.SIGCONT)

    def stop(self, *, input_grace_s: float = INPUT_GRACE_S) -> list[str]:
        """End all children and their descendants for good, as `end`: none can be started afterwards.

        Returns a line for each process that had to be forced.
        """
        with interrupts_deferred():
            with self._lock:
                self._stopping = True
            forced = self.end(self._children, input_grace_s=input_grace_s) + self._end_strays()
            deadline = time.monotonic() + LAST_WORDS_S
            for child in self._children.values():
                child.silent.wait(max(0.0, deadline - time.monotonic()))
            self._watcher.close()
            for child in self._children.values():
                child.stdout.close()
            for forker in self._forkers.values():
                forker.close()
            return forced

    def _end_strays(self) -> list[str]:
        lines = []
        for stray, name in self.strays():
            with contextlib.suppress(psutil.NoSuchProcess):
                lines.append(f"{name} left {stray.name()} (pid {stray.pid}) behind: SIGKILL")
                stray.kill()
        deadline = time.monotonic() + KILL_GRACE_S
        # polled: there is no other way to wait for a process that is not a child
        while lines and self.strays() and time.monotonic() < deadline:
            time.sleep(0.01)
        return lines

    def strays(self) -> list[tuple[psutil.Process, str]]:
        """Return living descendants of the children with the child's name, found by their environment.

        A process that left its parent, group and session still has the mark; only one that changed its
        environment or its user does not. A forked process has its prefork server's.
        """
        found, names = [], {child.pid: child.name for child in list(self._children.values())}
        for process in psutil.process_iter():
            try:
                token, _, name = process.environ().get(MARK, "").partition("/")
                if token == self.token and process.status() != psutil.STATUS_ZOMBIE:
                    found.append((process, names.get(process.pid, name)))
            except (psutil.Error, OSError):
                continue
        return found

    def log_path(self, name: str) -> Path:
        """Return the path of a child's log."""
        return self.log_folder / f"{name.replace(' ', '-')}.log"

    def log_tail(self, name: str, lines: int = TAIL_LINES) -> str:
        """Return the last lines of a child's log, of any size; empty if there is none."""
        try:
            with self.log_path(name).open("rb") as log:
                log.seek(max(0, log.seek(0, os.SEEK_END) - TAIL_BYTES))
                last = collections.deque(log, maxlen=lines)
        except OSError:
            return ""
        return b"".join(last).decode(errors="replace").rstrip()


def _wait_gone(children: Iterable[_Child], timeout_s: float) -> None:
    deadline = time.monotonic() + timeout_s
    for child in children:
        child.gone.wait(max(0.0, deadline - time.monotonic()))
