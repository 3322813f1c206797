"""What a part of the antenna's validation found: numbers with what is asked of them, tables, figures.

How a page is made of them, and what is printed, is the program's that asks.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

from msgspec import Struct

from antenna.backend import Backend, BackendUnavailable, make_backend
from antenna.config import AntennaConfig

Job = tuple[Callable[[Any], Any], Any]
"""A function of a module, for it goes to another process, and its argument."""
Results = dict[str, list[Any]]
"""What the jobs of each group gave, in their order."""


class Finding(Struct, frozen=True, kw_only=True):
    """One number and its bounds, inclusive; None is no bound."""

    name: str
    value: float
    unit: str
    at_least: float | None = None
    at_most: float | None = None


class Listing(Struct, frozen=True, kw_only=True):
    """A table of numbers that explain the findings."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


class Chapter(Struct, frozen=True, kw_only=True):
    """One subject."""

    title: str
    conditions: str
    """How it was measured: Markdown paragraphs."""
    findings: tuple[Finding, ...]
    listings: tuple[Listing, ...] = ()
    figures: tuple[tuple[str, str], ...] = ()
    """(file name, what it shows)"""


def deviation(name: str, value: float, expected: float, tolerance: float, unit: str) -> Finding:
    """How far a value is from the expected one, and may be either way."""
    return difference(f"{name}, less {expected:.5g}", value - expected, tolerance, unit)


def difference(name: str, value: float, tolerance: float, unit: str) -> Finding:
    """Give a number that would be 0."""
    return Finding(name=name, value=value, unit=unit, at_least=-tolerance, at_most=tolerance)


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
