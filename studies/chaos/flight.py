"""One flight of the chaos study: a real ``coflight hold``, whose processes have a mark in their environment.

A held swarm transmits and ranges on the ground, so a flight takes a few seconds and all processes work.
"""

import contextlib
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path
from typing import Self

import psutil
from msgspec import Struct

from studies.chaos.faults import Fault, named, statuses

MARK = "COFLIGHT_CHAOS"
END_LIMIT_S = 15.0
"""Wall time from the fault to the end of a flight that does not go on."""
GONE_LIMIT_S = 2.0
"""Wall time after the end within which no process is left."""
REACH_LIMIT_S = 120.0
"""Wall time within which a phase must be reached."""
COMPLETE_LIMIT_S = 120.0
"""Wall time within which a flight must be complete that goes on."""
SIMULATED_S = 20.0
"""Length of the flights, at twice the wall clock's pace: longer than it takes to find a stopped process."""
POLL_S = 0.02
SOCKET_FOLDER = "coflight-radio-"
"""Begin of the name of the folder for the radio's socket."""
FILE_BYTES = 4_096
"""How much a file may still grow after the fault of a limited file size."""


class Outcome(Struct, frozen=True, kw_only=True):
    """How one flight ended. Wall times are from the fault on."""

    fault: Fault
    status: int | None
    ended_s: float
    last_line: str
    complaints: tuple[str, ...]
    """What is not as it has to be."""
    reached: bool = True
    """Whether the phase was reached while the process existed."""


def fly(fault: Fault, folder: Path) -> Outcome:
    """Fly into a new folder and inject the fault; returns the judged outcome and leaves no process."""
    with _Flight(fault, folder) as flight:
        return flight.judged()


