"""Code of a worker process of the cluster. The modules of a flight are imported at the first task."""

import contextlib
import os
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from harness.campaign.sources import hash_bytes, hash_code, read_sources
from harness.campaign.store import ClusterError, Flown, Task
from harness.records.versions import ROOT

_STDOUT, _STDERR = 1, 2
_MEASURED_BY = ("harness/campaign/flights.py",)


def _read(measured_by: tuple[str, ...]) -> dict[str, bytes]:
    return read_sources(ROOT, measured_by=(*_MEASURED_BY, *measured_by))


_sources = cache(_read)


@cache
def sources_state(measured_by: tuple[str, ...]) -> str:
    """Return the hash of libraries and sources of flights and results, as of the first call.

    ``measured_by``: see `harness.campaign.store.Flying`.
    """
    return hash_code(_sources(measured_by))


def present_state(measured_by: tuple[str, ...]) -> str:
    """Return the hash of the same libraries and sources as of now."""
    return hash_code(_read(measured_by))


@cache
def sources_bytes(measured_by: tuple[str, ...]) -> str:
    """Return the hash of the same libraries and of the sources' bytes."""
    return hash_bytes(_sources(measured_by))


def fly_on_worker(task: Task) -> tuple[Flown, dict[str, bytes]]:
    """Fly a run in the worker's own folder.

    Raises ClusterError if its sources or libraries differ from the campaign's, or for errors of its machine.
    """
    from distributed import get_worker  # noqa: PLC0415  slow to import

    worker = get_worker()
    measured_by = task.flying.measured_by
    if sources_bytes(measured_by) != task.state_bytes and sources_state(measured_by) != task.state:
        raise ClusterError(
            f"the sources of the worker at {worker.address} are not the campaign's, or have changed since it "
            "began, or its libraries are others; start workers and campaign again"
        )
    with _silent(_STDERR):
        from harness.campaign import flights  # noqa: PLC0415  Bullet prints a line when imported
    folder = Path(worker.local_directory)
    try:
        return flights.fly_task(task, folder)
    except flights.OF_THE_MACHINE as error:
        trouble = flights.one_line(error, folder)
    # outside of the except block: with the other error as its context it cannot always be pickled
    raise ClusterError(
        f"the worker at {worker.address} cannot fly: {trouble}; what has been flown stays, and the same "
        "campaign goes on from there"
    )


def dask_setup(_worker: Any) -> None:  # noqa: ANN401  a distributed.Worker
    """Prepare a worker of the local cluster, which preloads this module."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; only the parent reports it
    _close(_STDOUT)  # reserved for the campaign's results


@contextlib.contextmanager
def _silent(stream: int) -> Iterator[None]:
    """Redirect a file descriptor to /dev/null in the block."""
    before = os.dup(stream)
    _close(stream)
    try:
        yield
    finally:
        os.dup2(before, stream)
        os.close(before)


def _close(stream: int) -> None:
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream)
    os.close(null)
