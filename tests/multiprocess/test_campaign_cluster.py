"""The local cluster of a campaign runs nothing for programs without its key, of whatever user (20 s)."""

import json
import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from distributed import LocalCluster
from paths import ROOT

from harness.campaign.cluster import connected

pytestmark = pytest.mark.multiprocess

STRANGER = ROOT / "tests" / "support" / "cluster_stranger.py"
NOT_FOUND = 404
WALL_LIMIT_S = 240.0


def listening_ports() -> list[int]:
    """Return the TCP ports on which this process and its descendants listen."""
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
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


def test_functions_of_strangers_do_not_run(tmp_path: Path) -> None:
    before = set(listening_ports())
    with connected(workers=2, scheduler=None, folder=tmp_path, note=print) as client:
        ports = set(listening_ports()) - before
        assert client.submit(os.getpid).result(timeout=30) != os.getpid()
        tried = tried_by_a_stranger(sorted(ports))
    assert len(ports) >= len(("scheduler", "worker", "worker", "nanny", "nanny"))
    assert {user for user, _ in tried.values()} == {None}
    assert {status for _, status in tried.values()} <= {None, NOT_FOUND}


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
