"""Processes that compile a package: progress, completion, and how their failures are reported."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from paths import ROOT

from harness.launch import kernel_cache
from harness.launch.kernel_cache import CompileError, Compilers, prepare

KERNELS = """
from numba import njit

@njit
def twice(x):
    return 2 * x

@njit
def thrice(x):
    return 3 * x

def warm_up():
    twice(1)
    twice(1.0)  # a second specialisation is not a second kernel
    thrice(1)
"""
RAISES = "def warm_up():\n    raise ValueError('first line\\nthe solver diverged')\n"
KILLED = "import os, signal\n\ndef warm_up():\n    os.kill(os.getpid(), signal.SIGKILL)\n"
LOUD = """
import sys
from demo.kernels import warm_up as compile_all

def warm_up():
    sys.stderr.write("warning\\n" * 25_000)
    sys.stdout.write("no progress\\n" * 25_000 + "7 of 9\\n")
    compile_all()
"""
COUNTED = """
from pathlib import Path

def warm_up():
    with Path(__file__).with_name("calls").open("a") as calls:
        calls.write("called\\n")
"""
STOPPED = KILLED.replace("SIGKILL", "SIGSTOP")
MODULES = {
    "kernels": KERNELS,
    "raises": RAISES,
    "killed": KILLED,
    "loud": LOUD,
    "counted": COUNTED,
    "stopped": STOPPED,
}


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Replace the packages by modules of a package that the compiling processes import; return the cache."""
    package = tmp_path / "demo"
    package.mkdir()
    (package / "__init__.py").touch()
    for name, text in MODULES.items():
        (package / f"{name}.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path), str(ROOT))))
    monkeypatch.setattr(kernel_cache, "_WARM_UPS", {name: f"demo.{name}" for name in MODULES})
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setattr(kernel_cache, "folder", lambda: folder)
    return folder


def compile_all(*names):
    """Return the progress that was reported, by package."""
    reported = {name: [] for name in names}

    def on_progress(state):
        for name, progress in state.items():
            reported[name].append((progress.done, progress.total))

    with Compilers(names) as compilers:
        compilers.wait(on_progress)
    return reported


def test_progress_counts_kernels_up_to_all_and_the_package_is_complete(cache):
    reported = compile_all("kernels")["kernels"]
    assert reported == sorted(reported)
    assert reported[-1] == (2, 2)
    assert (cache / "kernels.complete").exists()


def test_the_last_line_of_an_error_names_the_package(cache):
    with pytest.raises(CompileError) as raised:
        compile_all("raises")
    assert str(raised.value) == "the raises kernels do not compile: the solver diverged"
    assert not (cache / "raises.complete").exists()


def test_a_killed_process_is_reported_by_its_signal(cache):
    with pytest.raises(CompileError, match="the killed kernels do not compile: ended by SIGKILL"):
        compile_all("killed")
    assert not (cache / "killed.complete").exists()


def test_output_of_the_kernels_neither_blocks_nor_counts_as_progress(cache):
    assert set(compile_all("loud")["loud"]) <= {(0, 0), (0, 2), (1, 2), (2, 2)}
    assert (cache / "loud.complete").exists()


def test_of_two_processes_for_one_package_one_compiles(cache):
    failures = []

    def run():
        try:
            compile_all("counted")
        except CompileError as error:
            failures.append(error)

    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert failures == []
    calls = cache.with_name("demo") / "calls"
    assert calls.read_text().splitlines() == ["called"]


def test_what_is_complete_is_not_compiled_again(cache, monkeypatch):
    monkeypatch.setattr(kernel_cache, "_WARM_UPS", {name: f"demo.{name}" for name in ("kernels", "counted")})
    notes = []
    prepare(notes.append)
    prepare(notes.append)
    assert notes == ["compiling the numerical kernels of kernels and counted; this is done once"]
    assert (cache.with_name("demo") / "calls").read_text().splitlines() == ["called"]


def test_closing_ends_processes_that_compile(cache):
    (cache.with_name("demo") / "counted.py").write_text(
        "import time\n\ndef warm_up():\n    time.sleep(600.0)\n"
    )
    with Compilers(["counted"]) as compilers:
        process = compilers._compilers[0]._process
        assert process.poll() is None
    assert process.returncode == -9
    assert not (cache / "counted.complete").exists()


def test_a_module_that_cannot_be_imported_is_an_error_of_one_line(cache):
    complete = cache / "absent.complete"
    done = subprocess.run(
        [sys.executable, "-P", "-m", "foundation.kernels.compiling", "demo.absent", str(complete)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "ModuleNotFoundError: No module named 'demo.absent'"
    assert not Path(complete).exists()


@pytest.mark.usefixtures("cache")
def test_a_stopped_process_is_named():
    with pytest.raises(
        CompileError, match=r"^the process that compiles the stopped kernels is stopped \(SIGSTOP\)$"
    ):
        compile_all("stopped")