class _Flight:
    """A launcher with its processes. ``folder`` gets the run, its messages and its temporary files."""

    def __init__(self, fault: Fault, folder: Path) -> None:
        self._fault = fault
        self._mark = uuid.uuid4().hex
        self._run = folder / "run"
        self._messages = folder / "messages.txt"
        self._temporary = folder / "temporary"
        self._temporary.mkdir(0o700, parents=True)
        duration_s = 0.2 if fault.phase == "report" else SIMULATED_S
        speed = "max" if fault.phase == "report" else "2"
        command = [
            sys.executable, "-m", "coflight", "hold", "article", "--agents=2", f"--duration={duration_s:g}",
            f"--speed={speed}", "--port-offset=auto", "--set=antenna.grid_deg=6", "--out", str(self._run),
        ]  # fmt: skip
        folders = dict.fromkeys(("TMPDIR", "XDG_RUNTIME_DIR"), str(self._temporary))
        environment = os.environ | folders | {MARK: self._mark}
        self._terminal, terminal = os.openpty()
        self._reader: int | None = None
        if fault.kind == "closed output":
            self._reader, output = os.pipe()
        else:
            output = os.open(self._messages, os.O_WRONLY | os.O_CREAT)
        self._launcher = subprocess.Popen(
            command, env=environment, stdin=terminal, stdout=output, stderr=output, start_new_session=True,
            preexec_fn=_take_terminal,  # noqa: PLW1509  this process has one thread
        )  # fmt: skip
        os.close(terminal)
        os.close(output)
        self._text = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes().values():
            with contextlib.suppress(psutil.Error):
                process.kill()
        self._launcher.kill()
        self._launcher.wait()
        os.close(self._terminal)
        if self._reader is not None:
            os.close(self._reader)

    def judged(self) -> Outcome:
        """Inject the fault, wait for the end, and judge it."""
        if not self._reach():
            return Outcome(
                fault=self._fault, status=self._launcher.poll(), ended_s=0.0, last_line=self._last_line(),
                complaints=(), reached=False,
            )  # fmt: skip
        wall_begin_s = time.monotonic()
        self._inject()
        expected = statuses(self._fault)
        goes_on = 0 in expected
        status: int | None = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            status = self._launcher.wait(COMPLETE_LIMIT_S if goes_on else 2.0 * END_LIMIT_S)
        ended_s = time.monotonic() - wall_begin_s
        left = self._left()
        complaints = []
        if status is None:
            complaints.append("it does not end")
        elif status not in expected:
            complaints.append(f"status {status} instead of {' or '.join(map(str, expected))}")
        if not goes_on and ended_s > END_LIMIT_S:
            complaints.append(f"it ends after {ended_s:.1f} s")
        text = self._all_text()
        patterns = named(self._fault)
        if patterns and not any(re.search(pattern, text) for pattern in patterns):
            complaints.append("it does not name the process and what happened to it")
        if "Traceback" in text:
            complaints.append("it prints a traceback")
        if left:
            complaints.append(f"it leaves {', '.join(left)}")
        complaints += self._folder_complaints(status)
        return Outcome(
            fault=self._fault, status=status, ended_s=ended_s, last_line=self._last_line(),
            complaints=tuple(complaints),
        )  # fmt: skip

    def _reach(self) -> bool:
        """Wait for the phase and its delay; returns whether the process exists then."""
        wall_end_s = time.monotonic() + REACH_LIMIT_S
        while not self._has_begun():
            if self._launcher.poll() is not None or time.monotonic() > wall_end_s:
                return False
            time.sleep(POLL_S)
        if self._fault.phase == "pause":
            os.write(self._terminal, b" ")
            while "paused at" not in self._all_text():
                if self._launcher.poll() is not None or time.monotonic() > wall_end_s:
                    return False
                time.sleep(POLL_S)
        if self._fault.phase == "stop":
            self._launcher.send_signal(signal.SIGINT)
        time.sleep(self._fault.delay_s)
        return self._launcher.poll() is None and self._fault.target in self._processes()

    def _has_begun(self) -> bool:
        target, text = self._fault.target, self._all_text()
        match self._fault.phase:
            case "imports":
                return target in self._processes() and (
                    target != "launcher" or _handles(self._launcher.pid, signal.SIGTERM)
                )
            case "start":
                return "uav 0" in self._processes()
            case "report":
                return "computing patterns" in text
            case _:
                return "holding" in text and re.search(r"t = [0-9.]+ of ", text) is not None

    def _inject(self) -> None:
        process, kind = self._processes()[self._fault.target], self._fault.kind
        with contextlib.suppress(psutil.NoSuchProcess, ProcessLookupError):
            match kind:
                case "closed output":
                    assert self._reader is not None  # noqa: S101  opened for this kind
                    os.close(self._reader)
                    self._reader = None
                case "file limit":
                    sizes = (path.stat().st_size for path in (self._run / "raw").glob("*.bin"))
                    limit = max(sizes, default=0) + FILE_BYTES
                    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
                case "SIGSTOP for 2 s":
                    os.kill(process.pid, signal.SIGSTOP)
                    time.sleep(2.0)
                    os.kill(process.pid, signal.SIGCONT)
                case _:
                    os.kill(process.pid, getattr(signal, kind))
        if self._fault.phase == "pause":  # what goes on has to complete
            with contextlib.suppress(OSError):
                os.write(self._terminal, b" ")

    def _processes(self) -> dict[str, psutil.Process]:
        """Return the living processes of the flight by name."""
        found = {}
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get(MARK) == self._mark and process.status() != psutil.STATUS_ZOMBIE:
                    found[_name(process, self._launcher.pid)] = process
        return found

    def _left(self) -> list[str]:
        """Return the names of the processes that exist after their time."""
        wall_end_s = time.monotonic() + GONE_LIMIT_S
        while (left := sorted(self._processes())) and time.monotonic() < wall_end_s:
            time.sleep(POLL_S)
        return left

    def _folder_complaints(self, status: int | None) -> list[str]:
        """Judge the records and the temporary files."""
        complaints = []
        left = sorted(path.name for path in self._temporary.iterdir())
        if status is not None and status < 0:  # the next launcher removes the socket of a killed one
            left = [name for name in left if not name.startswith(SOCKET_FOLDER)]
        if left:
            complaints.append(f"it leaves {', '.join(left)}")
        has_flown = self._fault.phase not in ("imports", "start")
        if has_flown and not (self._run / "summary.json").exists():
            report = [sys.executable, "-m", "coflight", "report", str(self._run), "--json"]
            done = subprocess.run(report, capture_output=True, text=True, check=False)
            if done.returncode != 0:
                complaints.append(f"its records cannot be read: {done.stderr.strip()[-200:]}")
        return complaints

    def _all_text(self) -> str:
        """Return all messages so far."""
        if self._fault.kind != "closed output":
            return self._messages.read_text(errors="replace") if self._messages.exists() else ""
        if self._reader is not None:
            os.set_blocking(self._reader, False)
            with contextlib.suppress(BlockingIOError):
                while data := os.read(self._reader, 65_536):
                    self._text += data.decode(errors="replace")
        return self._text

    def _last_line(self) -> str:
        return next(iter(reversed(self._all_text().splitlines())), "")


def _name(process: psutil.Process, launcher: int) -> str:
    """Return the name of one of the flight's processes."""
    if process.pid == launcher:
        return "launcher"
    named = str(process.name())
    if named.startswith("uav ") or named == "prefork":
        return named
    line = " ".join(process.cmdline())
    modules = {"harness.simulator.server": "physics", "prefork_server": "prefork", "netsim": "radio"}
    return next((name for module, name in modules.items() if module in line), f"{named} ({process.pid})")


def _handles(pid: int, number: signal.Signals) -> bool:
    """Whether a process has a handler for a signal: until coflight runs, the interpreter has none."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("SigCgt:"):
                return bool(int(line.split()[1], 16) >> (number - 1) & 1)
    return False


def _take_terminal() -> None:
    """Make standard input the controlling terminal, and restore the signals that this process may ignore."""
    import fcntl  # noqa: PLC0415  in the new process alone
    import termios  # noqa: PLC0415

    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def fly_in_temporary_folder(fault: Fault) -> Outcome:
    """Fly as `fly` in a folder that is deleted afterwards."""
    with tempfile.TemporaryDirectory(prefix="coflight-chaos-") as folder:
        return fly(fault, Path(folder))
