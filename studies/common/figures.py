"""Shared form of the studies' figures."""

from pathlib import Path

from matplotlib.figure import Figure

DPI = 130


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def save(figure: Figure, path: Path, *, margin: float | None = None) -> None:
    """Write a PNG file with a grid in all axes, and a share ``margin`` of free space beside the data."""
    for axes in figure.axes:
        axes.grid(alpha=0.3)
        if margin is not None:
            axes.margins(x=margin)
    figure.savefig(path, dpi=DPI)
