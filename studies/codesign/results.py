"""Flights of the experiment as runs of a campaign, and their stored results.

A stored flight is valid while its digest equals that of the flight with the current scenario, faults and
state of the sources.
"""

import hashlib
from collections.abc import Iterable, Sequence

import msgspec
from msgspec import Struct

from harness.campaign.definition import Campaign, Run
from harness.campaign.store import Flown, Flying, Store
from harness.campaign.worker import sources_state
from studies.codesign.cases import ARTICLE, CodesignCase, CodesignPlan
from studies.codesign.measures import Measures

FLYING = Flying("studies.codesign.measures:fly", ("studies/codesign/measures.py",))


class CodesignFlown(Struct, frozen=True, kw_only=True):
    """A finished flight: its measures, or the reason why there are none."""

    case: str
    seed: int
    digest: str
    measures: Measures | None = None
    broken: str | None = None
    """Reason, one line"""
    state: str = ""
    """State of the sources"""


def campaign(plan: CodesignPlan) -> Campaign:
    """Return the campaign of `make_runs`."""
    return Campaign(name="codesign", scenario=ARTICLE, seeds=tuple(range(1, plan.seeds + 1)))


def state() -> str:
    """Return the hash of the sources that determine a flight and its measures, as of the first call."""
    return sources_state(FLYING.measured_by)


def make_runs(cases: Iterable[CodesignCase], plan: CodesignPlan, *, of_state: str) -> list[Run]:
    """Return all flights of the cases without duplicates, seed by seed; those marked ``last`` come last."""
    distinct = {case.name: case for case in cases}
    runs = []
    flights = [(case, seed) for seed in range(1, plan.seeds + 1) for case in distinct.values()]
    for case, seed in sorted(flights, key=lambda flight: flight[0].last):
        scenario = case.scenario(plan, seed)
        content = msgspec.json.encode((of_state, scenario, case.faults, case.gains))
        runs.append(
            Run(
                case=case.name, swept=(), seed=seed, settings=case.settings(plan), scenario=scenario,
                digest=hashlib.sha256(content).hexdigest()[:16],
                options={"faults": case.faults, "gains": case.gains},
            )
        )  # fmt: skip
    return runs


def known(
    runs: Sequence[Run], store: Store, *, stale: bool = False, retry: bool = False
) -> dict[tuple[str, int], CodesignFlown]:
    """Return the stored flights of the runs by case and seed.

    ``stale`` accepts flights of other states of the sources if there is none of the current one and the
    settings are the same. ``retry`` skips flights without measures.
    """
    found = {(run.case, run.seed): _read(run, flown) for run in runs if (flown := store.get(run.digest))}
    if retry:
        found = {key: flown for key, flown in found.items() if flown.measures is not None}
    if stale:
        missing = {(run.case, run.seed): run for run in runs if (run.case, run.seed) not in found}
        for flown in store.flights():
            run = missing.get((flown.summary.get("scenario", ""), flown.summary.get("seed", 0)))
            if run is not None and flown.settings == run.settings:
                found[run.case, run.seed] = _read(run, flown)
    return found


def _read(run: Run, flown: Flown) -> CodesignFlown:
    measures = flown.summary.get("measures")
    return CodesignFlown(
        case=run.case, seed=run.seed, digest=flown.digest,
        measures=None if measures is None else msgspec.convert(measures, Measures),
        broken=flown.reason if measures is None else None, state=flown.state,
    )  # fmt: skip
