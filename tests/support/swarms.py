"""Swarms with --hold at wall-clock speed, and the results of clients on them."""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from paths import ROOT

from harness.launch.resources import ResourceError, bind
from harness.scenario.scenario import PortsConfig

AGENTS = 3
START_S = 150.0
END_S = 60.0
KILL_S = 10.0
OFFSETS = range(1_000, 14_000, 50)
"""With these all ports are below Linux's range of ephemeral ports."""


def free_offset() -> int:
    """Return an offset with which all ports of a swarm are free; the search begins at the process id."""
    begin = os.getpid() % len(OFFSETS)
    for offset in (*OFFSETS[begin:], *OFFSETS[:begin]):
        with contextlib.ExitStack() as stack, contextlib.suppress(ResourceError):
            for name, base in PortsConfig().numbers().items():
                kind = socket.SOCK_STREAM if name.endswith("tcp") else socket.SOCK_DGRAM
                for i in range(AGENTS):
                    stack.enter_context(bind(kind, "127.0.0.1", base + offset + i))
            return offset
    raise AssertionError("no free ports for a swarm")


class Held:
    """A swarm started from the command line with --hold; its ports are PX4's plus an offset."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.folder = folder
        self._options = options
        self.log_lines: list[str] = []
        self._ready = threading.Event()
        self._news = threading.Condition()
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start it; return when its vehicles wait."""
        port_offset = free_offset()
        self.ground_station_port, self.companion_port = 14550 + port_offset, 14540 + port_offset
        command = [sys.executable, str(ROOT / "scripts" / "launch_swarm.py")]
        command += [
            str(ROOT / "scenarios" / "article.toml"),
            "--agents",
            str(AGENTS),
            "--hold",
        ]
        command += ["--port-offset", str(port_offset), "--out", str(self.folder), *self._options]
        self._process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        assert self._ready.wait(START_S), self.log_lines
        assert self._process.poll() is None, self.log_lines

    def _read(self) -> None:
        assert self._process is not None and self._process.stderr is not None  # noqa: PT018
        for line in self._process.stderr:
            with self._news:
                self.log_lines.append(line.rstrip())
                self._news.notify_all()
            if line.startswith("uav 0, system 1:"):  # the first of the addresses: all have started
                self._ready.set()
        self._ready.set()

    def await_time(self, time_s: float) -> str:
        """Wait until a line of progress has this simulated time; return the line."""

        def found() -> str | None:
            times = ((re.match(r"t = ([\d.]+) s, ", line), line) for line in self.log_lines)
            return next((line for match, line in times if match and float(match[1]) >= time_s), None)

        with self._news:
            line = self._news.wait_for(found, START_S)
        assert line is not None, self.log_lines
        return line

    def end(self) -> dict[str, Any]:
        """End the run by SIGINT; return its manifest."""
        assert self._process is not None
        self._process.send_signal(signal.SIGINT)
        assert self._process.wait(END_S) == 0, self.log_lines
        self._reader.join(END_S)
        return json.loads((self.folder / "manifest.json").read_text())

    def kill(self) -> None:
        """Terminate it if it still runs; its child processes end with it."""
        if self._process is None:
            return
        if self._process.poll() is None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(END_S)
            self._process.kill()
            self._process.wait(KILL_S)
        self._reader.join(END_S)
        if self._process.stderr is not None:
            self._process.stderr.close()

    @property
    def pace(self) -> list[float]:
        """Reported real-time factors, one every few seconds."""
        return [float(x) for line in self.log_lines for x in re.findall(r"([\d.]+) x real time", line)]


def findings(process: subprocess.Popen[str], *, wall_limit_s: float) -> list[dict[str, Any]]:
    """Results of a client, which is killed after ``wall_limit_s``; other output is added to a failure."""
    wall_deadline_s = time.monotonic() + wall_limit_s
    try:
        output, _ = process.communicate(timeout=wall_limit_s)
    except subprocess.TimeoutExpired:
        process.kill()
        output, _ = process.communicate()
    lines = output.splitlines()
    found = [json.loads(line) for line in lines if line.startswith("{")]
    if process.returncode != 0 or time.monotonic() > wall_deadline_s:
        rest = [line for line in lines if not line.startswith("{")][-20:]
        found.append({"check": "the client ends by itself", "ok": False, "trouble": "\n".join(rest)})
    return found


def failures(found: list[dict[str, Any]]) -> list[str]:
    """One line for each failed check."""
    return [
        f"{one['check']}: {one['trouble']} ({one.get('wall_s')} s, of the vehicle's {one.get('vehicle_s')} s)"
        for one in found
        if not one["ok"]
    ]
