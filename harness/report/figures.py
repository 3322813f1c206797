"""Figures of a run as PNG files: tracks, formation errors, channel occupancy, ranging errors, antenna.

Drawn with matplotlib's objects only: no window, no global state.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from antenna.analysis.gain_figures import gain_density_figure, patterns_figure
from antenna.analysis.patterns import Pattern
from foundation.types import Array
from harness.records.flight import Flight
from harness.report.formation_error import ErrorSeries, FormationError

DPI = 150
SHOWN_ON_THE_WAY = 13
"""Number of instants at which a moving formation is marked on the map."""
LEGEND_VEHICLES = 12
"""Largest number of vehicles with a legend."""


def save_tracks(path: Path, flight: Flight) -> None:
    """Draw a map of the tracks, with desired ones if the formation moves, and heights over time; T >= 1."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    plan, profile = figure.subplots(2, 1, height_ratios=[3, 2])
    time_s = flight.time_us / 1e6
    moves = bool((flight.desired_pos_ned_m != flight.desired_pos_ned_m[0]).any())
    on_the_way = np.linspace(0, len(flight) - 1, SHOWN_ON_THE_WAY).astype(int)
    mark, cross, cross_width = (4, 8, 1.2) if moves else (6, 16, 2.0)
    for i, colour in enumerate(_colours(flight.alive.shape[1])):
        north_m, east_m, down_m = (
            np.ma.array(flight.pos_ned_m[:, i, axis], mask=~flight.alive[:, i]) for axis in range(3)
        )
        plan.plot(east_m, north_m, color=colour, linewidth=0.9, label=f"UAV {i}")
        profile.plot(time_s, -down_m, color=colour, linewidth=0.9)
        living = np.flatnonzero(flight.alive[:, i])
        if len(living) > 0:
            last = living[-1]
            marker = "o" if last == len(flight) - 1 else "X"  # a cross at the position of a loss
            plan.plot(
                east_m[last], north_m[last], marker, color=colour, markeredgecolor="black", markersize=mark
            )
        desired_north_m, desired_east_m, desired_down_m = flight.desired_pos_ned_m[:, i].T
        if moves:
            plan.plot(desired_east_m, desired_north_m, "--", color="0.2", linewidth=0.4, zorder=3)
            plan.plot(east_m[on_the_way], north_m[on_the_way], "o", color=colour, markersize=3)
        plan.plot(
            desired_east_m[-1],
            desired_north_m[-1],
            "+",
            color=colour,
            markersize=cross,
            markeredgewidth=cross_width,
        )
        profile.plot(time_s, -desired_down_m, "k--", linewidth=1.0, zorder=1)
    moving = " (desired: dashed; · at equal intervals)" if moves else ""
    plan.set(
        xlabel="East (m)",
        ylabel="North (m)",
        title=f"Tracks{moving}; + desired place, ● last position, ✖ of a lost UAV",
    )
    plan.set_aspect("equal", adjustable="datalim")
    profile.set(
        xlabel="Time (s)", ylabel="Height over the site (m)", title="Heights; the desired ones dashed"
    )
    _finish(plan)
    _finish(profile)
    if flight.alive.shape[1] <= LEGEND_VEHICLES:
        figure.legend(
            *plan.get_legend_handles_labels(), loc="outside lower center", ncols=8, fontsize="small"
        )
    figure.savefig(path, dpi=DPI)


def save_formation_error(path: Path, time_us: NDArray[np.int64], error: FormationError) -> None:
    """Draw each vehicle's absolute and shape errors, with the RMS over vehicles."""
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    _draw_errors(upper, time_us, error.absolute, "Absolute: from the desired places")
    _draw_errors(lower, time_us, error.shape, "Shape: after the best rigid alignment")
    lower.set_xlabel("Time (s)")
    figure.savefig(path, dpi=DPI)


def save_gain_density(path: Path, series: Mapping[str, Array], ideal_dbi: float) -> None:
    """Draw densities of gains: see `antenna.analysis.gain_figures.gain_density_figure`."""
    gain_density_figure(series, ideal_dbi).savefig(path, dpi=DPI)


def save_patterns(path: Path, ideal: Pattern, flown: Pattern) -> None:
    """Draw the ideal and a flown pattern, as the article's figure 4: see `flown_array.figure_patterns`."""
    patterns_figure({"Ideal": ideal, "Flown": flown}).savefig(path, dpi=DPI)


def save_channel_occupancy(path: Path, time_us: NDArray[np.int64], busy_fraction: Array) -> None:
    """Draw the busy fraction of the channel, (K,) 0 to 1, in intervals ending at ``time_us`` (K,)."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.plot(time_us / 1e6, 100.0 * busy_fraction, linewidth=0.9)
    mean_percent = 100.0 * float(np.mean(busy_fraction))
    axes.axhline(
        mean_percent, color="black", linestyle="--", linewidth=1.0, label=f"mean {mean_percent:.1f} %"
    )
    axes.set(xlabel="Time (s)", ylabel="Channel busy (%)", title="Occupancy of the 802.11 channel")
    axes.set_ylim(bottom=0.0)
    _finish(axes)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=DPI)


def save_ftm_errors(path: Path, error_m: Array) -> None:
    """Draw a histogram of measured minus true distances, (M,) of M >= 1 completed FTM sessions."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.hist(error_m, bins="auto", density=True, color="C0", alpha=0.6)
    mean_m, std_m = float(np.mean(error_m)), float(np.std(error_m))
    axes.axvline(mean_m, color="black", linestyle="--", linewidth=1.0, label=f"{mean_m:.3f} ± {std_m:.3f} m")
    axes.set(
        xlabel="Measured less true distance (m)",
        ylabel="Probability density (1/m)",
        title=f"FTM distance errors, {len(error_m)} sessions",
    )
    _finish(axes)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=DPI)


def _draw_errors(axes: Axes, time_us: NDArray[np.int64], series: ErrorSeries, title: str) -> None:
    time_s = time_us / 1e6
    error_m = np.ma.array(series.error_m, mask=~series.valid)
    for i, colour in enumerate(_colours(error_m.shape[1])):
        axes.plot(time_s, error_m[:, i], color=colour, linewidth=0.7, alpha=0.8)
    rms_m = series.rms_m
    label = "none" if rms_m is None else f"rms over vehicles (of the whole: {rms_m:.2f} m)"
    axes.plot(time_s, np.ma.sqrt((error_m**2).mean(axis=1)), color="black", linewidth=1.8, label=label)
    axes.set(ylabel="Error (m)", title=title)
    axes.margins(y=0.2)  # room for the legend
    axes.set_ylim(bottom=0.0)
    _finish(axes)
    axes.legend(fontsize="small", loc="upper right")


def _colours(count: int) -> list[str]:
    if count <= 10:
        return [f"C{i}" for i in range(count)]
    return [to_hex(rgba) for rgba in colormaps["turbo"](np.linspace(0.05, 0.95, count))]


def _finish(axes: Axes) -> None:
    axes.grid(alpha=0.3)
    axes.margins(x=0.02)
