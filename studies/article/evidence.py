"""Evidence for the judgement of the statements."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from antenna.analysis.patterns import Pattern
from antenna.analysis.statistics import GainStatistics
from studies.article.campaign_data import Cell, Key, OneFlight
from studies.article.comparison import (
    ComparedEstimate,
    common_seeds,
    has_gains,
    has_shape,
    jackknife,
    mean_dbi,
)
from studies.article.monte_carlo import Drawn
from studies.article.patterns import PatternReading
from studies.article.plan import ARTICLE, FIGURE_WAVELENGTH_M, FIGURE_WIND_N
from studies.article.retained_flights import Separation

LONG_M = 10.0
"""Shortest wavelength at which the article calls the formation resilient."""


class Missing(Exception):
    """Evidence for a statement was not measured; the text is one line that names it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Evidence:
    """Results of the campaigns, of the retained flights, and of random formations."""

    cells: Mapping[Key, Cell]
    ideals: Mapping[str, Mapping[float, Pattern]]
    """The formation in its places, by solver and wavelength."""
    solver: str = "batch"
    """Solver of the flights."""
    frequencies_mhz: Mapping[float, float] = field(default_factory=dict)
    """By wavelength, as in the solvers' input."""
    separations: Iterable[Separation]
    patterns: Mapping[str, PatternReading]
    """See `studies.article.retained_flights.FigurePatterns.readings`; empty without a flight."""
    pattern_flights: Mapping[int, Mapping[str, PatternReading]] = field(default_factory=dict)
    """The same for all retained flights of the pattern, by seed."""
    drawn: Mapping[tuple[float, float], Drawn]
    """Random formations, by (sigma_m, wavelength_m)."""
    leaning: Mapping[float, PatternReading] = field(default_factory=dict)
    """The formation in its places with the tilt of figure 4's flight, by wind direction phi in degrees."""

    @property
    def winds_n(self) -> list[float]:
        """Sorted winds of the article's campaign; raises Missing."""
        return self._flown({wind_n for case, _, wind_n in self.cells if case == ARTICLE})

    @property
    def wavelengths_m(self) -> list[float]:
        """Sorted wavelengths of the article's campaign; raises Missing."""
        return self._flown({wavelength_m for case, wavelength_m, _ in self.cells if case == ARTICLE})

    def _flown(self, values: set[float]) -> list[float]:
        if not values:
            raise Missing("no flights")
        return sorted(values)

    @property
    def long_m(self) -> list[float]:
        """Wavelengths that the article calls resilient; raises Missing with fewer than two."""
        found = [each for each in self.wavelengths_m if each >= LONG_M]
        if len(found) < 2:
            raise Missing(f"fewer than two wavelengths of {LONG_M:g} m and more were flown")
        return found

    @property
    def calm_n(self) -> float:
        """No wind; raises Missing."""
        return self._wind(0.0, "without wind")

    @property
    def strongest_n(self) -> float:
        """The article's high wind; raises Missing."""
        return self._wind(FIGURE_WIND_N, f"in {FIGURE_WIND_N:g} N")

    def _wind(self, wind_n: float, words: str) -> float:
        if wind_n not in self.winds_n:
            raise Missing(f"no flights {words}")
        return wind_n

    def cell(self, wavelength_m: float, wind_n: float, case: str = ARTICLE) -> Cell:
        """Return a cell that has gains; raises Missing."""
        cell = self.cells.get((case, wavelength_m, wind_n))
        if cell is None or not len(cell.max_gain_dbi):
            raise Missing(f"{_named((case, wavelength_m, wind_n))}: no flight has a pattern")
        return cell

    def gains(self, wavelength_m: float, wind_n: float) -> GainStatistics:
        """Return the statistics of a cell's maximum gain; raises Missing."""
        found = self.cell(wavelength_m, wind_n).statistics
        assert found is not None  # noqa: S101  the cell has gains
        return found

    def estimate(
        self,
        keys: Sequence[Key],
        measure: Callable[..., float],
        known: Callable[[OneFlight], bool] = has_gains,
    ) -> ComparedEstimate:
        """Estimate a measure of cells, one argument each, over their common seeds; raises Missing."""
        cells = [self.flown(key) for key in keys]
        seeds = common_seeds(cells, known)
        if not seeds:
            raise Missing(f"no seed was completed in all of {'; '.join(map(_named, keys))}")
        return jackknife(seeds, lambda kept: measure(*(cell.of(kept) for cell in cells)))

    def shape(self, keys: Sequence[Key], measure: Callable[..., float]) -> ComparedEstimate:
        """Estimate a measure of the cells' shape errors; raises Missing."""
        return self.estimate(keys, measure, has_shape)

    def flown(self, key: Key) -> Cell:
        """Return a cell; raises Missing."""
        if key not in self.cells:
            raise Missing(f"{_named(key)}: no flights")
        return self.cells[key]

    def ideal_dbi(self, wavelength_m: float) -> float:
        """Return the ideal gain by the flights' solver; raises Missing."""
        found = self.ideals.get(self.solver, {}).get(wavelength_m)
        if found is None:
            raise Missing(f"λ {wavelength_m:g} m: {self.solver} did not solve the ideal formation")
        return found.max_gain_dbi

    def windy_and_calm(self, wavelength_m: float) -> tuple[Key, Key]:
        """Return the keys of the article's cells in the strongest wind and without wind; raises Missing."""
        return (ARTICLE, wavelength_m, self.strongest_n), (ARTICLE, wavelength_m, self.calm_n)

    def wind_loss(self, wavelength_m: float) -> ComparedEstimate:
        """Return the loss of the mean from no wind to the strongest wind, dB; raises Missing."""
        return self.estimate(self.windy_and_calm(wavelength_m), wind_loss_db)

    def separation(self, wavelength_m: float, wind_n: float) -> Separation:
        """Return the losses due to positions and tilt; raises Missing."""
        for each in self.separations:
            if (each.wavelength_m, each.wind_n) == (wavelength_m, wind_n):
                return each
        raise Missing(f"λ {wavelength_m:g} m, {wind_n:g} N: no flight was retained")

    def pattern(self, name: str) -> PatternReading:
        """Return a reading of figure 4; raises Missing."""
        if name not in self.patterns:
            raise Missing(f"no flight at {FIGURE_WAVELENGTH_M:g} m in {FIGURE_WIND_N:g} N was retained")
        return self.patterns[name]

    def pattern_estimate(self, measure: Callable[[Mapping[str, PatternReading]], float]) -> ComparedEstimate:
        """Return the mean of a measure of patterns over the flights of figure 4; raises Missing."""
        if not self.pattern_flights:
            raise Missing(f"no flight at {FIGURE_WAVELENGTH_M:g} m in {FIGURE_WIND_N:g} N was retained")
        numbers = {seed: measure(found) for seed, found in self.pattern_flights.items()}
        return jackknife(sorted(numbers), lambda seeds: sum(numbers[seed] for seed in seeds) / len(seeds))

    def sigma_m(self, wavelength_m: float, wind_n: float, case: str = ARTICLE) -> float:
        """Return the horizontal position error per axis; raises Missing."""
        found = self.cell(wavelength_m, wind_n, case).sigma_m
        if found is None:
            raise Missing(f"{_named((case, wavelength_m, wind_n))}: no flight has a shape error")
        return found


def wind_loss_db(windy: Cell, calm: Cell) -> float:
    """Return the mean maximum gain of the calm cell less that of the windy one, dB."""
    return mean_dbi(calm) - mean_dbi(windy)


def _named(key: Key) -> str:
    case, wavelength_m, wind_n = key
    return f"{case}, λ {wavelength_m:g} m, {wind_n:g} N"
