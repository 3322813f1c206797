"""Finished flights on disk, and a campaign that flies what is not there yet.

One JSON line per flight, appended as soon as it has landed, so whatever ends a campaign costs the flights
that were in the air. A line is of use while its digest is that of the flight as it would be flown now: the
same scenario, the same faults, the same state of the sources.
"""

import hashlib
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from harness.campaign.sources import ROOT, hash_sources
from harness.campaign.store import CampaignError, alone
from harness.scenario.scenario import Scenario
from harness.world.faults import AnyFault
from studies.codesign.cases import CodesignCase, CodesignPlan
from studies.codesign.measures import Measures

START_METHOD = "spawn"
"""Not forked: this process may have threads, and a worker shall be as a program of its own."""
FLYING = "flying"
"""Below the store's folder: one for each flight while it lasts"""
_MEASURED_BY = ("studies/codesign/flights.py", "studies/codesign/measures.py")


class CodesignTask(Struct, frozen=True, kw_only=True):
    """A flight to be flown, as a worker is told."""

    case: str
    seed: int
    digest: str
    state: str
    """Of the sources"""
    plan_s: float
    """In formation by the plan"""
    scenario: Scenario
    faults: tuple[AnyFault, ...]
    """Injected when the formation is reached"""
    gains: bool
    folder: str
    """For the run while it lasts"""


class CodesignFlown(Struct, frozen=True, kw_only=True):
    """A flight that has ended: its numbers, or why there are none."""

    case: str
    seed: int
    digest: str
    measures: Measures | None = None
    broken: str | None = None
    """One line"""
    state: str = ""
    """Of the sources; written by the campaign, as the next"""
    plan_s: float | None = None
    """In formation by the plan, after which cuts and lies are timed"""


class CodesignStore:
    """Flights in ``flights.jsonl`` of a folder, which is made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / "flights.jsonl"
        folder.mkdir(parents=True, exist_ok=True)

    def append(self, flown: CodesignFlown) -> None:
        """Write a flight down for good."""
        with self.path.open("ab") as file:
            if file.tell() and not self._ends_a_line():
                file.write(b"\n")
            file.write(msgspec.json.encode(flown) + b"\n")

    def flights(self) -> list[CodesignFlown]:
        """All that are there, oldest first; a line that a killed campaign has left unfinished is none."""
        flights = []
        if self.path.exists():
            for line in self.path.read_bytes().splitlines():
                try:
                    flights.append(msgspec.json.decode(line, type=CodesignFlown))
                except msgspec.DecodeError:  # also of a layout that has changed: it has another digest
                    continue
        return flights

    def alone(self) -> AbstractContextManager[None]:
        """Hold the folder for one campaign. Raises CampaignError if another one has it."""
        return alone(self.folder)

    def _ends_a_line(self) -> bool:
        with self.path.open("rb") as file:
            file.seek(-1, 2)
            return file.read(1) == b"\n"


@cache
def sources_state(root: Path = ROOT) -> str:
    """Hash of what the modules say that fly, and that make a flight's numbers here."""
    return hash_sources(root, measured_by=_MEASURED_BY)


def make_tasks(
    cases: Iterable[CodesignCase], plan: CodesignPlan, *, folder: Path, state: str | None = None
) -> list[CodesignTask]:
    """All flights of the cases, each once, seed by seed: a part of a campaign has all cases but the last.

    ``state`` is that of the sources.
    """
    state = sources_state() if state is None else state
    distinct = {case.name: case for case in cases}
    tasks = []
    flights = [(case, seed) for seed in range(1, plan.seeds + 1) for case in distinct.values()]
    for case, seed in sorted(flights, key=lambda flight: flight[0].last):
        scenario = case.scenario(plan, seed)
        content = msgspec.json.encode((state, scenario, case.faults, case.gains))
        digest = hashlib.sha256(content).hexdigest()[:16]
        tasks.append(
            CodesignTask(
                case=case.name, seed=seed, digest=digest, state=state[:16], plan_s=plan.duration_s,
                scenario=scenario, faults=case.faults, gains=case.gains,
                folder=str(folder / FLYING / digest),
            )
        )  # fmt: skip
    return tasks


def known(
    tasks: Sequence[CodesignTask], store: CodesignStore, *, stale: bool = False
) -> dict[tuple[str, int], CodesignFlown]:
    """Flights of the tasks that are on disk, by case and seed, the latest of each.

    ``stale`` takes those of other states of the sources where there is none of this one, if they are of
    the same plan.
    """
    wanted = {(task.case, task.seed): task for task in tasks}
    found: dict[tuple[str, int], CodesignFlown] = {}
    for flown in store.flights():
        key = (flown.case, flown.seed)
        if (task := wanted.get(key)) is None:
            continue
        if flown.digest == task.digest:  # which says so, whether or not it is written down
            found[key] = replace(flown, state=task.state, plan_s=task.plan_s)
        elif stale and flown.plan_s == task.plan_s and (key not in found or found[key].digest != task.digest):
            found[key] = flown
    return found


def fly_tasks(
    tasks: Sequence[CodesignTask],
    store: CodesignStore,
    fly: Callable[[CodesignTask], CodesignFlown],
    *,
    workers: int,
    done: Callable[[CodesignFlown], None],
) -> None:
    """Fly them all in worker processes; each is in the store before ``done`` hears of it.

    ``fly`` is a function of a module. A worker that dies takes those in the air with it: each of them is
    flown again alone, and if that ends a worker once more it is the one that does so. Raises CampaignError
    when a worker finds other sources than the tasks are of.
    """

    def finish(task: CodesignTask, flown: CodesignFlown) -> None:
        flown = replace(flown, state=task.state, plan_s=task.plan_s)
        store.append(flown)
        done(flown)

    waiting = deque(tasks)
    while waiting:
        for task in _fly_while_whole(waiting, fly, workers, finish):
            if list(_fly_while_whole(deque([task]), fly, 1, finish)):
                finish(task, broken(task, "its process died"))


def broken(task: CodesignTask, reason: str) -> CodesignFlown:
    """Make what is written down of a flight without numbers."""
    return CodesignFlown(case=task.case, seed=task.seed, digest=task.digest, broken=reason)


def _fly_while_whole(
    waiting: deque[CodesignTask],
    fly: Callable[[CodesignTask], CodesignFlown],
    workers: int,
    finish: Callable[[CodesignTask, CodesignFlown], None],
) -> list[CodesignTask]:
    """Fly what is waiting, and take it out; returns those in the air when a worker died."""
    flying: dict[Future[CodesignFlown], CodesignTask] = {}
    context = multiprocessing.get_context(START_METHOD)
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(fly,)) as pool:
        try:
            while waiting or flying:
                while waiting and len(flying) < workers:
                    flying[pool.submit(_fly_of_state, fly, waiting[0])] = waiting[0]
                    waiting.popleft()
                for future in wait(flying, return_when=FIRST_COMPLETED).done:
                    flown = future.result()
                    finish(flying.pop(future), flown)
        except BrokenProcessPool:
            return list(flying.values())
    return []


def _begin(fly: Callable[[CodesignTask], CodesignFlown]) -> None:  # noqa: ARG001  it is given so that it is imported by now
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C goes to all, and the parent alone speaks of it
    sources_state()  # kept: of what has just been read


def _fly_of_state(fly: Callable[[CodesignTask], CodesignFlown], task: CodesignTask) -> CodesignFlown:
    if sources_state()[: len(task.state)] != task.state:
        raise CampaignError("the sources have changed since the campaign began; start it again")
    return fly(task)
