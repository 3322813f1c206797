"""Figures of a run: tracks, formation errors, channel occupancy, ranging errors; `save` writes any figure.

Drawn with matplotlib's objects only: no window, no global state.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from foundation.types import Array
from harness.records.flight import Flight
from harness.report.formation_error import ErrorSeries, FormationError
from harness.report.vehicle_colours import vehicle_colours
from harness.world.wind.config import WindConfig, direction_ned

DPI = 150
FORMATS = ("png", "pdf")
SHOWN_ON_THE_WAY = 13
"""Number of instants at which a moving formation is marked on the map."""
MOST_INSTANTS = 10_000
"""Instants that are drawn, several for each dot of a figure's width; a flight of 400 s has as many."""
LEGEND_VEHICLES = 12
"""Largest number of vehicles with a legend; more have a colour bar."""
DOTTED_POINTS = 60
"""Largest number of points of a line that are marked."""
STACKED_ASPECT = 0.7
"""Largest height over width of a map above the heights; a taller one is beside them."""
_BELOW: Final = "outside lower center"


def save(figure: Figure, path: Path, title: str) -> list[str]:
    """Write a figure with a title above all panels as PNG and PDF; returns the names of the files.

    The suffixes are appended to ``path``. The PDF has no date: equal figures give equal bytes. Draws each
    file once, which `Figure.savefig` does twice.
    """
    figure.suptitle(title, parse_math=False)
    figure.set_dpi(DPI)
    png, pdf = (path.with_name(f"{path.name}.{suffix}") for suffix in FORMATS)
    as_png: Any = FigureCanvasAgg(figure)  # its methods have no types
    as_png.print_png(png)
    figure.set_layout_engine("none")  # the layout of the first file is that of the second
    as_pdf: Any = FigureCanvasPdf(figure)
    as_pdf.print_pdf(pdf, metadata={"CreationDate": None})
    return [png.name, pdf.name]


def tracks_figure(flight: Flight, wind: WindConfig) -> Figure:
    """Return a map of the tracks with the mean wind, and heights over time; T >= 1.

    If the formation moves, the desired tracks are dashed. Of a long flight `MOST_INSTANTS` are drawn.
    """
    figure, plan, profile, rose = _track_panels(flight)
    rows = drawn_instants(len(flight))
    time_s = flight.time_us[rows] / 1e6
    moves = bool((flight.desired_pos_ned_m != flight.desired_pos_ned_m[0]).any())
    flight.release()
    on_the_way = np.linspace(0, len(time_s) - 1, SHOWN_ON_THE_WAY).astype(int)
    size = 4 if moves else 6
    cross: dict[str, Any] = {
        "linestyle": "none", "marker": "+", "markersize": 2 * size, "markeredgewidth": 0.3 * size,
    }  # fmt: skip
    for i, colour in enumerate(vehicle_colours(flight.alive.shape[1])):
        alive = flight.alive[rows, i]
        north_m, east_m, down_m = (
            np.ma.array(flight.pos_ned_m[rows, i, axis], mask=~alive) for axis in range(3)
        )
        flight.release()
        plan.plot(east_m, north_m, color=colour, linewidth=0.9)
        profile.plot(time_s, -down_m, color=colour, linewidth=0.9)
        desired_north_m, desired_east_m, desired_down_m = flight.desired_pos_ned_m[rows, i].T
        if moves:
            plan.plot(desired_east_m, desired_north_m, "--", color="0.2", linewidth=0.4, zorder=3)
            plan.plot(east_m[on_the_way], north_m[on_the_way], "o", color=colour, markersize=3)
        plan.plot(desired_east_m[-1], desired_north_m[-1], color=colour, **cross)
        profile.plot(time_s, -desired_down_m, "k--", linewidth=1.0, zorder=1)
        flight.release()
        living = np.flatnonzero(alive)
        if len(living) > 0:
            first, last = living[0], living[-1]
            plan.plot(
                east_m[first], north_m[first], "s", markeredgecolor=colour, color="white", markersize=size
            )
            # a cross at the position of a loss
            marker, marker_size = ("o", size) if last == len(time_s) - 1 else ("X", size + 3)
            plan.plot(
                east_m[last],
                north_m[last],
                marker,
                color=colour,
                markeredgecolor="black",
                markersize=marker_size,
            )
    plan.set(xlabel="East (m)", ylabel="North (m)", title="Tracks")
    plan.set_aspect("equal", adjustable="datalim")
    profile.set(xlabel="Time (s)", ylabel="Height over the site (m)", title="Heights")
    _finish(plan)
    _finish(profile)
    _draw_wind(rose, wind, float(-flight.desired_pos_ned_m[0, :, 2].mean()))
    marks = [
        _mark("s", "start", size, markeredgecolor="0.3", color="white"),
        _mark("o", "last position", size, color="0.6", markeredgecolor="black"),
        Line2D([], [], color="0.3", label="desired place at the end", **cross),
        Line2D([], [], color="black", linestyle="--", linewidth=1.0, label="desired"),
    ]
    if not flight.alive[-1].all():
        marks.insert(2, _mark("X", "lost", size + 3, color="0.6", markeredgecolor="black"))
    if moves:
        interval_s = (time_s[-1] - time_s[0]) / (SHOWN_ON_THE_WAY - 1)
        marks.insert(1, _mark("o", f"every {interval_s:.3g} s", 3, color="0.3"))
    _explain_colours(figure, (plan, profile), flight.alive.shape[1], marks)
    return figure


