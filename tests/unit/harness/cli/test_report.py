"""``coflight report``: the summary of a run again, its figures drawn again from its tables. 10 s."""

import json
import shutil

import pytest
from paths import SCENARIOS

from foundation import exit_status
from harness.cli import report
from harness.launch.one_process import OneProcessSwarm
from harness.scenario.scenario_file import load


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "flown"
    overrides = ["run.duration_s=2", "antenna.snapshot_rate_hz=2", "antenna.grid_deg=6"]
    with OneProcessSwarm(load(SCENARIOS / "article.toml", overrides), out=folder) as swarm:
        swarm.run_until_formed(timeout_s=60.0)
        swarm.run_for(2.0)
        swarm.summary(draw=True)
    return folder


def test_it_shows_the_summary_that_the_flight_showed(run, capsys):
    assert report.main([str(run)]) == exit_status.FINE
    shown = capsys.readouterr().out
    summary = json.loads((run / "summary.json").read_text())
    assert summary["log_sha256"][:16] in shown
    assert report.main([str(run), "--json"]) == exit_status.FINE
    assert json.loads(capsys.readouterr().out) == summary


def test_figures_are_drawn_again_as_they_were(run, capsys):
    before = {path.name: path.read_bytes() for path in (run / "figures").iterdir()}
    assert {"patterns.png", "tracks.png", "channel.png", "ftm_error.png", "patterns.pdf"} <= before.keys()
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["figures"] == sorted(before)
    (run / "manifest.json").write_text(json.dumps(manifest | {"figures": []}))  # as of a run without figures
    for name in before:
        (run / "figures" / name).unlink()
    assert report.main([str(run), "--figures"]) == exit_status.FINE
    after = {path.name: path.read_bytes() for path in (run / "figures").iterdir()}
    assert after == before
    assert json.loads((run / "manifest.json").read_text()) == manifest
    assert "drawn into" in capsys.readouterr().err


def test_tables_that_were_altered_are_named_in_one_line(run, capsys, tmp_path):
    copied = tmp_path / "copied"
    shutil.copytree(run, copied)
    assert report.main([str(copied), "--json"]) == exit_status.FINE
    assert capsys.readouterr().err == ""
    table = copied / "ftm.parquet"
    table.write_bytes(table.read_bytes()[:-1] + b"2")
    (copied / "air.parquet").unlink()
    assert report.main([str(copied), "--json"]) == exit_status.FINE
    shown = capsys.readouterr()
    line = f"warning: {copied}: ftm.parquet, air.parquet: not as the run wrote it, by manifest.json\n"
    assert shown.err == line
    assert json.loads(shown.out) == json.loads((run / "summary.json").read_text())


def test_a_folder_without_a_run_is_one_line(tmp_path, capsys):
    assert report.main([str(tmp_path)]) == exit_status.BAD_INPUT
    line = f"coflight: {tmp_path}: no run that has ended: it has no manifest.json\n"
    assert capsys.readouterr().err == line


@pytest.mark.parametrize(("content", "reason"), [("{", "not JSON"), ("{}", "of another version")])
def test_a_manifest_that_cannot_be_read_is_one_line(content, reason, tmp_path, capsys):
    (tmp_path / "manifest.json").write_text(content)
    assert report.main([str(tmp_path)]) == exit_status.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"coflight: {tmp_path}/manifest.json: {reason}")
