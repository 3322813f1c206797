"""Whole sessions of pytest with the plugin: interruption, workers of pytest-xdist, cache of kernels."""

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from paths import SUPPORT

import harness.launch.one_process
import harness.launch.processes
import harness.launch.run_monitor
from harness.launch import kernel_cache
from harness.launch.one_process import OneProcessSwarm
from harness.launch.swarm import Swarm, SwarmTimeoutError

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.multiprocess

STAND_INS = f"""
import sys
import harness.launch.processes
import harness.launch.run_monitor

def stand_in(module, *arguments):
    return [sys.executable, {str(SUPPORT / "supervisor_stand_ins.py")!r}, module, *arguments]

harness.launch.processes.bound_module = stand_in
"""
NEVER_COMPILED = """
from pathlib import Path
from harness.launch import kernel_cache

kernel_cache._WARM_UPS = {"radio": "blocked"}
kernel_cache.folder = lambda: Path(__file__).parent / "cache"
"""
BLOCKED = """
import signal
import socket

def warm_up():
    with socket.create_connection(("127.0.0.1", PORT)):
        signal.pause()
"""


@pytest.mark.parametrize("workers", [(), ("-n", "1")], ids=["here", "xdist"])
def test_interrupt_ends_the_compilation_with_its_processes(
    pytester: pytest.Pytester, workers: tuple[str, ...]
) -> None:
    """The interrupt is sent to pytest's main process alone; a terminal sends it to the others as well."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(100.0)
        pytester.makeconftest(NEVER_COMPILED)
        pytester.makepyfile(
            blocked=BLOCKED.replace("PORT", str(server.getsockname()[1])),
            test_user="def test_any(swarm): pass\n",
        )
        command = [sys.executable, "-m", "pytest", *workers]
        session = pytester.popen(command, stdin=subprocess.DEVNULL)
        try:
            compiler, _ = server.accept()
            with compiler:
                compiler.settimeout(30.0)
                session.send_signal(signal.SIGINT)
                output, errors = session.communicate(timeout=60.0)
                assert compiler.recv(1) == b""  # its process has ended
        finally:
            session.kill()
            session.communicate()
    assert session.returncode == pytest.ExitCode.INTERRUPTED, output
    said = b"coflight: compiling the numerical kernels of radio; this is done once"
    assert said in (errors if workers else output).splitlines()


def test_compilation_is_said_despite_the_capture_of_output(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(
        """
        from harness.launch import kernel_cache

        kernel_cache.prepare = lambda note, on_progress: note("compiling the kernels")
        """
    )
    pytester.makepyfile(test_user="def test_late(request): request.getfixturevalue('coflight_settings')\n")
    done = pytester.runpytest_subprocess(timeout=120.0)
    done.assert_outcomes(passed=1)
    assert done.outlines.count("coflight: compiling the kernels") == 1


@pytest.mark.parametrize("kind", [Swarm, OneProcessSwarm])
def test_compilation_does_not_count_as_wall_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kind: type[Swarm]
) -> None:
    class Clock:
        ahead_s = 0.0

        @classmethod
        def monotonic(cls) -> float:
            return time.monotonic() + cls.ahead_s

    def prepare(*_: object) -> kernel_cache.Compilers:
        Clock.ahead_s += 500.0
        return kernel_cache.Compilers()

    monkeypatch.setattr(harness.launch.processes, "time", Clock)
    monkeypatch.setattr(harness.launch.run_monitor, "time", Clock)
    monkeypatch.setattr(harness.launch.one_process, "time", Clock)
    monkeypatch.setattr(kernel_cache, "prepare_flight", prepare)
    monkeypatch.setattr(kernel_cache, "prepare", prepare)
    with kind("article", agents=1, out=tmp_path / "run", wall_limit_s=200.0) as swarm:
        swarm.run_for(0.1)
        assert Clock.ahead_s == 500.0
        Clock.ahead_s += 200.0
        with pytest.raises(SwarmTimeoutError, match="the wall time of 200 s is over"):
            swarm.run_for(0.1)


def test_runs_of_workers_are_kept_and_named(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(STAND_INS)
    pytester.makefile(".toml", small="agents = 2\n")
    pytester.makepyfile(
        test_user="""
        def test_fine(swarm):
            swarm("small.toml")

        def test_fails(swarm):
            swarm("small.toml").run_until_formed(timeout_s=10)
            assert False
        """
    )
    done = pytester.runpytest_subprocess("-n", "1", "--coflight-out", "mine", timeout=120.0)
    done.assert_outcomes(passed=1, failed=1)
    (folder,) = pytester.path.glob("mine/test_user-*")
    done.stdout.fnmatch_lines(
        [
            f"run folder: mine/{folder.name}",
            "  t = 3.00 s: formation reached",
            f"test_user.py::test_fails: *mine/{folder.name}",
        ]
    )
    assert (folder / "logs" / "physics.log").exists()


def test_an_interrupted_test_keeps_its_run(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(STAND_INS)
    pytester.makefile(".toml", small="agents = 2\n")
    pytester.makepyfile(
        test_user="def test_hangs(swarm):\n    swarm('small.toml')\n    raise KeyboardInterrupt\n"
    )
    done = pytester.runpytest_subprocess(timeout=120.0)
    assert done.ret == pytest.ExitCode.INTERRUPTED
    (folder,) = pytester.path.glob(".coflight/test_user-*")
    # the stand-in of the physics server has flown nothing that could be reported
    done.stdout.fnmatch_lines([f"test_user.py::test_hangs: without tables: .coflight/{folder.name}"])


def test_numba_of_a_conftest_uses_the_launchers_cache_folder(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(kernel_cache.VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(pytester.path / "cache"))
    pytester.makeconftest("import numba\n")
    pytester.makepyfile(
        test_user="""
        import numba
        from pathlib import Path

        def test_folder():
            from harness.launch import kernel_cache
            assert numba.config.CACHE_DIR == str(kernel_cache.folder())
            assert Path(numba.config.CACHE_DIR).parts[-3:-1] == ("coflight", "kernels")
        """
    )
    pytester.runpytest_subprocess(timeout=120.0).assert_outcomes(passed=1)
