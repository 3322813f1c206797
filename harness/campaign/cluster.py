"""Workers of a campaign: processes of this machine, or those of a dask scheduler."""

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
    # a run that kills its worker is flown again alone by `running`, to identify the cause
    "distributed.scheduler.allowed-failures": 0,
    # the processes' HTTP servers, which do not use TLS, answer no request
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
_QUIET = logging.CRITICAL + 1
"""Above all levels: errors of the library are reported by coflight instead."""
_ADDRESS = re.compile(r"(tcp|tls)://[^\s/]+:[0-9]{1,5}")
_NO_DASHBOARD = {"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"}
"""Its page would be open to all users of the machine. Without an address the scheduler binds port 8787."""


def check_address(scheduler: str | None) -> None:
    """Check the address of a scheduler. Raises CampaignError."""
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise CampaignError(
            f"--scheduler {scheduler}: expected the address of a dask scheduler, tcp://HOST:PORT"
        )


@contextlib.contextmanager
def connected(
    *, workers: int, scheduler: str | None, folder: Path, note: Callable[[str], None]
) -> Iterator[Any]:
    """Yield a client of the scheduler at an address, or of a local cluster that ends with the block.

    The local cluster has ``workers`` processes that fly one run at a time each, in ``folder``; a worker ends
    when this process ends for any reason. All its sockets are on the loopback interface, which all users of
    the machine reach: its processes accept only peers with the key of this cluster (TLS), which is held in
    memory. Raises CampaignError, or CompileError.
    """
    check_address(scheduler)
    with contextlib.ExitStack() as stack:
        import dask  # noqa: PLC0415  slow to import, and not needed for reading
        import distributed  # noqa: PLC0415

        library: Any = distributed  # only partly typed

        if scheduler is None:
            os.environ.update(kernel_cache.environment())  # inherited by the workers, for Numba
            kernel_cache.prepare(note)
            stack.enter_context(dask.config.set(_SETTINGS))
            stack.enter_context(warnings.catch_warnings())
            warnings.simplefilter("ignore")  # about a port in use: another one is chosen
            target: object = stack.enter_context(
                library.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    memory_limit=0,  # otherwise workers above their share of the memory are ended
                    processes=True,
                    host=LOOPBACK,
                    security=library.Security.temporary(),
                    dashboard_address=None,
                    scheduler_kwargs=_NO_DASHBOARD,
                    local_directory=str(folder),
                    silence_logs=_QUIET,
                    preload=["harness.campaign.worker"],
                )
            )
        else:
            target = scheduler
        logger = logging.getLogger("distributed")
        stack.callback(logger.setLevel, logger.level)
        logger.setLevel(_QUIET)
        try:
            client = stack.enter_context(
                library.Client(target, timeout=CONNECT_LIMIT_S, set_as_default=False)
            )
        except (OSError, ValueError) as error:
            raise CampaignError(f"{scheduler}: no dask scheduler answers: {error}") from None
        if scheduler is not None and not client.nthreads():
            note(f"{scheduler}: waiting for its first worker")
        yield client
