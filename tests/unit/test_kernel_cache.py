"""The cache of compiled kernels is another one whenever anything that they are compiled from is."""

import shutil
from pathlib import Path

import pytest

from harness import kernel_cache
from harness.kernel_cache import VARIABLE, digest

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
