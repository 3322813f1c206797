"""Figures of patterns and of the maximum gain, as the article's figures 3 and 4; cuts and envelopes.

Figures use matplotlib's objects without pyplot: no window, no global state. The caller saves them.
"""

from collections.abc import Mapping
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.projections.polar import PolarAxes

from antenna.analysis.features import main_lobe
from antenna.analysis.patterns import HALF_POWER_DB, Pattern
from antenna.analysis.statistics import (
    Envelope,
    gain_density,
    gain_statistics,
    gain_towards_dbi,
    refined_gain_dbi,
)
from antenna.model.geometry import Array

GAIN_RANGE_DBI = (-30.0, 18.0)
"""Colour range of a pattern, as in the article."""
GAIN_STEP_DB = 6.0
DRAWN_STEP_DEG = 0.5
"""Step of a drawn pattern: a null narrower than the step would look like a string of beads."""
OUTLINE = "half power of the main lobe (3 dB below its maximum)"
CUT_FLOOR_DBI = -20.0
"""Gain at the centre of a polar cut; lower gains are drawn there."""


def patterns_figure(patterns: Mapping[str, Pattern]) -> Figure:
    """Return a figure with one panel per pattern, titled by key and maximum, on one colour scale.

    Main lobes are outlined at half power, as a legend says, unless no grid resolves its lobe.
    """
    figure = Figure(figsize=(5.2 * len(patterns) + 1.0, 4.2), layout="constrained")
    panels = figure.subplots(1, len(patterns), sharey=True, squeeze=False)[0]
    outlined = False
    for axes, (title, pattern) in zip(panels, patterns.items(), strict=True):
        image = draw_pattern(axes, pattern)
        outlined |= _outline_main_lobe(axes, pattern)
        axes.set_title(
            f"{title}: {pattern.max_gain_dbi:.2f} dBi at θ {pattern.max_theta_deg:.0f}°,"
            f" φ {pattern.max_phi_deg:.0f}°"
        )
    panels[0].set_ylabel("θ from zenith (°)")
    ticks = np.arange(GAIN_RANGE_DBI[0], GAIN_RANGE_DBI[1] + 0.1, GAIN_STEP_DB)
    figure.colorbar(image, ax=list(panels), label="Gain (dBi)", ticks=ticks, extend="min", pad=0.02)
    if outlined:
        line = Line2D([], [], color="black", linewidth=1.5, label=OUTLINE)
        figure.legend(handles=[line], loc="outside lower center", fontsize="small")
    return figure


def gain_density_figure(series: Mapping[str, Array], ideal_dbi: float | None) -> Figure:
    """Return a figure of the densities of the maximum gain of one or more flights, (K,) dBi each.

    A line shows the ideal formation's gain unless it is None.
    """
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    for i, (name, max_gain_dbi) in enumerate(series.items()):
        density, colour = gain_density(max_gain_dbi), f"C{i}"
        found = gain_statistics(max_gain_dbi)
        title = f"{name}: {found.mean_dbi:.2f} ± {found.std_db:.2f} dBi"
        if len(density.gain_dbi) == 0:  # all equal: a line, since the density is infinite
            axes.axvline(float(max_gain_dbi[0]), color=colour, label=title)
            continue
        axes.stairs(density.histogram_per_db, density.bin_edges_dbi, fill=True, alpha=0.25, color=colour)
        axes.plot(density.gain_dbi, density.kernel_per_db, color=colour, label=title)
    if ideal_dbi is not None:
        axes.axvline(
            ideal_dbi, color="black", linestyle="--", linewidth=1.0, label=f"ideal: {ideal_dbi:.2f} dBi"
        )
    axes.set(xlabel="Maximum gain (dBi)", ylabel="Probability density (1/dB)")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    return figure


def cuts_figure(patterns: Mapping[str, Pattern]) -> Figure:
    """Return polar cuts of total gain: the horizon, and the great circle through zenith and end-fire axis."""
    figure = Figure(figsize=(9.6, 5.4), layout="constrained")
    azimuth, elevation = (
        cast("PolarAxes", figure.add_subplot(1, 2, panel, projection="polar")) for panel in (1, 2)
    )
    angles_deg = np.arange(0.0, 360.5, 1.0)
    highest_dbi = max(pattern.max_gain_dbi for pattern in patterns.values())
    for i, (name, pattern) in enumerate(patterns.items()):
        title = f"{name}: {pattern.max_gain_dbi:.2f} dBi"
        horizon_dbi = [gain_towards_dbi([pattern], 90.0, phi)[0] for phi in angles_deg]
        # of 90 and 270 degrees, the two halves of the circle
        meridian_dbi = [
            gain_towards_dbi([pattern], min(a, 360.0 - a), 90.0 if a <= 180.0 else 270.0)[0]
            for a in angles_deg
        ]
        azimuth.plot(
            np.radians(angles_deg), np.maximum(horizon_dbi, CUT_FLOOR_DBI), color=f"C{i}", label=title
        )
        elevation.plot(np.radians(angles_deg), np.maximum(meridian_dbi, CUT_FLOOR_DBI), color=f"C{i}")
    elevation.set_theta_zero_location("N")
    elevation.set_theta_direction(-1)
    elevation.set_xticks(np.radians(np.arange(0, 360, 45)))
    elevation.set_xticklabels(["θ 0°", "45°", "90°", "135°", "180°", "135°", "90°", "45°"])
    azimuth.set_xlabel("horizon (θ 90°), by φ")
    elevation.set_xlabel("through the end-fire axis: φ 90° on the right")
    top_dbi = 5.0 * np.ceil(highest_dbi / 5.0)
    for axes in (azimuth, elevation):
        axes.set_ylim(CUT_FLOOR_DBI, max(top_dbi, CUT_FLOOR_DBI + 10.0))
        axes.set_yticks(np.arange(CUT_FLOOR_DBI + 10.0, axes.get_ylim()[1] + 0.1, 10.0))
        axes.set_rlabel_position(22.5)
        axes.grid(alpha=0.4)
    figure.legend(*azimuth.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize="small")
    return figure


