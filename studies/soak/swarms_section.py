"""Many swarms in one process: it keeps nothing of those that have ended."""

import os
import tempfile
from functools import partial
from pathlib import Path

import psutil
from msgspec import Struct

from harness.launch.swarm import Swarm
from harness.scenario.packaged import find
from studies.common.report import Check, Section
from studies.common.runner import Job, Results
from studies.soak.growth import slope
from studies.soak.measure import Measured, measure
from studies.soak.plan import SoakPlan

MOST_MB_PER_HUNDRED = 0.5
AGENTS = 2
FLOWN_S = 0.2
_GROUP = "swarms"
_MARK = "coflight-"
"""Beginning of the names of temporary run folders"""


class ManySwarms(Struct, frozen=True, kw_only=True):
    """The process after each swarm, and what was left after the last."""

    measured: list[Measured]
    left_processes: int
    left_folders: int


def jobs(plan: SoakPlan) -> dict[str, list[Job]]:
    """Return the one process that starts all swarms."""
    return {_GROUP: [partial(start_many, plan.swarms)]}


def start_many(count: int) -> ManySwarms:
    """Start, fly and end swarms, one after the other. Raises SwarmError."""
    before, others = set(_folders()), set(_children())
    measured = []
    for seed in range(1, count + 1):
        with Swarm(find("article"), agents=AGENTS, seed=seed) as swarm:
            swarm.run(until_s=FLOWN_S)
        del swarm  # with its temporary folder
        measured.append(measure(os.getpid()))
    return ManySwarms(
        measured=measured,
        left_processes=len(set(_children()) - others),
        left_folders=len(set(_folders()) - before),
    )


def _children() -> list[psutil.Process]:
    return psutil.Process().children(recursive=True)


def _folders() -> list[Path]:
    return list(Path(tempfile.gettempdir()).glob(f"{_MARK}*"))


def judge(plan: SoakPlan, results: Results) -> Section:
    """Compare the growth of the process, and what it has left, with their limits."""
    (many,) = results[_GROUP]
    hundreds = [number / 100.0 for number in range(len(many.measured))]

    def grown(name: str) -> float:
        return slope(hundreds, [getattr(each, name) for each in many.measured])

    first_mb, last_mb = many.measured[0].private_mb, many.measured[-1].private_mb
    return Section(
        title="Many swarms in one process",
        conditions=(
            f"{plan.swarms} swarms of {AGENTS} UAVs, each started, flown for {FLOWN_S:g} s and ended by one "
            f"process. It has {first_mb:.0f} MB after the first and {last_mb:.0f} MB after the last.\n"
        ),
        checks=(
            Check("private memory", grown("private_mb"), "MB per 100 swarms", at_most=MOST_MB_PER_HUNDRED),
            Check("descriptors", grown("descriptors"), "per 100 swarms", at_most=0.0),
            Check("threads", grown("threads"), "per 100 swarms", at_most=0.0),
            Check("processes left", many.left_processes, at_most=0.0),
            Check("temporary folders left", many.left_folders, at_most=0.0),
        ),
    )
