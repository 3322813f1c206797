"""Compute patterns of many snapshots in worker processes, in the order of the snapshots.

A worker is this module run as a program. The workers of the standard pools would import the caller's main
module, and so execute a script without a main guard again.
"""

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from threading import Thread
from typing import BinaryIO

from antenna.analysis.patterns import Pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, Snapshot
from antenna.solvers.selection import make_backend


class WorkerError(RuntimeError):
    """A worker ended without results; the text is one line."""


CHUNK = 8
"""Least snapshots per worker, a fifth of a second of NEC2."""
_SIZE_BYTES = 8


def compute_patterns(
    config: AntennaConfig, snapshots: Sequence[Snapshot], *, workers: int = 1
) -> list[Pattern | ElementsTouch]:
    """Return one result per snapshot; results do not depend on ``workers``.

    One worker computes in this process; more are child processes, or threads for the batch backend, which
    releases the interpreter lock. Raises BackendUnavailable, WorkerError.
    """
    if config.backend == "batch":
        return make_backend(config, threads=workers).patterns(snapshots)
    backend = make_backend(config)  # raises here if unavailable, not in every worker
    workers = min(workers, -(-len(snapshots) // CHUNK))
    if workers <= 1:
        return backend.patterns(snapshots)
    results: list[Pattern | ElementsTouch | None] = [None] * len(snapshots)
    pool: list[subprocess.Popen[bytes]] = []
    try:
        for first in range(workers):
            pool.append(start_worker())
            _send(pool[-1], (config, list(snapshots[first::workers])))
        for first, worker in enumerate(pool):
            results[first::workers] = _receive(worker)
    finally:
        for worker in pool:
            worker.kill()
            with contextlib.suppress(BrokenPipeError):
                worker.communicate()
    return [result for result in results if result is not None]


def start_worker() -> "subprocess.Popen[bytes]":
    """Start a worker, which ignores Ctrl-C of the terminal and ends with its parent in any case."""
    command = [sys.executable, "-P", "-m", "antenna.solvers.parallel"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)


def _send(worker: "subprocess.Popen[bytes]", work: object) -> None:
    assert worker.stdin is not None  # noqa: S101  started with a pipe
    content = pickle.dumps(work)
    with contextlib.suppress(BrokenPipeError):  # its exit status is reported by `_receive`
        worker.stdin.write(len(content).to_bytes(_SIZE_BYTES, "little") + content)
        worker.stdin.flush()  # stays open: the worker ends at its end


def _receive(worker: "subprocess.Popen[bytes]") -> list[Pattern | ElementsTouch]:
    assert worker.stdout is not None  # noqa: S101  started with a pipe
    content = worker.stdout.read()
    if status := worker.wait():
        raise WorkerError(f"an antenna worker ended with status {status}")
    results: list[Pattern | ElementsTouch] = pickle.loads(content)  # noqa: S301  from our own child
    return results


def _work(stdin: BinaryIO, stdout: BinaryIO) -> None:
    size = int.from_bytes(stdin.read(_SIZE_BYTES), "little")
    content = stdin.read(size)
    if len(content) < size or not size:
        return  # the parent has ended
    Thread(target=_end_with_parent, daemon=True).start()
    config, snapshots = pickle.loads(content)  # noqa: S301  from our own parent
    stdout.write(pickle.dumps(make_backend(config).patterns(snapshots)))
    stdout.flush()


def _end_with_parent() -> None:
    os.read(sys.stdin.fileno(), 1)
    os._exit(1)


if __name__ == "__main__":
    _work(sys.stdin.buffer, sys.stdout.buffer)
