"""Figures of patterns and of the maximum gain, in the manner of the article's figures 3 and 4.

Figures are made by matplotlib's objects alone, without pyplot: no window, no global state. The caller
saves them.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import label

from antenna.geometry import Array
from antenna.patterns import Pattern
from antenna.statistics import gain_density

GAIN_RANGE_DBI = (-30.0, 18.0)
"""Colours of a pattern: the article's."""
GAIN_STEP_DB = 6.0
MAIN_LOBE_DB = 3.0
"""The main lobe is outlined at its half power."""


def patterns_figure(patterns: Mapping[str, Pattern]) -> Figure:
    """One panel for each pattern, titled by its key and its maximum, on one colour scale."""
    figure = Figure(figsize=(5.2 * len(patterns) + 1.0, 3.9), layout="constrained")
    panels = figure.subplots(1, len(patterns), sharey=True, squeeze=False)[0]
    for axes, (title, pattern) in zip(panels, patterns.items(), strict=True):
        image = draw_pattern(axes, pattern)
        axes.set_title(
            f"{title}: {pattern.max_gain_dbi:.2f} dBi at θ {pattern.max_theta_deg:.0f}°,"
            f" φ {pattern.max_phi_deg:.0f}°"
        )
    panels[0].set_ylabel("θ from zenith (°)")
    ticks = np.arange(GAIN_RANGE_DBI[0], GAIN_RANGE_DBI[1] + 0.1, GAIN_STEP_DB)
    figure.colorbar(image, ax=list(panels), label="Gain (dBi)", ticks=ticks, extend="min", pad=0.02)
    return figure


def gain_density_figure(series: Mapping[str, Array], ideal_dbi: float) -> Figure:
    """Densities of the maximum gain of one or more flights, (K,) dBi each, beside the ideal formation's."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    for i, (name, max_gain_dbi) in enumerate(series.items()):
        density, colour = gain_density(max_gain_dbi), f"C{i}"
        title = f"{name}: {np.mean(max_gain_dbi):.2f} ± {np.std(max_gain_dbi):.2f} dBi"
        if len(density.gain_dbi) == 0:  # all alike: a line, since a density would be infinite
            axes.axvline(float(max_gain_dbi[0]), color=colour, label=title)
            continue
        axes.stairs(density.histogram_per_db, density.bin_edges_dbi, fill=True, alpha=0.25, color=colour)
        axes.plot(density.gain_dbi, density.kernel_per_db, color=colour, label=title)
    axes.axvline(ideal_dbi, color="black", linestyle="--", linewidth=1.0, label=f"ideal: {ideal_dbi:.2f} dBi")
    axes.set(xlabel="Maximum gain (dBi)", ylabel="Probability density (1/dB)")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize="small")
    return figure


def draw_pattern(axes: Axes, pattern: Pattern) -> QuadMesh:
    """Gain over phi and theta with the main lobe outlined in black; returns the image, for a colour bar."""
    phi_deg = np.append(pattern.phi_deg, 360.0)
    gain_dbi = np.column_stack([pattern.gain_dbi, pattern.gain_dbi[:, 0]])
    low_dbi, high_dbi = GAIN_RANGE_DBI
    image = axes.pcolormesh(
        phi_deg,
        pattern.theta_deg,
        np.clip(gain_dbi, low_dbi, high_dbi),
        vmin=low_dbi,
        vmax=high_dbi,
        cmap="turbo",
        shading="gouraud",
        rasterized=True,
    )
    _outline_main_lobe(axes, pattern)
    axes.set(xlim=(0.0, 360.0), ylim=(0.0, 180.0), xlabel="φ from broadside axis (°)")
    axes.set_xticks(np.arange(0, 361, 45))
    axes.set_yticks(np.arange(0, 181, 45))
    return image


def main_lobe(pattern: Pattern) -> NDArray[np.bool_]:
    """(T, P) grid directions that are within `MAIN_LOBE_DB` of the maximum and connected with it."""
    high = pattern.gain_dbi >= pattern.max_gain_dbi - MAIN_LOBE_DB
    lobes, _ = label(
        np.tile(high, (1, 3))
    )  # three turns, so that a lobe across phi = 0 is whole in the middle
    turn = len(pattern.phi_deg)
    row = int(np.argmin(np.abs(pattern.theta_deg - pattern.max_theta_deg)))
    column = turn + int(np.argmin(np.abs(pattern.phi_deg - pattern.max_phi_deg)))
    inside = lobes == (lobes[row, column] or -1)
    lobe: NDArray[np.bool_] = inside.reshape(len(lobes), 3, turn).any(axis=1)
    return lobe


def _outline_main_lobe(axes: Axes, pattern: Pattern) -> None:
    """Draw the half-power contour of the main lobe alone: other lobes are sunk below the level first."""
    level_dbi = pattern.max_gain_dbi - MAIN_LOBE_DB
    others = (pattern.gain_dbi >= level_dbi) & ~main_lobe(pattern)
    gain_dbi = np.where(others, level_dbi - MAIN_LOBE_DB, np.maximum(pattern.gain_dbi, GAIN_RANGE_DBI[0]))
    turns_deg = np.concatenate([pattern.phi_deg + turn_deg for turn_deg in (-360.0, 0.0, 360.0)])
    three_turns_dbi = np.tile(gain_dbi, (1, 3))
    axes.contour(turns_deg, pattern.theta_deg, three_turns_dbi, [level_dbi], colors="black", linewidths=1.5)
