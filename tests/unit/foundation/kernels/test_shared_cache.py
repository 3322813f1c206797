"""Kernels of a cache that this user cannot write are loaded; what it lacks is compiled and not kept."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT
from without_privileges import obeying_modes

from foundation.kernels import cache_folder

KERNEL = "from numba import njit\n\n@njit(cache=True)\ndef twice(x):\n    return 2 * x\n"
CALLS = """
import sys
from numba.core.event import Listener, install_listener

class Compiled(Listener):
    def on_start(self, event): pass
    def on_end(self, event): print(event.data["dispatcher"].py_func.__qualname__)

with install_listener("numba:compile", Compiled()):
    from demo import twice
    for text in sys.argv[1:]:
        assert twice(eval(text)) == 2 * eval(text)
"""


@pytest.fixture
def modules(tmp_path: Path) -> Path:
    path = tmp_path / "modules"
    path.mkdir()
    (path / "demo.py").write_text(KERNEL)
    (path / "calls.py").write_text(CALLS)
    return path


def compiled(modules: Path, cache: Path, *values: str, shared: bool) -> list[str]:
    """Call the kernel with values in a process of its own; returns the kernels that it compiled."""
    named = {cache_folder.VARIABLE: str(cache)}
    if shared:
        named[cache_folder.LOCATORS] = cache_folder.SHARED
    done = subprocess.run(
        obeying_modes(sys.executable, str(modules / "calls.py"), *values),
        env=os.environ | named | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture
def cache(modules: Path, tmp_path: Path) -> Path:
    """A cache of the kernel for integers in which no file can be written."""
    path = tmp_path / "cache"
    assert compiled(modules, path, "1", shared=False) == ["twice"]
    for each in (*path.rglob("*"), path, modules):
        each.chmod(0o555 if each.is_dir() else 0o444)
    return path


def files(folder: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_a_kernel_of_the_cache_is_loaded(modules: Path, cache: Path, tmp_path: Path) -> None:
    before = files(tmp_path)
    assert compiled(modules, cache, "1", shared=True) == []
    assert files(tmp_path) == before


def test_without_the_locator_numba_does_not_use_the_cache(modules: Path, cache: Path) -> None:
    assert compiled(modules, cache, "1", shared=False) == ["twice"]


def test_what_the_cache_lacks_is_compiled_and_not_kept(modules: Path, cache: Path, tmp_path: Path) -> None:
    before = files(tmp_path)
    assert compiled(modules, cache, "1", "1.0", shared=True) == ["twice"]
    assert files(tmp_path) == before


def test_modules_that_the_cache_does_not_have_are_cached_as_numba_does(modules: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert compiled(modules, empty, "1", shared=True) == ["twice"]
    assert compiled(modules, empty, "1", shared=True) == []


def test_the_environment_names_the_locator_for_a_folder_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache_folder, "folder", lambda: tmp_path)
    monkeypatch.setattr(cache_folder, "_check", lambda _path: None)
    assert cache_folder.LOCATORS not in cache_folder.environment()
    monkeypatch.setattr(cache_folder.os, "access", lambda _path, mode: mode != os.W_OK)
    assert cache_folder.environment()[cache_folder.LOCATORS] == cache_folder.SHARED
