"""A launcher that is killed at any moment leaves no process, namespace or interface of its vehicles."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path

import psutil
import pytest
from supervising import wait_for

from netsim.network.namespaces import why_not

pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(why_not() is not None, reason=str(why_not())),
    pytest.mark.timeout(600),
]

SCENARIO = f"""
agents = 2
[run]
duration_s = 60.0
[[programs]]
name = "daemon"
command = ["sh", "-c", "setsid sh -c 'trap : TERM HUP; while true; do sleep 1; done' & sleep 1000"]
[[programs]]
name = "companion"
command = ["{sys.executable}", "-I", "-S", "companion.py"]
"""
COMPANION = """
import socket
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.bind(("0.0.0.0", 14540))
while True:
    data, sender = link.recvfrom(2000)
    link.sendto(b"no MAVLink", sender)
    print(len(data), flush=True)
"""
KINDS = ("net", "mnt", "pid", "user")
MARK = "COFLIGHT_TEST"
SEED = 5
START_S = 60.0
"""Wall time that a start may take on a busy machine."""
MOMENTS = (
    ("start", 3.0),  # while modules are imported and processes start
    ("config/network.json", 1.0),  # while namespaces are made
    ("logs/uav-1-companion.log", 1.5),  # in flight, with MAVLink on eth0
) * int(os.environ.get("COFLIGHT_KILL_ROUNDS", "1"))
"""Files of the run's folder, with content, and the longest random wall time in seconds after it has them."""


def marked(mark):
    """Return the processes that have inherited an environment variable."""
    found = []
    for pid in psutil.pids():
        with contextlib.suppress(OSError):
            if mark.encode() in Path(f"/proc/{pid}/environ").read_bytes():
                found.append(pid)
    return found


def namespaces_of(pids):
    """Return the namespaces of processes without those of this one."""
    found = set()
    for pid in pids:
        for kind in KINDS:
            with contextlib.suppress(OSError):
                found.add(Path(f"/proc/{pid}/ns/{kind}").readlink())
    return found - {Path(f"/proc/self/ns/{kind}").readlink() for kind in KINDS}


def has_content(path):
    return path.is_file() and path.stat().st_size > 0


@pytest.fixture
def short_folder():
    """Yield a folder whose path is short enough for a socket in it."""
    folder = Path(tempfile.mkdtemp(prefix="kill-"))
    yield folder
    shutil.rmtree(folder)


def test_nothing_outlives_a_launcher_that_is_killed_at_random_moments(tmp_path, short_folder, monkeypatch):
    scenario, work, generator = tmp_path / "kill.toml", tmp_path / "work", random.Random(SEED)  # noqa: S311  moments
    work.mkdir()
    scenario.write_text(SCENARIO)
    (tmp_path / "companion.py").write_text(COMPANION)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("TMPDIR", str(short_folder))
    interfaces = psutil.net_if_addrs().keys()
    seen = 0
    for number, (file, longest_s) in enumerate(MOMENTS):
        mark, run = uuid.uuid4().hex, tmp_path / f"run{number}"
        monkeypatch.setenv(MARK, mark)
        command = [sys.executable, "-m", "coflight", "fly", scenario, "--speed", "1", "--out", run]
        errors = tmp_path / f"errors{number}"
        with errors.open("wb") as stderr:
            launcher = subprocess.Popen(command, cwd=work, stdout=subprocess.DEVNULL, stderr=stderr)
        try:
            wall_end_s = time.monotonic() + START_S
            while file != "start" and not has_content(run / file) and time.monotonic() < wall_end_s:
                time.sleep(0.01)
            time.sleep(generator.uniform(0.0, longest_s))
            assert launcher.poll() is None, errors.read_text()
            assert file == "start" or has_content(run / file)
            namespaces = namespaces_of(marked(mark))
        finally:
            launcher.send_signal(signal.SIGKILL)
            launcher.wait(10.0)
        wait_for(
            lambda mark=mark, left=namespaces: not marked(mark) and not left & namespaces_of(psutil.pids()),
            "end of all processes and namespaces",
        )
        assert psutil.net_if_addrs().keys() == interfaces
        assert list(work.iterdir()) == []
        # the folder of the radio's socket is removed by the next launcher, network.json remains in the run's
        assert len([each.name.startswith("coflight-radio-") for each in short_folder.iterdir()]) <= 1
        seen += bool(namespaces)
    assert seen >= len(MOMENTS) // 3  # at least those in flight had some
