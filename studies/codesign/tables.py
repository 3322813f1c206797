"""Write the experiment as CSV: one row for each flight, and one row of means with intervals for each case."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from studies.codesign.book import Book
from studies.codesign.cases import CodesignCase
from studies.codesign.measures import Measures
from studies.common.report import write_csv

SETTINGS = (
    "localisation", "agents", "wind_n", "wavelength_m", "beacon_period_ms", "ranging", "ftm_period_s",
    "channel", "drop_fraction",
)  # fmt: skip
_LEFT_OUT = {"wall_s", "real_time_factor", "range_offsets_m", "gain_dbi", "track_mm"}
"""Series, and values that are not determined by the seed"""
NUMBERS = (
    *(name for name in Measures.__struct_fields__ if name not in _LEFT_OUT),
    "gain_mean_dbi", "gain_std_db",
)  # fmt: skip
MEANS = (
    "formed_s", "shape_m", "shape_whole_m", "absolute_m", "vertical_m", "estimate_m", "control_m",
    "busy_fraction", "sessions_per_s", "completed_fraction", "beacons_lost_fraction", "gain_mean_dbi",
    "gain_std_db",
)  # fmt: skip


def write_tables(out: Path, cases: Iterable[CodesignCase], book: Book) -> None:
    """Write ``codesign-flights.csv`` and ``codesign-cases.csv`` into the folder, which is created."""
    distinct = list({case.name: case for case in cases}.values())
    flights = [
        [case.name, seed, *_settings(case), *([getattr(each, name) for name in NUMBERS])]
        for case in distinct
        for seed, each in enumerate(book.measures(case), start=1)
        if each is not None
    ]
    write_csv(out / "codesign-flights.csv", ["case", "seed", *SETTINGS, *NUMBERS], flights)
    rows = []
    for case in distinct:
        means = [book.mean(case, name) for name in MEANS]
        rows.append([
            case.name, *_settings(case), len(book.flown(case)), book.formed(case), book.collided(case),
            *(value for mean in means for value in (mean.value, mean.low, mean.high)),
        ])  # fmt: skip
    bounds = [f"{name}{part}" for name in MEANS for part in ("", "_low", "_high")]
    write_csv(out / "codesign-cases.csv", ["case", *SETTINGS, "flights", "formed", "collided", *bounds], rows)


def _settings(case: CodesignCase) -> list[Any]:
    return [getattr(case, name) for name in SETTINGS]
