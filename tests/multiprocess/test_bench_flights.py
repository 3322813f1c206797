"""A short benchmark of real flights, and interrupted ones."""

import json
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
from paths import ROOT

from harness.launch.profiling import VEHICLES
from reference.exit_statuses import RESULTS

pytestmark = pytest.mark.multiprocess
BENCH = ROOT / "scripts" / "bench.py"
WALL_LIMIT_S = 60.0
(KEYS,) = (set(each.keys) for each in RESULTS if each.command == "bench")


def test_bench_reports_speed_floor_parts_memory_and_start_up():
    command = [sys.executable, str(BENCH), "--quick", "--agents", "2", "--duration", "1", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert set(found) == KEYS
    assert [run["agents"] for run in found["runs"]] == [2]
    assert found["machine"]["processors"] >= 1
    for run in found["runs"]:
        spent = run["cpu_s_per_simulated_s"]
        assert {"physics", "radio", VEHICLES, "launcher"} <= set(spent)
        # processor time, since other work of the machine changes both wall times
        assert run["floor_cpu_s_per_simulated_s"] < sum(spent.values())
        assert run["real_time_factor"] > 0.0
        assert run["floor_real_time_factor"] > 0.0
        assert run["echo_real_time_factor"] > 0.0
        for kind, parts in run["parts_cpu_s_per_simulated_s"].items():
            assert sum(parts.values()) == pytest.approx(spent[kind])
        assert 0.0 < run["uss_mb_per_uav"] < 200.0
        assert 0.0 < run["startup_s"] < 120.0
        assert run["formed_s"] > 1.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_interrupted_bench_leaves_no_process_and_no_file(tmp_path, number):
    command = [sys.executable, str(BENCH), "--quick", "--agents", "2", "--duration", "1000", "--repeats", "1"]
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as bench:
        descendants: dict[str, psutil.Process] = {}
        deadline_s = time.monotonic() + WALL_LIMIT_S
        while not {"uav 0", "uav 1"} <= descendants.keys():
            assert time.monotonic() < deadline_s
            for process in psutil.Process(bench.pid).children(recursive=True):
                try:
                    descendants[process.name()] = process
                except psutil.NoSuchProcess:
                    continue
        bench.send_signal(number)
        _, errors = bench.communicate(timeout=WALL_LIMIT_S)
    assert psutil.wait_procs(descendants.values(), timeout=WALL_LIMIT_S)[1] == []
    if number == signal.SIGKILL:  # no process is left to delete the files
        return
    assert bench.returncode == 130
    assert errors.splitlines()[-1] == "bench: interrupted"
    assert list(tmp_path.iterdir()) == []
