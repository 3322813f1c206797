"""All that the statements are judged by."""

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
"""From this wavelength on the article calls a formation resilient."""


class Missing(Exception):
    """What a statement rests on was not measured; the text is a line that says what."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Evidence:
    """Readings of the campaigns, of the kept flights, and of random formations."""

    cells: Mapping[Key, Cell]
    ideals: Mapping[str, Mapping[float, Pattern]]
    """The formation in its places, by solver and wavelength."""
    solver: str = "batch"
    """Which of them solved the flights."""
    frequencies_mhz: Mapping[float, float] = field(default_factory=dict)
    """By wavelength, as solvers are told."""
    separations: Iterable[Separation]
    patterns: Mapping[str, PatternReading]
    """See `studies.article.retained_flights.FigurePatterns.readings`; empty without a flight."""
    pattern_flights: Mapping[int, Mapping[str, PatternReading]] = field(default_factory=dict)
    """The same of all flights of it that were kept, by seed."""
    drawn: Mapping[tuple[float, float], Drawn]
    """Random formations, by (sigma_m, wavelength_m)."""
    leaning: Mapping[float, PatternReading] = field(default_factory=dict)
    """The formation in its places, tilted as in figure 4's flight, by the wind's direction phi in degrees."""

    @property
    def winds_n(self) -> list[float]:
        """Winds of the article's campaign, rising; raises Missing."""
        return self._flown({wind_n for case, _, wind_n in self.cells if case == ARTICLE})

    @property
    def wavelengths_m(self) -> list[float]:
        """Its wavelengths, rising; raises Missing."""
        return self._flown({wavelength_m for case, wavelength_m, _ in self.cells if case == ARTICLE})

    def _flown(self, values: set[float]) -> list[float]:
        if not values:
            raise Missing("nothing was flown")
        return sorted(values)

    @property
    def long_m(self) -> list[float]:
        """Of them those that the article calls resilient; raises Missing with fewer than two."""
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
            raise Missing(f"nothing was flown {words}")
        return wind_n

    def cell(self, wavelength_m: float, wind_n: float, case: str = ARTICLE) -> Cell:
        """Give a cell that has gains; raises Missing."""
        cell = self.cells.get((case, wavelength_m, wind_n))
        if cell is None or not len(cell.max_gain_dbi):
            raise Missing(f"{_named((case, wavelength_m, wind_n))}: no flight has a pattern")
        return cell

    def gains(self, wavelength_m: float, wind_n: float, case: str = ARTICLE) -> GainStatistics:
        """Statistics of its maximum gain; raises Missing."""
        found = self.cell(wavelength_m, wind_n, case).statistics
        assert found is not None  # noqa: S101  it has gains
        return found

    def estimate(
        self,
        keys: Sequence[Key],
        measure: Callable[..., float],
        known: Callable[[OneFlight], bool] = has_gains,
    ) -> ComparedEstimate:
        """Measure cells, one argument each, of the seeds that all of them have; raises Missing."""
        cells = [self.flown(key) for key in keys]
        seeds = common_seeds(cells, known)
        if not seeds:
            raise Missing(f"no seed was flown to its end in all of {'; '.join(map(_named, keys))}")
        return jackknife(seeds, lambda kept: measure(*(cell.of(kept) for cell in cells)))

    def shape(self, keys: Sequence[Key], measure: Callable[..., float]) -> ComparedEstimate:
        """Measure shape errors of cells; raises Missing."""
        return self.estimate(keys, measure, has_shape)

    def flown(self, key: Key) -> Cell:
        """Give a cell of any flights; raises Missing."""
        if key not in self.cells:
            raise Missing(f"{_named(key)}: nothing was flown")
        return self.cells[key]

    def ideal_dbi(self, wavelength_m: float) -> float:
        """Of the flights' solver; raises Missing."""
        found = self.ideals.get(self.solver, {}).get(wavelength_m)
        if found is None:
            raise Missing(f"λ {wavelength_m:g} m: {self.solver} did not solve the ideal formation")
        return found.max_gain_dbi

    def windy_and_calm(self, wavelength_m: float) -> tuple[Key, Key]:
        """Keys of the article's cells in the strongest wind and in none; raises Missing."""
        return (ARTICLE, wavelength_m, self.strongest_n), (ARTICLE, wavelength_m, self.calm_n)

    def wind_loss(self, wavelength_m: float) -> ComparedEstimate:
        """By how much the mean is lower in the strongest wind than in none, dB; raises Missing."""
        return self.estimate(self.windy_and_calm(wavelength_m), wind_loss_db)

    def separation(self, wavelength_m: float, wind_n: float) -> Separation:
        """Give what positions and tilt cost; raises Missing."""
        for each in self.separations:
            if (each.wavelength_m, each.wind_n) == (wavelength_m, wind_n):
                return each
        raise Missing(f"λ {wavelength_m:g} m, {wind_n:g} N: no flight was kept")

    def pattern(self, name: str) -> PatternReading:
        """Give a reading of figure 4; raises Missing."""
        if name not in self.patterns:
            raise Missing(f"no flight at {FIGURE_WAVELENGTH_M:g} m in {FIGURE_WIND_N:g} N was kept")
        return self.patterns[name]

    def pattern_estimate(self, measure: Callable[[Mapping[str, PatternReading]], float]) -> ComparedEstimate:
        """Mean of a number of the patterns of one flight, over the flights of figure 4; raises Missing."""
        if not self.pattern_flights:
            raise Missing(f"no flight at {FIGURE_WAVELENGTH_M:g} m in {FIGURE_WIND_N:g} N was kept")
        numbers = {seed: measure(found) for seed, found in self.pattern_flights.items()}
        return jackknife(sorted(numbers), lambda seeds: sum(numbers[seed] for seed in seeds) / len(seeds))

    def sigma_m(self, wavelength_m: float, wind_n: float, case: str = ARTICLE) -> float:
        """Horizontal position error per axis; raises Missing."""
        found = self.cell(wavelength_m, wind_n, case).sigma_m
        if found is None:
            raise Missing(f"{_named((case, wavelength_m, wind_n))}: no flight has a shape error")
        return found


def wind_loss_db(windy: Cell, calm: Cell) -> float:
    """By how much the mean maximum gain is lower in one cell than in the other."""
    return mean_dbi(calm) - mean_dbi(windy)


def _named(key: Key) -> str:
    case, wavelength_m, wind_n = key
    return f"{case}, λ {wavelength_m:g} m, {wind_n:g} N"
