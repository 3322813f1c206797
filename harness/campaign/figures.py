"""Figures of a campaign's table: means and confidence intervals of the results against each factor.

Factors are the swept paths with several values, and the case if there are several. Of another factor there is
a line for each value; of several other ones, for each combination. If these are too many, their runs are
pooled; the figure says which.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from harness.campaign.intervals import CONFIDENCE, Interval, mean_interval
from harness.campaign.store import FAILED
from harness.campaign.table import CAMPAIGN_KEY, SCENARIO_KEY
from harness.report.figures import save

MOST_LINES = 8
"""Largest number of combinations of the other factors with a line each."""
MOST_TICKS = 8
"""Largest number of values of a numeric factor with a tick each."""
LONG_NAMES = 28
"""Number of letters of all names of an axis from which they are slanted."""
DODGE = 0.015
"""Distance of points of neighbouring lines over the range of the axis, unless there are many."""
MOST_COLUMNS = 3
LEAST_WIDTH_IN = 7.0
LETTERS_PER_IN, LETTERS_OF_A_LINE = 12, 9
"""Letters of the legend in an inch, and the room of a line's sample in letters."""
_NO_NUMBERS = (pa.types.is_boolean, pa.types.is_string)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A column of the table that is drawn."""

    column: str
    label: str
    factor: float = 1.0
    """From the column's unit to the label's"""
    count: bool = False
    """Whether it counts something"""


QUANTITIES = (
    Quantity("formation_rms_m.shape", "Formation error, shape, rms (m)"),
    Quantity("formation_rms_m.absolute", "Formation error, absolute, rms (m)"),
    Quantity("max_gain_dbi.mean", "Maximum gain, mean of a flight (dBi)"),
    Quantity("channel_busy_fraction", "Channel busy (%)", 100.0),
    Quantity("ftm.error_std_m", "FTM error, std of a flight (m)"),
    Quantity("vehicles_lost", "Lost UAVs, mean number", count=True),
)


def draw_table(path: Path) -> list[str]:
    """Write a figure for every factor of a table (Parquet) beside it; returns the names of the files.

    Nothing is written if no run has results. Raises OSError, and KeyError or ValueError for another table.
    """
    rows = pq.read_table(path)
    written_for = rows.schema.metadata or {}
    names = [written_for[key.encode()].decode() for key in (CAMPAIGN_KEY, SCENARIO_KEY)]
    title = f"Campaign {names[0]}, scenario {names[1]}"
    figures = {factor: factor_figure(rows, factor) for factor in factors(rows)}
    return [
        name
        for factor, figure in figures.items()
        if figure is not None
        for name in save(figure, path.with_name(f"by-{factor}"), title)
    ]


def factors(rows: pa.Table) -> tuple[str, ...]:
    """Return the columns that differ between runs by the campaign's definition; ``case`` if none does."""
    names = rows.column_names
    defined = names[names.index("case") : names.index("seed")]
    several = tuple(name for name in defined if len(set(rows.column(name).to_pylist())) > 1)
    return several or ("case",)


