"""One flight of the chaos study: a real ``coflight hold``, its faults, and the judgement of its end."""

import contextlib
import re
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import psutil
from msgspec import Struct

from foundation.exit_status import FINE
from studies.chaos.faults import Fault, Kind, Target
from studies.chaos.launcher import Launcher
from studies.chaos.requirements import STOP_S, end_limit_s, named, statuses, statuses_before
from studies.chaos.small_disk import SmallDisk

GONE_LIMIT_S = 2.0
"""Wall time after the end within which no process is left."""
REACH_LIMIT_S = 120.0
"""Wall time within which a phase must be reached."""
COMPLETE_LIMIT_S = 120.0
"""Wall time within which a flight must be complete that goes on."""
POLL_S = 0.02
SOCKET_FOLDER = "coflight-radio-"
"""Begin of the name of the folder for the radio's socket."""
FILE_BYTES = 4_096
"""How much a file may still grow after the fault of a limited file size."""


class Outcome(Struct, frozen=True, kw_only=True):
    """How one flight ended. Wall times are from the first fault on."""

    fault: Fault
    status: int | None
    ended_s: float
    last_line: str
    complaints: tuple[str, ...]
    """What is not as it has to be."""
    reached: bool = True
    """Whether the phase was reached while the process existed; the launcher's end is judged otherwise."""
    second_reached: bool = True
    """Whether the process of the second fault existed; the flight is judged by the first alone otherwise."""


class Cancelled(Exception):
    """The study is being ended."""


def fly(fault: Fault, folder: Path, cancelled: threading.Event | None = None) -> Outcome:
    """Fly into a new folder and inject the fault; returns the judged outcome and leaves no process.

    Raises `Cancelled` soon after ``cancelled`` is set.
    """
    with contextlib.ExitStack() as stack:
        disk = stack.enter_context(SmallDisk(folder / "disk")) if fault.target == "disk" else None
        launcher = Launcher(fault, folder, disk)
        stack.callback(launcher.end)
        return _Flight(fault, launcher, disk, cancelled or threading.Event()).judged()


def fly_in_temporary_folder(fault: Fault, cancelled: threading.Event | None = None) -> Outcome:
    """Fly as `fly` in a folder that is deleted afterwards."""
    with tempfile.TemporaryDirectory(prefix="coflight-chaos-") as folder:
        return fly(fault, Path(folder), cancelled)


