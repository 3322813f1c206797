"""Signals and full disks before a run has its results: raw logs are kept, and its tables are made later.

Every test flies two UAVs in one process for some seconds.
"""

import contextlib
import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from paths import SCENARIOS

import harness.report.report as results
from harness.cli import fly, report
from harness.launch import kernel_cache
from harness.launch.one_process import OneProcessSwarm
from harness.scenario.scenario_file import load

pytestmark = pytest.mark.multiprocess

FLIGHT = (str(SCENARIOS / "article.toml"), "--one-process", "--agents=2", "--set=antenna.grid_deg=6")
SMALL = ("--duration=1", "--set=onboard.enabled=false")
"""Options of a flight of one second on the ground."""
SIZE_KB = 300
WALL_LIMIT_S = 120.0
MEASURED = {"wall_s", "real_time_factor"}


def summary_of(run: Path) -> dict[str, Any]:
    summary = json.loads((run / "summary.json").read_text())
    return {name: value for name, value in summary.items() if name not in MEASURED}


def manifest_of(run: Path) -> dict[str, Any]:
    manifest: dict[str, Any] = json.loads((run / "manifest.json").read_text())
    return manifest


def tables_of(run: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in run.glob("*.parquet")}


def interrupt_at(name: str, patch: pytest.MonkeyPatch) -> None:
    """Send this process a SIGINT when the report calls one of its functions, after the function's work."""
    original = getattr(results, name)

    def interrupted(*arguments: Any, **options: Any) -> Any:
        original(*arguments, **options)
        os.kill(os.getpid(), signal.SIGINT)

    patch.setattr(results, name, interrupted)


def test_signal_while_tables_are_written_keeps_the_raw_logs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, run = tmp_path / "whole", tmp_path / "run"
    assert fly.main([*FLIGHT, *SMALL, "--out", str(whole)]) == fly.FINE
    with monkeypatch.context() as patch:
        interrupt_at("write_tables", patch)
        assert fly.main([*FLIGHT, *SMALL, "--out", str(run)]) == fly.INTERRUPTED
    last_line = capsys.readouterr().err.splitlines()[-1]
    assert last_line.startswith("coflight: broken off: no table is written; 0.")
    assert last_line.endswith(
        f"raw logs are kept in {run}/raw: coflight report {run} makes the tables of them"
    )
    assert tables_of(run) == {}
    assert report.main([str(run)]) == report.FINE
    assert f"tables and figures made of {run}/raw" in capsys.readouterr().err
    assert (tables_of(run), summary_of(run)) == (tables_of(whole), summary_of(whole))
    assert not (run / "raw").exists()
    manifests = [json.loads((each / "manifest.json").read_text()) for each in (run, whole)]
    for name in ("status", "processes", "deterministic", "logs_sha256"):
        first, second = (manifest[name] for manifest in manifests)
        assert first == second, name


def test_signal_while_figures_are_drawn_keeps_the_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    with monkeypatch.context() as patch:
        interrupt_at("_draw", patch)
        assert fly.main([*FLIGHT, *SMALL, "--out", str(run)]) == fly.INTERRUPTED
    last_line = capsys.readouterr().err.splitlines()[-1]
    assert last_line == (
        "coflight: broken off: the tables are written, figures or report.html are not: "
        f"coflight report {run} --figures makes them"
    )
    assert report.main([str(run), "--figures"]) == report.FINE
    assert "tracks.png" in capsys.readouterr().err


