"""A campaign from its definition to its table: fly what is not there yet, keep what has landed.

    table = run(load("scenarios/campaigns/wind.toml"), out="runs/wind")
    gains = [table.series(row)["max_gain_dbi"] for row in range(len(table.runs))]

Whatever ends it costs the runs that were in the air: the same call goes on from there, and its table is that
of a campaign which was never broken off, byte for byte. A program that calls `run` has to be one that can be
imported (``if __name__ == "__main__":``), since the workers do so.
"""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

from msgspec import Struct

from harness.campaign.cluster import check_address, connected
from harness.campaign.definition import Campaign, Run, expand
from harness.campaign.store import FAILED, ClusterError, Flown, Store
from harness.campaign.table import Table, write_table
from harness.campaign.task import Task, failed
from harness.campaign.worker import fly_on_worker, sources_bytes, sources_state

DIED = "its process died"
GONE = "the scheduler has gone; the same campaign goes on from here"


class Landed(Struct, frozen=True, kw_only=True):
    """A run has ended, and the store has it, or what it had of it before if it now has failed."""

    run: Run
    """The first that has this flight"""
    flown: Flown
    done: int
    """Flights that have ended since the campaign was started this time, and ..."""
    total: int
    """... how many there are to be flown"""


def run(
    campaign: Campaign,
    *,
    out: str | Path,
    runs: Sequence[Run] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    retry: bool = False,
    dashboard: str | None = None,
    progress: Callable[[Landed], None] | None = None,
    note: Callable[[str], None] | None = None,
) -> Table:
    """Fly what is missing of a campaign, and write its table.

    Args:
        campaign: what is flown.
        out: folder, of one campaign at a time.
        runs: all of the campaign's, for who has had `harness.campaign.definition.expand` make them.
        workers: processes of this machine; by default as many as it has processors.
        scheduler: address of a dask scheduler, whose workers then fly.
        retry: fly those again that failed.
        dashboard: address of the page that shows the local cluster, such as ``127.0.0.1:8787``.
        progress: is told of every run that lands.
        note: is told what takes long.

    Raises CampaignError for a campaign that cannot be flown, before anything is; ClusterError, CompileError,
    OSError.

    """
    check_address(scheduler)
    state = sources_state()
    if runs is None:
        runs = expand(campaign, state=state)
    store = Store(Path(out))
    with store.alone():
        flown, missing = known(campaign, runs, store, retry=retry)
        if missing:
            with connected(
                workers=workers or os.cpu_count() or 1,
                scheduler=scheduler,
                folder=store.flying,
                dashboard=dashboard,
                note=note or _unsaid,
            ) as client:
                for landed, kept in _fly(client, campaign, missing, store, state):
                    flown[kept.digest] = kept
                    if progress is not None:
                        progress(landed)
        return write_table(campaign, runs, flown, store)


def _unsaid(_line: str) -> None:
    pass


def known(
    campaign: Campaign, runs: Sequence[Run], store: Store, *, retry: bool = False
) -> tuple[dict[str, Flown], list[Run]]:
    """Give what has been flown, by digest, and the runs that have to be, each flight once."""
    flown: dict[str, Flown] = {}
    missing: dict[str, Run] = {}
    for each in runs:
        if each.digest in flown or each.digest in missing:
            continue
        found = store.get(each.digest, campaign.keep)
        if found is None or (retry and found.status == FAILED):
            missing[each.digest] = each
        else:
            flown[each.digest] = found
    return flown, list(missing.values())


def _fly(
    client: Any,  # noqa: ANN401  a distributed.Client
    campaign: Campaign,
    missing: Sequence[Run],
    store: Store,
    state: str,
) -> Iterator[tuple[Landed, Flown]]:
    """Fly them all, and give each with what is kept of it; it is in the store before it is told.

    A worker that dies takes the runs with it that it had: each of them is flown again alone, when all the
    others have landed, and one that ends a worker once more is the one that does so.
    """

    def task_of(each: Run) -> Task:
        return Task(
            digest=each.digest,
            state=state,
            state_bytes=sources_bytes(),
            scenario=each.scenario,
            settings=each.settings,
            keep=campaign.keep,
        )

    done = 0
    suspects: list[Run] = []
    for together, flights in ((True, missing), (False, suspects)):
        for each, result in _results(client, flights, task_of, together=together):
            if result is None and together:
                suspects.append(each)
                continue
            flown, series = result or (failed(task_of(each), DIED), {})
            kept = store.put(flown, series)
            done += 1
            yield Landed(run=each, flown=flown, done=done, total=len(missing)), kept


Result = tuple[Flown, dict[str, bytes]]


def _results(
    client: Any,  # noqa: ANN401  a distributed.Client
    flights: Sequence[Run],
    task_of: Callable[[Run], Task],
    *,
    together: bool,
) -> Iterator[tuple[Run, Result | None]]:
    """Have runs flown, and give each with its result as it lands; None: a worker died of it.

    No more are with the cluster than it has threads, or but one, so that a run waits here rather than there:
    a worker's death is of what it flies, and memory holds few results however many runs there are. Raises
    ClusterError for a worker that refuses and a scheduler that goes.
    """
    import distributed  # noqa: PLC0415  slow to import

    library: Any = distributed  # half of it has no types

    waiting = deque(flights)
    flying: dict[str, Run] = {}
    landing = library.as_completed(loop=client.loop)
    while waiting or flying:
        room = _threads(client) if together else 1
        while waiting and len(flying) < room:
            each = waiting.popleft()
            future = client.submit(
                fly_on_worker, task_of(each), pure=False, key=f"run-{each.digest}-{together}"
            )
            flying[future.key] = each
            landing.add(future)
        future = next(landing)
        each = flying.pop(future.key)
        result: Result | None = None
        try:
            result = future.result()
        except library.KilledWorker:
            pass
        except CancelledError:
            raise ClusterError(GONE) from None
        future.release()
        yield each, result


def _threads(client: Any) -> int:  # noqa: ANN401  a distributed.Client
    """Give how many runs the cluster can fly at once just now, at least 1."""
    try:
        threads: int = sum(client.nthreads().values())
    except OSError:
        raise ClusterError(GONE) from None
    return max(1, threads)
