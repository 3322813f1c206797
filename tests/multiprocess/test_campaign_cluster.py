"""The cluster of a campaign runs nothing for programs without its key, of whatever user (30 s)."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import psutil
import pytest
from distributed import LocalCluster, Security
from paths import ROOT

from harness.campaign import Campaign, CampaignError, cluster, running
from harness.campaign import run as fly_campaign
from harness.campaign.store import Flown, Task

pytestmark = pytest.mark.multiprocess

STRANGER = ROOT / "tests" / "support" / "cluster_stranger.py"
NOT_FOUND = 404
WALL_LIMIT_S = 240.0


def listening_ports(pid: int | None = None) -> list[int]:
    """Return the TCP ports on which a process, this one by default, and its descendants listen."""
    processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    return sorted(
        {
            connection.laddr.port
            for process in processes
            for connection in process.net_connections("tcp")
            if connection.status == psutil.CONN_LISTEN
        }
    )


def tried_by_a_stranger(ports: list[int]) -> dict[int, tuple[int | None, int | None]]:
    """Return by port the user id with which a function ran, or None, and the HTTP status, or None."""
    ended = subprocess.run(
        [sys.executable, str(STRANGER), *map(str, ports)],
        capture_output=True,
        text=True,
        timeout=WALL_LIMIT_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    tried = json.loads(ended.stdout)
    assert tried["uid"] != 0
    return {int(port): tuple(result) for port, result in tried["ports"].items()}


def test_functions_of_strangers_run_without_encryption(tmp_path: Path) -> None:
    """The same program succeeds on scheduler, worker and nanny of a cluster with dask's defaults."""
    before = set(listening_ports())
    http = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
        scheduler_kwargs=http,
        local_directory=str(tmp_path),
    ):
        tried = tried_by_a_stranger(sorted(set(listening_ports()) - before))
    assert sum(user == os.getuid() for user, _ in tried.values()) == len(("scheduler", "worker", "nanny"))


CAMPAIGN = f"""
scenario = "{ROOT / "scenarios" / "article.toml"}"
seeds = 2
[set]
agents = 2
formation.columns = 2
formation.rows = 1
formation.height_m = 2
onboard.localisation = "gps"
antenna.snapshot_rate_hz = 4
run.duration_s = 10.0
"""


def test_functions_of_strangers_do_not_run_while_a_campaign_flies(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(CAMPAIGN)
    line = ["-m", "coflight", "campaign", "c.toml", "--out", "out", "--workers", "1", "--json"]
    with subprocess.Popen(
        [sys.executable, *line], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as campaign:
        deadline_s = time.monotonic() + WALL_LIMIT_S
        while not list((tmp_path / "out" / "flying").rglob("truth.bin")):
            assert campaign.poll() is None, campaign.communicate()
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        ports = listening_ports(campaign.pid)
        tried = tried_by_a_stranger(ports)
        stdout, stderr = campaign.communicate(timeout=WALL_LIMIT_S)
    assert campaign.returncode == 0, stderr
    assert json.loads(stdout)["completed"] == 2
    assert len(tried) >= len(("scheduler", "worker", "nanny"))
    assert {user for user, _ in tried.values()} == {None}
    assert {status for _, status in tried.values()} <= {None, NOT_FOUND}


# ---- a scheduler with certificates


def certificates(folder: Path) -> dict[str, str]:
    """Write a certificate and its key; returns the settings of dask that name them for every role."""
    folder.mkdir()
    made: Any = Security.temporary()
    for name, content in (("ca.pem", made.tls_ca_file), ("key.pem", made.tls_client_key)):
        (folder / name).write_text(content)
    files = {"cert": str(folder / "ca.pem"), "key": str(folder / "key.pem")}
    roles = {
        f"distributed.comm.tls.{role}.{name}": file
        for role in ("client", "scheduler", "worker")
        for name, file in files.items()
    }
    return {"distributed.comm.tls.ca-file": files["cert"], **roles}


def fly_nothing(task: Task) -> tuple[Flown, dict[str, bytes]]:
    return Flown(digest=task.digest, status="completed", summary={"value": task.scenario.run.seed}), {}


@pytest.fixture
def scheduler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Run a scheduler with one worker, both with certificates; yield its address."""
    monkeypatch.setattr(running, "fly_on_worker", fly_nothing)
    monkeypatch.setattr(cluster, "CONNECT_LIMIT_S", 3.0)
    with (
        dask.config.set(certificates(tmp_path / "scheduler")),
        LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            host="127.0.0.1",
            protocol="tls",
            security=Security(require_encryption=True),
            dashboard_address=None,
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            local_directory=str(tmp_path),
        ) as made,
    ):
        yield made.scheduler_address


CASE = Campaign(name="encrypted", scenario=ROOT / "scenarios" / "article.toml", seeds=(1, 2))


def test_a_scheduler_with_tls_flies_for_the_certificates_of_dasks_settings(
    scheduler: str, tmp_path: Path
) -> None:
    assert scheduler.startswith("tls://")
    notes: list[str] = []
    with dask.config.set({name: str(path) for name, path in named(tmp_path / "scheduler").items()}):
        table = fly_campaign(CASE, out=tmp_path / "out", scheduler=scheduler, note=notes.append)
    assert table.column("value") == [1, 2]
    assert notes == []


def named(folder: Path) -> dict[str, Path]:
    """Return the settings of a client with the files of `certificates`."""
    prefix = "distributed.comm.tls"
    return {
        f"{prefix}.ca-file": folder / "ca.pem",
        f"{prefix}.client.cert": folder / "ca.pem",
        f"{prefix}.client.key": folder / "key.pem",
    }


def test_other_certificates_and_missing_ones_are_one_line(scheduler: str, tmp_path: Path) -> None:
    certificates(tmp_path / "other")
    (tmp_path / "text").write_text("no certificate")
    names = [*named(tmp_path)]
    for files, line in (
        (dict.fromkeys(names), f"{names[0]} names no file"),
        (dict.fromkeys(names, tmp_path / "none"), "cannot be used: .*No such file"),
        (dict.fromkeys(names, tmp_path / "text"), "cannot be used: "),
        (named(tmp_path / "other"), "no dask scheduler answers: "),
    ):
        settings = {name: path and str(path) for name, path in files.items()}
        with dask.config.set(settings), pytest.raises(CampaignError, match=line) as raised:
            fly_campaign(CASE, out=tmp_path / "out", scheduler=scheduler)
        assert "\n" not in str(raised.value)
        assert scheduler in str(raised.value)


def test_a_scheduler_without_encryption_is_used_with_a_warning_only_where_it_is_permitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "fly_on_worker", fly_nothing)
    http = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, host="127.0.0.1", protocol="tcp",
        dashboard_address=None, scheduler_kwargs=http, local_directory=str(tmp_path),
    ) as made:  # fmt: skip
        address, notes = made.scheduler_address, list[str]()
        with pytest.raises(CampaignError, match=r"can run code .* --unencrypted"):
            fly_campaign(CASE, out=tmp_path / "out", scheduler=address)
        assert not (tmp_path / "out").exists()
        fly_campaign(CASE, out=tmp_path / "out", scheduler=address, unencrypted=True, note=notes.append)
    assert [note for note in notes if note.startswith(f"warning: {address} is not encrypted")] == notes != []
