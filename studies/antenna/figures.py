"""Figures of the antenna's validation as PNG files, drawn with matplotlib's object interface."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from antenna.analysis.statistics import gain_density
from studies.common.figures import new_figure, save

DASHES = ("-", "--", ":")
LEAST_DB = 1e-5
"""Smaller differences are drawn as this one."""


def save_agreement(
    path: Path, cases: Sequence[tuple[str, tuple[Sequence[float], Sequence[float]], tuple[float, float]]]
) -> None:
    """Plot cumulative shares of formations over the difference: (case, (maximum, pattern), limits), dB."""
    figure = new_figure(10.0, 4.2)
    panels = figure.subplots(1, 2, sharey=True)
    for panel, (axes, title) in enumerate(zip(panels, ("Maximum gain", "Pattern, greatest"), strict=True)):
        for i, (name, differences_db, limits_db) in enumerate(cases):
            sizes_db = np.sort(np.maximum(np.abs(differences_db[panel]), LEAST_DB))
            share = np.arange(1, len(sizes_db) + 1) / len(sizes_db)
            axes.step(sizes_db, share, where="post", color=f"C{i}", label=name)
            axes.axvline(limits_db[panel], color=f"C{i}", linestyle="--", linewidth=0.9)
        axes.set_xscale("log")
        axes.set(xlabel="Difference from NEC2 (dB)", title=f"{title}; dashed: limit")
    panels[0].set_ylabel("Share of the formations")
    panels[0].legend(fontsize="small", loc="upper left")
    save(figure, path)


def save_sensitivity(
    path: Path,
    *,
    curve: Sequence[tuple[float, float, float]],
    points: Sequence[tuple[float, float, float]],
    densities: Sequence[tuple[float, str, Sequence[float]]],
    ideal_dbi: float,
) -> None:
    """Plot gain over deviation, and densities of the maximum gain.

    ``curve`` and ``points`` are (sigma in wavelengths, mean dBi, deviation dB), the points of the reference;
    ``densities`` are (sigma in wavelengths, title, gains in dBi), with one colour for each sigma.
    """
    figure = new_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2)
    at, mean_dbi, std_db = np.array(curve).T
    left.plot(at, mean_dbi, color="C0", label="batch: mean, refined maximum")
    left.fill_between(at, mean_dbi - std_db, mean_dbi + std_db, color="C0", alpha=0.2, label="± deviation")
    for i, (x, mean, std) in enumerate(points):
        left.errorbar(
            x, mean, std, fmt="x", color="black", capsize=3, elinewidth=0.9,
            label="reference: mean ± deviation" if i == 0 else None,
        )  # fmt: skip
    left.axhline(ideal_dbi, color="black", linestyle="--", linewidth=1.0, label=f"ideal, {ideal_dbi:.2f} dBi")
    left.set_xscale("log")
    left.set(xlabel="σ of positions on each axis (wavelengths)", ylabel="Maximum gain (dBi)")
    left.legend(fontsize="small", loc="lower left")
    groups = sorted({round(at, 9) for at, *_ in densities})
    for i, group in enumerate(groups):
        alike = [(title, gains) for at, title, gains in densities if round(at, 9) == group]
        for k, (title, gains_dbi) in enumerate(alike):
            density = gain_density(np.array(gains_dbi))
            # they should coincide: the first is broad, the others are dashed
            look = {"color": f"C{i}", "linewidth": 3.5, "alpha": 0.6} if k == 0 else {"color": "black"}
            dashes = DASHES[min(k, len(DASHES) - 1)]
            right.plot(density.gain_dbi, density.kernel_per_db, dashes, label=f"{title}: {group:g}", **look)
    right.set(xlabel="Maximum gain (dBi)", ylabel="Probability density (1/dB)")
    right.set_ylim(bottom=0.0)
    right.legend(fontsize="small", loc="upper left", title="σ at wavelength: ratio")
    save(figure, path)


def save_convergence(path: Path, curves: Mapping[str, Sequence[tuple[int, float]]]) -> None:
    """Plot maximum gain over segments, (segments, dBi) by title, less the gain with the most segments."""
    figure = new_figure(6.4, 4.0)
    axes = figure.subplots()
    for i, (title, points) in enumerate(curves.items()):
        segments, gain_dbi = np.array(sorted(points)).T
        dots = "o-" if i % 2 == 0 else "x--"
        axes.plot(segments, gain_dbi - gain_dbi[-1], dots, color=f"C{i // 2}", label=title, markersize=5)
    axes.set(xlabel="Segments of a dipole", ylabel="Maximum gain less that of the most segments (dB)")
    axes.legend(fontsize="small")
    save(figure, path)
