"""What a pattern costs by both solvers: the laboratory's benchmark, as it is, and what is asked of it."""

import math
import os
from pathlib import Path
from typing import Any

import msgspec

from antenna.solvers.interface import BackendUnavailable
from studies.antenna.checks import said_missing
from studies.antenna.plan import AntennaPlan
from studies.common.report import Check, ReportTable, Section
from studies.common.runner import Job, Results

LEAST = {"speedup_short_dipole": 200.0, "speedup_5m_dipole": 40.0, "speedup_two_cores": 1.7}
"""Asked of fields of the benchmark."""


def jobs(plan: AntennaPlan) -> dict[str, list[Job]]:
    """One: nothing else may run beside it."""
    return {"benchmark": [(measure, plan.benchmark_s)]}


def measure(seconds: float) -> dict[str, Any] | None:
    """Give the benchmark's fields; None without PyNEC."""
    from antenna.lab.benchmark import benchmark  # noqa: PLC0415  compiles

    try:
        fields: dict[str, Any] = msgspec.to_builtins(benchmark(seconds), str_keys=True)
    except BackendUnavailable:
        return None
    return fields


def judge(plan: AntennaPlan, results: Results, images: Path | None) -> Section:  # noqa: ARG001  # common signature
    """Bound three of its numbers, and list all."""
    (fields,) = results["benchmark"]
    cores = len(os.sched_getaffinity(0))
    return Section(
        title="Speed",
        conditions=(
            f"`antenna_lab.py benchmark --seconds {plan.benchmark_s:g}`, with nothing else of this "
            f"validation beside it, on {cores} core{'s' if cores > 1 else ''}: both solvers make the "
            "patterns of the same random formations of eight dipoles on a grid of 5 degrees with a refined "
            "maximum, in turns, one core each; the batch solver then with two threads by the clock on the "
            "wall. docs/antenna.md says what is counted.\n"
            + said_missing([] if fields is not None else ["nec2 (PyNEC), without which nothing is compared"])
        ),
        checks=() if fields is None else requirements(fields),
        tables=() if fields is None else (
            ReportTable(
                caption="All that it measured:", columns=("field", "value"), rows=tuple(flat(fields))
            ),
        ),
    )  # fmt: skip


def requirements(fields: dict[str, Any]) -> tuple[Check, ...]:
    """Speed-ups that are asked for; one that the benchmark does not have is not met."""
    return tuple(
        Check(name=name, value=float(fields.get(name, math.nan)), unit="", at_least=least)
        for name, least in LEAST.items()
    )


def flat(fields: dict[str, Any], under: str = "") -> list[tuple[str, str]]:
    """Names and values of a nested dict, one line each."""
    rows = []
    for name, value in fields.items():
        if isinstance(value, dict):
            rows += flat(value, f"{under}{name}.")
        else:
            rows.append((under + name, f"{value:.5g}" if isinstance(value, float) else str(value)))
    return rows