def formation_error_figure(time_us: NDArray[np.int64], error: FormationError) -> Figure:
    """Return a figure of each vehicle's absolute and shape errors, with the RMS over vehicles."""
    figure = Figure(figsize=(9.0, 6.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    _draw_errors(upper, time_us, error.absolute, "Absolute: from the desired places")
    _draw_errors(lower, time_us, error.shape, "Shape: after the best rigid alignment")
    lower.set_xlabel("Time (s)")
    rms = Line2D([], [], color="black", linewidth=1.8, label="rms over vehicles")
    _explain_colours(figure, (upper, lower), error.absolute.error_m.shape[1], [rms])
    return figure


def channel_figure(time_us: NDArray[np.int64], busy_fraction: Array) -> Figure:
    """Return a figure of the busy fraction, (K,) 0 to 1, in intervals ending at ``time_us`` (K,); K >= 1."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    axes = figure.subplots()
    marker = "." if len(time_us) <= DOTTED_POINTS else ""
    axes.plot(
        time_us / 1e6, 100.0 * busy_fraction, linewidth=0.9, marker=marker, label="over the interval before"
    )
    mean_percent = 100.0 * float(np.mean(busy_fraction))
    axes.axhline(
        mean_percent, color="black", linestyle="--", linewidth=1.0, label=f"mean {mean_percent:.1f} %"
    )
    axes.set(xlabel="Time (s)", ylabel="Channel busy (%)", title="Occupancy of the 802.11 channel")
    axes.set_ylim(bottom=0.0)
    _finish(axes)
    figure.legend(loc=_BELOW, ncols=2, fontsize="small")
    return figure


def ftm_error_figure(error_m: Array) -> Figure:
    """Return a histogram of measured minus true distances, (M,) of M >= 1 completed FTM sessions."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.subplots()
    axes.hist(error_m, bins="auto", color="C0", alpha=0.6)
    mean_m, std_m = float(np.mean(error_m)), float(np.std(error_m, ddof=1)) if len(error_m) > 1 else 0.0
    label = f"mean {round(mean_m, 3) + 0.0:.3f} m, standard deviation {std_m:.3f} m"
    axes.axvline(mean_m, color="black", linestyle="--", linewidth=1.0, label=label)
    axes.set(
        xlabel="Measured less true distance (m)",
        ylabel="Number of sessions",
        title=f"FTM distance errors, {len(error_m)} sessions",
    )
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    _finish(axes)
    figure.legend(loc=_BELOW, fontsize="small")
    return figure


def drawn_instants(count: int) -> slice | NDArray[np.int64]:
    """Return the indices of the instants that are drawn of a flight, with its first and last."""
    return slice(None) if count <= MOST_INSTANTS else np.linspace(0, count - 1, MOST_INSTANTS).astype(int)


def _track_panels(flight: Flight) -> tuple[Figure, Axes, Axes, Axes]:
    """Return a figure with panels for map, heights and wind; the map has about the shape of the tracks."""
    north_m, east_m = (_extent_m(flight, axis) for axis in (0, 1))
    aspect = max(north_m, 1.0) / max(east_m, 1.0)
    if aspect <= STACKED_ASPECT:
        map_in, heights_in = max(8.0 * aspect, 2.2), 2.4
        figure = Figure(figsize=(9.0, map_in + heights_in + 2.4), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=[8, 1], height_ratios=[map_in, heights_in])
        return (
            figure, figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, :]),
            figure.add_subplot(grid[0, 1]),
        )  # fmt: skip
    map_in = min(max(5.4 / aspect, 2.4), 6.5)
    figure = Figure(figsize=(map_in + 6.2, 7.0), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[map_in, 4.8], height_ratios=[1, 4])
    return (
        figure, figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[1, 1]), figure.add_subplot(grid[0, 1])
    )  # fmt: skip


