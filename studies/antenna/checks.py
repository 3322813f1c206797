"""Shared parts of the antenna's subjects: checks against an expected value, optional solvers."""

import math
from collections.abc import Iterable

from antenna.analysis.patterns import Pattern
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTouch, Snapshot
from antenna.solvers.interface import Backend, BackendUnavailable
from antenna.solvers.selection import make_backend
from studies.common.report import Check


def deviation(name: str, value: float, expected: float, tolerance: float, unit: str) -> Check:
    """Return a check of the deviation of a value from the expected one, in either direction."""
    return difference(f"{name}, less {expected:.5g}", value - expected, tolerance, unit)


def difference(name: str, value: float, tolerance: float, unit: str) -> Check:
    """Return a check of a value whose expected value is 0."""
    return Check(name, value, unit, at_least=-tolerance, at_most=tolerance)


def worst(values: Iterable[float]) -> float:
    """Return the value with the largest magnitude; NaN, which fails checks, if one is NaN or none exists."""
    numbers = list(values)
    if not numbers or any(math.isnan(value) for value in numbers):
        return math.nan
    return max(numbers, key=abs)


def witness(config: AntennaConfig) -> Backend | None:
    """Return the solver that ``config`` selects, None if it is not installed."""
    try:
        return make_backend(config)
    except BackendUnavailable:
        return None


def solve(snapshot: Snapshot, config: AntennaConfig) -> Pattern | ElementsTouch | None:
    """Solve one array; None if the solver is not installed."""
    solver = witness(config)
    return None if solver is None else solver.patterns([snapshot])[0]


def said_missing(names: Iterable[str]) -> str:
    """Return a paragraph with the missing solvers; empty if all are installed."""
    absent = sorted(set(names))
    if not absent:
        return ""
    return f"\n**Not installed, therefore without a row: {', '.join(absent)}.**\n"


def row(*cells: object) -> tuple[str, ...]:
    """Format table cells: floats with four decimals, None as an empty text."""
    return tuple(
        "" if cell is None else f"{cell:.4f}" if isinstance(cell, float) else str(cell) for cell in cells
    )
