"""Workers that fly: processes of this machine, or whatever a dask scheduler has."""

import contextlib
import logging
import os
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from harness.campaign.store import CampaignError
from harness.launch import kernel_cache

LOOPBACK = "127.0.0.1"
CONNECT_LIMIT_S = 20.0
"""Wall time within which a scheduler must answer."""
_SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.large-graph-warning-threshold": "1GB",
    # a run that kills its worker is flown again alone by us, so that nobody else is blamed
    "distributed.scheduler.allowed-failures": 0,
}
_QUIET = logging.CRITICAL + 1
"""What the library logs as an error is a line of ours."""
_ADDRESS = re.compile(r"(tcp|tls)://[^\s/]+:[0-9]{1,5}")
_NO_DASHBOARD = {"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"}
"""Without an address the scheduler would take port 8787 for a page that says nothing."""


def check_address(scheduler: str | None) -> None:
    """Refuse what is no address of a scheduler; raises CampaignError."""
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise CampaignError(f"{scheduler}: expected the address of a dask scheduler, tcp://HOST:PORT")


@contextlib.contextmanager
def connected(
    *,
    workers: int,
    scheduler: str | None,
    folder: Path,
    dashboard: str | None,
    note: Callable[[str], None],
) -> Iterator[Any]:
    """Give a client of the scheduler at an address, or of a local cluster that ends with the block.

    The local one is of ``workers`` processes that fly one run at a time each, in ``folder``; all its sockets
    are of the loopback interface, and a worker ends when this process does, however it does. ``dashboard``
    is the address of the page that shows it. Raises CampaignError, or CompileError.
    """
    check_address(scheduler)
    with contextlib.ExitStack() as stack:
        import dask  # noqa: PLC0415  slow to import, and not wanted by who only reads
        import distributed  # noqa: PLC0415

        library: Any = distributed  # half of it has no types

        if scheduler is None:
            os.environ.update(kernel_cache.environment())  # of the workers, whose numba reads it
            kernel_cache.prepare(note)
            stack.enter_context(dask.config.set(_SETTINGS))
            stack.enter_context(warnings.catch_warnings())
            warnings.simplefilter("ignore")  # of a port that is taken: another is
            cluster = stack.enter_context(
                library.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    memory_limit=0,  # else a worker is ended that has more than its share of the machine's
                    processes=True,
                    host=LOOPBACK,
                    dashboard_address=dashboard,
                    scheduler_kwargs={} if dashboard else _NO_DASHBOARD,
                    local_directory=str(folder),
                    silence_logs=_QUIET,
                    preload=["harness.campaign.worker"],
                )
            )
            target: object = cluster
        else:
            target = scheduler
        stack.enter_context(_without_logs())
        try:
            client = stack.enter_context(
                library.Client(target, timeout=CONNECT_LIMIT_S, set_as_default=False)
            )
        except (OSError, ValueError) as error:
            raise CampaignError(f"{scheduler}: no dask scheduler answers: {error}") from None
        if scheduler is not None and not client.nthreads():
            note(f"{scheduler}: waiting for its first worker")
        yield client


@contextlib.contextmanager
def _without_logs() -> Iterator[None]:
    """Have the library log nothing in this process for a while."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(_QUIET)
    try:
        yield
    finally:
        logger.setLevel(before)
