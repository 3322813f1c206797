"""Programs of vehicles as children of PID 1: started, restarted, stopped and reaped."""

import contextlib
import errno
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from netsim.network import enter
from netsim.network.messages import ProgramConfig, ProgramEnded, ProgramStarted, Restart
from netsim.wire.messages import Station

TERM_GRACE_S = 2.0
"""Wall time between SIGTERM and SIGKILL."""
FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 10.0
"""Wall time before a restart: doubled with each, up to the longest."""
STEADY_S = 10.0
"""Wall time after which a program counts as running: the next delay is the first again."""
_NETWORK_FD, _MOUNTS_FD = 3, 4
"""In the program's process; in this one both are of other files, which were opened first."""
_KILL_PERIOD_S = 0.05
"""Wall time between two attempts to kill what has not ended."""
_OWN_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "PYTHONFAULTHANDLER",
    "NUMBA_CACHE_DIR",
    "ZENOH_RUNTIME",
)
"""Settings of coflight's processes, which programs do not inherit."""
Namespaces = tuple[int, int]
"""Descriptors of a vehicle's network and mount namespaces."""
Report = Callable[[ProgramStarted | ProgramEnded], None]


def restart_delay_s(restart: Restart, returncode: int, ran_s: float, last_delay_s: float) -> float | None:
    """Return the wall time before a program is started again, None if it is not.

    ``last_delay_s`` is that before its last start, 0 for none.
    """
    if restart == "never" or (restart == "on_failure" and returncode == 0):
        return None
    if ran_s >= STEADY_S or last_delay_s <= 0.0:
        return FIRST_DELAY_S
    return min(2.0 * last_delay_s, LONGEST_DELAY_S)


class _Program:
    def __init__(self, index: int, config: ProgramConfig, namespaces: Namespaces) -> None:
        self.index, self.config, self.namespaces = index, config, namespaces
        self.wall_started_s = 0.0
        self.wall_due_s: float | None = None
        """When it is to be started."""
        self.delay_s = 0.0
        self.was_requested = False
        self.starts = self.failures = 0


class Programs:
    """All programs, for one thread. ``report`` is called with each start and end.

    ``namespaces`` are the vehicles'.
    """

    def __init__(
        self, configs: Sequence[ProgramConfig], namespaces: Mapping[Station, Namespaces], report: Report
    ) -> None:
        self._programs = [
            _Program(index, config, namespaces[config.station]) for index, config in enumerate(configs)
        ]
        self._running: dict[int, _Program] = {}
        """By process id."""
        self._report = report
        self._wall_kill_s: float | None = None
        """When processes are killed that have not ended by SIGTERM."""
        self._orphans = 0

    def start(self, indices: Sequence[int] | None, wall_s: float) -> list[int]:
        """Start programs that have not been started, None: all; return indices of which there is none."""
        if self._wall_kill_s is not None:
            return []
        chosen = range(len(self._programs)) if indices is None else indices
        for index in chosen:
            if index < len(self._programs) and not self._programs[index].was_requested:
                self._programs[index].was_requested = True
                self._start(self._programs[index], wall_s)
        return [index for index in chosen if index >= len(self._programs)]

    @property
    def wall_due_s(self) -> float | None:
        """Return the wall time at which `update` is to be called next; None: at no particular time."""
        if self._wall_kill_s is not None:
            return self._wall_kill_s
        return min((each.wall_due_s for each in self._programs if each.wall_due_s is not None), default=None)

    def update(self, wall_s: float) -> None:
        """Reap ended children, and start or kill what is due."""
        while (ended := _reap()) is not None:
            self._on_end(*ended, wall_s)
        if self._wall_kill_s is not None:
            if wall_s >= self._wall_kill_s:
                _signal_all(signal.SIGKILL)
                self._wall_kill_s = wall_s + _KILL_PERIOD_S
            return
        for program in self._programs:
            if program.wall_due_s is not None and wall_s >= program.wall_due_s:
                self._start(program, wall_s)

    def stop(self, wall_s: float) -> None:
        """Ask all processes of the namespace to end; those that have not after `TERM_GRACE_S` are killed."""
        if self._wall_kill_s is None:
            self._wall_kill_s = wall_s + TERM_GRACE_S
            for program in self._programs:
                program.wall_due_s = None
            _signal_all(signal.SIGTERM)
            _signal_all(signal.SIGCONT)

    @property
    def have_ended(self) -> bool:
        """Whether this process has no children any more, after `stop`."""
        return self._wall_kill_s is not None and not _has_children()

    @property
    def counters(self) -> dict[str, object]:
        """Return the numbers of starts and failures of the programs, and of reaped orphans."""
        return {
            "started": sum(each.starts for each in self._programs),
            "failed": sum(each.failures for each in self._programs),
            "orphans": self._orphans,
        }

    def _start(self, program: _Program, wall_s: float) -> None:
        program.wall_due_s, program.wall_started_s = None, wall_s
        program.starts += 1
        try:
            pid = _spawn(program.config, *program.namespaces)
        except OSError as error:
            _write_reason(program.config.log_path, error)
            status = enter.NOT_FOUND if error.errno == errno.ENOENT else enter.CANNOT_EXECUTE
            self._ended(program, status, wall_s)
            return
        self._running[pid] = program
        self._report(ProgramStarted(program=program.index, station=program.config.station, pid=pid))

    def _on_end(self, pid: int, returncode: int, wall_s: float) -> None:
        program = self._running.pop(pid, None)
        if program is not None:
            self._ended(program, returncode, wall_s)
        elif self._wall_kill_s is None:  # otherwise it may be a namespace's holder
            self._orphans += 1

    def _ended(self, program: _Program, returncode: int, wall_s: float) -> None:
        ran_s = wall_s - program.wall_started_s
        delay_s = restart_delay_s(program.config.restart, returncode, ran_s, program.delay_s)
        if self._wall_kill_s is not None:
            delay_s = None
        else:
            program.failures += returncode != 0
        if delay_s is not None:
            program.delay_s, program.wall_due_s = delay_s, wall_s + delay_s
        self._report(
            ProgramEnded(
                program=program.index, name=program.config.name, station=program.config.station,
                returncode=returncode, ran_s=ran_s, restart_in_s=delay_s,
                was_stopped=self._wall_kill_s is not None,
            )
        )  # fmt: skip


