"""The table of a campaign: one row per run, in the campaign's order.

Columns: ``case``, every swept path, ``seed``, ``status``, ``reason``, ``digest`` (of the run's files), every
number, Boolean and string of the runs' summaries under its dotted path, and ``vehicles_lost``. Wall times are
omitted, so that equal runs give equal bytes; lists are omitted too, but are in the runs' files.
"""

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from foundation.records.whole_file import write_whole
from harness.campaign.columns import kind_of
from harness.campaign.definition import Campaign, Run
from harness.campaign.store import TABLES, Flown, Store
from harness.campaign.values import toml_text
from harness.records.columns import describe

_LEFT_OUT = {"scenario", "seed", "status", "reason", "wall_s", "real_time_factor"}
"""Omitted fields of the summary: those of other columns, and those that depend on the machine"""

CAMPAIGN_KEY, SCENARIO_KEY = "campaign", "scenario"
"""Metadata of the Parquet file: names of the campaign and of its scenario's file"""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Results of a complete campaign."""

    runs: tuple[Run, ...]
    """Run of each row"""
    rows: pa.Table
    store: Store
    parquet: Path
    csv: Path

    def column(self, name: str) -> list[Any]:
        """Return a column's values, None for missing ones; raises KeyError."""
        values: list[Any] = self.rows.column(name).to_pylist()
        return values

    def series(self, row: int, name: str = "gains") -> pa.Table | None:
        """Read a stored series; None for a failed run."""
        path = self.store.series_path(self.runs[row].digest, name)
        return pq.read_table(path) if path.exists() else None


def write_table(campaign: Campaign, runs: Sequence[Run], flown: Mapping[str, Flown], store: Store) -> Table:
    """Write the table of runs, whose digests are all in ``flown``, as Parquet and CSV; raises OSError."""
    rows = make_rows(campaign, runs, flown)
    parquet, csv = io.BytesIO(), io.BytesIO()
    pq.write_table(rows, parquet, compression="zstd")
    pyarrow.csv.write_csv(rows, csv)
    paths = [store.folder / name for name in TABLES]
    for path, content in zip(paths, (parquet, csv), strict=True):
        write_whole(path, content.getvalue())
    return Table(runs=tuple(runs), rows=rows, store=store, parquet=paths[0], csv=paths[1])


def make_rows(campaign: Campaign, runs: Sequence[Run], flown: Mapping[str, Flown]) -> pa.Table:
    """Return the runs, at least one, as a table with the metadata of `harness.records.columns.describe`."""
    ended = [flown[run.digest] for run in runs]
    columns: dict[str, list[Any]] = {"case": [run.case for run in runs]}
    for number, path in enumerate(campaign.sweep):
        columns[path] = [run.swept[number] for run in runs]
    columns["seed"] = [run.seed for run in runs]
    columns["status"] = [each.status for each in ended]
    columns["reason"] = [each.reason for each in ended]
    columns["digest"] = [run.digest for run in runs]
    measured = [dict(_measured(each.summary)) for each in ended]
    for name in dict.fromkeys(name for each in measured for name in each):
        columns.setdefault(name, [each.get(name) for each in measured])
    rows = pa.table({name: _array(name, values) for name, values in columns.items()})
    kind = kind_of(columns, campaign.sweep, runs[0].scenario)
    return describe(rows, kind, {CAMPAIGN_KEY: campaign.name, SCENARIO_KEY: campaign.scenario.stem})


def _measured(summary: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in summary.items():
        path = f"{above}{key}"
        if isinstance(value, dict):
            yield from _measured(value, f"{path}.")
        elif path == "vehicles":
            yield "vehicles_lost", sum(not vehicle["alive"] for vehicle in value)
        elif not isinstance(value, list) and path not in _LEFT_OUT:
            yield path, value


_WORDS = {"case", "status", "reason", "digest"}


def _array(name: str, values: list[Any]) -> pa.Array:
    """Return a column: numbers, Booleans or strings; values of mixed or other types as TOML text."""
    known = [value for value in values if value is not None]
    if name in _WORDS or (known and all(isinstance(value, str) for value in known)):
        return pa.array(values, pa.string())
    if known and all(isinstance(value, bool) for value in known):
        return pa.array(values, pa.bool_())
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in known):
        return pa.array([None if value is None else toml_text(value) for value in values], pa.string())
    if known and all(isinstance(value, int) for value in known):
        return pa.array(values, pa.int64())
    return pa.array([None if value is None else float(value) for value in values], pa.float64())
