"""Figures of the co-design experiment, in colours for colour vision deficiency.

Bars and bands are 95 % confidence intervals of the mean over the seeds unless a figure states otherwise.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from antenna.analysis.statistics import gain_density
from foundation.types import Array
from harness.campaign.intervals import Interval
from studies.common.figures import new_figure, save

GPS, FTM, OTHER = "#D55E00", "#0072B2", "#009E73"
"""Palette of Okabe and Ito, suitable for colour vision deficiency"""
COLOURS = {"gps": GPS, "ftm": FTM}
LABELS = {"gps": "GPS alone", "ftm": "with FTM"}
Gains = Mapping[float, Mapping[tuple[str, float], Sequence[float]]]
"""Maximum gains in dBi by wavelength, localisation and wind"""
_MARKERS = ("o", "s", "^", "D")


def save_wind(
    path: Path, winds_n: Sequence[float], shape_m: Mapping[int, Mapping[str, Sequence[Interval]]]
) -> None:
    """Plot shape error against wind, a panel for each number of vehicles, by localisation."""
    figure = new_figure(9.0, 3.8)
    panels = figure.subplots(1, len(shape_m), sharey=True, squeeze=False)[0]
    for axes, (agents, by_localisation) in zip(panels, shape_m.items(), strict=True):
        for localisation, intervals in by_localisation.items():
            _draw(axes, winds_n, intervals, COLOURS[localisation], LABELS[localisation])
        _logarithmic(axes)
        axes.set(title=f"{agents} UAVs", xlabel="Mean wind force (N)")
        axes.set_xticks(list(winds_n))
    panels[0].set_ylabel("Horizontal shape error, rms (m)")
    _legend(panels[0], fontsize="small")
    save(figure, path, margin=0.05)


def save_agents(
    path: Path,
    agents: Sequence[int],
    shape_m: Mapping[str, Sequence[Interval]],
    busy: Mapping[str, Sequence[Interval]],
) -> None:
    """Plot shape error and channel occupancy against the number of vehicles, by localisation."""
    figure = new_figure(9.0, 3.8)
    left, right = figure.subplots(1, 2)
    for localisation in shape_m:
        colour, label = COLOURS[localisation], LABELS[localisation]
        _draw(left, agents, shape_m[localisation], colour, label)
        _draw(right, agents, [_scaled(each, 100.0) for each in busy[localisation]], colour, label)
    _logarithmic(left)
    left.set(ylabel="Horizontal shape error, rms (m)", title="Shape")
    right.set(ylabel="Channel busy (%)", title="Contention")
    right.set_ylim(bottom=0.0)
    for axes in (left, right):
        axes.set_xlabel("UAVs")
        axes.set_xticks(list(agents))
        _legend(axes, fontsize="small")
    save(figure, path, margin=0.05)


def save_beacons(path: Path, periods_ms: Sequence[float], parts_m: Mapping[str, Sequence[Interval]]) -> None:
    """Plot shape error and its parts against the beacon period."""
    figure = new_figure(7.0, 4.0)
    axes = figure.subplots()
    for i, (name, intervals) in enumerate(parts_m.items()):
        _draw(axes, periods_ms, intervals, (FTM, OTHER, GPS)[i], name, marker=_MARKERS[i])
    axes.set_xscale("log")
    axes.set_xticks(list(periods_ms), [f"{period_ms:g}" for period_ms in periods_ms])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="Beacon period (ms)", ylabel="Horizontal rms after alignment (m)")
    axes.set_ylim(bottom=0.0)
    _legend(axes, fontsize="small")
    save(figure, path, margin=0.05)


def save_ranging(path: Path, points: Mapping[str, Sequence[tuple[str, Interval, Interval]]]) -> None:
    """Plot shape error against channel occupancy: for each series (policy, busy fraction, shape).

    A policy has one marker in all series, and a series one colour.
    """
    figure = new_figure(8.6, 4.4)
    axes = figure.subplots()
    names = dict.fromkeys(name for entries in points.values() for name, _, _ in entries)
    marker_of = dict(zip(names, itertools.cycle(_MARKERS), strict=False))
    for i, (series, entries) in enumerate(points.items()):
        for name, busy, shape in entries:
            if shape.count and busy.count:
                axes.errorbar(
                    100.0 * busy.value, shape.value, xerr=100.0 * _bars([busy]), yerr=_bars([shape]),
                    fmt=marker_of[name], color=(FTM, GPS, OTHER)[i], markersize=8, capsize=3,
                    markeredgecolor="white", label=f"{series}: {name}",
                )  # fmt: skip
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="Channel busy (%)", ylabel="Horizontal shape error, rms (m)")
    axes.set_ylim(bottom=0.0)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside right center", fontsize="small")
    save(figure, path, margin=0.05)


def save_gains(path: Path, gains_dbi: Gains, ideal_dbi: float) -> None:
    """Plot densities of the maximum gain, all instants of all flights: a panel for each wavelength.

    By localisation and wind.
    """
    figure = new_figure(9.6, 4.0)
    panels = figure.subplots(1, len(gains_dbi), sharex=True, squeeze=False)[0]
    for axes, (wavelength_m, series) in zip(panels, gains_dbi.items(), strict=True):
        for (localisation, wind_n), values_dbi in series.items():
            if len(values_dbi) < 2:
                continue
            at_dbi, colour = np.array(values_dbi), COLOURS[localisation]
            label = (
                f"{LABELS[localisation]}, {wind_n:g} N: {at_dbi.mean():.2f} ± {at_dbi.std(ddof=1):.2f} dBi"
            )
            density, line = gain_density(at_dbi), "-" if wind_n >= 5 else "--"
            if len(density.gain_dbi):
                axes.plot(density.gain_dbi, density.kernel_per_db, line, color=colour, label=label)
                axes.fill_between(
                    density.gain_dbi, density.kernel_per_db, color=colour, alpha=0.12, linewidth=0
                )
        axes.axvline(
            ideal_dbi, color="black", linestyle=":", linewidth=1.2, label=f"ideal: {ideal_dbi:.2f} dBi"
        )
        axes.set(title=f"λ = {wavelength_m:g} m", xlabel="Maximum gain (dBi)")
        axes.set_ylim(bottom=0.0)
        _legend(axes, fontsize="x-small", loc="upper left")
    panels[0].set_ylabel("Probability density (1/dB)")
    save(figure, path, margin=0.05)


def save_cut(
    path: Path, time_s: Array, shape_m: Array, *, cut_at_s: float, cut_s: float, usual_m: float
) -> None:
    """Plot shape error over time (seeds, T) through a channel outage: mean, band of all flights."""
    figure = new_figure(8.0, 3.8)
    axes = figure.subplots()
    axes.axvspan(cut_at_s, cut_at_s + cut_s, color="0.85", label="no channel")
    if len(shape_m):
        low_m, high_m = shape_m.min(axis=0), shape_m.max(axis=0)
        axes.fill_between(
            time_s, low_m, high_m, color=FTM, alpha=0.2, linewidth=0, label=f"{len(shape_m)} flights"
        )
        axes.plot(time_s, shape_m.mean(axis=0), color=FTM, linewidth=1.5, label="mean of all flights")
    if math.isfinite(usual_m):
        axes.axhline(
            usual_m, color="black", linestyle="--", linewidth=1.0, label=f"before: {usual_m:.2f} m rms"
        )
    axes.set(xlabel="Time in formation (s)", ylabel="Horizontal shape error (m)")
    axes.set_ylim(0.0, 1.4 * float(shape_m.max(initial=0.1)))  # leaves space for the legend
    _legend(axes, fontsize="small", loc="upper left", ncols=2)
    save(figure, path, margin=0.05)


def _draw(
    axes: Axes,
    at: Sequence[float],
    intervals: Sequence[Interval],
    colour: str,
    label: str,
    *,
    marker: str = "o",
) -> None:
    known = [(x, interval) for x, interval in zip(at, intervals, strict=True) if interval.count]
    if known:
        xs, shown = [x for x, _ in known], [interval for _, interval in known]
        axes.errorbar(
            xs, [each.value for each in shown], yerr=_bars(shown), color=colour, label=label, marker=marker,
            capsize=4, linewidth=1.4,
        )  # fmt: skip


def _bars(intervals: Sequence[Interval]) -> Array:
    """Return the lengths below and above (2, n); 0 where there is no interval."""
    below = [each.value - each.low for each in intervals], [each.high - each.value for each in intervals]
    return np.asarray(np.nan_to_num(np.array(below)))


def _scaled(interval: Interval, factor: float) -> Interval:
    return Interval(factor * interval.value, factor * interval.low, factor * interval.high, interval.count)


def _logarithmic(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())


def _legend(axes: Axes, **options: Any) -> None:  # noqa: ANN401  options of matplotlib
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**options)
