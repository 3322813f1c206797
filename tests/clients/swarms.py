"""Swarms that hold, at the pace of the wall clock, and what clients found on them."""

import json
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
START_S = 150.0
END_S = 60.0


class Held:
    """A swarm of the command line that waits for ground stations; its ports are PX4's plus the offset."""

    def __init__(self, folder: Path, port_offset: int, *options: str) -> None:
        self.folder = folder
        self.ground_station_port, self.companion_port = 14550 + port_offset, 14540 + port_offset
        command = [sys.executable, str(ROOT / "scripts" / "launch_swarm.py")]
        command += [str(ROOT / "scenarios" / "article.toml"), "--agents", "3", "--speed", "1", "--hold"]
        command += ["--port-offset", str(port_offset), "--out", str(folder), *options]
        self.said: list[str] = []
        self._ready = threading.Event()
        self._process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        assert self._ready.wait(START_S), self.said
        assert self._process.poll() is None, self.said

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self.said.append(line.rstrip())
            if line.startswith("uav 0, system 1:"):  # the first of the addresses: all have started
                self._ready.set()
        self._ready.set()

    def end(self) -> dict[str, Any]:
        """End the run as its user does; returns its manifest."""
        self._process.send_signal(signal.SIGINT)
        assert self._process.wait(END_S) == 0, self.said
        self._reader.join(END_S)
        return json.loads((self.folder / "manifest.json").read_text())

    def kill(self) -> None:
        """Make sure that it is gone."""
        if self._process.poll() is None:
            self._process.terminate()
            self._process.wait(END_S)
        self._reader.join(END_S)
        if self._process.stderr is not None:
            self._process.stderr.close()

    @property
    def pace(self) -> list[float]:
        """Speeds against the wall clock that it told, one every few seconds."""
        return [float(x) for line in self.said for x in re.findall(r"([\d.]+) x real time", line)]


def findings(process: subprocess.Popen[str], *, wall_limit_s: float) -> list[dict[str, Any]]:
    """What a client found, which has so long to end by itself; its lines that are no JSON tell of trouble."""
    wall_deadline_s = time.monotonic() + wall_limit_s
    try:
        said, _ = process.communicate(timeout=wall_limit_s)
    except subprocess.TimeoutExpired:
        process.kill()
        said, _ = process.communicate()
    lines = said.splitlines()
    found = [json.loads(line) for line in lines if line.startswith("{")]
    if process.returncode != 0 or time.monotonic() > wall_deadline_s:
        rest = [line for line in lines if not line.startswith("{")][-20:]
        found.append({"check": "the client ends by itself", "ok": False, "trouble": "\n".join(rest)})
    return found


def failures(found: list[dict[str, Any]]) -> list[str]:
    """A line for each check that failed."""
    return [f"{one['check']}: {one['trouble']}" for one in found if not one["ok"]]
