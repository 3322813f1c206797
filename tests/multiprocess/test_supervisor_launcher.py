"""The launcher's command line: exit status, streams and Ctrl-C, with stand-ins for its processes."""

import fcntl
import json
import os
import re
import signal
import socket
import subprocess
import sys
import termios
import time
from pathlib import Path

import forked_command
import psutil
import pytest
from paths import SUPPORT

from harness.launch.resources import bind

pytestmark = pytest.mark.multiprocess

WALL_LIMIT_S = 30.0
AT_ONCE_S = 5.0
"""Wall time within which a run ends that has not begun."""
SUMMARY = """{
    "scenario": scenario.name, "seed": 1, "status": outcome.status, "reason": outcome.reason, "wall_s": 1.0,
    "simulated_s": outcome.simulated_us / 1e6, "real_time_factor": 1.0, "formed_s": None, "collisions": 0,
    "formation_rms_m": {"absolute": None, "shape": None}, "channel_busy_fraction": 0.1, "deterministic": True,
    "frames": {"sent": 0, "delivered": 0, "collided": 0, "lost_to_noise": 0}, "log_sha256": "0",
    "ftm": {"requested": 0, "completed": 0, "failed": 0, "error_mean_m": None, "error_std_m": None},
    "max_gain_dbi": {"ideal": None, "mean": None, "std": None}, "vehicles": [],
    "pids": [process.pid for process in outcome.processes], "speed": outcome.speed,
}"""
LAUNCHER = f"""
import shutil, sys, types
import harness.launch.processes
from harness.cli.fly import main

def python_module(module, *arguments):
    return [sys.executable, {str(SUPPORT / "supervisor_stand_ins.py")!r}, module, *arguments]

def finish(folder, scenario, outcome, *, draw=True):
    shutil.rmtree(folder.raw)
    return {SUMMARY}

harness.launch.processes.bound_module = python_module
# the analysis needs records of a real flight, and seconds to import
sys.modules["harness.report.report"] = types.SimpleNamespace(finish=finish)
sys.exit(main())
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a working folder with scenarios on free ports."""
    bases = (
        "simulator_tcp",
        "gcs_local_udp",
        "gcs_remote_udp",
        "companion_local_udp",
        "companion_remote_udp",
    )
    ports = "".join(f"{base} = 0\n" for base in (*bases, "radio_tcp")) + 'simulator_link = "tcp"\n'
    for name in ("fine", "never-formed", "physics-fails", "physics-dies-at-last", "interrupted", "held"):
        path = tmp_path / f"{name}.toml"
        path.write_text(f'name = "{name}"\nagents = 2\n[run]\nreach_timeout_s = 5.0\n[ports]\n{ports}')
    return tmp_path


def launch(folder: Path, *arguments: str, code: str = LAUNCHER) -> "subprocess.CompletedProcess[str]":
    """Run the launcher to its end, in a fork of a process that has its modules."""
    return forked_command.run(arguments, folder, limit_s=WALL_LIMIT_S, code=code)


def test_completed_run(folder: Path) -> None:
    launched = launch(folder, "fine.toml", "--duration", "1.5", "--out", "run")
    assert launched.returncode == 0
    assert "fine, seed 1: completed" in launched.stdout
    assert "t = 3.00 s: formation reached" in launched.stderr
    assert "written to run:" in launched.stderr


def test_list_of_written_files_has_no_empty_ones(folder: Path) -> None:
    content = "folder.summary.write_text('{}'); folder.flight.touch()"
    code = LAUNCHER.replace("    return {", f"    {content}\n    return {{")
    launched = launch(folder, "fine.toml", "--duration", "0.5", "--out", "run", code=code)
    assert launched.stderr.splitlines()[-1] == "written to run: manifest.json, summary.json"


def test_folder_with_other_files_is_refused_before_anything_is_written(folder: Path) -> None:
    before = sorted(folder.iterdir())
    launched = launch(folder, "fine.toml", "--out", ".")
    assert launched.returncode == 2
    last_line = launched.stderr.splitlines()[-1]
    names = [path.name for path in before]
    assert last_line.startswith(f"coflight: {folder} holds {', '.join(names[:3])} and {len(names) - 3} more")
    assert "--out" in last_line
    assert sorted(folder.iterdir()) == before


