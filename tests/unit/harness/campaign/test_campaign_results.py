"""Results of a campaign: stored runs and their table."""

import csv
import errno
import importlib.metadata
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace
from paths import ROOT, SCENARIOS

from antenna.solvers.interface import BackendUnavailable
from foundation import exit_status
from foundation.records.whole_file import write_whole
from harness.campaign import Campaign, CampaignError, load, running, sources
from harness.campaign.definition import expand
from harness.campaign.flights import fly_task
from harness.campaign.running import known
from harness.campaign.store import FAILED, PLAIN_FLIGHT, Flown, Store, Task
from harness.campaign.table import make_rows, write_table
from harness.campaign.worker import _MEASURED_BY, sources_state
from harness.cli import campaign as cli
from harness.launch import one_process
from harness.launch.run_messages import SetupError, SwarmError
from harness.scenario.scenario_file import load as load_scenario

ARTICLE = SCENARIOS / "article.toml"
KEEPING = (
    "__init__", "cluster", "columns", "definition", "running", "sources", "store", "table", "values",
    "worker",
)  # fmt: skip
"""Modules of campaigns that do not affect flights and results"""
SMALL = (
    "agents=2", "formation.columns=2", "formation.rows=1", "formation.height_m=2", "onboard.localisation=gps",
    "antenna.snapshot_rate_hz=4",
)  # fmt: skip


def campaign(**changed):
    return Campaign(**{"name": "one", "scenario": ARTICLE, "seeds": (1, 2)} | changed)


def flown(run, **changed):
    summary = {"scenario": "article", "seed": run.seed, "status": "completed", "wall_s": 9.0, "agents": 8}
    return Flown(**{"digest": run.digest, "status": "completed", "summary": summary} | changed)


# ---- the store


def test_a_run_is_stored_if_it_is_complete_with_its_series(tmp_path):
    one, other = expand(campaign(), state="")
    store = Store(tmp_path)
    assert store.get(one.digest) is None
    store.put(flown(one), {})
    assert store.get(one.digest) == flown(one)
    assert store.get(one.digest, ["gains"]) is None  # not stored then
    kept = store.put(flown(one), {"gains": b"1"})
    assert store.get(one.digest, ["gains"]) == kept == flown(one, series=kept.series)
    store.put(flown(other, status=FAILED, reason="fell", summary={}), {})
    assert store.get(other.digest, ["gains"]).reason == "fell"  # a failed run has none
    path = tmp_path / "runs" / f"{one.digest}.json"
    whole = path.read_bytes()
    for size in range(len(whole) - 1):
        path.write_bytes(whole[:size])
        assert store.get(one.digest) is None
    path.write_bytes(whole.replace(one.digest.encode(), other.digest.encode()))
    assert store.get(one.digest) is None


def test_a_damaged_series_counts_as_missing(tmp_path):
    """Truncated, emptied, one bit changed, or deleted: the run is flown again only for this series."""
    (run, _) = expand(campaign(), state="")
    store, content = Store(tmp_path), b"PAR1 of the test PAR1"
    kept = store.put(flown(run), {"gains": content, "air": b"a"})
    path = store.series_path(run.digest, "gains")
    for damaged in (content[:-1], b"", content + b"\0", content.replace(b"t", b"u", 1)):
        path.write_bytes(damaged)
        assert store.get(run.digest, ["air", "gains"]) is None
        assert store.get(run.digest, ["air"]) == store.get(run.digest) == kept
    path.unlink()
    assert store.get(run.digest, ["gains"]) is None
    store.put(flown(run), {"gains": content})
    assert store.get(run.digest, ["gains", "air"]) == kept  # series stored before are kept


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b'"agents": 8', b'"agents": 9'), (b'"completed"', b'"failed"   '), (b"article", b"artikel"),
        (b'"run":{', b'"run":{ '), (b'"sha256":"', b'"sha256":"0'),
    ],
)  # fmt: skip
def test_a_file_that_was_altered_by_hand_is_named_and_flown_again(tmp_path, before, after):
    plan = campaign()
    runs, store, notes = expand(plan, state=""), Store(tmp_path), []
    for run in runs:
        store.put(flown(run), {})
    path = tmp_path / "runs" / f"{runs[0].digest}.json"
    text = path.read_bytes()
    assert before in text
    path.write_bytes(text.replace(before, after, 1))
    there, missing = known(plan, runs, store, note=notes.append)
    assert ([*there], missing) == ([runs[1].digest], [runs[0]])
    line = f"{path}: not as the campaign stored it, altered or deleted: its flight is flown again"
    assert notes == [line]


