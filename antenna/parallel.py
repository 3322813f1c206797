"""Patterns of many snapshots over worker processes, in the order of the snapshots."""

import os
import signal
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process
from threading import Thread

from antenna.backend import make_backend
from antenna.config import AntennaConfig
from antenna.geometry import ElementsTouch, Snapshot
from antenna.patterns import Pattern

CHUNK = 8
"""Snapshots handed to a worker at a time: a fifth of a second of NEC2, so that workers end together."""


def compute_patterns(
    config: AntennaConfig, snapshots: Sequence[Snapshot], *, workers: int = 1
) -> list[Pattern | ElementsTouch]:
    """One result for each snapshot, the same whatever ``workers`` is.

    One worker computes in this process. More are processes of their own, spawned and ended here: a script
    that calls this keeps its start behind ``if __name__ == "__main__"``.
    """
    chunks = [snapshots[i : i + CHUNK] for i in range(0, len(snapshots), CHUNK)]
    workers = min(workers, len(chunks))
    if workers <= 1:
        return make_backend(config).patterns(snapshots)
    with worker_pool(workers) as pool:
        parts = pool.map(_patterns, [config] * len(chunks), chunks)
        return [result for part in parts for result in part]


def worker_pool(workers: int) -> ProcessPoolExecutor:
    """Pool of spawned processes that leave Ctrl-C to their parent and end when it does, however it does."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin_worker)


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Executors leave their workers waiting for ever when the parent is killed."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _patterns(config: AntennaConfig, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
    return make_backend(config).patterns(snapshots)
