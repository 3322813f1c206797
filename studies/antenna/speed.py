"""Time of a pattern by both solvers: the benchmark of `antenna.lab`, and its requirements."""

import math
import os
from functools import partial
from typing import Any

import msgspec

from antenna.solvers.interface import BackendUnavailable
from studies.antenna.checks import said_missing
from studies.antenna.plan import AntennaPlan
from studies.common.report import Check, ReportTable, Section
from studies.common.runner import Job, Results

LEAST = {"speedup_short_dipole": 200.0, "speedup_5m_dipole": 40.0, "speedup_two_cores": 1.7}
"""Smallest allowed values of fields of the benchmark."""


def jobs(plan: AntennaPlan) -> dict[str, list[Job]]:
    """Return one job, because nothing else may run at the same time."""
    return {"benchmark": [partial(measure, plan.benchmark_s)]}


def measure(seconds: float) -> dict[str, Any] | None:
    """Return the fields of the benchmark; None without PyNEC."""
    from antenna.lab.benchmark import benchmark  # noqa: PLC0415  compiles kernels

    try:
        fields: dict[str, Any] = msgspec.to_builtins(benchmark(seconds), str_keys=True)
    except BackendUnavailable:
        return None
    return fields


def judge(plan: AntennaPlan, results: Results) -> Section:  # common signature
    """Check three fields, and list all."""
    (fields,) = results["benchmark"]
    cores = len(os.sched_getaffinity(0))
    return Section(
        title="Speed",
        conditions=(
            f"`antenna_lab.py benchmark --seconds {plan.benchmark_s:g}`, without other parts of this "
            f"validation running, on {cores} core{'s' if cores > 1 else ''}: both solvers compute the "
            "patterns of the same random formations of eight dipoles on a grid of 5 degrees with a refined "
            "maximum, in turn, on one core each; then the batch solver runs with two threads, measured in "
            "wall time. docs/concepts/antenna.md describes the fields.\n"
            + said_missing([] if fields is not None else ["nec2 (PyNEC), which all comparisons require"])
        ),
        checks=() if fields is None else requirements(fields),
        tables=() if fields is None else (
            ReportTable(
                caption="All fields:", columns=("field", "value"), rows=tuple(flat(fields))
            ),
        ),
    )  # fmt: skip


def requirements(fields: dict[str, Any]) -> tuple[Check, ...]:
    """Return the checks of the required speed-ups; a missing field fails."""
    return tuple(
        Check(name, float(fields.get(name, math.nan)), at_least=least) for name, least in LEAST.items()
    )


def flat(fields: dict[str, Any], under: str = "") -> list[tuple[str, str]]:
    """Return names and values of a nested dict, one row each."""
    rows = []
    for name, value in fields.items():
        if isinstance(value, dict):
            rows += flat(value, f"{under}{name}.")
        else:
            rows.append((under + name, f"{value:.5g}" if isinstance(value, float) else str(value)))
    return rows