def test_port_in_use_raises_all_ports_unless_an_offset_is_given(folder: Path) -> None:
    with bind(socket.SOCK_STREAM, "127.0.0.1", 0) as holder:
        port = holder.getsockname()[1]
        text = (folder / "fine.toml").read_text().replace("simulator_tcp = 0", f"simulator_tcp = {port}")
        (folder / "fine.toml").write_text(text)
        launched = launch(folder, "fine.toml", "--duration", "0.5", "--out", "run")
        assert launched.returncode == 0
        (line,) = [line for line in launched.stderr.splitlines() if "in use" in line]
        offset = int(line.rpartition("raised by ")[2])
        physics = json.loads((folder / "run" / "config" / "physics.json").read_text())
        assert physics["scenario"]["ports"]["simulator_tcp"] == port + offset
        for options in (["--port-offset", "0"], ["--hold"]):
            launched = launch(folder, "fine.toml", *options, "--out", "refused")
            assert launched.returncode == 2
            last_line = launched.stderr.splitlines()[-1]
            assert last_line.startswith(f"coflight: TCP port {port} on 127.0.0.1: Address already in use")
            assert "--port-offset auto" in last_line
            assert not (folder / "refused").exists()


@pytest.mark.parametrize("place", ["a-file", "a-file/below"])
def test_file_in_place_of_the_folder_is_reported(folder: Path, place: str) -> None:
    (folder / "a-file").touch()
    launched = launch(folder, "fine.toml", "--out", place)
    assert launched.returncode == 2
    last_line = launched.stderr.splitlines()[-1]
    assert last_line.startswith(f"coflight: {place}: ")
    assert "--out" in last_line
    assert "Errno" not in last_line
    assert "raw" not in last_line


def test_json_is_alone_on_stdout(folder: Path) -> None:
    launched = launch(folder, "fine.toml", "--duration", "1.5", "--json")
    assert launched.returncode == 0
    summary = json.loads(launched.stdout)
    assert summary["status"] == "completed"
    # formed at 3 s, and 1.5 s in formation
    assert summary["simulated_s"] == pytest.approx(4.5, abs=0.004)
    assert len(set(summary["pids"])) == 5
    (run,) = (folder / "runs").glob("fine-*")
    assert (run / "logs" / "uav-1.log").exists()


def test_unreached_formation_fails_the_run(folder: Path) -> None:
    launched = launch(folder, "never-formed.toml", "--json")
    assert launched.returncode == 1
    assert launched.stderr.splitlines()[-1] == "coflight: the formation was not reached within 5 s"
    assert json.loads(launched.stdout)["status"] == "not_formed"


def test_failed_process_fails_the_run_with_its_message(folder: Path) -> None:
    launched = launch(folder, "physics-fails.toml")
    assert launched.returncode == 1
    last_line = launched.stderr.splitlines()[-1]
    assert last_line.startswith("coflight: physics (pid ")
    assert "ended with status 2: physics: the world has ended (log: runs/physics-fails-" in last_line
    assert "Traceback" not in launched.stderr


def test_process_killed_at_its_end_fails_the_run(folder: Path) -> None:
    launched = launch(folder, "physics-dies-at-last.toml", "--duration", "0.5", "--json")
    assert launched.returncode == 1
    last_line = launched.stderr.splitlines()[-1]
    assert last_line.startswith("coflight: physics (pid ")
    assert "was killed by SIGKILL" in last_line
    summary = json.loads(launched.stdout)
    assert (summary["status"], f"coflight: {summary['reason']}") == ("failed", last_line)


def test_too_few_file_descriptors_are_reported_before_the_start(folder: Path) -> None:
    narrow = f"import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40)){LAUNCHER}"
    launched = launch(folder, "fine.toml", "--duration", "1.5", code=narrow)
    assert launched.returncode == 2
    last_line = launched.stderr.splitlines()[-1]
    assert last_line.startswith("coflight: 5 processes take ")
    assert last_line.endswith(" file descriptors, and the limit is 40 (ulimit -Hn)")
    assert not list((folder / "runs").glob("fine-*/logs/*"))


def test_ctrl_c_stops_all_processes_and_keeps_the_records(folder: Path) -> None:
    launched = launch(folder, "interrupted.toml", "--json", "--duration", "1e6")
    assert launched.returncode == 130
    last_line = launched.stderr.splitlines()[-1]
    (run,) = (folder / "runs").iterdir()
    assert last_line == (
        f"coflight: broken off: every process is stopped, the records are kept in runs/{run.name}"
    )
    summary = json.loads(launched.stdout)
    assert summary["status"] == "interrupted"
    assert not any(psutil.pid_exists(pid) for pid in summary["pids"])


