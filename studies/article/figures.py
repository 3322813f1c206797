"""The article's figures 3 and 4 from our flights, and further figures that explain them, as PNG files."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from antenna.analysis.gain_figures import patterns_figure
from antenna.analysis.statistics import gain_density
from studies.article.campaign_data import Cell, Key
from studies.article.monte_carlo import Drawn
from studies.article.patterns import REGION_PHI_DEG, REGION_THETA_DEG
from studies.article.plan import ARTICLE, CHANGES, FIGURE_WIND_N
from studies.article.retained_flights import FLOWN, FigurePatterns
from studies.common.figures import DPI, new_figure, save

COLOURS = {5.0: "#D55E00", 7.5: "#E69F00", 10.0: "#009E73", 15.0: "#56B4E9", 20.0: "#0072B2"}
"""Palette of Okabe and Ito, suitable for colour vision deficiency"""
TAILS = 0.002
"""Share of the gains at either end that is outside the axis range"""


def save_densities(path: Path, cells: Mapping[Key, Cell], ideal_dbi: float) -> None:
    """Plot figure 3: densities of the maximum gain by wavelength, a panel for each wind."""
    winds_n = sorted({wind_n for case, _, wind_n in cells if case == ARTICLE}, reverse=True)
    panels = {f"{wind_n:g} N": _of(cells, ARTICLE, wind_n) for wind_n in winds_n}
    heights = [1.0 if wind_n > 0.0 else 0.6 for wind_n in winds_n]
    _save_panels(path, panels, heights, ideal_dbi)


def save_changes(path: Path, cells: Mapping[Key, Cell], ideal_dbi: float) -> None:
    """Plot densities in the wind of figure 4, a panel for each flown change of the scenario."""
    panels = {name: _of(cells, name, FIGURE_WIND_N) for name in (ARTICLE, *CHANGES)}
    _save_panels(path, {name: found for name, found in panels.items() if found}, None, ideal_dbi)


def _of(cells: Mapping[Key, Cell], case: str, wind_n: float) -> list[Cell]:
    found = [cell for (name, _, wind), cell in cells.items() if (name, wind) == (case, wind_n)]
    return sorted((cell for cell in found if len(cell.max_gain_dbi)), key=lambda cell: cell.wavelength_m)


def _save_panels(
    path: Path, panels: Mapping[str, Sequence[Cell]], heights: Sequence[float] | None, ideal_dbi: float
) -> None:
    count = max(len(panels), 1)
    figure = new_figure(8.0, 1.2 + 2.2 * sum(heights or [1.0] * count))
    all_axes = figure.subplots(count, 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axes, (title, cells) in zip(all_axes, panels.items(), strict=False):
        for cell in cells:
            _draw_density(axes, cell)
        axes.axvline(ideal_dbi, color="black", linestyle="--", linewidth=1.0, label=f"ideal {ideal_dbi:.2f}")
        axes.set(ylabel="Density (1/dB)")
        axes.set_title(title, loc="left", fontsize="medium")
        axes.set_ylim(bottom=0.0)
        axes.legend(fontsize="x-small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    gains = [cell.max_gain_dbi for cells in panels.values() for cell in cells]
    if gains:
        low_dbi = min(float(np.quantile(each, TAILS)) for each in gains)
        all_axes[0].set_xlim(low_dbi - 0.1 * (ideal_dbi - low_dbi), ideal_dbi + 0.2)
    all_axes[-1].set_xlabel("Maximum gain (dB)")
    save(figure, path)


def _draw_density(axes: Axes, cell: Cell) -> None:
    density, found = gain_density(cell.max_gain_dbi), cell.statistics
    colour = COLOURS.get(cell.wavelength_m, "0.4")
    label = f"λ = {cell.wavelength_m:g} m"
    if found is not None:
        label += f": {found.mean_dbi:.2f} ± {found.std_db:.2f}"
    if len(density.gain_dbi) == 0:  # equal gains: a line, because the density is infinite
        axes.axvline(float(cell.max_gain_dbi[0]), color=colour, label=label)
        return
    axes.plot(density.gain_dbi, density.kernel_per_db, color=colour, linewidth=1.4, label=label)
    axes.fill_between(density.gain_dbi, density.kernel_per_db, color=colour, alpha=0.12, linewidth=0)


def save_patterns(path: Path, patterns: FigurePatterns, *, mean: bool = False) -> None:
    """Plot figure 4: the ideal pattern and that of the median instant, or the flight's mean.

    The region in which the article finds less gain has a dashed border.
    """
    flown = {"Mean of the flight": patterns.means[FLOWN]} if mean else {"Flown": patterns.median}
    figure = patterns_figure({"Ideal": patterns.ideal, **flown})
    for axes in figure.axes[:2]:
        axes.add_patch(
            Rectangle(
                (REGION_PHI_DEG[0], REGION_THETA_DEG[0]), np.ptp(REGION_PHI_DEG), np.ptp(REGION_THETA_DEG),
                fill=False, edgecolor="white", linestyle="--", linewidth=1.4,
            )
        )  # fmt: skip
    figure.savefig(path, dpi=DPI)


def save_wind(path: Path, cells: Sequence[Cell], ideal_dbi: float) -> None:
    """Plot mean and deviation of the maximum gain against wind, by wavelength; ``cells`` is sorted."""
    figure = new_figure(9.0, 3.6)
    left, right = figure.subplots(1, 2)
    for wavelength_m, row in itertools.groupby(cells, lambda cell: cell.wavelength_m):
        found = [(cell.wind_n, cell.statistics) for cell in row if cell.statistics is not None]
        winds_n = [wind_n for wind_n, _ in found]
        style = {"color": COLOURS.get(wavelength_m, "0.4"), "label": f"λ = {wavelength_m:g} m"}
        if found:
            left.plot(winds_n, [each.mean_dbi for _, each in found], "o-", **style)
            right.plot(winds_n, [each.std_db for _, each in found], "o-", **style)
    left.axhline(ideal_dbi, color="black", linestyle="--", linewidth=1.0, label="ideal")
    left.set(ylabel="Mean maximum gain (dB)")
    right.set(ylabel="Its standard deviation (dB)")
    right.set_ylim(bottom=0.0)
    for axes in (left, right):
        axes.set(xlabel="Mean wind force (N)")
    left.legend(fontsize="small")
    save(figure, path)


def save_sigma(path: Path, drawn: Mapping[tuple[float, float], Drawn], cells: Iterable[Cell]) -> None:
    """Plot mean maximum gain against position error: random formations with ± σ, and all flights."""
    figure = new_figure(8.0, 4.2)
    axes = figure.subplots()
    sigmas_lambda, means, stds = (
        np.array(column)
        for column in zip(
            *sorted(
                (sigma_m / wavelength_m, each.statistics.mean_dbi, each.statistics.std_db)
                for (sigma_m, wavelength_m), each in drawn.items()
            ),
            strict=True,
        )
    )
    axes.plot(sigmas_lambda, means, color="black", linewidth=1.2, label="random formations, upright")
    axes.fill_between(sigmas_lambda, means - stds, means + stds, color="0.85", linewidth=0)
    markers = dict(zip((ARTICLE, *CHANGES), "o^v<>sDP", strict=False))
    shown: set[str] = set()
    for cell in cells:
        found, sigma_m = cell.statistics, cell.sigma_m
        if found is None or sigma_m is None or cell.case not in markers:
            continue
        axes.errorbar(
            sigma_m / cell.wavelength_m, found.mean_dbi, yerr=found.std_db, fmt=markers[cell.case],
            color=COLOURS.get(cell.wavelength_m, "0.4"), markersize=5, linewidth=0.8,
        )  # fmt: skip
        shown.add(cell.case)
    for case in (case for case in markers if case in shown):  # colours are used for wavelengths
        axes.plot([], [], markers[case], color="0.4", label=case)
    for wavelength_m, colour in COLOURS.items():
        axes.plot([], [], color=colour, label=f"λ = {wavelength_m:g} m")
    axes.set(xlabel="Horizontal position error per axis σ/λ", ylabel="Maximum gain, mean ± deviation (dB)")
    axes.set_xscale("log")
    axes.legend(fontsize="small", loc="lower left", ncols=2)
    save(figure, path)
