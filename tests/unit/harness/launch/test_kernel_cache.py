"""The cache of compiled kernels is another one whenever anything that they are compiled from is."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from kernel_coverage import called_by_rehearsal, kernels, signatures
from paths import ROOT, SCENARIOS

import autopilot.process.warm_up
from antenna.analysis.patterns import Pattern
from antenna.model.clearance import check_apart
from antenna.model.config import AntennaConfig
from antenna.model.geometry import grid, upright
from antenna.solvers.ports import feed
from antenna.solvers.selection import make_backend
from antenna.solvers.warm_up import warm_up
from foundation.kernels import cache_folder
from harness.launch import kernel_cache
from harness.launch.kernel_cache import KEPT_S, KEPT_STATES, VARIABLE, CompileError, digest, remove_old
from harness.launch.one_process import OneProcessSwarm

ARTICLE = SCENARIOS / "article.toml"

KERNEL = "from autopilot.constants import G\nfrom numba import njit\n\n@njit\ndef f(x):\n    return G * x\n"


@pytest.fixture
def root(tmp_path):
    package = tmp_path / "autopilot"
    package.mkdir()
    (package / "kernel.py").write_text(KERNEL)
    (package / "constants.py").write_text("from autopilot.units import M\nG = 9.8 * M\n")
    (package / "units.py").write_text("M = 1.0\n")
    (package / "other.py").write_text("print('no kernel, and imported by none')\n")
    return tmp_path


@pytest.mark.parametrize("changed", ["kernel.py", "constants.py", "units.py"])
def test_a_change_of_a_kernel_or_of_what_it_imports_makes_a_new_cache(root, changed):
    before = digest(root)
    path = root / "autopilot" / changed
    path.write_text(path.read_text() + "# changed\n")
    assert digest(root) != before


def test_a_change_elsewhere_keeps_it(root):
    before = digest(root)
    (root / "autopilot" / "other.py").write_text("changed = True\n")
    assert digest(root) == before


CPUINFO = """\
processor	: 0
model name	: {model}
cpu MHz		: {mhz}
flags		: fpu {flags}