def _extent_m(flight: Flight, axis: int) -> float:
    """Return the size along an axis of the site of all desired places and true positions."""
    true_m, desired_m, alive = flight.pos_ned_m[..., axis], flight.desired_pos_ned_m[..., axis], flight.alive
    greatest_m, least_m = desired_m.max(), desired_m.min()
    flight.release()
    greatest_m = np.maximum(true_m.max(where=alive, initial=-np.inf), greatest_m)
    least_m = np.minimum(true_m.min(where=alive, initial=np.inf), least_m)
    flight.release()
    return float(greatest_m - least_m)


def _draw_wind(axes: Axes, wind: WindConfig, height_m: float) -> None:
    """Draw an arrow to where the mean wind blows, in the map's directions, and its magnitude at a height."""
    axes.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
    axes.set_aspect("equal")
    axes.set_axis_off()
    if wind.kind == "force":
        mean = wind.force_model().mean_n
        text = f"{mean:.3g} N"
    else:
        mean = float(wind.velocity_model(height_m).mean_speed_m_s(np.array(height_m)))
        text = f"{mean:.3g} m/s\n{height_m:.3g} m above ground"
    if mean == 0.0:
        axes.set_title("No mean wind", fontsize="small")
        return
    axes.set_title(f"Mean wind\n{text}", fontsize="small")
    north, east, _ = direction_ned(wind.direction_deg, wind.vertical_fraction)
    axes.annotate(
        "", xy=(east, north), xytext=(-east, -north),
        arrowprops={"arrowstyle": "-|>", "mutation_scale": 18, "linewidth": 2.0, "color": "0.2"},
    )  # fmt: skip


def _draw_errors(axes: Axes, time_us: NDArray[np.int64], series: ErrorSeries, title: str) -> None:
    time_s = time_us / 1e6
    error_m = np.ma.array(series.error_m, mask=~series.valid)
    for i, colour in enumerate(vehicle_colours(error_m.shape[1])):
        axes.plot(time_s, error_m[:, i], color=colour, linewidth=0.7, alpha=0.8)
    rms_m = series.rms_m
    axes.plot(time_s, np.ma.sqrt((error_m**2).mean(axis=1)), color="black", linewidth=1.8)
    found = "not defined" if rms_m is None else f"rms {rms_m:.2f} m"
    axes.set(ylabel="Error (m)", title=f"{title}; {found}")
    axes.set_ylim(bottom=0.0)
    _finish(axes)


def _explain_colours(figure: Figure, panels: Sequence[Axes], count: int, marks: Sequence[Line2D]) -> None:
    """Add a legend below the panels: marks, and the colours of vehicles; many have a colour bar instead."""
    colours = vehicle_colours(count)
    lines: list[Artist] = []
    if count <= LEGEND_VEHICLES:
        lines = [Line2D([], [], color=colour, label=f"UAV {i}") for i, colour in enumerate(colours)]
    else:
        edges = np.arange(count + 1) - 0.5
        shown = ScalarMappable(BoundaryNorm(edges, count), ListedColormap(colours))
        bar = figure.colorbar(shown, ax=list(panels), label="UAV", pad=0.01, aspect=40)
        bar.locator = MaxNLocator(integer=True)
        bar.minorticks_off()
        bar.update_ticks()
    figure.legend(handles=[*lines, *marks], loc=_BELOW, ncols=6, fontsize="small")


def _mark(marker: str, label: str, size: float, *, color: str, markeredgecolor: str | None = None) -> Line2D:
    return Line2D(
        [], [], linestyle="none", marker=marker, label=label, markersize=size, color=color,
        markeredgecolor=markeredgecolor or color,
    )  # fmt: skip


def _finish(axes: Axes) -> None:
    axes.grid(alpha=0.3)
    axes.margins(x=0.02)
