"""Attempts to run a function on a cluster of a campaign without its key. An I/O module."""

import asyncio
import os
import threading
from typing import Any

import distributed
from distributed.protocol import pickle

from studies.attacks.tasks import Report, RunOnCluster

LIBRARY: Any = distributed
"""Only partly typed."""
LIMIT_S = 5.0
OPERATIONS = ("run", "run_function")
"""Of scheduler, worker and nanny."""


def try_functions(task: RunOnCluster, ended: threading.Event) -> Report:  # noqa: ARG001
    """Try to run a function by all protocols and operations on all ports; one that runs is a finding."""
    tried = [
        (port, scheme, operation)
        for port in task.ports
        for scheme in ("tcp", "tls")
        for operation in OPERATIONS
    ]
    security = {"tcp": LIBRARY.Security(), "tls": LIBRARY.Security.temporary()}

    async def run_all() -> list[bool]:
        return await asyncio.gather(
            *(
                _runs(f"{scheme}://127.0.0.1:{port}", security[scheme], operation)
                for port, scheme, operation in tried
            )
        )

    found = [
        f"runs a function on port {port} over {scheme}"
        for (port, scheme, _), has_run in zip(tried, asyncio.run(run_all()), strict=True)
        if has_run
    ]
    return Report(counts={"ports of the cluster": len(task.ports)}, found=found)


async def _runs(address: str, security: Any, operation: str) -> bool:  # noqa: ANN401  only partly typed
    """Whether the process at an address has run ``os.getuid``."""
    dumps: Any = pickle.dumps
    request = {"op": operation, "function": dumps(os.getuid), "args": dumps(()), "kwargs": dumps({})}

    async def answer_of() -> object:
        comm = await LIBRARY.comm.connect(address, timeout=LIMIT_S, **security.get_connection_args("client"))
        try:
            await comm.write(request | {"reply": True, "wait": True})
            return await comm.read()
        finally:
            comm.abort()

    try:
        answer = await asyncio.wait_for(answer_of(), 2.0 * LIMIT_S)
    except Exception:  # noqa: BLE001  every way of refusing is one
        return False
    result = answer.get("result", answer) if isinstance(answer, dict) else answer
    return isinstance(result, int)