processor	: 1
model name	: {model}
flags		: fpu {flags}
"""


def test_another_processor_has_its_own(root, tmp_path, monkeypatch):
    """Also from a cache that was filled elsewhere: the compiler rejects its code, so it is not complete."""
    monkeypatch.setattr(cache_folder, "PROCESSOR", tmp_path / "cpuinfo")

    def digest_on(model, flags="avx2", mhz=2600):
        (tmp_path / "cpuinfo").write_text(CPUINFO.format(model=model, flags=flags, mhz=mhz))
        return digest(root)

    first = digest_on("one")
    assert digest_on("one", mhz=3100) == first
    assert len({first, digest_on("another"), digest_on("one", flags="avx2 avx512f")}) == 3
    (tmp_path / "cpuinfo").unlink()
    assert digest(root) == digest(root)


def test_another_checkout_with_the_same_content_has_its_own(root, tmp_path_factory):
    other = tmp_path_factory.mktemp("elsewhere") / "checkout"
    shutil.copytree(root, other)
    assert digest(other) != digest(root)
    assert digest(other) == digest(other / ".." / "checkout")


def test_a_folder_that_the_user_names_holds_one_for_each_state(monkeypatch, tmp_path):
    compute = kernel_cache.folder.__wrapped__
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    folder = compute()
    assert folder.parent == tmp_path
    monkeypatch.setenv(VARIABLE, str(folder))  # as a child of ours finds it
    assert compute() == folder
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert compute() == Path("/somewhere/coflight/kernels") / folder.name


@pytest.mark.parametrize(
    "start",
    [
        "import autopilot.__main__",
        "import runpy; runpy.run_path('scripts/launch_swarm.py', run_name='script')",
    ],
)
def test_a_process_that_is_started_by_hand_compiles_into_the_folder_of_the_sources_state(tmp_path, start):
    """Beside the sources a kernel would stay as it was when only another module's, that it calls, changes."""
    program = (
        f"{start}; import sys; from foundation.kernels import cache_folder\n"
        "from numba.core.dispatcher import Dispatcher\n"
        "paths = {kernel._cache.cache_path for name, module in sys.modules.items()\n"
        "         if name.partition('.')[0] in cache_folder.PACKAGES\n"
        "         for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}\n"
        "assert paths and all(path.startswith(str(cache_folder.folder())) for path in paths), paths\n"
    )
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env=environment | {"XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()


SCRIPTS = sorted((ARTICLE.parents[1] / "scripts").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_every_script_names_the_folder_of_the_kernels_before_it_imports_numba(tmp_path, script):
    program = (
        "import os, runpy, sys\n"
        "from foundation.kernels import cache_folder\n"
        "class Door:\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'numba':\n"
        "            assert os.environ.get(cache_folder.VARIABLE) == str(cache_folder.folder())\n"
        "            sys.exit()\n"  # seen is what was to be seen
        "sys.meta_path.insert(0, Door())\n"
        f"runpy.run_path({str(script)!r}, run_name='script')\n"
    )
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=script.parents[1],
        env=environment | {"XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()


@pytest.fixture
def states(monkeypatch, tmp_path):
    """Folders of ten states; the first was used ten days ago, the last but one two days ago."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    base = tmp_path / "coflight" / "kernels"
    folders = [base / f"{k:016x}" for k in range(10)]
    for k, path in enumerate(folders):
        path.mkdir(parents=True)
        (path / "kernel.nbi").touch()
        os.utime(path, (NOW_S - (10 - k) * KEPT_S - 1.0,) * 2)
    monkeypatch.setattr(kernel_cache, "folder", lambda: folders[9])
    monkeypatch.setenv(VARIABLE, str(folders[9]))  # as our scripts have it
    return folders


NOW_S = 1_800_000_000.0


def test_old_states_go_but_for_the_latest_also_where_our_scripts_have_set_the_folder(states):
    """Those that never came to be complete as well; what is none of ours stays."""
    notes = states[0].parent / "notes"
    notes.mkdir()
    remove_old(NOW_S)
    assert [path.exists() for path in states] == [k >= 10 - KEPT_STATES for k in range(10)]
    assert notes.exists()


def test_what_was_used_within_a_day_stays_however_many_there_are(states):
    for path in states[:2]:
        os.utime(path, (NOW_S - KEPT_S + 1.0,) * 2)
    remove_old(NOW_S)  # the latest eight are 0, 1 and 4 to 9
    assert [k for k, path in enumerate(states) if not path.exists()] == [2, 3]
    for path in states:
        path.mkdir(exist_ok=True)
        os.utime(path, (NOW_S - KEPT_S + 1.0,) * 2)
    remove_old(NOW_S)
    assert all(path.exists() for path in states)


def test_a_folder_that_the_user_names_is_not_tidied(states, monkeypatch, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    for path in states:
        shutil.move(path, theirs / path.name)
    monkeypatch.setattr(kernel_cache, "folder", lambda: theirs / states[9].name)
    remove_old(NOW_S)
    assert len(list(theirs.iterdir())) == 10


def test_a_request_for_the_folder_creates_it_for_its_owner_and_marks_it_as_used(monkeypatch, tmp_path):
    folder = tmp_path / "state"
    monkeypatch.setattr(cache_folder, "folder", lambda: folder)
    assert cache_folder.environment() == {VARIABLE: str(folder)}
    assert folder.stat().st_mode & 0o777 == 0o700
    os.utime(folder, (1.0, 1.0))
    cache_folder.environment()
    assert folder.stat().st_mtime > 1.0


def test_a_folder_that_cannot_be_made_is_named_before_anything_is_said_to_be_compiled(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path / "file" / "state")
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    said = []
    with pytest.raises(CompileError, match=r"cannot be kept in .*/file/state: Not a directory"):
        kernel_cache.prepare(said.append)
    assert said == []


def test_the_rehearsal_of_the_antenna_calls_every_kernel():
    needed = kernels(ROOT / "antenna")
    assert len(needed) >= 10
    assert needed - called_by_rehearsal("antenna.solvers.warm_up") == set()


def test_the_rehearsal_of_the_physics_calls_every_kernel():
    needed = kernels(ROOT / "harness")
    assert len(needed) >= 20
    assert needed - called_by_rehearsal("harness.world.physics.warm_up") == set()


def test_after_the_rehearsal_of_the_antenna_nothing_is_left_to_be_compiled():
    """Other elements, grounds, feeds, grids and counts ask for no other types."""
    warm_up()
    compiled = signatures("antenna")
    assert any(compiled.values())
    dipole = {"element_length_m": 5.0, "element_radius_m": 0.001, "segments": 11}
    places_m = grid(8, 4, 8.5, 2.5) + np.array([0.0, 0.0, 12.0])
    for settings in (dipole, {"ground": "perfect"}, {"excitation": "optimum"} | dipole, {"grid_deg": 2.0}):
        config = AntennaConfig(**settings)
        voltages = feed(places_m, config)
        arrays = [upright(places_m[:count], voltages[:count]) for count in (8, 8, 3)]
        for pattern in make_backend(config, threads=2).patterns(arrays * 40):
            assert isinstance(pattern, Pattern)
        check_apart(arrays[0], config.element(), grounded=False)
    assert signatures("antenna") == compiled


def test_after_the_rehearsal_of_the_vehicles_nothing_is_left_to_be_loaded():
    """Or every vehicle that is forked would load it for itself, in flight."""
    autopilot.process.warm_up.warm_up()
    loaded = signatures("autopilot")
    assert any(loaded.values())
    with OneProcessSwarm(ARTICLE, agents=3) as swarm:
        swarm.run_until_formed(timeout_s=60.0)
    assert signatures("autopilot") == loaded
