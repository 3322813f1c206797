"""Numbers out of the campaigns' tables and series: one `Cell` for each change, wavelength and wind."""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from antenna.statistics import GainStatistics, gain_density, gain_statistics
from harness.article.plan import FIGURE_WAVELENGTH_M, FIGURE_WIND_N, WAVELENGTH, WIND
from harness.campaign import Table
from harness.codesign.sensitivity import per_axis_sigma_m
from harness.flight import Array

COMPLETED = "completed"
CSV_COLUMNS = (
    "case", "wavelength_m", "wind_n", "flights", "completed", "collided", "instants", "missing", "ideal_dbi",
    "mean_dbi", "std_db", "q05_dbi", "q50_dbi", "q95_dbi", "peak_per_db", "shape_rms_m",
    "shape_horizontal_rms_m", "sigma_horizontal_m", "channel_busy_fraction", "ftm_requested", "ftm_completed",
    "ftm_error_std_m",
)  # fmt: skip
Key = tuple[str, float, float]
"""Case, wavelength in m, mean wind force in N."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Cell:
    """Flights of all seeds of one case in one wind at one wavelength; None where no flight has a number."""

    case: str
    wavelength_m: float
    wind_n: float
    flights: int
    completed: int
    collided: int
    """Flights in which two UAVs touched."""
    max_gain_dbi: Array
    """(K,) of all instants of all flights in formation that have a pattern."""
    missing: int
    """Instants without one: antennas touched."""
    ideal_dbi: float | None
    shape_m: float | None
    """Rms over the flights of the distance from the best laid shape."""
    shape_horizontal_m: float | None
    vehicles: int
    busy_fraction: float | None
    """Of the channel, mean of the flights."""
    ftm_requested: int
    ftm_completed: int
    ftm_error_std_m: float | None
    """Of the measured distances, rms over the flights."""

    @property
    def statistics(self) -> GainStatistics | None:
        """Of the maximum gain; None without a pattern."""
        return gain_statistics(self.max_gain_dbi) if len(self.max_gain_dbi) else None

    @property
    def peak_per_db(self) -> float | None:
        """Highest probability density of the maximum gain; infinite where all gains are alike."""
        if not len(self.max_gain_dbi):
            return None
        kernel_per_db = gain_density(self.max_gain_dbi).kernel_per_db
        return float(kernel_per_db.max()) if len(kernel_per_db) else math.inf

    @property
    def sigma_m(self) -> float | None:
        """Of independent errors on each horizontal axis that leave this shape error."""
        known = self.shape_horizontal_m is not None and self.vehicles > 1
        return per_axis_sigma_m(self.shape_horizontal_m or 0.0, self.vehicles) if known else None


def read_cells(table: Table) -> dict[Key, Cell]:
    """Gather the runs of a table that has one row for each seed."""
    rows: dict[Key, list[int]] = {}
    for row, run in enumerate(table.runs):
        swept = dict(zip(table.rows.column_names[1:], run.swept, strict=False))
        wavelength_m = float(swept.get(WAVELENGTH, FIGURE_WAVELENGTH_M))
        rows.setdefault((run.case, wavelength_m, float(swept.get(WIND, FIGURE_WIND_N))), []).append(row)
    return {key: _cell(table, key, of_key) for key, of_key in rows.items()}


def _cell(table: Table, key: Key, rows: Sequence[int]) -> Cell:
    def values(name: str) -> list[Any]:
        if name not in table.rows.column_names:
            return []
        column = table.column(name)
        return [column[row] for row in rows if column[row] is not None]

    gains = [series for row in rows if (series := table.series(row)) is not None]
    columns = [series.column("max_gain_dbi") for series in gains]
    known = [column.drop_null().to_numpy() for column in columns]
    case, wavelength_m, wind_n = key
    ideals = values("max_gain_dbi.ideal")
    return Cell(
        case=case, wavelength_m=wavelength_m, wind_n=wind_n, flights=len(rows),
        completed=values("status").count(COMPLETED),
        collided=sum(count > 0 for count in values("collisions")),
        max_gain_dbi=np.concatenate([np.empty(0), *known]),
        missing=sum(column.null_count for column in columns),
        ideal_dbi=ideals[0] if ideals else None,
        shape_m=_rms(values("formation_rms_m.shape")),
        shape_horizontal_m=_rms(values("formation_rms_m.shape_horizontal")),
        vehicles=int(max(values("agents"), default=0)),
        busy_fraction=_mean(values("channel_busy_fraction")),
        ftm_requested=sum(values("ftm.requested")), ftm_completed=sum(values("ftm.completed")),
        ftm_error_std_m=_rms(values("ftm.error_std_m")),
    )  # fmt: skip


def _rms(values: Sequence[float]) -> float | None:
    return math.sqrt(sum(value * value for value in values) / len(values)) if values else None


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def csv_text(cells: Iterable[Cell]) -> str:
    """Write cells as CSV, a row each; empty where there is no number."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for cell in cells:
        writer.writerow([_written(value) for value in csv_row(cell).values()])
    return text.getvalue()


def csv_row(cell: Cell) -> Mapping[str, Any]:
    """Give what a row says, by column."""
    found = cell.statistics
    quantiles = {q: None if found is None else found.quantiles_dbi[q] for q in (0.05, 0.5, 0.95)}
    values = (
        cell.case, cell.wavelength_m, cell.wind_n, cell.flights, cell.completed, cell.collided,
        len(cell.max_gain_dbi), cell.missing, cell.ideal_dbi, None if found is None else found.mean_dbi,
        None if found is None else found.std_db, *quantiles.values(), cell.peak_per_db, cell.shape_m,
        cell.shape_horizontal_m, cell.sigma_m, cell.busy_fraction, cell.ftm_requested, cell.ftm_completed,
        cell.ftm_error_std_m,
    )  # fmt: skip
    return dict(zip(CSV_COLUMNS, values, strict=True))


def _written(value: object) -> object:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else value
