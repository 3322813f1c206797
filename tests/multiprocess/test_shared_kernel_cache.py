"""A cache of kernels that cannot be written serves every process of a run, and the caller's (60 s)."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT
from without_privileges import obeying_modes

from foundation.kernels import cache_folder
from harness.launch import kernel_cache

pytestmark = pytest.mark.multiprocess

WALL_LIMIT_S = 240.0
PAIR = ("agents=2", "formation.columns=2", "formation.rows=1", "antenna.snapshot_rate_hz=4")
SCRIPT = """
import json, sys
import numba
from numba.core.event import Listener, install_listener

class Compiled(Listener):
    def __init__(self): self.names = []
    def on_start(self, event): pass
    def on_end(self, event): self.names.append(event.data["dispatcher"].py_func.__module__)

compiled = Compiled()
with install_listener("numba:compile", compiled):
    {imports}

    if __name__ == "__main__":
        with Swarm("article", overrides={overrides}, out=sys.argv[1]) as swarm:
            swarm.run_until_formed(timeout_s=60.0)
            swarm.run_for(1.0)
        summary = swarm.summary(draw=False)
print(json.dumps([compiled.names, summary["status"], summary["max_gain_dbi"]]))
"""


@pytest.fixture(scope="module")
def complete() -> Path:
    """Return the cache of the present sources, with all kernels."""
    kernel_cache.prepare(print)
    return kernel_cache.folder()


def test_a_run_with_a_cache_that_cannot_be_written_compiles_nothing(complete: Path, tmp_path: Path) -> None:
    shared = tmp_path / "cache" / "coflight" / "kernels" / complete.name
    shutil.copytree(complete, shared)
    for path in (shared, *shared.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    before = {path: path.stat().st_mtime_ns for path in shared.rglob("*")}
    settings = [part for each in PAIR for part in ("--set", each)]
    line = ["-m", "coflight", "fly", "article", *settings, "--duration", "1", "--json", "--out", "run"]
    environment = {name: value for name, value in os.environ.items() if name != cache_folder.VARIABLE}
    done = subprocess.run(
        obeying_modes(sys.executable, *line),
        cwd=tmp_path,
        env=environment | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=WALL_LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["status"], summary["deterministic"]) == ("completed", True)
    assert "compiling" not in done.stderr
    assert {path: path.stat().st_mtime_ns for path in shared.rglob("*")} == before


@pytest.mark.usefixtures("complete")
@pytest.mark.parametrize(
    "imports",
    ["from coflight import Swarm", "from harness.launch.swarm import Swarm"],
    ids=["face", "module"],
)
def test_a_script_that_imports_numba_first_reports_with_the_kernels_of_the_cache(
    imports: str, tmp_path: Path
) -> None:
    beside = {*ROOT.glob("[!.]*/**/__pycache__/*.nbi")}
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(imports=imports, overrides=list(PAIR)))
    environment = {name: value for name, value in os.environ.items() if name != cache_folder.VARIABLE}
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "run")],
        env=environment | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=WALL_LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    compiled, status, gain = json.loads(done.stdout.splitlines()[-1])
    assert (compiled, status) == ([], "completed")
    assert gain["patterns"] > 0
    assert {*ROOT.glob("[!.]*/**/__pycache__/*.nbi")} == beside
