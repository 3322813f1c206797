"""Writes ``report.html`` of a campaign: factors with confidence intervals, failed runs, links to the runs.

Made of the campaign's table; like the page of a run it is one file that a browser opens from disk.
"""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from foundation.records.whole_file import write_whole
from harness.campaign.figures import (
    MOST_LINES,
    QUANTITIES,
    Quantity,
    axis_name,
    factors,
    has_values,
    intervals,
    lines_of,
    places_of,
)
from harness.campaign.intervals import CONFIDENCE, Interval
from harness.campaign.store import FAILED, PAGE, TABLES
from harness.campaign.table import CAMPAIGN_KEY, SCENARIO_KEY
from harness.report.page.content import (
    Card,
    Cell,
    Link,
    Page,
    Section,
    Table,
    count,
    file_link,
    percent,
    size_text,
)
from harness.report.page.encoding import plot_text
from harness.report.page.plots import QUALITATIVE, Plot, axis

MOST_ROWS = 2_000
"""Runs that are listed; the table has all"""


def write_page(path: Path) -> str:
    """Write the page of a campaign's table (Parquet) beside it; returns its name.

    Raises OSError, and KeyError or ValueError for another table.
    """
    page = make_page(pq.read_table(path), path.parent)
    from harness.report.page.html import render  # noqa: PLC0415  Jinja and Plotly: for pages only

    write_whole(path.with_name(PAGE), render(page), private=True)
    return PAGE


def make_page(rows: pa.Table, folder: Path) -> Page:
    """Return the content of the page of a campaign's table. Raises KeyError, OSError."""
    about = rows.schema.metadata or {}
    name, scenario = (about[key.encode()].decode() for key in (CAMPAIGN_KEY, SCENARIO_KEY))
    statuses = Counter(rows.column("status").to_pylist())
    shown = rows.filter(pc.not_equal(rows.column("status"), FAILED))
    found, failed = factors(rows), statuses.get(FAILED, 0)
    seeds = len(set(rows.column("seed").to_pylist()))
    cards = [
        Card(label="Runs", value=count(len(rows)), detail=f"{seeds} seed{'s' if seeds > 1 else ''}"),
        Card(
            label="Completed",
            value=count(statuses.get("completed", 0)),
            detail=percent(statuses.get("completed", 0), len(rows), ".1f"),
        ),
        Card(label="Formation not reached", value=count(statuses.get("not_formed", 0))),
        Card(label="Failed", value=count(failed), tone="bad" if failed else ""),
    ]
    sections = [_factor_section(number, rows, shown, factor) for number, factor in enumerate(found)]
    sections += [
        *_failed_section(rows, found, folder),
        _runs_section(rows, found, folder),
        _files_section(folder),
    ]
    return Page(
        kind="Campaign",
        title=name,
        badge=f"{failed} failed" if failed else "no run failed",
        badge_tone="bad" if failed else "good",
        subtitle=[f"scenario {scenario}", f"{len(rows)} runs", f"factors: {', '.join(found)}"],
        cards=cards,
        sections=sections,
        footer="Written by coflight. The file holds all that it shows and loads nothing.",
    )


def _factor_section(number: int, rows: pa.Table, shown: pa.Table, factor: str) -> Section:
    """Return means and intervals of every quantity against a factor, as figures and as a table."""
    quantities = [each for each in QUANTITIES if has_values(shown, each)]
    others = tuple(name for name in factors(rows) if name != factor)
    lines, pooled = lines_of(shown, others) if len(shown) else {}, ""
    if len(lines) > MOST_LINES:
        lines, pooled = {"": np.arange(len(shown))}, f"; pooled over {', '.join(others)}"
    results = {
        label: {each.column: intervals(shown.take(of_line), factor, each) for each in quantities}
        for label, of_line in lines.items()
    }
    text = f"Points are means over the flights with their {CONFIDENCE:.0%} interval (Student's t){pooled}."
    if len(shown) < len(rows):
        text += f" Failed runs are left out: {len(rows) - len(shown)} of {len(rows)}."
    return Section(
        key=f"factor-{number}",
        title=factor,
        text=text if quantities else "No run has results.",
        plots=[
            _plot(
                f"factor-{number}-{k}",
                rows,
                factor,
                each,
                {label: of_line[each.column] for label, of_line in results.items()},
            )
            for k, each in enumerate(quantities)
        ],
        tables=[_interval_table(factor, quantities, results)] if quantities else [],
    )


