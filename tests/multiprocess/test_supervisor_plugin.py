"""The pytest plugin in a separate pytest: output of tests that pass, fail or leave processes behind."""

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from paths import SUPPORT

pytestmark = pytest.mark.multiprocess

CONFTEST = f"""
import sys
import pytest
import harness.launch.processes

@pytest.fixture(autouse=True)
def stand_ins(monkeypatch):
    def python_module(module, *arguments):
        stand_ins = {str(SUPPORT / "supervisor_stand_ins.py")!r}
        return [sys.executable, stand_ins, module, *arguments]
    monkeypatch.setattr(harness.launch.processes, "bound_module", python_module)
"""


def run_pytest(folder: Path, code: str) -> "subprocess.CompletedProcess[str]":
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "pytest.ini").write_text("[pytest]\nfilterwarnings = error\n")
    (folder / "small.toml").write_text("agents = 2\n")
    (folder / "test_user.py").write_text(textwrap.dedent(code))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)


def test_user_test_passes_from_any_folder(tmp_path: Path) -> None:
    finished = run_pytest(
        tmp_path,
        """
        def test_hover(swarm):
            flight = swarm("small.toml", agents=3)
            assert flight.run_until_formed(timeout_s=10).error_m.max() < 0.5

        def test_two(swarm):
            first, second = swarm("small.toml"), swarm("small.toml")
            assert set(first.pids.values()).isdisjoint(second.pids.values())
        """,
    )
    assert finished.returncode == 0, finished.stdout
    assert "2 passed" in finished.stdout


def test_failed_test_shows_the_ends_of_the_logs(tmp_path: Path) -> None:
    finished = run_pytest(
        tmp_path,
        """
        def test_channel(swarm):
            flight = swarm("small.toml")
            flight.cut_channel()
            flight.run_for(0.1)
            assert flight.truth.t_s > 1.0
        """,
    )
    assert finished.returncode == 1
    assert "- log of physics -" in finished.stdout
    assert "extra_attenuation_db=200.0" in finished.stdout
    assert "1 failed" in finished.stdout


def test_failed_start_is_reported_with_its_reason(tmp_path: Path) -> None:
    finished = run_pytest(
        tmp_path,
        """
        def test_airframe(swarm):
            swarm("small.toml", overrides=["autopilot.params.MIS_TAKEOFF_ALT=1"])
        """,
    )
    assert finished.returncode == 1
    assert "ended with status 2: uav 1: no such airframe" in finished.stdout


def test_wall_time_limit_ends_a_test(tmp_path: Path) -> None:
    finished = run_pytest(
        tmp_path,
        """
        def test_long(swarm):
            swarm("small.toml", wall_limit_s=2.0).run_until(lambda _: False, timeout_s=1e9)
        """,
    )
    assert finished.returncode == 1
    assert "the wall time of 2 s is over" in finished.stdout


def test_port_left_in_use_fails_the_test(tmp_path: Path) -> None:
    finished = run_pytest(
        tmp_path,
        """
        import socket
        from harness.launch.resources import bind

        def test_untidy(swarm, monkeypatch):
            flight = swarm("small.toml")
            port = flight._processes.ready["uav 0"].details["gcs_local_udp"]
            flight.stop()
            global held
            held = bind(socket.SOCK_DGRAM, "127.0.0.1", port)

        def test_close():
            held.close()
        """,
    )
    assert finished.returncode == 1
    assert "the swarm left behind: port " in finished.stdout
    assert "2 passed, 1 error" in finished.stdout


def test_plugin_imports_no_large_library(tmp_path: Path) -> None:
    code = (
        "import sys, harness.launch.pytest_plugin; print({'numpy', 'msgspec', 'psutil'} & sys.modules.keys())"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert loaded.stdout.strip() == "set()"
