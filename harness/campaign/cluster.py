"""Workers of a campaign: processes of this machine, or those of a dask scheduler."""

import contextlib
import logging
import os
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from foundation.kernels.cache_trust import UntrustedCache
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


_TLS = "distributed.comm.tls"
_CERTIFICATES = (f"{_TLS}.ca-file", f"{_TLS}.client.cert", f"{_TLS}.client.key")
"""Settings of dask that name the files of a client"""


def check_address(scheduler: str | None, *, unencrypted: bool) -> None:
    """Check the address of a scheduler, and that connections without encryption are permitted explicitly.

    Raises CampaignError.
    """
    if scheduler is None:
        if unencrypted:
            raise CampaignError("--unencrypted: it belongs to --scheduler tcp://HOST:PORT")
        return
    match = _ADDRESS.fullmatch(scheduler)
    if match is None:
        raise CampaignError(
            f"--scheduler {scheduler}: expected the address of a dask scheduler, tls://HOST:PORT"
        )
    if match[1] == "tcp" and not unencrypted:
        raise CampaignError(
            f"--scheduler {scheduler}: any program that reaches its ports can run code as the users of its "
            "workers: use a scheduler with TLS, tls://HOST:PORT, or permit this one by --unencrypted (in "
            "Python, unencrypted=True)"
        )
    if match[1] == "tls" and unencrypted:
        raise CampaignError(f"--unencrypted: {scheduler} is encrypted; leave it out")


def _make_security(scheduler: str) -> Any:  # noqa: ANN401  a distributed.Security
    """Return the client's certificates of dask's settings. Raises CampaignError."""
    import dask  # noqa: PLC0415  slow to import
    import distributed  # noqa: PLC0415

    library: Any = distributed  # only partly typed
    for setting in _CERTIFICATES:
        if not dask.config.get(setting, None):
            raise CampaignError(f"--scheduler {scheduler}: dask's setting {setting} names no file")
    security = library.Security(require_encryption=True)
    try:
        security.get_connection_args("client")
    except (OSError, ValueError) as error:  # OSError: also errors of the ssl module
        raise CampaignError(
            f"--scheduler {scheduler}: the files of dask's settings {_TLS} cannot be used: {error}"
        ) from None
    return security


@contextlib.contextmanager
def connected(
    *,
    workers: int,
    scheduler: str | None,
    folder: Path,
    note: Callable[[str], None],
    unencrypted: bool = False,
) -> Iterator[Any]:
    """Yield a client of the scheduler at an address, or of a local cluster that ends with the block.

    The local cluster has ``workers`` processes that fly one run at a time each, in ``folder``; a worker ends
    when this process ends for any reason. All its sockets are on the loopback interface, which all users of
    the machine reach: its processes accept only peers with the key of this cluster (TLS), which is held in
    memory. A scheduler ``tls://`` is reached with the certificates of dask's settings, one ``tcp://`` only
    with ``unencrypted``. Raises CampaignError, or CompileError, also for a cache of kernels that others can
    write.
    """
    check_address(scheduler, unencrypted=unencrypted)
    with contextlib.ExitStack() as stack:
        import dask  # noqa: PLC0415  slow to import, and not needed for reading
        import distributed  # noqa: PLC0415

        library: Any = distributed  # only partly typed

        security = None
        if scheduler is None:
            try:
                os.environ.update(kernel_cache.environment())  # inherited by the workers, for Numba
            except UntrustedCache as error:
                raise kernel_cache.CompileError(str(error)) from None
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
            if unencrypted:
                note(
                    f"warning: {scheduler} is not encrypted: any program that reaches its ports can run code "
                    "as the users of its workers"
                )
            else:
                security = _make_security(scheduler)
        logger = logging.getLogger("distributed")
        stack.callback(logger.setLevel, logger.level)
        logger.setLevel(_QUIET)
        try:
            client = stack.enter_context(
                library.Client(target, security=security, timeout=CONNECT_LIMIT_S, set_as_default=False)
            )
        except (OSError, ValueError) as error:
            raise CampaignError(f"{scheduler}: no dask scheduler answers: {error}") from None
        if scheduler is not None and not client.nthreads():
            note(f"{scheduler}: waiting for its first worker")
        yield client
