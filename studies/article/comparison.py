"""How well numbers of a few flights are known: standard errors over flights, in pairs of one seed.

Flights of one seed fly in the same wind with the same errors of GPS, so what differs between two cells is
taken over the seeds that both have, and every estimate leaves out one seed at a time, of all cells at once.
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from msgspec import Struct

from studies.article.campaign_data import Cell, OneFlight

TOLD_APART = 2.0
"""Standard errors by which a number has to differ from its bound."""


class ComparedEstimate(Struct, frozen=True, kw_only=True):
    """A number of several flights."""

    value: float
    error: float | None
    """Standard error; None of a single flight."""
    flights: int
    """Seeds that went into it."""

    def text(self, digits: int = 3, unit: str = "") -> str:
        """Give it with its standard error, if that is known."""
        error = "" if self.error is None else f" ± {self.error:.{digits}f}"
        return f"{self.value:.{digits}f}{error}{unit}"

    @property
    def positive(self) -> bool | None:
        """Whether it is above 0; None if that cannot be told."""
        if self.error is None or abs(self.value) <= TOLD_APART * self.error:
            return None
        return self.value > 0.0


def jackknife(seeds: Sequence[int], measure: Callable[[Sequence[int]], float]) -> ComparedEstimate:
    """Estimate what ``measure`` gives of seeds, with the standard error of Quenouille and Tukey's jackknife.

    Of a mean over seeds it is the usual one, s / sqrt(n).
    """
    value, n = measure(seeds), len(seeds)
    if n < 2:
        return ComparedEstimate(value=value, error=None, flights=n)
    parts = [measure([*seeds[:k], *seeds[k + 1 :]]) for k in range(n)]
    if not all(map(math.isfinite, parts)):  # densities of gains that are all alike
        alike = all(part == value for part in parts)
        return ComparedEstimate(value=value, error=0.0 if alike else None, flights=n)
    mean = math.fsum(parts) / n
    square = (n - 1) / n * math.fsum((part - mean) ** 2 for part in parts)
    return ComparedEstimate(value=value, error=math.sqrt(square), flights=n)


def common_seeds(cells: Sequence[Cell], known: Callable[[OneFlight], bool]) -> list[int]:
    """Seeds of which every cell has a flight whose number is ``known``, rising."""
    seeds = [{flight.seed for flight in cell.runs if known(flight)} for cell in cells]
    return sorted(set.intersection(*seeds)) if seeds else []


def holds(margins: Iterable[ComparedEstimate]) -> bool | None:
    """Whether all are above 0: no as soon as one is told below it, else None if one cannot be told."""
    found = [each.positive for each in margins]
    if False in found:
        return False
    return None if None in found else True


# ---- numbers of a cell whose flights all have them


def has_gains(flight: OneFlight) -> bool:
    """Whether an instant of it has a pattern."""
    return len(flight.max_gain_dbi) > 0


def has_shape(flight: OneFlight) -> bool:
    """Whether it was in formation."""
    return flight.shape_horizontal_m is not None


def mean_dbi(cell: Cell) -> float:
    """Mean of its flights' mean maximum gains."""
    return float(np.mean([flight.max_gain_dbi.mean() for flight in cell.runs]))


def std_db(cell: Cell) -> float:
    """Deviation of the maximum gain over all instants."""
    found = cell.statistics
    return math.nan if found is None else found.std_db


def peak_per_db(cell: Cell) -> float:
    """Highest density of the maximum gain."""
    return math.nan if cell.peak_per_db is None else cell.peak_per_db


def shape_m(cell: Cell) -> float:
    """Horizontal shape error, rms over the flights."""
    return math.nan if cell.shape_horizontal_m is None else cell.shape_horizontal_m
