"""One seed flown twice, beside attacks and without, and what differs. An I/O module."""

import contextlib
import json
import math
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow.parquet as pq
from msgspec import Struct

from harness.launch.run_messages import SwarmError
from harness.launch.swarm import Swarm
from harness.launch.swarm_settings import Ports
from harness.scenario.packaged import find
from studies.attacks.launch import AttackError, AttackProcess
from studies.attacks.tasks import Report, Task
from studies.common.report import Check
from studies.soak.measure import measure

AGENTS, SEED = 3, 5
ROW = ("formation.rows=1", f"formation.columns={AGENTS}")
BEGIN_S = 1.0
"""Simulated time at which attacks begin."""
SLICE_S = 0.5
"""Simulated time between two measurements of memory."""
PACE = 1.0
"""Simulated over wall time while an attack lasts, so that a long one does not need a longer flight."""
ATTACK_LIMIT_S = 3_600.0
"""Wall time within which attacks that end by themselves have ended."""
MOST_MB = 30.0
"""Private memory that an attack may add to a process: buffers of its connections."""
LAUNCHER = "launcher"
TABLE = "flight.parquet"


class Attack(Struct, frozen=True, kw_only=True):
    """A task and the user that performs it; ``lasts``: it ends with the flight, not by itself."""

    task: Task
    is_other: bool = False
    lasts: bool = False


class ComparedFlight(Struct, frozen=True, kw_only=True):
    """One flight."""

    simulated_s: float
    log_sha256: str
    status: str
    causes: list[str]
    """Why it is not deterministic, as the manifest says"""
    grown_mb: dict[str, float]
    """Largest growth of each process's private memory since `BEGIN_S`: the launcher has flown before"""
    unknown: list[str]
    """Columns of the flight's table that have not-a-number or infinite values"""
    details: dict[str, Any]
    """Of each process, from the manifest"""
    reports: list[Report] = []


class Comparison(Struct, frozen=True, kw_only=True):
    """An attacked flight and the same without; ``error`` if the attacked one failed."""

    title: str
    attacked: ComparedFlight | None
    plain: ComparedFlight | None
    error: str = ""
    may_influence: bool = False
    """Whether the attack is permitted to change the flight, which the manifest then has to name"""


Prepare = Callable[[Swarm], Sequence[Attack]]


def compare(
    title: str,
    prepare: Prepare,
    *,
    overrides: Sequence[str] = (),
    before: Sequence[Attack] = (),
    least_s: float,
    ports: Ports = "free",
    may_influence: bool = False,
) -> Comparison:
    """Fly beside attacks, then without, for the same simulated time.

    ``prepare`` returns the attacks on a swarm that flies; those of ``before`` begin before its start.
    Raises AttackError, also for an attack that does not end in time, and SwarmError for the flight without
    attacks.
    """
    try:
        attacked = _fly(prepare, overrides, before=before, least_s=least_s, ports=ports)
    except SwarmError as error:
        return Comparison(
            title=title, attacked=None, plain=None, error=str(error), may_influence=may_influence
        )
    plain = _fly(lambda _: (), overrides, until_s=attacked.simulated_s, ports=ports)
    return Comparison(title=title, attacked=attacked, plain=plain, may_influence=may_influence)


def _fly(
    prepare: Prepare,
    overrides: Sequence[str],
    *,
    before: Sequence[Attack] = (),
    least_s: float = 0.0,
    until_s: float = 0.0,
    ports: Ports,
) -> ComparedFlight:
    """Fly until ``until_s``, or until all attacks have ended and ``least_s`` after their begin."""
    with contextlib.ExitStack() as stack, tempfile.TemporaryDirectory(prefix="coflight-attacks-") as folder:
        early = [(attack, stack.enter_context(_begun(attack))) for attack in before]
        swarm = Swarm(
            find("article"),
            agents=AGENTS,
            seed=SEED,
            overrides=[*ROW, *overrides],
            out=Path(folder) / "run",
            ports=ports,
        )
        with swarm:
            swarm.run(until_s=BEGIN_S)
            begin_mb = _memory_mb(swarm)
            grown_mb = dict.fromkeys(begin_mb, 0.0)
            begun = [*early, *((each, stack.enter_context(_begun(each))) for each in prepare(swarm))]
            if begun:
                swarm.set_speed(PACE)
            until_s = max(until_s, BEGIN_S + least_s)
            wall_end_s = time.monotonic() + ATTACK_LIMIT_S
            while swarm.truth.t_s < until_s or _are_running(begun):
                if time.monotonic() > wall_end_s and _are_running(begun):
                    raise AttackError(f"an attack does not end within {ATTACK_LIMIT_S:g} s")
                swarm.run_for(SLICE_S)
                for name, private_mb in _memory_mb(swarm).items():
                    growth_mb = private_mb - begin_mb.get(name, 0.0)
                    grown_mb[name] = max(growth_mb, grown_mb.get(name, 0.0))
            reports = [process.report() for _, process in begun]
            simulated_s = swarm.truth.t_s
        summary = swarm.summary(draw=False)
        manifest = json.loads((swarm.path / "manifest.json").read_text(encoding="utf-8"))
        return ComparedFlight(
            simulated_s=simulated_s,
            log_sha256=summary["log_sha256"],
            status=summary["status"],
            causes=manifest["nondeterminism"],
            grown_mb=grown_mb,
            unknown=unknown_columns(swarm.path / TABLE),
            details={each["name"]: each["details"] for each in manifest["processes"]},
            reports=reports,
        )