def test_run_of_a_killed_launcher_gets_its_tables_when_it_has_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    command = [sys.executable, "-m", "coflight", "fly", *FLIGHT, "--duration=1e5", "--out", str(run)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as launcher:
        assert launcher.stderr is not None
        assert any("formation reached" in line for line in launcher.stderr)
        assert report.main([str(run)]) == report.BAD_INPUT  # it would delete what is being written
        assert f"coflight: {run}: the run is in flight" in capsys.readouterr().err
        launcher.kill()
    manifest = manifest_of(run)
    assert (manifest["status"], manifest["complete"], manifest["deterministic"]) == ("running", False, None)
    assert manifest["command"][1:3] == [*FLIGHT[:2]]
    assert report.main([str(run), "--json"]) == report.FINE
    assert (run / "figures" / "tracks.png").stat().st_size
    manifest = manifest_of(run)
    assert (manifest["status"], manifest["complete"], manifest["deterministic"]) == (
        "interrupted",
        True,
        False,
    )
    summary = json.loads(capsys.readouterr().out)
    assert (summary["status"], summary["wall_s"]) == ("interrupted", None)
    assert "its launcher was killed" in summary["reason"]
    assert summary["simulated_s"] >= summary["formed_s"] > 0.0
    assert not summary["deterministic"]
    assert len(summary["vehicles"]) == 2
    assert report.main([str(run)]) == report.FINE  # as a table, with missing wall times


def test_launcher_killed_before_the_flight_leaves_a_manifest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, started = tmp_path / "run", tmp_path / "started"
    program = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from harness.launch import kernel_cache\n"
        "from harness.cli import fly\n"
        f"kernel_cache.prepare = lambda *_: (Path({str(started)!r}).touch(), time.sleep(600.0))\n"
        f"fly.main([*{FLIGHT!r}, '--out', {str(run)!r}])\n"
    )
    with subprocess.Popen([sys.executable, "-c", program]) as launcher:
        deadline_s = time.monotonic() + WALL_LIMIT_S
        while not started.exists():
            assert launcher.poll() is None
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        assert report.main([str(run)]) == report.BAD_INPUT
        assert f"coflight: {run}: the run is in flight" in capsys.readouterr().err
        launcher.kill()
    manifest = manifest_of(run)
    assert (manifest["status"], manifest["complete"], manifest["seed"]) == ("running", False, 1)
    assert manifest["scenario"]["agents"] == 2
    assert (run / "manifest.json").stat().st_mode & 0o077 == 0
    for options in ([], ["--figures"], ["--json"]):
        assert report.main([str(run), *options]) == report.BAD_INPUT
        assert "its flight has not begun: its end is not recorded" in capsys.readouterr().err


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system that a flight fills before its formation is reached."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SIZE_KB}k", "tmpfs", str(disk)]
    with contextlib.ExitStack() as stack:
        try:
            subprocess.run(mount, check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            pytest.skip("no file system can be mounted here")
        stack.callback(subprocess.run, ["umount", str(disk)], check=True)
        yield disk


def test_full_disk_in_flight_is_reported_with_what_is_kept(
    small_disk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = small_disk / "run[bold]"  # also not read as markup
    assert fly.main([*FLIGHT, "--duration=1e5", "--out", str(run)]) == fly.FAILED
    *_, results_line, last_line = capsys.readouterr().err.splitlines()
    assert f"ended with status 1: no space left on the device of {run}: 0." in last_line
    assert last_line.endswith(" s are readable")
    assert results_line.startswith("the results cannot be written: ")
    assert results_line.endswith(
        f"kept in {run}/raw: coflight report {run} makes the tables of them, once they can be"
    )
    assert list(run.glob("*.parquet")) == []
    moved = tmp_path / "moved"
    shutil.copytree(run, moved)
    assert report.main([str(moved), "--json"]) == report.FINE
    summary = json.loads(capsys.readouterr().out)
    assert "its disk was full" in summary["reason"]
    assert summary["simulated_s"] > 1.0
    assert (moved / "flight.parquet").stat().st_size


def test_full_disk_after_the_flight_keeps_the_raw_logs(
    small_disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run, prepare = small_disk / "run", results.write_tables

    def fill(*arguments: Any) -> Any:
        with contextlib.suppress(OSError), (small_disk / "other").open("wb", buffering=0) as other:
            while other.write(bytes(1_024)):
                pass
        return prepare(*arguments)

    monkeypatch.setattr(results, "write_tables", fill)
    assert fly.main([*FLIGHT, *SMALL, "--out", str(run)]) == fly.FAILED
    streams = capsys.readouterr()
    (line,) = [line for line in streams.err.splitlines() if line.startswith("coflight: ")]
    assert line.startswith("coflight: the results cannot be written: ")
    assert "No space left on device" in line
    assert "written to" not in streams.err
    assert list(run.glob("*.parquet")) == []
    (small_disk / "other").unlink()
    monkeypatch.undo()
    moved = tmp_path / "moved"
    shutil.copytree(run, moved)
    assert report.main([str(moved)]) == report.FINE
    assert summary_of(moved)["status"] == "completed"


def test_second_signal_while_processes_stop_keeps_the_raw_logs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first one ends the flight, the second one arrives when its processes have ended."""
    run, stop = tmp_path / "run", OneProcessSwarm.stop
    fly_on = OneProcessSwarm.run_for

    def interrupted_flight(swarm: OneProcessSwarm, duration_s: float) -> Any:
        fly_on(swarm, duration_s)
        raise KeyboardInterrupt

    def interrupted_stop(swarm: OneProcessSwarm) -> None:
        stop(swarm)
        monkeypatch.setattr(OneProcessSwarm, "stop", stop)
        raise KeyboardInterrupt

    monkeypatch.setattr(OneProcessSwarm, "run_for", interrupted_flight)
    monkeypatch.setattr(OneProcessSwarm, "stop", interrupted_stop)
    assert fly.main([*FLIGHT, *SMALL, "--out", str(run)]) == fly.INTERRUPTED
    assert f"coflight report {run} makes the tables of them" in capsys.readouterr().err
    gc.collect()  # the raw logs are released, as at the end of the program
    assert report.main([str(run), "--json"]) == report.FINE
    reason = json.loads(capsys.readouterr().out)["reason"]
    assert reason is None or "killed" not in reason


def test_run_whose_program_asks_for_no_summary_gets_the_same_later(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = load(SCENARIOS / "article.toml", ["agents=2", "onboard.enabled=false", "antenna.grid_deg=6"])
    with OneProcessSwarm(scenario, out=tmp_path / "run") as swarm:
        swarm.run_for(1.0)
    with OneProcessSwarm(scenario, out=tmp_path / "asked") as swarm:
        swarm.run_for(1.0)
        asked = swarm.summary(draw=False)
    assert report.main([str(tmp_path / "run"), "--json"]) == report.FINE
    found = json.loads(capsys.readouterr().out)
    assert (found["status"], found["reason"], found["deterministic"]) == ("completed", None, True)
    assert found["log_sha256"] == asked["log_sha256"]


def test_summary_after_an_error_of_a_figure_is_that_of_the_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = load(SCENARIOS / "article.toml", ["agents=2", "onboard.enabled=false", "antenna.grid_deg=6"])
    monkeypatch.setattr(results, "_draw", Mock(side_effect=ValueError("no figure")))
    with OneProcessSwarm(scenario, out=tmp_path / "run") as swarm:
        swarm.run_for(1.0)
        with pytest.raises(ValueError, match="no figure"):
            swarm.summary()
        assert swarm.summary()["simulated_s"] == pytest.approx(1.0, abs=0.01)


def test_run_that_did_not_start_for_lack_of_kernels_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_cache, "prepare", Mock(side_effect=kernel_cache.CompileError("no room")))
    assert fly.main([*FLIGHT, *SMALL, "--out", str(tmp_path / "run")]) == fly.FAILED
    assert list(tmp_path.iterdir()) == []