@pytest.mark.parametrize("enabled", ["true", "false"])
def test_ctrl_c_is_how_a_hold_ends(folder: Path, enabled: str) -> None:
    options = ["--hold", "--set", f"onboard.enabled={enabled}", "--set", "run.duration_s=1"]
    launched = launch(folder, "held.toml", *options, "--json")
    assert launched.returncode == 0
    assert "coflight:" not in launched.stderr
    summary = json.loads(launched.stdout)
    assert (summary["status"], summary["reason"], summary["speed"]) == ("held", None, 1.0)
    assert summary["simulated_s"] >= 3.0  # beyond run.duration_s
    assert not any(psutil.pid_exists(pid) for pid in summary["pids"])


def test_hold_with_a_duration_is_completed_at_its_end_and_interrupted_before(folder: Path) -> None:
    launched = launch(folder, "held.toml", "--hold", "--duration", "2", "--json")
    assert launched.returncode == 0
    assert json.loads(launched.stdout)["status"] == "completed"
    launched = launch(folder, "held.toml", "--hold", "--duration", "1e6", "--json")
    assert launched.returncode == 130
    assert json.loads(launched.stdout)["status"] == "interrupted"


def take_terminal() -> None:
    """Make standard input the controlling terminal and restore SIGHUP, which nohup ignores."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def start_in_terminal(folder: Path) -> tuple[int, "subprocess.Popen[bytes]"]:
    """Start an endless run in a terminal of its own, and wait until the formation is reached.

    Returns the terminal's other end and the launcher, whose report goes to the file ``reported``.
    """
    other_end, terminal = os.openpty()
    code = LAUNCHER.replace("    return {", "    open('reported', 'w').write(outcome.status)\n    return {")
    launcher = subprocess.Popen(
        [sys.executable, "-c", code, "fine.toml", "--duration", "1e6"],
        cwd=folder, stdin=terminal, stdout=terminal, stderr=terminal, start_new_session=True,
        preexec_fn=take_terminal,  # noqa: PLW1509  it takes no lock
    )  # fmt: skip
    os.close(terminal)
    shown = b""
    while b"formation reached" not in shown:
        shown += os.read(other_end, 4_096)
    return other_end, launcher


def test_closed_terminal_ends_and_reports_the_run(folder: Path) -> None:
    other_end, launcher = start_in_terminal(folder)
    with launcher:
        children = psutil.Process(launcher.pid).children(recursive=True)
        os.close(other_end)
        assert launcher.wait(WALL_LIMIT_S) == 130
    assert (folder / "reported").read_text() == "interrupted"
    assert not any(child.is_running() for child in children)


@pytest.mark.parametrize(
    ("number", "children_at"),
    [(signal.SIGINT, 1), (signal.SIGINT, 3), (signal.SIGTERM, 2), (signal.SIGKILL, 1), (signal.SIGKILL, 4)],
)
def test_signal_during_the_start_leaves_no_process_and_no_folder(
    folder: Path, number: signal.Signals, children_at: int
) -> None:
    command = [sys.executable, "-c", LAUNCHER, "fine.toml", "--duration", "1e6"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as launcher:
        children: dict[int, psutil.Process] = {}
        deadline_s = time.monotonic() + WALL_LIMIT_S
        while len(children) < children_at:
            assert time.monotonic() < deadline_s
            children |= {child.pid: child for child in psutil.Process(launcher.pid).children(recursive=True)}
        launcher.send_signal(number)
        _, errors = launcher.communicate(timeout=WALL_LIMIT_S)
        if number != signal.SIGKILL:
            assert errors.decode().splitlines()[1:] == [
                "coflight: broken off during the start: no process is left, and nothing was written"
            ]
            assert not (folder / "runs").exists()
        assert launcher.returncode == (-signal.SIGKILL if number == signal.SIGKILL else 130)
    # after SIGKILL the children end by themselves
    assert psutil.wait_procs(children.values(), timeout=WALL_LIMIT_S)[1] == []


def test_ctrl_c_does_not_wait_for_processes_that_still_start(folder: Path) -> None:
    deaf = '[sys.executable, "-c", "import time; time.sleep(600)"]  # as one that imports, it reads no stdin'
    code = re.sub(r"return \[sys.executable.*", f"return {deaf}", LAUNCHER)
    command = [sys.executable, "-c", code, "fine.toml"]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE) as launcher:
        process, wall_deadline_s = psutil.Process(launcher.pid), time.monotonic() + WALL_LIMIT_S
        while len(process.children()) < 2:
            assert time.monotonic() < wall_deadline_s
        children, wall_begin_s = process.children(), time.monotonic()
        launcher.send_signal(signal.SIGINT)
        launcher.communicate(timeout=WALL_LIMIT_S)
        assert launcher.returncode == 130
        assert time.monotonic() - wall_begin_s < AT_ONCE_S
    assert psutil.wait_procs(children, timeout=WALL_LIMIT_S)[1] == []