def _begun(attack: Attack) -> AttackProcess:
    return AttackProcess(attack.task, is_other=attack.is_other)


def _are_running(begun: Sequence[tuple[Attack, AttackProcess]]) -> bool:
    return any(process.is_running for attack, process in begun if not attack.lasts)


def _memory_mb(swarm: Swarm) -> dict[str, float]:
    """Return the private memory of the run's processes that live, MB."""
    found = {}
    for name, pid in {LAUNCHER: os.getpid(), **swarm.pids}.items():
        with contextlib.suppress(psutil.NoSuchProcess):
            found[name] = measure(pid).private_mb
    return found


def unknown_columns(path: Path) -> list[str]:
    """Return the columns of a table that have a value which is not finite."""
    table = pq.read_table(path)
    unknown = []
    for name in table.column_names:
        values = table.column(name).to_numpy()
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            unknown.append(name)
    return unknown


def checks(comparison: Comparison) -> tuple[Check, ...]:
    """Return the requirements on a comparison."""
    title, attacked, plain = comparison.title, comparison.attacked, comparison.plain
    if attacked is None or plain is None:
        return (Check(f"{title}: flights that ended early", 1.0, at_most=0.0),)
    differs = attacked.log_sha256 != plain.log_sha256
    common = (
        Check(f"{title}: flights that ended early", int(attacked.status != plain.status), at_most=0.0),
        Check(
            f"{title}: logs that differ without a named cause",
            int(differs and not attacked.causes),
            at_most=0.0,
        ),
        Check(
            f"{title}: memory that the attack adds to a process",
            added_mb(comparison)[1],
            "MB",
            at_most=MOST_MB,
        ),
        Check(f"{title}: findings", sum(len(each.found) for each in attacked.reports), at_most=0.0),
    )
    if comparison.may_influence:
        new = set(attacked.unknown) - set(plain.unknown)
        return (*common, Check(f"{title}: columns that are no longer finite", len(new), at_most=0.0))
    return (*common, Check(f"{title}: named influences", len(attacked.causes), at_most=0.0))


def added_mb(comparison: Comparison) -> tuple[str, float]:
    """Return the process whose growth differs most from that without the attack, and by how much."""
    if comparison.attacked is None or comparison.plain is None:
        return "", math.nan
    added = {
        name: mb - comparison.plain.grown_mb.get(name, 0.0)
        for name, mb in comparison.attacked.grown_mb.items()
    }
    return max(added.items(), key=lambda item: item[1])


def row(comparison: Comparison) -> tuple[str, ...]:
    """Return a comparison as a row: title, simulated time, what was sent, hash, named causes, memory."""
    if comparison.attacked is None or comparison.plain is None:
        return comparison.title, "", "", "", comparison.error, ""
    sent = [
        f"{value:,} {name}" for each in comparison.attacked.reports for name, value in each.counts.items()
    ]
    found = [text for each in comparison.attacked.reports for text in each.found]
    equal = "equal" if comparison.attacked.log_sha256 == comparison.plain.log_sha256 else "other"
    process, mb = added_mb(comparison)
    causes = "; ".join([*comparison.attacked.causes, *found]) or "none"
    return (
        comparison.title,
        f"{comparison.attacked.simulated_s:.1f}",
        ", ".join(sent),
        equal,
        causes,
        f"{mb:+.1f} ({process})",
    )


COLUMNS = ("attack", "simulated, s", "sent", "logs", "named in the manifest", "memory, MB")
