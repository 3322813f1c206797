"""What a worker process of the cluster runs. It loads nothing of the flights before it is told to fly."""

import contextlib
import os
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from harness.campaign.sources import ROOT, hash_bytes, hash_said, read_sources
from harness.campaign.store import ClusterError, Flown
from harness.campaign.task import Task

_STDOUT, _STDERR = 1, 2
_MEASURED_BY = ("harness/campaign/flights.py", "harness/campaign/series.py")


@cache
def _sources() -> dict[str, bytes]:
    return read_sources(ROOT, measured_by=_MEASURED_BY)


@cache
def sources_state() -> str:
    """Hash of the libraries and sources that fly and measure, as they were when first read."""
    return hash_said(_sources())


@cache
def sources_bytes() -> str:
    """Hash of the same libraries and of the same sources' bytes."""
    return hash_bytes(_sources())


def fly_on_worker(task: Task) -> tuple[Flown, dict[str, bytes]]:
    """Fly a run in the worker's own folder.

    Raises ClusterError if its sources or libraries are not the campaign's, or its machine is in trouble.
    """
    from distributed import get_worker  # noqa: PLC0415  slow to import

    worker = get_worker()
    if sources_bytes() != task.state_bytes and sources_state() != task.state:
        raise ClusterError(
            f"the sources of the worker at {worker.address} are not the campaign's, or have changed since it "
            "began, or its libraries are others; start workers and campaign again"
        )
    with _silent(_STDERR):
        from harness.campaign import flights  # noqa: PLC0415  Bullet prints a line at its import
    folder = Path(worker.local_directory)
    try:
        return flights.fly_task(task, folder)
    except flights.OF_THE_MACHINE as error:
        trouble = flights.one_line(error, folder)
    # not within the block: with the other errors as its context it could not always travel
    raise ClusterError(
        f"the worker at {worker.address} cannot fly: {trouble}; what has been flown stays, and the same "
        "campaign goes on from there"
    )


def dask_setup(_worker: Any) -> None:  # noqa: ANN401  a distributed.Worker
    """Prepare a worker of the local cluster, by which it was named as a preload."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all, and the parent alone speaks of it
    _close(_STDOUT)  # it is for the campaign's results alone


@contextlib.contextmanager
def _silent(stream: int) -> Iterator[None]:
    """Let a file descriptor lead nowhere for a while."""
    before = os.dup(stream)
    _close(stream)
    try:
        yield
    finally:
        os.dup2(before, stream)
        os.close(before)


def _close(stream: int) -> None:
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, stream)
    os.close(nothing)