def factor_figure(rows: pa.Table, factor: str) -> Figure | None:
    """Return a figure with a panel for every quantity that some run has, against a factor; None without any.

    Runs that failed are left out, and their number is on the figure.
    """
    shown = rows.filter(pc.not_equal(rows.column("status"), FAILED))
    quantities = [each for each in QUANTITIES if has_values(shown, each)]
    if not quantities:
        return None
    others = tuple(name for name in factors(rows) if name != factor)
    lines = lines_of(shown, others)
    pooled = others if len(lines) > MOST_LINES else ()
    if pooled:
        lines = {"": np.arange(len(shown))}
    places, is_number = places_of(rows.column(factor))
    style = "o-" if is_number else "o"
    panel_rows = -(-len(quantities) // MOST_COLUMNS)
    columns = -(-len(quantities) // panel_rows)
    width_in = max(4.0 * columns + 0.6, LEAST_WIDTH_IN)
    figure = Figure(figsize=(width_in, 3.2 * panel_rows + 1.5), layout="constrained")
    panels = figure.subplots(panel_rows, columns, squeeze=False).ravel()
    most_flights = 0
    for axes, quantity in zip(panels, quantities, strict=False):
        for number, (label, of_line) in enumerate(lines.items()):
            found = intervals(shown.take(of_line), factor, quantity)
            most_flights = max([most_flights, *(each.count for each in found.values())])
            shift = _shift(number, len(lines), list(places.values()))
            _draw_line(axes, [places[value] + shift for value in found], list(found.values()), label, style)
        axes.set(title=quantity.label)
        axes.title.set_fontsize("medium")
        axes.set_xlabel(axis_name(rows, factor), parse_math=False)
        axes.grid(alpha=0.3)
        axes.yaxis.set_major_locator(MaxNLocator(nbins=5))
        _tick(axes, places, is_number=is_number)
    for axes in panels[len(quantities) :]:
        axes.set_axis_off()
    fitting = int(LETTERS_PER_IN * width_in) // (max(map(len, lines)) + LETTERS_OF_A_LINE)
    legend = figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", fontsize="small",
        ncols=max(1, min(fitting, len(lines))),
        title=_caption(
            rows, shown, others, pooled=bool(pooled), mark="line" if is_number else "colour",
            has_intervals=most_flights > 1,
        ), title_fontsize="small",
    )  # fmt: skip
    for text in (*legend.get_texts(), legend.get_title()):
        text.set_parse_math(False)
    return figure


def intervals(rows: pa.Table, factor: str, quantity: Quantity) -> dict[Any, Interval]:
    """Return mean and interval of a quantity by the factor's values, in their order in the table.

    Rows of one flight count once, and values without results have no entry.
    """
    flights: dict[Any, dict[str, float | None]] = {}
    columns = (rows.column(name).to_pylist() for name in (factor, "digest", quantity.column))
    for value, digest, result in zip(*columns, strict=True):
        flights.setdefault(value, {})[digest] = None if result is None else quantity.factor * result
    found = {value: mean_interval(list(results.values())) for value, results in flights.items()}
    return {value: interval for value, interval in found.items() if interval.count}


def has_values(rows: pa.Table, quantity: Quantity) -> bool:
    """Whether a run has a value; of a count, one other than 0."""
    if quantity.column not in rows.column_names:
        return False
    values = [value for value in rows.column(quantity.column).to_pylist() if value is not None]
    return any(values) if quantity.count else bool(values)


def lines_of(rows: pa.Table, others: Sequence[str]) -> dict[str, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Return the rows of every combination of values of other factors, by its name."""
    if not others:
        return {"": np.arange(len(rows))}
    combined = rows.select(others).to_pylist()
    named = [", ".join(f"{name} = {_text(value)}" for name, value in row.items()) for row in combined]
    return {name: np.flatnonzero(np.array(named) == name) for name in dict.fromkeys(named)}


def axis_name(rows: pa.Table, factor: str) -> str:
    """Return the name of a factor with its unit."""
    unit = (rows.schema.field(factor).metadata or {}).get(b"unit", b"").decode()
    return f"{factor} ({unit})" if unit else factor


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def places_of(column: pa.ChunkedArray) -> tuple[dict[Any, float], bool]:
    """Return the place of every value on the axis, and whether the axis is numeric."""
    values = list(dict.fromkeys(column.to_pylist()))
    is_number = not any(is_type(column.type) for is_type in _NO_NUMBERS) and None not in values
    return {value: float(value) if is_number else float(i) for i, value in enumerate(values)}, is_number


def _shift(number: int, count: int, places: Sequence[float]) -> float:
    """Return the displacement of a line, so that its intervals do not cover those of others."""
    least, whole = (np.diff(np.sort(places)).min(), np.ptp(places)) if len(places) > 1 else (1.0, 1.0)
    return float(min(DODGE * whole, 0.5 * least / count)) * (number - (count - 1) / 2.0)


def _draw_line(axes: Axes, at: Sequence[float], found: Sequence[Interval], label: str, style: str) -> None:
    order = np.argsort(at)
    mean, low, high = np.array([(each.value, each.low, each.high) for each in found]).reshape(-1, 3)[order].T
    axes.errorbar(
        np.array(at)[order], mean, yerr=(mean - low, high - mean), fmt=style, markersize=4, linewidth=0.9,
        capsize=3, label=label or "all runs",
    )  # fmt: skip


def _tick(axes: Axes, places: Mapping[Any, float], *, is_number: bool) -> None:
    at = list(places.values())
    margin = 0.07 * float(np.ptp(at)) if is_number and len(at) > 1 else 0.5
    axes.set_xlim(min(at) - margin, max(at) + margin)
    if not is_number:
        names = [_text(value) for value in places]
        slanted: dict[str, Any] = {"rotation": 30, "ha": "right"} if sum(map(len, names)) > LONG_NAMES else {}
        axes.set_xticks(at, names, parse_math=False, **slanted)
    elif len(at) <= MOST_TICKS and (len(at) == 1 or np.diff(np.sort(at)).min() > np.ptp(at) / 12.0):
        axes.set_xticks(at, [_text(value) for value in places])
    elif all(isinstance(value, int) for value in places):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _caption(
    rows: pa.Table, shown: pa.Table, others: Sequence[str], *, pooled: bool, mark: str, has_intervals: bool
) -> str:
    """Return what points, bars and lines are, and which runs are missing."""
    seeds = len(set(rows.column("seed").to_pylist()))
    interval = f"mean and {CONFIDENCE:.0%} interval of the mean (Student's t)"
    parts = [
        interval if has_intervals else "one flight each, so without intervals",
        f"{len(shown)} runs, {seeds} seed{'s' if seeds > 1 else ''}",
    ]
    if others:
        parts.append(
            f"pooled over {', '.join(others)}" if pooled else f"a {mark} for each {', '.join(others)}"
        )
    missing = Counter(rows.column("status").to_pylist())[FAILED]
    if missing:
        parts.append(f"{missing} failed run{'s' if missing > 1 else ''} left out")
    return f"{'; '.join(parts[:2])}\n{'; '.join(parts[2:])}".strip()
