"""An interrupt, or files in use, at the moment in which a run becomes complete. 5 s."""

import errno
import os
import signal
from pathlib import Path

import pytest
from paths import SCENARIOS

from foundation.exit_status import FINE
from harness.cli import report as cli_report
from harness.launch.interrupts import interruptible
from harness.launch.one_process import OneProcessSwarm
from harness.records.run_folder import RunFolder
from harness.report.report import finish_later
from harness.scenario.scenario_file import load


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    """Return the folder of a run that has flown and has no tables."""
    scenario = load(SCENARIOS / "article.toml", ["agents=2", "antenna.grid_deg=6"])
    with OneProcessSwarm(scenario, out=tmp_path / "run") as flown:
        flown.run(until_s=0.2)
    return flown._folder


@pytest.mark.parametrize("after", [False, True])
def test_ctrl_c_at_the_last_manifest_leaves_the_tables_it_promises(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch, *, after: bool
) -> None:
    write = RunFolder.write_manifest

    def write_with_signal(self: RunFolder, content: bytes) -> None:
        if not after:
            signal.raise_signal(signal.SIGINT)
        write(self, content)
        if after:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(RunFolder, "write_manifest", write_with_signal)
    with interruptible(), pytest.raises(KeyboardInterrupt):
        finish_later(folder)
    assert folder.is_reported()
    assert folder.flight.exists()
    assert folder.summary.exists()
    assert not folder.raw.exists()


def test_files_in_use_that_a_file_system_keeps_do_not_fail_the_report(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    rmdir = os.rmdir

    def keep(path: object, **named: int) -> None:
        if os.fspath(path) == os.fspath(folder.raw):  # type: ignore[call-overload]  # any path
            raise OSError(errno.ENOTEMPTY, "Directory not empty", os.fspath(folder.raw))
        rmdir(path, **named)  # type: ignore[arg-type]  # as above

    monkeypatch.setattr(os, "rmdir", keep)
    assert finish_later(folder)["agents"] == 2
    assert folder.is_reported()
    assert list(folder.raw.iterdir()) == []


def test_tables_that_were_made_just_now_are_not_read_again(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder.release()
    compared = []
    monkeypatch.setattr(cli_report, "altered_tables", lambda each: compared.append(each) or [])
    assert cli_report.main([str(folder.path), "--json"]) == FINE
    assert compared == []
    assert cli_report.main([str(folder.path), "--json"]) == FINE
    assert len(compared) == 1
