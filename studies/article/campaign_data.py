"""Values from the campaigns' tables and series: one `Cell` for each change, wavelength and wind."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from antenna.analysis.statistics import GainStatistics, gain_density, gain_statistics
from foundation.types import Array
from harness.campaign import Table
from studies.article.plan import FIGURE_WAVELENGTH_M, FIGURE_WIND_N, WAVELENGTH, WIND
from studies.codesign.sensitivity import per_axis_sigma_m

COMPLETED = "completed"
CSV_COLUMNS = (
    "case", "wavelength_m", "wind_n", "flights", "completed", "collided", "instants", "missing", "ideal_dbi",
    "mean_dbi", "std_db", "between_flights_db", "q05_dbi", "q50_dbi", "q95_dbi", "peak_per_db", "shape_rms_m",
    "shape_horizontal_rms_m", "sigma_horizontal_m", "channel_busy_fraction", "ftm_requested", "ftm_completed",
    "ftm_error_std_m",
)  # fmt: skip
Key = tuple[str, float, float]
"""Case, wavelength in m, mean wind force in N."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OneFlight:
    """Values of one flight; None, or no gains, if missing."""

    seed: int
    completed: bool = True
    collided: bool = False
    """Two UAVs touched."""
    max_gain_dbi: Array = field(default_factory=lambda: np.empty(0))
    """(K,) at the instants in formation that have a pattern."""
    missing: int = 0
    """Instants without a pattern, because antennas touched."""
    ideal_dbi: float | None = None
    shape_m: float | None = None
    """Rms distance from the desired shape after the best alignment."""
    shape_horizontal_m: float | None = None
    vehicles: int = 0
    busy_fraction: float | None = None
    """Of the channel time."""
    ftm_requested: int = 0
    ftm_completed: int = 0
    ftm_error_std_m: float | None = None
    """Standard deviation of the measured distances' errors."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Cell:
    """Flights of all seeds of one case, wind and wavelength; a value is None if no flight has it."""

    case: str
    wavelength_m: float
    wind_n: float
    runs: tuple[OneFlight, ...]

    def of(self, seeds: Collection[int]) -> "Cell":
        """Return the cell with some of its seeds."""
        return replace(self, runs=tuple(each for each in self.runs if each.seed in seeds))

    @property
    def flights(self) -> int:
        """Number of planned flights."""
        return len(self.runs)

    @property
    def completed(self) -> int:
        """Number of completed flights."""
        return sum(each.completed for each in self.runs)

    @property
    def collided(self) -> int:
        """Number of flights in which two UAVs touched."""
        return sum(each.collided for each in self.runs)

    @cached_property
    def max_gain_dbi(self) -> Array:
        """(K,) at all instants in formation of all flights that have a pattern."""
        return np.concatenate([np.empty(0), *(each.max_gain_dbi for each in self.runs)])

    @property
    def missing(self) -> int:
        """Number of instants without a pattern."""
        return sum(each.missing for each in self.runs)

    @property
    def ideal_dbi(self) -> float | None:
        """Maximum gain of the formation in its places, from the flights' summaries."""
        return next((each.ideal_dbi for each in self.runs if each.ideal_dbi is not None), None)

    @property
    def shape_m(self) -> float | None:
        """Distance from the desired shape after the best alignment, rms over the flights."""
        return _rms([each.shape_m for each in self.runs if each.shape_m is not None])

    @property
    def shape_horizontal_m(self) -> float | None:
        """Horizontal part of `shape_m`."""
        return _rms([each.shape_horizontal_m for each in self.runs if each.shape_horizontal_m is not None])

    @property
    def vehicles(self) -> int:
        """Number of vehicles of a flight."""
        return max((each.vehicles for each in self.runs), default=0)

    @property
    def busy_fraction(self) -> float | None:
        """Busy fraction of the channel, mean of the flights."""
        return _mean([each.busy_fraction for each in self.runs if each.busy_fraction is not None])

    @property
    def ftm_requested(self) -> int:
        """Number of requested ranging sessions."""
        return sum(each.ftm_requested for each in self.runs)

    @property
    def ftm_completed(self) -> int:
        """Number of sessions that returned a distance."""
        return sum(each.ftm_completed for each in self.runs)

    @property
    def ftm_error_std_m(self) -> float | None:
        """Standard deviation of the distance errors, rms over the flights."""
        return _rms([each.ftm_error_std_m for each in self.runs if each.ftm_error_std_m is not None])

    @cached_property
    def statistics(self) -> GainStatistics | None:
        """Statistics of the maximum gain; None without a pattern."""
        return gain_statistics(self.max_gain_dbi) if len(self.max_gain_dbi) else None

    @property
    def between_flights_db(self) -> float | None:
        """Deviation of the flights' mean maximum gains; None with fewer than two."""
        means = [float(each.max_gain_dbi.mean()) for each in self.runs if len(each.max_gain_dbi)]
        return float(np.std(means, ddof=1)) if len(means) > 1 else None

    @cached_property
    def peak_per_db(self) -> float | None:
        """Highest probability density of the maximum gain; infinite if all gains are equal."""
        if not len(self.max_gain_dbi):
            return None
        kernel_per_db = gain_density(self.max_gain_dbi).kernel_per_db
        return float(kernel_per_db.max()) if len(kernel_per_db) else math.inf

    @property
    def sigma_m(self) -> float | None:
        """Standard deviation of independent errors on each horizontal axis with this shape error."""
        shape_m = self.shape_horizontal_m
        return None if shape_m is None or self.vehicles < 2 else per_axis_sigma_m(shape_m, self.vehicles)


