"""Campaigns on real workers: resumption after SIGKILL, dead workers, wrong sources (40 s)."""

import errno
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster
from paths import ROOT

from harness.campaign import Campaign, ClusterError, running, worker
from harness.campaign import run as fly_campaign
from harness.campaign.store import FAILED, Flown
from harness.launch import one_process
from harness.launch.run_messages import SwarmError

pytestmark = pytest.mark.multiprocess

WALL_LIMIT_S = 60.0
CAMPAIGN = f"""
scenario = "{ROOT / "scenarios" / "article.toml"}"
seeds = 2
keep = ["gains"]
[set]
agents = 2
formation.columns = 2
formation.rows = 1
formation.height_m = 2
onboard.localisation = "gps"
antenna.snapshot_rate_hz = 4
run.duration_s = 1.0
[sweep]
wind.mean_n = [0, 0.5]
"""
RUNS = 4


def command(folder: Path, out: str, *, workers: int) -> list[str]:
    program, file = ROOT / "scripts" / "campaign.py", folder / "c.toml"
    options = ["--out", str(folder / out), "--workers", str(workers), "--json"]
    return [sys.executable, str(program), str(file), *options]


def complete(folder: Path, out: str, *, workers: int) -> tuple[dict[str, object], dict[str, bytes]]:
    """Fly to the end; returns the printed JSON, and the contents of the tables and series by file name."""
    ended = subprocess.run(
        command(folder, out, workers=workers),
        capture_output=True,
        text=True,
        timeout=WALL_LIMIT_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    files = [*(folder / out).glob("table.*"), *(folder / out / "runs").glob("*.parquet")]
    return json.loads(ended.stdout), {path.name: path.read_bytes() for path in files}


def test_killed_campaign_is_resumed_with_the_same_table(tmp_path: Path) -> None:
    """Two workers end with their client and two others finish; one worker flies the uninterrupted campaign.

    All formations are reached, so that the series have rows: 4 gains per second, for 1 s.
    """
    (tmp_path / "c.toml").write_text(CAMPAIGN)
    line = command(tmp_path, "killed", workers=2)
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as client:
        deadline_s = time.monotonic() + WALL_LIMIT_S
        runs = tmp_path / "killed" / "runs"
        while not list(runs.glob("[!.]*.json")):
            assert client.poll() is None, client.communicate()
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        family = psutil.Process(client.pid).children(recursive=True)
        listening = [
            connection.laddr.ip
            for process in (psutil.Process(client.pid), *family)
            for connection in process.net_connections()
            if connection.status == psutil.CONN_LISTEN
        ]
        client.send_signal(signal.SIGKILL)
        _, alive = psutil.wait_procs(family, timeout=20.0)
    assert not alive
    assert set(listening) == {"127.0.0.1"}
    flown = len(list(runs.glob("[!.]*.json")))
    assert 1 <= flown < RUNS
    printed, kept = complete(tmp_path, "killed", workers=2)
    assert (printed["runs"], printed["flown"], printed["completed"]) == (RUNS, RUNS - flown, RUNS)
    printed, whole = complete(tmp_path, "whole", workers=1)
    assert (printed["runs"], printed["flown"], printed["completed"]) == (RUNS, RUNS, RUNS)
    series = [name for name in whole if name.endswith(".gains.parquet")]
    assert whole.keys() == {"table.parquet", "table.csv", *series}
    assert len({whole[name] for name in series}) == RUNS  # all flights differ in seed or wind
    assert all(pq.read_table(io.BytesIO(whole[name])).num_rows >= 4 for name in series)
    assert kept == whole
    assert not (tmp_path / "killed" / "flying").exists()


def fly_or_die(task):
    """Exit with seed 2, return a failed run with seed 4, and a completed one with others."""
    seed = task.scenario.run.seed
    if seed == 2:
        os._exit(3)
    if seed == 4:
        return Flown(digest=task.digest, status=FAILED, reason="refused"), {}
    return Flown(digest=task.digest, status="completed", summary={"value": seed}), {"gains": bytes([seed])}


def out_of_room(_scenario, _folder, **_):
    """Raise OSError as `harness.launch.one_process.fly` does, with a cycle of context and cause."""
    full = OSError(errno.ENOSPC, "No space left on device")
    full.__context__ = SwarmError("of the test")
    full.__context__.__cause__ = full
    raise full


def test_dead_worker_fails_only_its_own_run(tmp_path, monkeypatch):
    monkeypatch.setattr(running, "fly_on_worker", fly_or_die)
    campaign = Campaign(
        name="deadly", scenario=ROOT / "scenarios" / "article.toml", seeds=tuple(range(1, 9)), keep=("gains",)
    )
    landed = []
    table = fly_campaign(campaign, out=tmp_path, workers=2, progress=landed.append)
    assert [each.done for each in landed] == list(range(1, 9))
    assert landed[-1].run.seed == 2  # repeated alone after all others
    assert table.column("seed") == list(range(1, 9))
    assert table.column("value") == [1, None, 3, None, 5, 6, 7, 8]
    reasons = dict(zip(table.column("seed"), table.column("reason"), strict=True))
    assert {seed: reason for seed, reason in reasons.items() if reason} == {2: running.DIED, 4: "refused"}
    assert table.store.series_path(table.runs[6].digest, "gains").read_bytes() == bytes([7])
    monkeypatch.setattr(running, "connected", None)  # no run is left to fly
    assert fly_campaign(campaign, out=tmp_path).rows.equals(table.rows)


def test_workers_of_a_scheduler_fly_and_refuse_other_sources(tmp_path, monkeypatch):
    scenario = ROOT / "scenarios" / "article.toml"
    campaign = Campaign(name="elsewhere", scenario=scenario, seeds=(1, 3, 5, 7))
    local = {"host": "127.0.0.1", "protocol": "tcp", "dashboard_address": None, "processes": False}
    http = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(n_workers=1, threads_per_worker=2, scheduler_kwargs=http, **local) as cluster:
        address = cluster.scheduler_address
        with monkeypatch.context() as patch:
            patch.setattr(running, "fly_on_worker", fly_or_die)
            table = fly_campaign(campaign, out=tmp_path / "one", scheduler=address, unencrypted=True)
        assert table.column("value") == [1, 3, 5, 7]
        monkeypatch.setattr(one_process, "fly", out_of_room)
        with pytest.raises(ClusterError, match=r"the worker at .* cannot fly: No space left"):
            fly_campaign(campaign, out=tmp_path / "full", scheduler=address, unencrypted=True)
        monkeypatch.setattr(worker, "sources_bytes", lambda _: "others")
        with pytest.raises(ClusterError, match="No space left"):  # comments differ: accepted
            fly_campaign(campaign, out=tmp_path / "full", scheduler=address, unencrypted=True)
        monkeypatch.setattr(worker, "sources_state", lambda _: "others")
        with pytest.raises(ClusterError, match=r"the sources of the worker at .* are not the campaign's"):
            fly_campaign(campaign, out=tmp_path / "other", scheduler=address, unencrypted=True)
    for name in ("full", "other"):
        assert not list((tmp_path / name / "runs").iterdir())
