"""One seed, many flights under random load: the logs are the same, byte for byte."""

from collections import Counter
from functools import partial

import numpy as np
from msgspec import Struct

from harness.launch.swarm import Swarm
from harness.scenario.packaged import find
from studies.common.report import Check, ReportTable, Section, filled
from studies.common.runner import Job, Results
from studies.soak.load import random_load
from studies.soak.plan import SoakPlan

AGENTS, SEED = 4, 7
_SQUARE = ("formation.rows=2", "formation.columns=2")
_GROUP = "repeats"


class Repeat(Struct, frozen=True, kw_only=True):
    """Hash of one flight's logs, and the load beside it."""

    log_sha256: str
    deterministic: bool
    load: str


def jobs(plan: SoakPlan) -> dict[str, list[Job]]:
    """Return the flights."""
    return {_GROUP: [partial(fly, plan.repeat_s, number) for number in range(plan.repeats)]}


def fly(duration_s: float, number: int) -> Repeat:
    """Fly the seed beside the load of a number. Raises SwarmError."""
    with random_load(np.random.default_rng(number)) as load:
        with Swarm(find("article"), agents=AGENTS, seed=SEED, overrides=_SQUARE) as swarm:
            swarm.run(until_s=duration_s)
        summary = swarm.summary(draw=False)
    return Repeat(log_sha256=summary["log_sha256"], deterministic=summary["deterministic"], load=load)


def judge(plan: SoakPlan, results: Results) -> Section:
    """Count the different hashes."""
    repeats: list[Repeat] = results[_GROUP]
    loads = Counter(each.load for each in repeats)
    return Section(
        title="One seed under random load",
        conditions=filled(
            f"{len(repeats)} flights of {AGENTS} UAVs for {plan.repeat_s:g} s, two at a time, each beside "
            "up to three processes that compute or change 200 MB of memory, at random priorities."
        )
        + "\n",
        checks=(
            Check("different hashes", len({each.log_sha256 for each in repeats}), at_most=1.0),
            Check(
                "flights that depended on the machine",
                sum(not each.deterministic for each in repeats),
                at_most=0.0,
            ),
        ),
        tables=(
            ReportTable(
                caption="Flights by load.",
                columns=("load", "flights"),
                rows=tuple((load, str(count)) for load, count in sorted(loads.items())),
            ),
        ),
    )
