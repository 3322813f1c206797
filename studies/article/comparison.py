"""Standard errors of estimates from a few flights, in pairs of the same seed.

Flights with the same seed have the same wind and GPS errors, so differences between two cells use the seeds
that both have, and every estimate leaves out one seed at a time in all cells.
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from msgspec import Struct

from studies.article.campaign_data import Cell, OneFlight

DECIDED_ERRORS = 2.0
"""Smallest distance of a number from its bound for a decision, in standard errors."""


class ComparedEstimate(Struct, frozen=True, kw_only=True):
    """An estimate from several flights."""

    value: float
    error: float | None
    """Standard error; None for a single flight."""
    flights: int
    """Number of seeds."""

    def text(self, digits: int = 3, unit: str = "") -> str:
        """Format the value with its standard error, if there is one."""
        error = "" if self.error is None else f" ± {self.error:.{digits}f}"
        return f"{self.value:.{digits}f}{error}{unit}"

    @property
    def positive(self) -> bool | None:
        """Whether the value is above 0; None if undecided."""
        if self.error is None or abs(self.value) <= DECIDED_ERRORS * self.error:
            return None
        return self.value > 0.0


def jackknife(seeds: Sequence[int], measure: Callable[[Sequence[int]], float]) -> ComparedEstimate:
    """Return ``measure`` of the seeds with the standard error of Quenouille and Tukey's jackknife.

    For a mean over seeds it is s / sqrt(n).
    """
    value, n = measure(seeds), len(seeds)
    if n < 2:
        return ComparedEstimate(value=value, error=None, flights=n)
    parts = [measure([*seeds[:k], *seeds[k + 1 :]]) for k in range(n)]
    if not all(map(math.isfinite, parts)):  # densities of equal gains
        alike = all(part == value for part in parts)
        return ComparedEstimate(value=value, error=0.0 if alike else None, flights=n)
    mean = math.fsum(parts) / n
    square = (n - 1) / n * math.fsum((part - mean) ** 2 for part in parts)
    return ComparedEstimate(value=value, error=math.sqrt(square), flights=n)


def common_seeds(cells: Sequence[Cell], known: Callable[[OneFlight], bool]) -> list[int]:
    """Return the sorted seeds of which every cell has a flight that meets ``known``."""
    seeds = [{flight.seed for flight in cell.runs if known(flight)} for cell in cells]
    return sorted(set.intersection(*seeds)) if seeds else []


def holds(margins: Iterable[ComparedEstimate]) -> bool | None:
    """Return whether all margins are above 0: False if one is below, else None if one is undecided."""
    found = [each.positive for each in margins]
    if False in found:
        return False
    return None if None in found else True


# ---- numbers of a cell of which every flight has them


def has_gains(flight: OneFlight) -> bool:
    """Return whether the flight has a pattern at any instant."""
    return len(flight.max_gain_dbi) > 0


def has_shape(flight: OneFlight) -> bool:
    """Return whether the flight has a shape error."""
    return flight.shape_horizontal_m is not None


def mean_dbi(cell: Cell) -> float:
    """Return the mean of the flights' mean maximum gains."""
    return float(np.mean([flight.max_gain_dbi.mean() for flight in cell.runs]))


def std_db(cell: Cell) -> float:
    """Return the deviation of the maximum gain over all instants."""
    found = cell.statistics
    return math.nan if found is None else found.std_db


def peak_per_db(cell: Cell) -> float:
    """Return the highest density of the maximum gain."""
    return math.nan if cell.peak_per_db is None else cell.peak_per_db


def shape_m(cell: Cell) -> float:
    """Return the horizontal shape error, rms over the flights."""
    return math.nan if cell.shape_horizontal_m is None else cell.shape_horizontal_m
