"""Clients and the swarms that they fly are separate processes; all end with their test."""

import contextlib
import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from paths import SUPPORT
from swarms import Held

from harness.launch import kernel_cache

PACKAGES = {"mavsdk": "mavsdk", "MAVProxy": "MAVProxy", "serial": "pyserial", "cyclonedds": "cyclonedds"}
REQUIRED = os.environ.get("COFLIGHT_CLIENTS") == "required"
"""Set where the clients must be installed: then none of these tests is skipped."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    absent = [name for module, name in PACKAGES.items() if importlib.util.find_spec(module) is None]
    if absent and not REQUIRED:
        reason = f"{', '.join(absent)} not installed; run make test-clients"
        for item in items:  # the items are those of the whole session, not of this folder
            if item.get_closest_marker("clients") is not None:
                item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session", autouse=True)
def kernels() -> None:
    kernel_cache.prepare(lambda _: None)


@pytest.fixture
def hold(tmp_path: Path) -> Iterator[Callable[..., Held]]:
    """Return a factory of swarms, which are killed at the end of the test."""
    with contextlib.ExitStack() as stack:

        def make(*options: str) -> Held:
            swarm = Held(tmp_path / f"run{len(list(tmp_path.iterdir()))}", *options)
            stack.callback(swarm.kill)  # registered first, since the start may fail
            swarm.start()
            return swarm

        yield make


@pytest.fixture
def client() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Yield a function that starts a client script of tests/support; clients are killed at the end."""
    started: list[subprocess.Popen[str]] = []

    def start(script: str, *arguments: object) -> subprocess.Popen[str]:
        command = [sys.executable, str(SUPPORT / script), *map(str, arguments)]
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()