class _Flight:
    def __init__(
        self, fault: Fault, launcher: Launcher, disk: SmallDisk | None, cancelled: threading.Event
    ) -> None:
        self._fault = fault
        self._launcher = launcher
        self._disk = disk
        self._cancelled = cancelled

    def judged(self) -> Outcome:
        """Inject the faults, wait for the end, and judge it."""
        launcher = self._launcher
        has_begun = self._begin_phase()
        if not (has_begun and self._exists(self._fault.target)):
            return self._judged_before_fault(has_begun=has_begun)
        wall_begin_s = time.monotonic()
        second_reached = self._inject_all()
        fault = self._fault if second_reached else self._fault.parts[0]
        expected, limit_s = statuses(fault), end_limit_s(fault)
        goes_on = FINE in expected
        self._wait(self._has_ended, COMPLETE_LIMIT_S if goes_on else 2.0 * limit_s)
        status = launcher.process.poll()
        ended_s = round(time.monotonic() - wall_begin_s, 3)
        self._wait(lambda: not launcher.marked(), GONE_LIMIT_S)
        left = sorted(launcher.marked())
        complaints = []
        if status is None:
            complaints.append("it does not end")
        elif status not in expected:
            complaints.append(f"status {status} instead of {' or '.join(map(str, expected))}")
        if not goes_on and ended_s > limit_s:
            complaints.append(f"it ends after {ended_s:.1f} s")
        text = launcher.text()
        patterns = named(fault)
        if patterns and not any(re.search(pattern, text) for pattern in patterns):
            complaints.append("it does not name the process and what happened to it")
        if "Traceback" in text:
            complaints.append("it prints a traceback")
        if left:
            complaints.append(f"it leaves {', '.join(left)}")
        complaints += self._folder_complaints(status)
        return Outcome(
            fault=self._fault, status=status, ended_s=ended_s, last_line=self._last_line(),
            complaints=tuple(complaints), second_reached=second_reached,
        )  # fmt: skip

    def _judged_before_fault(self, *, has_begun: bool) -> Outcome:
        """Judge a flight that does not reach its phase, or whose process has ended before its fault."""
        complaint = ""
        if not has_begun and not self._has_ended():
            complaint = "it does not reach its phase"
        else:
            if self._fault.phase == "pause":  # the flight has to complete
                self._launcher.press(b" ")
            if not self._wait(self._has_ended, COMPLETE_LIMIT_S):
                complaint = "it does not end"
            elif self._launcher.process.poll() not in statuses_before(self._fault):
                complaint = f"status {self._launcher.process.poll()} before its fault"
        return Outcome(
            fault=self._fault, status=self._launcher.process.poll(), ended_s=0.0,
            last_line=self._last_line(), complaints=(complaint,) if complaint else (), reached=False,
        )  # fmt: skip

    def _wait(self, holds: Callable[[], bool], limit_s: float) -> bool:
        """Wait until a condition holds, at most for a wall time; returns whether it does."""
        wall_end_s = time.monotonic() + limit_s
        while not holds():
            if time.monotonic() > wall_end_s:
                return False
            self._sleep(POLL_S)
        return True

    def _sleep(self, wall_s: float) -> None:
        if self._cancelled.wait(max(0.0, wall_s)):
            raise Cancelled

    def _has_ended(self) -> bool:
        return self._launcher.process.poll() is not None

    def _begin_phase(self) -> bool:
        """Wait for the phase and its delay; returns whether the flight has reached the phase."""
        launcher = self._launcher
        if not self._wait(lambda: self._has_ended() or self._has_begun(), REACH_LIMIT_S) or self._has_ended():
            return False
        if self._fault.phase == "pause":
            launcher.press(b" ")
            self._wait(lambda: self._has_ended() or "paused at" in launcher.text(), REACH_LIMIT_S)
            if "paused at" not in launcher.text():
                return False
        if self._fault.phase == "stop":
            launcher.process.send_signal(signal.SIGINT)
        self._sleep(self._fault.delay_s)
        return True

    def _has_begun(self) -> bool:
        target, text = self._fault.target, self._launcher.text()
        match self._fault.phase:
            case "imports":
                return target in self._launcher.processes() and (
                    target != "launcher" or _handles(self._launcher.process.pid, signal.SIGTERM)
                )
            case "start":
                return "uav 0" in self._launcher.processes()
            case "report":
                return "computing patterns" in text
            case _:
                return "holding" in text and re.search(r"t = [0-9.]+ of ", text) is not None

    def _exists(self, target: Target) -> bool:
        return not self._has_ended() and (target == "disk" or target in self._launcher.processes())

    def _inject_all(self) -> bool:
        """Inject the faults, each at its time; returns whether the second process existed.

        Processes that are stopped for a time continue, and so does a flight in pause.
        """
        wall_begin_s = time.monotonic()
        second = self._fault.second
        continued: list[tuple[float, psutil.Process]] = []
        reached = True
        for i, part in enumerate(self._fault.parts):
            if i > 0 and second is not None:
                self._sleep(wall_begin_s + second.after_s - time.monotonic())
                reached = self._exists(part.target)
            if reached:
                process = self._inject(part.target, part.kind)
                if process is not None and part.kind == "SIGSTOP for 2 s":
                    continued.append((time.monotonic() + STOP_S, process))
        for wall_s, process in continued:
            self._sleep(wall_s - time.monotonic())
            with contextlib.suppress(psutil.NoSuchProcess):
                process.send_signal(signal.SIGCONT)
        if self._fault.phase == "pause":  # what goes on has to complete
            self._launcher.press(b" ")
        return reached

    def _inject(self, target: Target, kind: Kind) -> psutil.Process | None:
        """Inject a fault now; returns its process."""
        if kind == "full":
            assert self._disk is not None  # noqa: S101  made for this kind
            self._disk.fill()
        elif kind == "closed output":
            self._launcher.close_output()
        elif kind == "closed terminal":
            self._launcher.close_terminal()
        elif (process := self._launcher.processes().get(target)) is not None:
            with contextlib.suppress(psutil.NoSuchProcess, ProcessLookupError):
                if kind == "file limit":
                    sizes = (path.stat().st_size for path in (self._launcher.run / "raw").glob("*.bin"))
                    limit = max(sizes, default=0) + FILE_BYTES
                    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
                else:
                    process.send_signal(signal.SIGSTOP if kind == "SIGSTOP for 2 s" else signal.Signals[kind])
            return process
        return None

    def _folder_complaints(self, status: int | None) -> list[str]:
        """Judge the records and the temporary files."""
        complaints = []
        left = sorted(path.name for path in self._launcher.temporary.iterdir())
        if status is not None and status < 0:  # the next launcher removes the socket of a killed one
            left = [name for name in left if not name.startswith(SOCKET_FOLDER)]
        if left:
            complaints.append(f"it leaves {', '.join(left)}")
        summary = self._launcher.run / "summary.json"
        if (summary if self._disk is None else self._disk.path(summary)).exists():
            return complaints
        if status == FINE:
            complaints.append("it is complete without a summary")
        if self._fault.phase not in ("imports", "start"):
            error = self._report_error()
            if error is not None:
                complaints.append(f"its records cannot be read: {error[-200:]}")
        return complaints

    def _report_error(self) -> str | None:
        """Make the tables of a run that was broken off; returns the error, if they cannot be made."""
        command = [sys.executable, "-m", "coflight", "report", str(self._launcher.run), "--json"]
        if self._disk is not None:
            self._disk.free()
            command = self._disk.command(command)
        with tempfile.TemporaryFile(mode="w+") as messages:
            report = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=messages,
                env=self._launcher.environment,
            )  # fmt: skip
            try:
                self._wait(lambda: report.poll() is not None, COMPLETE_LIMIT_S)
            finally:
                report.kill()
                report.wait()
            messages.seek(0)
            return None if report.returncode == FINE else messages.read().strip()

    def _last_line(self) -> str:
        return next(iter(reversed(self._launcher.text().splitlines())), "")


def _handles(pid: int, number: signal.Signals) -> bool:
    """Whether a process has a handler for a signal: until coflight runs, the interpreter has none."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("SigCgt:"):
                return bool(int(line.split()[1], 16) >> (number - 1) & 1)
    return False