def test_a_series_that_was_altered_by_hand_is_named(tmp_path):
    plan = campaign(keep=("gains",))
    runs, store, notes = expand(plan, state=""), Store(tmp_path), []
    store.put(flown(runs[0]), {"gains": b"series"})
    assert [*known(plan, runs, store, note=notes.append)[0]] == [runs[0].digest]
    assert notes == []  # a run that was never flown is not named
    path = store.series_path(runs[0].digest, "gains")
    path.write_bytes(b"sorted")
    assert known(plan, runs, store, note=notes.append) == ({}, list(runs))
    assert [line.partition(":")[0] for line in notes] == [str(path)]


def test_a_failed_run_does_not_replace_one_that_did_not_fail(tmp_path):
    """Flown again for another series, a run may fail for reasons that did not affect the first flight."""
    (run, _) = expand(campaign(), state="")
    store = Store(tmp_path)
    fell = flown(run, status=FAILED, reason="fell", summary={})
    for first in (flown(run), flown(run, status="not_formed", reason="late")):
        store.put(fell, {})
        kept = store.put(first, {"air": b"a"})  # a failed one is replaced
        assert store.put(fell, {}) == kept
        assert store.get(run.digest, ["air"]) == kept
        (tmp_path / "runs" / f"{run.digest}.json").unlink()


def test_a_full_disk_leaves_no_partial_file(tmp_path, monkeypatch):
    path = tmp_path / "whole"
    write_whole(path, b"before")

    def full(_descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"after")
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [("whole", b"before")]


def test_missing_runs_are_flown_once_and_failed_ones_on_request(tmp_path):
    plan = campaign(seeds=(1, 2, 3), sweep={"wind.mean_n": (5, 5.0)})  # two forms of the same value
    runs = expand(plan, state="")
    store = Store(tmp_path)
    store.put(flown(runs[0]), {})
    store.put(flown(runs[1], status=FAILED, reason="fell"), {})
    there, missing = known(plan, runs, store)
    assert set(there) == {runs[0].digest, runs[1].digest}
    assert [run.seed for run in missing] == [3]
    _, missing = known(plan, runs, store, retry=True)
    assert [run.seed for run in missing] == [2, 3]


def test_a_folder_has_one_campaign_at_a_time_which_cleans_up_after_a_killed_one(tmp_path):
    store = Store(tmp_path)
    for name in ("runs/.half.json", "runs/.half.gains.parquet", ".table.parquet", ".table.csv"):
        (tmp_path / name).write_text("{")
    others = {tmp_path / "runs" / name for name in (".ipynb_checkpoints", ".folder.json", ".nfs0001")}
    for folder in sorted(others)[:2]:
        folder.mkdir()
    max(others).write_text("foreign")
    (store.flying / "run-1").mkdir(parents=True)
    with store.alone():
        assert set((tmp_path / "runs").iterdir()) == others
        assert {path.name for path in tmp_path.iterdir()} == {"runs", "lock"}
        assert not store.flying.exists()
        with pytest.raises(CampaignError, match="another campaign flies into it"), Store(tmp_path).alone():
            pass
    with store.alone():
        pass
    (tmp_path / "file").touch()
    with pytest.raises(CampaignError, match="cannot be a campaign's folder"):
        Store(tmp_path / "file")