def envelope_figure(envelope: Envelope, ideal: Pattern | None = None) -> Figure:
    """Return a figure of mean, quantile bands and extremes at the horizon and through the end-fire axis."""
    figure = Figure(figsize=(9.6, 6.4), layout="constrained")
    quantiles = sorted(envelope.quantiles_dbi)
    bands = [
        (envelope.min_dbi, envelope.max_dbi, 0.12, "least to greatest"),
        *(
            (envelope.quantiles_dbi[a], envelope.quantiles_dbi[1.0 - a], 0.2, f"middle {1.0 - 2.0 * a:.0%}")
            for a in quantiles
            if a < 0.5 and 1.0 - a in envelope.quantiles_dbi
        ),
    ]
    panels = figure.subplots(2, 1, sharey=True)
    top_dbi = max(GAIN_RANGE_DBI[1], float(np.ceil(envelope.max_dbi.max())))
    for axes, cut, grid_deg in (
        (panels[0], horizon_cut, envelope.phi_deg),
        (panels[1], meridian_cut, envelope.theta_deg),
    ):
        for low_dbi, high_dbi, alpha, name in bands:
            angles_deg, lows_dbi = cut(grid_deg, low_dbi)
            axes.fill_between(
                angles_deg, lows_dbi, cut(grid_deg, high_dbi)[1], color="C0", alpha=alpha, label=name
            )
        axes.plot(*cut(grid_deg, envelope.mean_dbi), color="C0", label=f"mean of {envelope.samples}")
        if ideal is not None:
            own_deg = ideal.phi_deg if cut is horizon_cut else ideal.theta_deg
            axes.plot(
                *cut(own_deg, ideal.gain_dbi), color="black", linewidth=1.0, linestyle="--", label="ideal"
            )
        axes.set(xlim=(0.0, 360.0), ylim=(GAIN_RANGE_DBI[0], top_dbi), ylabel="Gain (dBi)")
        axes.set_xticks(np.arange(0, 361, 45))
        axes.grid(alpha=0.3)
    panels[0].set(xlabel="φ from broadside axis, θ 90° (°)")
    panels[1].set(xlabel="from zenith through φ 90°, nadir (180°) and φ 270° (°)")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize="small"
    )
    return figure


def horizon_cut(phi_deg: Array, gain_dbi: Array) -> tuple[Array, Array]:
    """Return angles 0 to 360 and the gains at theta 90, from gains (T, P)."""
    return np.append(phi_deg, 360.0), np.append(gain_dbi[len(gain_dbi) // 2], gain_dbi[len(gain_dbi) // 2, 0])


def meridian_cut(theta_deg: Array, gain_dbi: Array) -> tuple[Array, Array]:
    """Return angles 0 to 360 from the zenith and the gains of (T, P): down at phi 90, up at phi 270."""
    quarter = gain_dbi.shape[1] // 4
    down, up = gain_dbi[:, quarter], gain_dbi[::-1, 3 * quarter]
    return np.append(theta_deg, 180.0 + theta_deg[1:]), np.append(down, up[1:])


def draw_pattern(axes: Axes, pattern: Pattern) -> AxesImage:
    """Draw the gain over phi and theta, interpolated to `DRAWN_STEP_DEG`; return the image."""
    theta_deg, phi_deg, gain_dbi = refined_gain_dbi(pattern, DRAWN_STEP_DEG)
    low_dbi, high_dbi = GAIN_RANGE_DBI
    half_theta_deg, half_phi_deg = theta_deg[1] / 2.0, phi_deg[1] / 2.0
    image = axes.imshow(
        np.clip(gain_dbi, low_dbi, high_dbi), vmin=low_dbi, vmax=high_dbi, cmap="viridis", aspect="auto",
        origin="lower", interpolation="bilinear",
        extent=(-half_phi_deg, 360.0 + half_phi_deg, -half_theta_deg, 180.0 + half_theta_deg),
    )  # fmt: skip
    axes.set(xlim=(0.0, 360.0), ylim=(0.0, 180.0), xlabel="φ from broadside axis (°)")
    axes.set_xticks(np.arange(0, 361, 45))
    axes.set_yticks(np.arange(0, 181, 45))
    return image


def _outline_main_lobe(axes: Axes, pattern: Pattern) -> bool:
    """Draw the half-power contour of the main lobe only: other lobes are lowered below the level first.

    Returns False and draws nothing for a lobe that the grid does not resolve.
    """
    level_dbi, lobe = pattern.max_gain_dbi - HALF_POWER_DB, main_lobe(pattern)
    if not lobe.any():
        return False
    others = (pattern.gain_dbi >= level_dbi) & ~lobe
    gain_dbi = np.where(others, level_dbi - HALF_POWER_DB, np.maximum(pattern.gain_dbi, GAIN_RANGE_DBI[0]))
    turns_deg = np.concatenate([pattern.phi_deg + turn_deg for turn_deg in (-360.0, 0.0, 360.0)])
    three_turns_dbi = np.tile(gain_dbi, (1, 3))
    axes.contour(turns_deg, pattern.theta_deg, three_turns_dbi, [level_dbi], colors="black", linewidths=1.5)
    return True
