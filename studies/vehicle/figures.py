"""Figures of the validation as PNG files, drawn from arrays with matplotlib's object interface."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from foundation.types import Array
from studies.common.figures import DPI, new_figure, save

OURS, OBSERVED, PX4 = "C0", "C2", "0.6"


def save_hover_error(
    path: Path, *, period_s: float, without: Array, with_observer: Array, required_m: float
) -> None:
    """Plot distances from the setpoint (T,) of two flights in the same wind, without and with observer."""
    figure = new_figure(8.0, 3.6)
    axes = figure.subplots()
    for distance_m, colour, label in (
        (without, OURS, "default cascade"),
        (with_observer, OBSERVED, "with disturbance observer"),
    ):
        rms_m = float(np.sqrt((distance_m**2).mean()))
        time_s = period_s * np.arange(len(distance_m))
        axes.plot(time_s, distance_m, color=colour, linewidth=1.1, label=f"{label}: {rms_m:.2f} m rms")
    axes.axhline(
        required_m, color="black", linestyle="--", linewidth=1.0, label=f"required rms {required_m:g} m"
    )
    axes.set(
        xlabel="Time (s)",
        ylabel="Distance from the setpoint (m)",
        title="Hover in 5 N of wind, gusts of 1 N rms",
    )
    axes.set_ylim(0.0, 1.35 * float(without.max()))
    axes.legend(fontsize="small", ncols=3, loc="upper center")
    save(figure, path, margin=0.02)


def save_against_px4(
    path: Path, *, names: Sequence[str], px4_m: Array, ours_m: Array, observed_m: Array, tolerance: float
) -> None:
    """Plot the rms of each row as bars: real PX4 with tolerance, default cascade and observer (n, seeds)."""
    figure = new_figure(8.0, 4.0)
    axes = figure.subplots()
    at, width = np.arange(len(names)), 0.27
    axes.bar(
        at - width, px4_m, width, color=PX4, yerr=tolerance * px4_m, capsize=4,
        error_kw={"elinewidth": 1.0}, label=f"real PX4 v1.17, ±{100 * tolerance:.0f} %",
    )  # fmt: skip
    for offset, values, colour, label in (
        (0.0, ours_m, OURS, "default cascade, PX4's gains"),
        (width, observed_m, OBSERVED, "with disturbance observer"),
    ):
        axes.bar(at + offset, values.mean(axis=1), width, color=colour, label=label)
        for i, row in enumerate(values):
            axes.plot(np.full(len(row), at[i] + offset), row, ".", color="black", markersize=3, alpha=0.5)
    axes.set_xticks(at, names)
    axes.set(ylabel="3-D rms about the setpoint (m)", title="Position hold in wind; dots are single flights")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize="small", loc="upper left")
    axes.grid(axis="y", alpha=0.3)
    figure.savefig(path, dpi=DPI)


def save_steps(
    path: Path,
    *,
    period_s: float,
    moves: Sequence[tuple[str, Array, float]],
    velocities: Sequence[tuple[str, Array]],
) -> None:
    """Plot responses (T,) over the commanded step, with labels and, for moves, the allowed time."""
    figure = new_figure(9.0, 4.0)
    left, right = figure.subplots(1, 2, sharey=True)
    for i, (label, trace, allowed_s) in enumerate(moves):
        left.plot(period_s * np.arange(len(trace)), trace, color=f"C{i}", linewidth=1.3, label=label)
        left.axvline(allowed_s, color=f"C{i}", linestyle=":", linewidth=1.2)
    for i, (label, trace) in enumerate(velocities):
        right.plot(period_s * np.arange(len(trace)), trace, color=f"C{i}", linewidth=1.3, label=label)
    for axes, highest, title in (
        (left, 1.05, "Position steps; dotted: settled by then"),
        (right, 1.10, "Velocity steps, unshaped"),
    ):
        axes.axhline(highest, color="black", linestyle="--", linewidth=0.9)
        axes.axhline(1.0, color="black", linewidth=0.6)
        axes.set(xlabel="Time from the step (s)", title=title)
        axes.legend(fontsize="small", loc="lower right")
    left.set_ylabel("Response over what was asked for")
    save(figure, path, margin=0.02)


def save_upsets(path: Path, *, period_s: float, tilts_deg: Array, limit_s: float, upright_deg: float) -> None:
    """Plot the tilt of every recovery (n, T) over time, with the required limit."""
    figure = new_figure(8.0, 3.8)
    axes = figure.subplots()
    time_s = period_s * np.arange(tilts_deg.shape[1])
    axes.plot(time_s, tilts_deg.T, color=OURS, linewidth=0.5, alpha=0.25)
    axes.plot(time_s, tilts_deg.max(axis=0), color="black", linewidth=1.2, label="worst at each time")
    axes.plot(time_s, np.median(tilts_deg, axis=0), color="C1", linewidth=1.4, label="median")
    axes.plot(
        [limit_s, limit_s, time_s[-1]], [180.0, upright_deg, upright_deg], "r--", linewidth=1.2,
        label=f"required: {upright_deg:g}° from {limit_s:g} s on",
    )  # fmt: skip
    axes.set(
        xlabel="Time from the upset (s)", ylabel="Tilt (deg)", ylim=(0.0, 180.0),
        title=f"Back upright from {len(tilts_deg)} random attitudes and rates",
    )  # fmt: skip
    axes.legend(fontsize="small", loc="upper right")
    save(figure, path, margin=0.02)


def save_nees(path: Path, *, time_s: Array, means: Mapping[str, Array], band: tuple[float, float]) -> None:
    """Plot NEES per degree of freedom (e,) over time, mean of the runs, with the band of one epoch."""
    figure = new_figure(8.0, 3.8)
    axes = figure.subplots()
    axes.axhspan(*band, color="0.88", label="95 % band of one epoch")
    for i, (group, mean) in enumerate(means.items()):
        axes.plot(time_s, mean, color=f"C{i}", linewidth=1.1, label=f"{group}: {mean.mean():.2f}")
    axes.axhline(1.0, color="black", linewidth=0.8)
    axes.set(
        xlabel="Time (s)", ylabel="NEES per degree of freedom",
        title="Normalised estimation error squared, mean of the runs",
    )  # fmt: skip
    axes.set_ylim(0.0, max(2.2, 1.3 * max(float(mean.max()) for mean in means.values())))
    axes.legend(fontsize="small", ncols=3, loc="upper center")
    save(figure, path, margin=0.02)