def test_folder_with_other_content_is_refused_and_stays_as_it_is(tmp_path):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(CampaignError, match=r"holds notes\.txt, and a campaign needs a folder.* --out"):
        Store(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_folder_that_holds_runs_of_the_user_is_no_campaigns_folder(tmp_path):
    (tmp_path / "runs").mkdir()
    with pytest.raises(CampaignError, match="holds runs, and a campaign needs a folder"):
        Store(tmp_path)
    assert [path.name for path in tmp_path.rglob("*")] == ["runs"]


def complete_campaign(tmp_path):
    """Return the command of a complete campaign of two runs."""
    path = tmp_path / "two.toml"
    path.write_text(f'scenario = "{ARTICLE}"\nseeds = 2\n')
    store = Store(tmp_path / "out")
    for run in expand(load(path), state=sources_state(PLAIN_FLIGHT.measured_by)):
        store.put(flown(run), {})
    return [str(path), "--out", str(tmp_path / "out")]


def test_the_runs_of_a_command_are_computed_once(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(cli, "expand", lambda *args, **named: made.append(0) or expand(*args, **named))
    monkeypatch.setattr(running, "expand", cli.expand)
    assert cli.main(complete_campaign(tmp_path)) == exit_status.FINE
    assert len(made) == 1


def test_a_schedulers_address_is_checked_without_missing_runs(tmp_path, capfd):
    command = complete_campaign(tmp_path)
    for more in ([], ["--dry-run"]):
        assert cli.main([*command, "--scheduler", "bogus", *more]) == exit_status.BAD_INPUT
        line = "campaign: --scheduler bogus: expected the address of a dask scheduler, tls://HOST:PORT\n"
        assert capfd.readouterr() == ("", line)
        assert cli.main([*command, "--scheduler", "tcp://localhost:8786", *more]) == exit_status.BAD_INPUT
        assert "use a scheduler with TLS, tls://HOST:PORT, or permit" in capfd.readouterr().err
    with pytest.raises(CampaignError, match="bogus: expected the address"):
        running.run(campaign(), out=tmp_path / "other", scheduler="bogus")
    assert not (tmp_path / "other").exists()


# ---- the table


def test_the_table_has_the_campaigns_order_every_number_and_no_wall_time(tmp_path):
    """Whole numbers remain whole, and missing values are empty."""
    plan = campaign(sweep={"wind.mean_n": (0, 2.5), "faults": ([], ["x", {"a": 1}])})
    swept = {0: (0, []), 2.5: (2.5, ["x", {"a": 1}])}  # which no scenario has
    winds = expand(campaign(sweep={"wind.mean_n": tuple(swept)}), state="")
    runs = [replace(run, swept=swept[run.swept[0]]) for run in winds]
    summary = {
        "scenario": "article", "seed": 1, "status": "completed", "reason": None, "agents": 8, "wall_s": 3.1,
        "real_time_factor": 2.0, "moves_s": None, "rms": {"shape": 0.5, "deep": {"er": 1}},
        "deterministic": True, "vehicles": [{"uav": 0, "alive": True}, {"uav": 1, "alive": False}],
        "log_sha256": "ab", "list": [1],
    }  # fmt: skip
    ended = {runs[0].digest: flown(runs[0], summary=summary)}
    ended[runs[1].digest] = flown(runs[1], status=FAILED, reason='a "bad", end', summary={})
    ended[runs[2].digest] = flown(runs[2], summary=summary | {"rms": {"shape": 1, "late": 2}, "moves_s": 3.0})
    ended[runs[3].digest] = flown(runs[3], summary=summary | {"log_sha256": "cd"})
    backwards = dict(reversed(ended.items()))
    table = write_table(plan, runs, backwards, Store(tmp_path))
    rows = pq.read_table(table.parquet)
    assert rows.column_names == [
        "case", "wind.mean_n", "faults", "seed", "status", "reason", "digest", "agents", "moves_s",
        "rms.shape", "rms.deep.er", "deterministic", "vehicles_lost", "log_sha256", "rms.late",
    ]  # fmt: skip
    columns = rows.to_pydict()
    assert columns["case"] == ["one"] * 4
    assert columns["seed"] == [1, 2, 1, 2]
    assert columns["wind.mean_n"] == [0.0, 0.0, 2.5, 2.5]
    assert columns["faults"] == ["[]", "[]", '["x", {"a" = 1}]', '["x", {"a" = 1}]']
    assert columns["reason"] == [None, 'a "bad", end', None, None]
    assert columns["rms.shape"] == [0.5, None, 1.0, 0.5]
    assert columns["moves_s"] == [None, None, 3.0, None]
    assert columns["rms.late"] == [None, None, 2, None]
    assert columns["vehicles_lost"] == [1, None, 1, 1]
    assert str(rows.schema.field("rms.late").type) == "int64"
    assert rows.schema.metadata[b"campaign"] == b"one"
    assert {b"table", b"description", b"row"} < rows.schema.metadata.keys()
    stated = {field.name: field.metadata for field in rows.schema}
    assert stated["wind.mean_n"][b"unit"] == b"N"
    assert stated["wind.mean_n"][b"description"].endswith(b".")
    assert json.loads(stated["status"][b"values"]).keys() == {"completed", "not_formed", "failed"}
    assert not stated["rms.deep.er"]  # a result of another function
    with table.csv.open() as file:
        lines = list(csv.DictReader(file))
    assert [line["reason"] for line in lines] == ["", 'a "bad", end', "", ""]
    assert [line["rms.shape"] for line in lines] == ["0.5", "", "1", "0.5"]
    before = table.parquet.read_bytes(), table.csv.read_bytes()
    again = write_table(plan, runs, ended, Store(tmp_path / "again"))
    assert (again.parquet.read_bytes(), again.csv.read_bytes()) == before


def test_a_campaign_of_failures_has_a_table_as_well():
    plan = campaign()
    runs = expand(plan, state="")
    rows = make_rows(
        plan, runs, {run.digest: Flown(digest=run.digest, status=FAILED, reason="x") for run in runs}
    )
    assert rows.column("reason").to_pylist() == ["x", "x"]


# ---- one flight


def task(*settings, keep=()):
    return Task(
        digest="d",
        state="s",
        state_bytes="b",
        scenario=load_scenario(ARTICLE, settings),
        settings=settings,
        keep=keep,
    )


def test_the_stored_gains_are_those_of_the_summary(tmp_path):
    """4 per second over 1 s of formation, of which the summary has number, mean and standard deviation."""
    settings = (
        *SMALL,
        "run.duration_s=1",
        "antenna.feeds_for=estimates",
    )  # uses all fields of the record
    ended, series = fly_task(task(*settings, keep=("gains", "air")), tmp_path)
    assert ended.status == "completed", ended.reason
    assert ended.settings == settings
    gains = pq.read_table(io.BytesIO(series["gains"]))
    gain_dbi = np.array(gains["max_gain_dbi"])
    result = ended.summary["max_gain_dbi"]
    assert len(gain_dbi) == result["patterns"] + result["missing"] >= 4
    assert gain_dbi.mean() == pytest.approx(result["mean"], abs=1e-4)
    assert gain_dbi.std(ddof=1) == pytest.approx(result["std"], abs=1e-4)
    times_us = np.array(gains["time_us"])
    assert np.diff(times_us) == pytest.approx(250_000, abs=40_000)  # of a log with 25 rows per second
    assert times_us[0] * 1e-6 == pytest.approx(ended.summary["formed_s"], abs=0.041)
    assert "busy_ns" in pq.read_table(io.BytesIO(series["air"])).column_names
    assert not list(tmp_path.iterdir())


def test_missing_gains_fail_a_run_that_must_store_them(tmp_path, monkeypatch):
    """Otherwise the run is valid, and its summary has the note."""
    summary = {"status": "completed", "reason": None, "max_gain_dbi": {"mean": None, "note": "of the test"}}
    monkeypatch.setattr(one_process, "fly", lambda _scenario, _folder: summary)
    ended, series = fly_task(task(keep=("gains",)), tmp_path)
    assert (ended.status, series) == (FAILED, {})
    assert ended.reason == "NoSeries: no gains to keep: of the test"
    ended, _ = fly_task(task(), tmp_path)
    assert ended.status == "completed"


def test_without_the_solver_nothing_is_flown(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(one_process, "fly", None)
    with pytest.raises(BackendUnavailable, match="nec2c patterns need"):
        fly_task(task("antenna.backend=nec2c"), tmp_path)


@pytest.mark.parametrize(
    "error",
    [OSError(errno.ENOSPC, "No space left on device"), MemoryError(), SetupError("No space left on device")],
    ids=repr,
)
def test_errors_of_the_machine_are_no_result_of_a_run(tmp_path, monkeypatch, error):
    """They would be stored, and the run would not be flown again."""

    def fail(_scenario, folder):
        (folder / "left").touch()
        raise error

    monkeypatch.setattr(one_process, "fly", fail)
    with pytest.raises(type(error)) as caught:
        fly_task(task(), tmp_path)
    assert caught.value is error
    assert not list(tmp_path.iterdir())


def test_a_formation_that_is_not_reached_is_a_result_without_gains(tmp_path):
    ended, series = fly_task(task(*SMALL, "run.reach_timeout_s=0.2", keep=("gains",)), tmp_path)
    assert (ended.status, ended.reason) == ("not_formed", "the formation was not reached within 0.2 s")
    assert pq.read_table(io.BytesIO(series["gains"])).num_rows == 0


def test_a_failure_is_a_reproducible_line(tmp_path, monkeypatch):
    """It contains neither process ids nor names of temporary folders."""

    def fail(_scenario, folder):
        (folder / "left").touch()
        log = folder / "logs" / "one process.log"
        raise SwarmError(
            f"physics (pid {id(folder)}) ended with status 1: no {folder}/x (log: {log})\nand more"
        )

    monkeypatch.setattr(one_process, "fly", fail)
    ended, series = fly_task(task(), tmp_path)
    assert (ended.status, ended.reason) == (FAILED, "SwarmError: physics ended with status 1: no x")
    assert series == {}
    assert not list(tmp_path.iterdir())


FLOWN_FILES = (
    "antenna/a.py", "autopilot/b.py", "harness/campaign/flights.py", "harness/report/report.py",
    "netsim/phy/table.csv",
)  # fmt: skip
OTHER_FILES = (
    "antenna/lab/cli.py", "antenna/analysis/gain_figures.py", "harness/cli/campaign.py", "harness/cli/fly.py",
    "harness/cli/export.py", "harness/report/figures.py", "harness/cli/progress.py",
    "harness/launch/pytest_plugin.py", "studies/vehicle/page.py",
)  # fmt: skip
MEASURED_BY = ("harness/campaign/flights.py",)


def hashes(root):
    read = sources.read_sources(root, measured_by=MEASURED_BY)
    return sources.hash_code(read), sources.hash_bytes(read)


def test_the_hash_of_the_sources_covers_flights_and_results(tmp_path):
    """Modules of the display and comments do not change it; modules of results do."""
    for name in (*FLOWN_FILES, *OTHER_FILES):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("A = 1\n")
    result, as_bytes = hashes(tmp_path)
    for name in OTHER_FILES:
        (tmp_path / name).write_text("A = 2\n")
        assert hashes(tmp_path) == (result, as_bytes), name
    (tmp_path / "antenna" / "a.py").write_text('"""What it is."""\n\nA = (\n    1  # one\n)\n')
    assert hashes(tmp_path)[0] == result
    assert hashes(tmp_path)[1] != as_bytes
    seen = {hashes(tmp_path)}
    for name in FLOWN_FILES:
        (tmp_path / name).write_text("A = 2\n")
        seen.add(hashes(tmp_path))
    assert [len(set(each)) for each in zip(*seen, strict=True)] == [1 + len(FLOWN_FILES)] * 2


@pytest.mark.parametrize("library", ["numpy", "scipy", "numba", "pybullet", "PyNEC"])
def test_another_version_of_a_library_changes_the_hash(tmp_path, monkeypatch, library):
    for name in MEASURED_BY:
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    before = hashes(tmp_path)
    installed = importlib.metadata.version
    monkeypatch.setattr(
        importlib.metadata, "version", lambda name: "0.0.1" if name == library else installed(name)
    )
    assert not set(hashes(tmp_path)) & set(before)


def test_every_module_that_a_flight_loads_is_hashed_except_drawing():
    program = (
        "import sys; import harness.campaign.flights, harness.report.report\n"
        "print(*(each.__file__ for name, each in sys.modules.items()\n"
        "        if name.partition('.')[0] in ('antenna', 'netsim', 'autopilot', 'harness')), sep='\\n')"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    paths = {Path(line) for line in result.splitlines() if line.endswith(".py")}
    loaded = {path.relative_to(ROOT).as_posix() for path in paths}
    flown = sources.read_sources(ROOT, measured_by=_MEASURED_BY).keys()
    assert len(loaded & flown) > 100
    kept_by = {f"harness/campaign/{name}.py" for name in KEEPING}
    drawing = {"antenna/analysis/gain_figures.py", "harness/report/figures.py"}
    drawing |= {name for name in loaded if name.startswith("harness/report/page/")}
    assert loaded - flown == drawing | kept_by