def _plot(
    key: str, rows: pa.Table, factor: str, quantity: Quantity, lines: dict[str, dict[Any, Interval]]
) -> Plot:
    """Return the figure of a quantity against a factor, with a line for each combination of the others."""
    places, is_number = places_of(rows.column(factor))
    data: list[dict[str, Any]] = []
    for colour, (label, found) in zip(QUALITATIVE * 2, lines.items(), strict=False):
        ordered = sorted(found, key=lambda value: places[value])
        means = [found[value].value for value in ordered]
        halves = [found[value].high - found[value].value for value in ordered]
        data.append(
            {
                "type": "scatter",
                "mode": "lines+markers" if is_number else "markers",
                "name": plot_text(label or "all runs"),
                "showlegend": len(lines) > 1,
                "x": [places[value] for value in ordered]
                if is_number
                else [_category(value) for value in ordered],
                "y": means,
                "line": {"color": colour, "width": 1.2},
                "marker": {"color": colour, "size": 7},
                "error_y": {
                    "type": "data",
                    "array": [0.0 if math.isnan(half) else half for half in halves],
                    "color": colour,
                    "thickness": 1.4,
                    "width": 5,
                },
                "text": [
                    plot_text(f"{found[value].text()}, {found[value].count} flights") for value in ordered
                ],
                "hovertemplate": "%{text}<extra>%{x}</extra>",
            }
        )
    kind: dict[str, Any] = (
        {}
        if is_number
        else {
            "type": "category",
            "categoryorder": "array",
            "categoryarray": [_category(value) for value in places],
        }
    )
    layout = {
        "xaxis": axis(plot_text(axis_name(rows, factor)), **kind),
        "yaxis": axis(quantity.label),
        "scattermode": "group",
        "hovermode": "closest",
    }
    return Plot(key=key, title=quantity.label, data=data, layout=layout)


def _category(value: object) -> str:
    return plot_text(_text(value))


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _interval_table(
    factor: str, quantities: Sequence[Quantity], results: dict[str, dict[str, dict[Any, Interval]]]
) -> Table:
    rows: list[list[Cell]] = []
    for label, found in results.items():
        for value in dict.fromkeys(value for of_column in found.values() for value in of_column):
            cells = [found[each.column].get(value) for each in quantities]
            flights = max((each.count for each in cells if each is not None), default=0)
            texts = ["–" if each is None else each.text() for each in cells]
            rows.append([_text(value), *([label] if len(results) > 1 else []), str(flights), *texts])
    heads = [factor, *(["Other factors"] if len(results) > 1 else []), "Flights"]
    heads += [each.label for each in quantities]
    first = len(heads) - len(quantities) - 1
    return Table(heads=heads, rows=rows, numeric=range(first, len(heads)), is_long=len(rows) > 16)


def _failed_section(rows: pa.Table, found: Sequence[str], folder: Path) -> list[Section]:
    """Return the runs that did not complete, with their reasons; nothing if all have."""
    chosen = rows.filter(pc.not_equal(rows.column("status"), "completed"))
    if not len(chosen):
        return []
    heads = ("Run", *found, "Seed", "Status", "Reason")
    names = ("digest", *found, "seed", "status", "reason")
    table = Table(heads=heads, rows=_listed(chosen, names, folder), note=_more(chosen), is_long=True)
    return [Section(key="failed", title="Runs that failed or did not form", tables=[table])]


def _runs_section(rows: pa.Table, found: Sequence[str], folder: Path) -> Section:
    quantities = [each for each in QUANTITIES if has_values(rows, each)]
    names = ("digest", *found, "seed", "status", *(each.column for each in quantities))
    heads = ("Run", *found, "Seed", "Status", *(each.column for each in quantities))
    first = len(heads) - len(quantities)
    return Section(
        key="runs",
        title="Runs",
        text="A run's file has its whole summary, and the settings with which coflight fly repeats it.",
        tables=[
            Table(
                heads=heads,
                rows=_listed(rows, names, folder),
                numeric=range(first, len(heads)),
                note=_more(rows),
                is_long=True,
            )
        ],
    )


def _listed(rows: pa.Table, names: Sequence[str], folder: Path) -> list[list[Cell]]:
    listed = []
    known = [name for name in dict.fromkeys(names) if name in rows.column_names]
    for row in rows.select(known).slice(0, MOST_ROWS).to_pylist():
        cells: list[Cell] = ["–" if row.get(name) is None else _short(row[name]) for name in names]
        digest = str(row["digest"])
        if (folder / "runs" / f"{digest}.json").is_file():
            cells[0] = Link(digest, file_link(f"runs/{digest}.json").target)
        listed.append(cells)
    return listed


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _more(rows: pa.Table) -> str:
    return f"The first {MOST_ROWS} of {len(rows)} runs." if len(rows) > MOST_ROWS else ""


def _files_section(folder: Path) -> Section:
    """Return links to tables, figures and kept series. Raises OSError."""
    paths = [folder / name for name in TABLES] + sorted([*folder.glob("by-*.png"), *folder.glob("by-*.pdf")])
    paths += sorted((folder / "runs").glob("[!.]*.parquet"))[:MOST_ROWS]
    rows: list[list[Cell]] = [
        [file_link(path.relative_to(folder).as_posix()), size_text(path.stat().st_size)]
        for path in paths
        if path.is_file()
    ]
    return Section(
        key="files",
        title="Files",
        tables=[Table(heads=("File", "Size"), rows=rows, numeric=(1,), is_long=True)],
    )
