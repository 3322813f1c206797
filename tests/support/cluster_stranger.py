"""A program that tries to run its own function in the processes of a dask cluster without the cluster's key.

    python cluster_stranger.py PORT...

If root starts it, it takes an unprivileged user id first. It tries each port with and without TLS, by the
operations that scheduler, workers and nannies offer, and requests a page by HTTP. Prints one JSON object: by
port the user id of the process that ran the function, or None, and the HTTP status, or None.
"""

import asyncio
import http.client
import json
import os
import sys

from distributed import Security
from distributed.comm import connect
from distributed.protocol.pickle import dumps

UNPRIVILEGED_ID = 65_534
LIMIT_S = 5.0
OPERATIONS = ("run", "run_function")


async def ran_by(address: str, security: Security, operation: str) -> int | None:
    """Return the user id of the process that ran ``os.getuid``; None: it did not."""
    request = {"op": operation, "function": dumps(os.getuid), "args": dumps(()), "kwargs": dumps({})}

    async def answer_of() -> object:
        comm = await connect(address, timeout=LIMIT_S, **security.get_connection_args("client"))
        try:
            await comm.write(request | {"reply": True, "wait": True})
            return await comm.read()
        finally:
            comm.abort()

    try:
        answer = await asyncio.wait_for(answer_of(), 2.0 * LIMIT_S)
    except Exception:  # noqa: BLE001  every way of refusing is one
        return None
    result = answer.get("result", answer) if isinstance(answer, dict) else answer
    return result if isinstance(result, int) else None


async def run_somehow(port: int) -> int | None:
    """Return the first result of `ran_by` over all protocols and operations."""
    tried = [
        ran_by(f"{scheme}://127.0.0.1:{port}", security, operation)
        for scheme, security in (("tcp", Security()), ("tls", Security.temporary()))
        for operation in OPERATIONS
    ]
    return next((user for user in await asyncio.gather(*tried) if user is not None), None)


def http_status(port: int) -> int | None:
    """Return the status of the answer to a request for the status page; None: no HTTP server answers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=LIMIT_S)
    try:
        connection.request("GET", "/health")
        return connection.getresponse().status
    except (OSError, http.client.HTTPException):
        return None
    finally:
        connection.close()


async def _try_all(ports: list[int]) -> dict[int, tuple[int | None, int | None]]:
    users = await asyncio.gather(*map(run_somehow, ports))
    return {port: (user, http_status(port)) for port, user in zip(ports, users, strict=True)}


if __name__ == "__main__":
    asyncio.run(ran_by("tcp://127.0.0.1:9", Security.temporary(), "run"))  # loads all modules while it may
    if os.getuid() == 0:
        os.setgroups([])
        os.setgid(UNPRIVILEGED_ID)
        os.setuid(UNPRIVILEGED_ID)
    tried = asyncio.run(_try_all([int(text) for text in sys.argv[1:]]))
    sys.stdout.write(json.dumps({"uid": os.getuid(), "ports": tried}) + "\n")
