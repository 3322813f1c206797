"""Runs a campaign: flies the missing runs, stores the results, and writes the table.

    table = run(load("scenarios/campaigns/wind.toml"), out="runs/wind")
    gains = [table.series(row)["max_gain_dbi"] for row in range(len(table.runs))]

After an interruption the same call continues and repeats only the runs that were flying; the table is
byte-identical to that of an uninterrupted campaign. A program that calls `run` must be importable
(``if __name__ == "__main__":``), because the workers import it.
"""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

from msgspec import Struct

from foundation.records.private_files import make_private
from harness.campaign.cluster import check_address, connected
from harness.campaign.definition import Campaign, Run, expand
from harness.campaign.store import FAILED, PLAIN_FLIGHT, ClusterError, Flown, Flying, Store, Task, failed
from harness.campaign.table import Table, write_table
from harness.campaign.worker import fly_on_worker, sources_bytes, sources_state

DIED = "its process died"
GONE = "the scheduler has gone; the same campaign goes on from here"


class Landed(Struct, frozen=True, kw_only=True):
    """A run has ended and is stored; if it failed, an earlier result of it remains stored."""

    run: Run
    """First run with this flight"""
    flown: Flown
    done: int
    """Number of flights that have ended since this start of the campaign"""
    total: int
    """Number of flights of this start"""


def run(
    campaign: Campaign,
    *,
    out: str | Path,
    runs: Sequence[Run] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    unencrypted: bool = False,
    retry: bool = False,
    progress: Callable[[Landed], None] | None = None,
    note: Callable[[str], None] | None = None,
    flying: Flying = PLAIN_FLIGHT,
) -> Table:
    """Fly the missing runs of a campaign, and write its table.

    Args:
        campaign: definition of the runs.
        out: folder, for one campaign at a time.
        runs: result of `harness.campaign.definition.expand`, if the caller has computed it.
        workers: processes of this machine; by default as many as it has processors.
        scheduler: address of a dask scheduler, whose workers are used instead: ``tls://HOST:PORT`` with the
            certificates of dask's settings ``distributed.comm.tls``.
        unencrypted: permit a scheduler ``tcp://HOST:PORT``, on a network that only its users reach.
        retry: fly failed runs again.
        progress: called for every run that ends.
        note: called with a line before what takes long, and for a stored flight that was altered.
        flying: the function that flies and measures a run.

    Raises CampaignError for an invalid campaign, before the first flight; ClusterError, CompileError,
    OSError.

    """
    check_address(scheduler, unencrypted=unencrypted)
    if runs is None:
        runs = expand(campaign, state=sources_state(flying.measured_by))
    store = Store(Path(out))
    with store.alone():
        note = note or (lambda _line: None)
        flown, missing = known(campaign, runs, store, retry=retry, note=note)
        if missing:
            make_private(store.flying)
            with connected(
                workers=workers or os.cpu_count() or 1,
                scheduler=scheduler,
                unencrypted=unencrypted,
                folder=store.flying,
                note=note,
            ) as client:
                for landed, kept in _fly(client, campaign, missing, store, flying):
                    flown[kept.digest] = kept
                    if progress is not None:
                        progress(landed)
        return write_table(campaign, runs, flown, store)


def known(
    campaign: Campaign,
    runs: Sequence[Run],
    store: Store,
    *,
    retry: bool = False,
    note: Callable[[str], None] = lambda _line: None,
) -> tuple[dict[str, Flown], list[Run]]:
    """Return the stored flights by digest, and the missing runs, each flight once.

    A flight whose file or series was altered since it was stored is missing; ``note`` receives a line for it.
    """

    def on_altered(path: Path) -> None:
        note(f"{path}: not as the campaign stored it, altered or deleted: its flight is flown again")

    flown: dict[str, Flown] = {}
    missing: dict[str, Run] = {}
    for each in runs:
        if each.digest in flown or each.digest in missing:
            continue
        found = store.get(each.digest, campaign.keep, on_altered=on_altered)
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
    flying: Flying,
) -> Iterator[tuple[Landed, Flown]]:
    """Fly all runs, store each result, and yield it with its stored form.

    A run is lost if its worker dies. All lost runs are flown again one by one after the others; a run whose
    worker dies again has failed.
    """

    def task_of(each: Run) -> Task:
        return Task(
            digest=each.digest,
            state=sources_state(flying.measured_by),
            state_bytes=sources_bytes(flying.measured_by),
            scenario=each.scenario,
            settings=each.settings,
            keep=campaign.keep,
            flying=flying,
            options=each.options,
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
    """Fly runs on the cluster, and yield each with its result when it ends; None: its worker died.

    Submits at most as many runs as the cluster has threads, or one if not ``together``; the others wait here.
    So a worker's death affects only flying runs, and memory holds few results. Raises ClusterError if a
    worker refuses a run or the scheduler ends.
    """
    import distributed  # noqa: PLC0415  slow to import

    library: Any = distributed  # only partly typed

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
    """Return the number of runs that the cluster can fly at once now, at least 1."""
    try:
        threads: int = sum(client.nthreads().values())
    except OSError:
        raise ClusterError(GONE) from None
    return max(1, threads)
