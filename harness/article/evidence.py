"""All that the statements are judged by."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from antenna.patterns import Pattern
from antenna.statistics import GainStatistics
from harness.article.draws import Drawn
from harness.article.kept import Separation
from harness.article.patterns import PatternReading
from harness.article.plan import ARTICLE, CROWDED, FIGURE_WAVELENGTH_M, FIGURE_WIND_N
from harness.article.readings import Cell, Key

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
    separations: Iterable[Separation]
    patterns: Mapping[str, PatternReading]
    """See `harness.article.kept.FigurePatterns.readings`; empty without a flight."""
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
            raise Missing(f"{case}, λ {wavelength_m:g} m, {wind_n:g} N: no flight has a pattern")
        return cell

    def gains(self, wavelength_m: float, wind_n: float, case: str = ARTICLE) -> GainStatistics:
        """Statistics of its maximum gain; raises Missing."""
        found = self.cell(wavelength_m, wind_n, case).statistics
        assert found is not None  # noqa: S101  it has gains
        return found

    def peak_per_db(self, wavelength_m: float, wind_n: float, case: str = ARTICLE) -> float:
        """Highest density of its maximum gain; raises Missing."""
        found = self.cell(wavelength_m, wind_n, case).peak_per_db
        assert found is not None  # noqa: S101  it has gains
        return found

    def ideal_dbi(self, wavelength_m: float) -> float:
        """Of the flights' solver; raises Missing."""
        found = next(iter(self.ideals.values()), {}).get(wavelength_m)
        if found is None:
            raise Missing(f"λ {wavelength_m:g} m: the ideal formation was not solved")
        return found.max_gain_dbi

    def wind_loss_db(self, wavelength_m: float) -> float:
        """By how much the mean is lower in the strongest wind than in none; raises Missing."""
        calm = self.gains(wavelength_m, self.calm_n).mean_dbi
        return calm - self.gains(wavelength_m, self.strongest_n).mean_dbi

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

    def sigma_m(self, wavelength_m: float, wind_n: float, case: str = ARTICLE) -> float:
        """Horizontal position error per axis; raises Missing."""
        found = self.cell(wavelength_m, wind_n, case).sigma_m
        if found is None:
            raise Missing(f"{case}, λ {wavelength_m:g} m, {wind_n:g} N: no flight has a shape error")
        return found

    @property
    def crowded(self) -> Cell:
        """The flights over a full channel; raises Missing."""
        return self.cell(FIGURE_WAVELENGTH_M, FIGURE_WIND_N, CROWDED)
