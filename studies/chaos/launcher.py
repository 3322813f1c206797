"""Start of a flight's launcher: its command, terminal, output and mark, and the processes that have the mark.

A held swarm transmits and ranges on the ground, so a flight takes a few seconds and all processes work.
"""

import contextlib
import json
import os
import subprocess
import sys
import uuid
from pathlib import Path

import psutil

from foundation.exit_status import FINE
from studies.chaos.faults import WITH_PX4, Fault
from studies.chaos.requirements import statuses
from studies.chaos.small_disk import SmallDisk

MARK = "COFLIGHT_CHAOS"
LONG_S = 60.0
"""Simulated length of a flight that the fault has to end: longer than it takes to find a stopped process."""
SHORT_S = 7.0
"""Simulated length of a flight that may go on, in each case at the wall clock's pace: longer than the phase's
delay, a second fault and the loss of a stopped vehicle."""
REPORT_S = 0.2
"""Simulated length of a flight whose fault comes while its results are computed."""
_SESSION = Path(__file__).with_name("session.py")
_PX4 = Path(__file__).with_name("px4_stand_in.py")
_MODULES = {
    "harness.simulator.server": "physics",
    "prefork_server": "prefork",
    "netsim": "radio",
    _PX4.name: "px4",
}


class Launcher:
    """A launcher with its processes. ``folder`` has the run, its messages and its temporary files."""

    def __init__(self, fault: Fault, folder: Path, disk: SmallDisk | None) -> None:
        self._mark = uuid.uuid4().hex
        self.run = (folder if disk is None else disk.folder) / "run"
        self.temporary = folder / "temporary"
        self.temporary.mkdir(0o700, parents=True)
        self._messages = folder / "messages.txt"
        self._text = ""
        self._reader: int | None = None
        folders = dict.fromkeys(("TMPDIR", "XDG_RUNTIME_DIR"), str(self.temporary))
        self.environment = os.environ | folders | {MARK: self._mark}
        command = _command(fault, self.run)
        if fault.target in WITH_PX4:
            command += _px4_options(folder)
        if disk is not None:
            command = disk.command(command)
        self._has_pipe = any(part.kind == "closed output" for part in fault.parts)
        if self._has_pipe:
            self._reader, output = os.pipe()
        else:
            output = os.open(self._messages, os.O_WRONLY | os.O_CREAT)
        own_end, terminal = os.openpty()
        self._terminal: int | None = own_end
        self.process = subprocess.Popen(
            [sys.executable, "-I", "-S", str(_SESSION), *command], env=self.environment,
            stdin=terminal, stdout=output, stderr=output, start_new_session=True,
        )  # fmt: skip
        os.close(terminal)
        os.close(output)

    def press(self, key: bytes) -> None:
        """Write to the terminal, unless it is closed or has no reader."""
        if self._terminal is not None:
            with contextlib.suppress(OSError):
                os.write(self._terminal, key)

    def close_terminal(self) -> None:
        """Close the terminal, as a user closes its window."""
        if self._terminal is not None:
            os.close(self._terminal)
            self._terminal = None

    def close_output(self) -> None:
        """Close the reader of its output and errors."""
        self.text()
        if self._reader is not None:
            os.close(self._reader)
            self._reader = None

    def text(self) -> str:
        """Return all messages so far."""
        if not self._has_pipe:
            return self._messages.read_text(errors="replace") if self._messages.exists() else ""
        if self._reader is not None:
            os.set_blocking(self._reader, False)
            with contextlib.suppress(BlockingIOError):
                while data := os.read(self._reader, 65_536):
                    self._text += data.decode(errors="replace")
        return self._text

    def processes(self) -> dict[str, psutil.Process]:
        """Return the living processes of the launcher's session by name."""
        found = {}
        for pid in psutil.pids():
            with contextlib.suppress(psutil.Error, OSError):
                if os.getsid(pid) == self.process.pid:
                    process = psutil.Process(pid)
                    if process.status() != psutil.STATUS_ZOMBIE:
                        found[self._name(process)] = process
        return found

    def marked(self) -> dict[str, psutil.Process]:
        """Return the living processes of the flight by name, whatever their session."""
        found = {}
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get(MARK) == self._mark and process.status() != psutil.STATUS_ZOMBIE:
                    found[self._name(process)] = process
        return found

    def _name(self, process: psutil.Process) -> str:
        if process.pid == self.process.pid:
            return "launcher"
        named = str(process.name())
        if named.startswith(("uav ", "application ")) or named == "prefork":
            return named
        words = process.cmdline()
        line = " ".join(words)
        name = next((name for module, name in _MODULES.items() if module in line), f"{named} ({process.pid})")
        if name == "px4":  # the stand-in itself, not the process that starts and watches it
            return f"px4 {int(words[2]) - 1}" if words[1] == str(_PX4) else f"starter {process.pid}"
        return name

    def end(self) -> None:
        """Kill all processes, and close terminal and output."""
        for process in self.marked().values():
            with contextlib.suppress(psutil.Error):
                process.kill()
        self.process.kill()
        self.process.wait()
        self.close_terminal()
        self.close_output()


def _command(fault: Fault, run: Path) -> list[str]:
    if fault.phase == "report":
        duration_s, speed = REPORT_S, "max"
    else:
        duration_s, speed = (SHORT_S if FINE in statuses(fault) else LONG_S), "1"
    return [
        sys.executable, "-m", "coflight", "hold", "article", "--agents=2", f"--duration={duration_s:g}",
        f"--speed={speed}", "--port-offset=auto", "--set=antenna.grid_deg=6", "--out", str(run),
    ]  # fmt: skip


def _px4_options(folder: Path) -> list[str]:
    """Return options by which stand-ins for PX4 fly, with a build folder that has the program's name only."""
    program = folder / "px4" / "bin" / "px4"
    program.parent.mkdir(parents=True)
    program.touch(0o755)
    command = json.dumps([sys.executable, str(_PX4), "{sysid}", "{tcp}"])
    return [
        "--set=autopilot.kind=px4", f"--set=autopilot.px4_build={folder / 'px4'}",
        f"--set=autopilot.px4_command={command}",
    ]  # fmt: skip
