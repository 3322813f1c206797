"""What the antenna's subjects share: checks against an expected value, and solvers that may not be there."""

import math
from collections.abc import Iterable

from antenna.model.config import AntennaConfig
from antenna.solvers.interface import Backend, BackendUnavailable
from antenna.solvers.selection import make_backend
from studies.common.report import Check


def deviation(name: str, value: float, expected: float, tolerance: float, unit: str) -> Check:
    """How far a value is from the expected one, and may be either way."""
    return difference(f"{name}, less {expected:.5g}", value - expected, tolerance, unit)


def difference(name: str, value: float, tolerance: float, unit: str) -> Check:
    """Give a number that would be 0."""
    return Check(name=name, value=value, unit=unit, at_least=-tolerance, at_most=tolerance)


def worst(values: Iterable[float]) -> float:
    """The one farthest from 0; not-a-number if one is, or there are none, so that no requirement is met."""
    numbers = list(values)
    if not numbers or any(math.isnan(value) for value in numbers):
        return math.nan
    return max(numbers, key=abs)


def witness(config: AntennaConfig) -> Backend | None:
    """The solver that ``config`` names, None where what it needs is not installed."""
    try:
        return make_backend(config)
    except BackendUnavailable:
        return None


def said_missing(names: Iterable[str]) -> str:
    """Paragraph about witnesses that were not there; empty if all were."""
    absent = sorted(set(names))
    if not absent:
        return ""
    return f"\n**Not installed here, so without a row: {', '.join(absent)}.**\n"


def row(*cells: object) -> tuple[str, ...]:
    """Cells as text: decibels and other reals with four decimals, None as nothing."""
    return tuple(
        "" if cell is None else f"{cell:.4f}" if isinstance(cell, float) else str(cell) for cell in cells
    )
