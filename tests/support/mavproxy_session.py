"""``python mavproxy_session.py PORT FOLDER``: MAVProxy without a window, controlled by commands on stdin.

MAVProxy is an interactive program, so it runs as a process, and its output is checked.
"""

import json
import os
import pty
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

MISSION = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t{lat:.7f}\t{lon:.7f}\t{alt:.2f}\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t5\t1
2\t0\t3\t16\t0\t1\t0\t0\t{north:.7f}\t{lon:.7f}\t5\t1
3\t0\t3\t16\t0\t1\t0\t0\t{north:.7f}\t{east:.7f}\t5\t1
4\t0\t3\t21\t0\t0\t0\t0\t{lat:.7f}\t{lon:.7f}\t0\t1
"""


PATIENCE = 2.0
"""How much slower than the wall clock a swarm may fly on a busy machine."""


class Session:
    """MAVProxy's prompt and its output."""

    def __init__(self, port: int, folder: Path) -> None:
        command = [sys.executable, "-m", "MAVProxy.mavproxy", f"--master=udpin:127.0.0.1:{port}"]
        command += [f"--state-basedir={folder}", "--aircraft=uav", "--force-connected"]
        # a terminal, since MAVProxy's output to a pipe is buffered in blocks
        self._terminal, inside = pty.openpty()
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=inside, stderr=inside, cwd=folder, text=True
        )
        os.close(inside)
        self.printed = ""
        self._checked_chars = 0
        self._output = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        while True:
            try:
                data = os.read(self._terminal, 4096)
            except OSError:
                return
            with self._output:
                self.printed += data.decode("utf-8", "replace")
                self._output.notify_all()

    def send_line(self, line: str) -> None:
        """Enter a command; checks apply to the output from now on."""
        with self._output:
            self._checked_chars = len(self.printed)
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def check(self, name: str, pattern: str, *, limit_s: float = 15.0, repeat: str | None = None) -> bool:
        """Wait for output with the pattern, entering ``repeat`` every second, and report the result.

        ``limit_s`` is in the vehicle's time, which MAVProxy does not print: wall time is PATIENCE times that.
        """
        wall_begin_s = time.monotonic()
        found, seen = False, ""
        while not found and time.monotonic() < wall_begin_s + PATIENCE * limit_s:
            if repeat is not None:
                self.send_line(repeat)
            with self._output:
                found = self._output.wait_for(
                    lambda: re.search(pattern, self.printed[self._checked_chars :]) is not None, 1.0
                )
                seen = self.printed[self._checked_chars :][-400:]
        report = {"check": name, "ok": found, "wall_s": round(time.monotonic() - wall_begin_s, 2)}
        sys.stdout.write(
            json.dumps(report | ({} if found else {"trouble": f"no {pattern!r} in {seen!r}"})) + "\n"
        )
        sys.stdout.flush()
        return found

    def end(self) -> None:
        """Exit MAVProxy; kill it if it does not end."""
        self.send_line("exit")
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()


def main(port: int, folder: Path, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
    session = Session(port, folder)
    session.check("it finds the vehicle", r"Detected vehicle 1:1", limit_s=30.0)
    session.check("and its parameters", r"Received \d{3,} parameters", limit_s=30.0)
    session.send_line("param show MPC_XY_CRUISE")
    session.check("a parameter", r"MPC_XY_CRUISE +[\d.]+")
    session.send_line("param set MIS_TAKEOFF_ALT 4")
    session.check("a parameter is set", r"MIS_TAKEOFF_ALT +4\.0", repeat="param show MIS_TAKEOFF_ALT")
    session.send_line("status GPS_RAW_INT")
    session.check("telemetry", r"fix_type *: *3", limit_s=20.0)
    plan = folder / "mission.txt"
    plan.write_text(
        MISSION.format(
            lat=latitude_deg,
            lon=longitude_deg,
            alt=altitude_m,
            north=latitude_deg + 8.0 / 111_319.5,
            east=longitude_deg + 1e-4,
        )
    )
    session.send_line(f"wp load {plan}")
    session.check("a mission goes up", r"Loaded 5 waypoints in [\d.]+s", limit_s=20.0)
    session.send_line(f"wp save {folder / 'back.txt'}")
    session.check("and comes back", r"Saved 5 waypoints", limit_s=20.0)
    session.send_line("arm throttle")
    session.check("it arms", r"\bARMED", limit_s=20.0)
    session.send_line("takeoff 5")  # PX4 reads it as an altitude above sea level, and raises it
    session.check("it takes off", r"Mode TAKEOFF", limit_s=10.0)
    session.check("and hovers", r"Mode LOITER", limit_s=25.0)
    session.send_line("long DO_SET_MODE 1 4 5")  # its command `mode` does not support PX4's modes
    session.check("it changes mode", r"Mode RTL", limit_s=10.0)
    session.check("it is down and disarmed", r"DISARMED", limit_s=40.0)
    session.end()


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), *map(float, sys.argv[3:6]))