def read_cells(table: Table) -> dict[Key, Cell]:
    """Return the cells of a table that has one row for each seed."""
    rows: dict[Key, list[int]] = {}
    for row, run in enumerate(table.runs):
        swept = dict(zip(table.rows.column_names[1:], run.swept, strict=False))
        wavelength_m = float(swept.get(WAVELENGTH, FIGURE_WAVELENGTH_M))
        rows.setdefault((run.case, wavelength_m, float(swept.get(WIND, FIGURE_WIND_N))), []).append(row)
    names = [name for name in table.rows.column_names if name in _READ]
    columns = {name: table.column(name) for name in names}
    return {
        (case, wavelength_m, wind_n): Cell(
            case=case, wavelength_m=wavelength_m, wind_n=wind_n,
            runs=tuple(_flight(table, columns, row) for row in of_key),
        )
        for (case, wavelength_m, wind_n), of_key in rows.items()
    }  # fmt: skip


_READ = (
    "status", "collisions", "agents", "max_gain_dbi.ideal", "formation_rms_m.shape",
    "formation_rms_m.shape_horizontal", "channel_busy_fraction", "ftm.requested", "ftm.completed",
    "ftm.error_std_m",
)  # fmt: skip


def _flight(table: Table, columns: Mapping[str, Sequence[Any]], row: int) -> OneFlight:
    def value(name: str) -> Any:  # noqa: ANN401  a table's number
        return columns[name][row] if name in columns else None

    series = table.series(row)
    gains = None if series is None else series.column("max_gain_dbi")
    return OneFlight(
        seed=table.runs[row].seed, completed=value("status") == COMPLETED,
        collided=(value("collisions") or 0) > 0,
        max_gain_dbi=np.empty(0) if gains is None else gains.drop_null().to_numpy(),
        missing=0 if gains is None else gains.null_count, ideal_dbi=value("max_gain_dbi.ideal"),
        shape_m=value("formation_rms_m.shape"), shape_horizontal_m=value("formation_rms_m.shape_horizontal"),
        vehicles=value("agents") or 0, busy_fraction=value("channel_busy_fraction"),
        ftm_requested=value("ftm.requested") or 0, ftm_completed=value("ftm.completed") or 0,
        ftm_error_std_m=value("ftm.error_std_m"),
    )  # fmt: skip


def _rms(values: Sequence[float]) -> float | None:
    return math.sqrt(sum(value * value for value in values) / len(values)) if values else None


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def csv_row(cell: Cell) -> tuple[str | float | None, ...]:
    """Return the values of `CSV_COLUMNS`."""
    found = cell.statistics
    quantiles = [None if found is None else found.quantiles_dbi[q] for q in (0.05, 0.5, 0.95)]
    return (
        cell.case, cell.wavelength_m, cell.wind_n, cell.flights, cell.completed, cell.collided,
        len(cell.max_gain_dbi), cell.missing, cell.ideal_dbi, None if found is None else found.mean_dbi,
        None if found is None else found.std_db, cell.between_flights_db, *quantiles,
        cell.peak_per_db, cell.shape_m, cell.shape_horizontal_m, cell.sigma_m, cell.busy_fraction,
        cell.ftm_requested, cell.ftm_completed, cell.ftm_error_std_m,
    )  # fmt: skip
