"""Store of finished flights, and a campaign that flies the missing ones.

Each flight is appended as one JSON line when it ends, so an interrupted campaign loses only the flights in
progress. A line is valid while its digest equals that of the flight with the current scenario, faults and
state of the sources.
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
"""No fork: this process may have threads, and a worker must start like a new program."""
FLYING = "flying"
"""Subfolder of the store with a run folder for each flight in progress"""
_MEASURED_BY = ("studies/codesign/flights.py", "studies/codesign/measures.py")


class CodesignTask(Struct, frozen=True, kw_only=True):
    """A flight to be flown by a worker."""

    case: str
    seed: int
    digest: str
    state: str
    """State of the sources"""
    plan_s: float
    """Planned time in formation"""
    scenario: Scenario
    faults: tuple[AnyFault, ...]
    """Injected when the formation is reached"""
    gains: bool
    folder: str
    """Run folder during the flight"""


class CodesignFlown(Struct, frozen=True, kw_only=True):
    """A finished flight: its measures, or the reason why there are none."""

    case: str
    seed: int
    digest: str
    measures: Measures | None = None
    broken: str | None = None
    """Reason, one line"""
    state: str = ""
    """State of the sources; set by the campaign, like the next field"""
    plan_s: float | None = None
    """Planned time in formation, which determines the times of outage and bias"""


class CodesignStore:
    """Flights in ``flights.jsonl`` of a folder, which is created."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / "flights.jsonl"
        folder.mkdir(parents=True, exist_ok=True)

    def append(self, flown: CodesignFlown) -> None:
        """Append a flight."""
        with self.path.open("ab") as file:
            if file.seek(0, 2) and not self._ends_a_line():
                file.write(b"\n")
            file.write(msgspec.json.encode(flown) + b"\n")

    def flights(self) -> list[CodesignFlown]:
        """Return all flights, oldest first; incomplete lines of a killed campaign are skipped."""
        flights = []
        if self.path.exists():
            for line in self.path.read_bytes().splitlines():
                try:
                    flights.append(msgspec.json.decode(line, type=CodesignFlown))
                except msgspec.DecodeError:  # incomplete, or of an older layout, whose digest differs anyway
                    continue
        return flights

    def alone(self) -> AbstractContextManager[None]:
        """Lock the folder for one campaign. Raises CampaignError if another one holds the lock."""
        return alone(self.folder)

    def _ends_a_line(self) -> bool:
        with self.path.open("rb") as file:
            file.seek(-1, 2)
            return file.read(1) == b"\n"


@cache
def sources_state(root: Path = ROOT) -> str:
    """Return the hash of the sources that determine a flight and its measures."""
    return hash_sources(root, measured_by=_MEASURED_BY)


def make_tasks(
    cases: Iterable[CodesignCase], plan: CodesignPlan, *, folder: Path, state: str | None = None
) -> list[CodesignTask]:
    """Return all flights of the cases without duplicates, seed by seed; those marked ``last`` come last.

    ``state`` is the state of the sources, by default the current one.
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
    """Return the stored flights of the tasks by case and seed, the latest of each.

    ``stale`` accepts flights of other states of the sources if there is none of the current one and the plan
    is the same.
    """
    required = {(task.case, task.seed): task for task in tasks}
    found: dict[tuple[str, int], CodesignFlown] = {}
    for flown in store.flights():
        key = (flown.case, flown.seed)
        if (task := required.get(key)) is None:
            continue
        if flown.digest == task.digest:  # the digest implies state and plan, which old lines lack
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
    """Fly all tasks in worker processes; each flight is stored before ``done`` is called with it.

    ``fly`` is a function at module level. If a worker dies, each flight in progress is repeated by itself; if
    it ends its worker again, it is recorded as broken. Raises CampaignError if a worker finds sources that
    differ from those of the tasks.
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
    """Return the record of a flight without measures."""
    return CodesignFlown(case=task.case, seed=task.seed, digest=task.digest, broken=reason)


def _fly_while_whole(
    waiting: deque[CodesignTask],
    fly: Callable[[CodesignTask], CodesignFlown],
    workers: int,
    finish: Callable[[CodesignTask, CodesignFlown], None],
) -> list[CodesignTask]:
    """Fly the waiting tasks and remove them; return those in progress if a worker died, else none."""
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


def _begin(fly: Callable[[CodesignTask], CodesignFlown]) -> None:  # noqa: ARG001  passed so that its module is imported
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C reaches all processes; only the parent reports it
    sources_state()  # cached: the state of the sources that were just imported


def _fly_of_state(fly: Callable[[CodesignTask], CodesignFlown], task: CodesignTask) -> CodesignFlown:
    if sources_state()[: len(task.state)] != task.state:
        raise CampaignError("the sources changed after the campaign started; start it again")
    return fly(task)