def _spawn(config: ProgramConfig, network_fd: int, mounts_fd: int) -> int:
    """Start a program by `netsim.network.enter` and return its process id. Raises OSError."""
    log = os.open(config.log_path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
    try:
        folder = [] if config.folder is None else ["--folder", config.folder]
        # -I -S: without the site packages, whose set-up takes several times as long
        python = [sys.executable, "-I", "-S", enter.__file__, str(_NETWORK_FD), str(_MOUNTS_FD)]
        return os.posix_spawn(
            sys.executable,
            [*python, *folder, "--", *config.command],
            inherited_environment() | config.environment,
            file_actions=(
                (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
                (os.POSIX_SPAWN_DUP2, log, 1),
                (os.POSIX_SPAWN_DUP2, log, 2),
                (os.POSIX_SPAWN_DUP2, network_fd, _NETWORK_FD),
                (os.POSIX_SPAWN_DUP2, mounts_fd, _MOUNTS_FD),
            ),
            setsigmask=(),
        )
    finally:
        os.close(log)


def inherited_environment() -> dict[str, str]:
    """Return the environment of this process without coflight's own settings."""
    return {name: text for name, text in os.environ.items() if name not in _OWN_VARIABLES}


def _write_reason(log_path: str, error: OSError) -> None:
    try:
        with Path(log_path).open("a", encoding="utf-8") as log:
            log.write(f"{error.filename}: {error.strerror}\n")
    except OSError:  # the log itself; the exit status remains
        print(f"{log_path}: {error.strerror}", file=sys.stderr)  # noqa: T201


def _reap() -> tuple[int, int] | None:
    """Return process id and exit status, or minus the signal, of a child that has ended; None without any."""
    try:
        pid, status = os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return None
    return (pid, os.waitstatus_to_exitcode(status)) if pid else None


def _has_children() -> bool:
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return False
    return True


def _signal_all(number: signal.Signals) -> None:
    """Signal all processes of the PID namespace but this one, which is its first."""
    if os.getpid() != 1:  # or it would signal all processes of the user
        raise RuntimeError("not the first process of a PID namespace")
    with contextlib.suppress(ProcessLookupError):  # there is none
        os.kill(-1, number)
