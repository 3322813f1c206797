"""A short bench of real flights."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from harness.profiling import VEHICLES

pytestmark = pytest.mark.multiprocess
BENCH = Path(__file__).parents[2] / "scripts" / "bench.py"


def test_bench_tells_speed_floor_parts_memory_and_start_up():
    command = [sys.executable, str(BENCH), "--quick", "--agents", "1,2", "--duration", "1", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert [run["agents"] for run in found["runs"]] == [1, 2]
    assert found["machine"]["processors"] >= 1
    for run in found["runs"]:
        spent = run["cpu_s_per_simulated_s"]
        assert {"physics", "radio", VEHICLES, "launcher"} <= set(spent)
        # processor time, for what else the machine does takes a share of the wall time of either
        assert run["floor_cpu_s_per_simulated_s"] < sum(spent.values())
        assert run["real_time_factor"] > 0.0
        assert run["floor_real_time_factor"] > 0.0
        assert run["echo_real_time_factor"] > 0.0
        for kind, parts in run["parts_cpu_s_per_simulated_s"].items():
            assert sum(parts.values()) == pytest.approx(spent[kind])
        assert 0.0 < run["uss_mb_per_uav"] < 200.0
        assert 0.0 < run["startup_s"] < 120.0
        assert run["formed_s"] > 1.0
