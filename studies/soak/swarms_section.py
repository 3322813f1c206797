"""Many swarms in one process: it keeps nothing of those that have ended."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import psutil
from msgspec import Struct

from harness.launch.swarm import Swarm
from harness.scenario.packaged import find
from studies.common.report import Check, Section, filled
from studies.common.runner import Job, Results
from studies.soak.growth import slope
from studies.soak.measure import Measured, measure
from studies.soak.plan import SoakPlan

LEAST_SWARMS = 100
"""Number of swarms from which the memory is judged"""
MOST_MB_PER_HUNDRED = 0.5
AGENTS = 2
FLOWN_S = 0.2
_GROUP = "swarms"
_FOLDERS = ("TMPDIR", "XDG_RUNTIME_DIR")


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
    others = set(_children())
    measured = []
    with _own_temporary_folder() as folder:
        for seed in range(1, count + 1):
            with Swarm(find("article"), agents=AGENTS, seed=seed) as swarm:
                swarm.run(until_s=FLOWN_S)
            del swarm  # with its temporary folder
            measured.append(measure(os.getpid()))
        return ManySwarms(
            measured=measured,
            left_processes=len(set(_children()) - others),
            left_folders=sum(path.is_dir() for path in folder.iterdir()),
        )


def _children() -> list[psutil.Process]:
    return [*psutil.Process().children(recursive=True)]


@contextlib.contextmanager
def _own_temporary_folder() -> Iterator[Path]:
    """Give this process and its children a folder of their own for temporary files and sockets."""
    before, before_folder = {name: os.environ.get(name) for name in _FOLDERS}, tempfile.tempdir
    with tempfile.TemporaryDirectory(prefix="coflight-soak-") as folder:
        os.environ.update(dict.fromkeys(_FOLDERS, folder))
        tempfile.tempdir = folder
        try:
            yield Path(folder)
        finally:
            tempfile.tempdir = before_folder
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def judge(plan: SoakPlan, results: Results) -> Section:
    """Compare the growth of the process, and what it has left, with their limits."""
    (many,) = results[_GROUP]
    hundreds = [number / 100.0 for number in range(len(many.measured))]

    def grown(name: str) -> float:
        return slope(hundreds, [getattr(each, name) for each in many.measured])

    memory = []
    if len(many.measured) >= LEAST_SWARMS:
        growth_mb = grown("private_mb")
        memory.append(Check("private memory", growth_mb, "MB per 100 swarms", at_most=MOST_MB_PER_HUNDRED))
    first_mb, last_mb = many.measured[0].private_mb, many.measured[-1].private_mb
    return Section(
        title="Many swarms in one process",
        conditions=filled(
            f"{plan.swarms} swarms of {AGENTS} UAVs, each started, flown for {FLOWN_S:g} s and ended by one "
            f"process. It has {first_mb:.0f} MB after the first and {last_mb:.0f} MB after the last."
        )
        + "\n",
        checks=(
            *memory,
            Check("descriptors", grown("descriptors"), "per 100 swarms", at_most=0.0),
            Check("threads", grown("threads"), "per 100 swarms", at_most=0.0),
            Check("processes left", many.left_processes, at_most=0.0),
            Check("temporary folders left", many.left_folders, at_most=0.0),
        ),
    )
