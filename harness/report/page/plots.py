"""Figures of a page as Plotly's data and layout: lines over time, histograms, maps, matrices.

Colours of texts, axes and backgrounds are not set here: the page's script takes them from its style, light
or dark. A trace that belongs to one UAV has its number in ``meta``, by which the page shows and hides it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.report.page.encoding import plot_text, singles
from harness.report.vehicle_colours import vehicle_colours

HEIGHT_PX = 320
QUALITATIVE = (
    "#4c78a8",
    "#f58518",
    "#54a24b",
    "#b279a2",
    "#eeca3b",
    "#72b7b2",
    "#ff9da6",
    "#9d755d",
    "#e45756",
    "#79706e",
    "#8cd17d",
    "#499894",
    "#d37295",
    "#b6992d",
)
GOOD, BAD, NEUTRAL = "#2f9e62", "#d64545", "#8a8f98"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plot:
    """A figure of the page."""

    key: str
    """Name of its element, unique on the page"""
    title: str
    """Plain text, over the figure and not in it"""
    data: list[dict[str, Any]]
    layout: dict[str, Any] = field(default_factory=dict)
    note: str = ""
    """What is drawn, and at which rate"""
    height_px: int = HEIGHT_PX
    is_wide: bool = False
    """Whether the figure takes the width of the page"""
    over_time: bool = False
    """Whether its horizontal axis is the simulated time in s, at which a click sets the replay"""

    def content(self) -> dict[str, Any]:
        """Return the figure for the page's script."""
        return {"data": self.data, "layout": self.layout, "time": self.over_time}


def axis(title: str, **more: Any) -> dict[str, Any]:  # noqa: ANN401  any setting of an axis
    """Return the settings of an axis with a title."""
    return {"title": {"text": title}, **more}


TIME = axis("Simulated time (s)")


def vehicle_lines(
    time_s: NDArray[Any], values: NDArray[Any], *, digits: int = 3, unit: str = ""
) -> list[dict[str, Any]]:
    """Return a line over time for each vehicle: values (P, N) at times (P,)."""
    x = singles(time_s)
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": f"UAV {i}",
            "x": x,
            "y": singles(values[:, i]),
            "line": {"color": colour, "width": 1.1},
            "meta": {"uav": i},
            "showlegend": False,
            "hovertemplate": f"%{{y:.{digits}f}}{plot_text(f' {unit}'.rstrip())}<extra>UAV {i}</extra>",
        }
        for i, colour in enumerate(vehicle_colours(values.shape[1]))
        if np.isfinite(values[:, i]).any()
    ]


def line(
    x: NDArray[Any],
    y: NDArray[Any],
    name: str,
    colour: str,
    **more: Any,  # noqa: ANN401  any setting
) -> dict[str, Any]:
    """Return one line; ``more`` are settings of the trace."""
    return {
        "type": "scatter",
        "mode": "lines",
        "name": plot_text(name),
        "x": singles(x),
        "y": singles(y),
        "line": {"color": colour, "width": 1.6},
        **more,
    }


def time_plot(
    key: str,
    title: str,
    label: str,
    data: Sequence[dict[str, Any]],
    *,
    note: str = "",
    **layout: Any,  # noqa: ANN401
) -> Plot:
    """Return a figure over the simulated time; ``layout`` are further settings of the vertical axis."""
    return Plot(
        key=key,
        title=title,
        data=list(data),
        note=note,
        over_time=True,
        layout={"xaxis": TIME, "yaxis": axis(label, **layout), "hovermode": "closest"},
    )


def rate_note(bin_s: float) -> str:
    """Return in words what the points of an envelope show; ``bin_s`` is 0 if every instant is there."""
    return f"least and greatest value of every {bin_s:.3g} s" if bin_s else "every recorded instant"


def histogram(key: str, title: str, label: str, values: NDArray[Any], *, note: str, colour: str) -> Plot:
    """Return a histogram of values (M,), M >= 1, counted here: the page has the bins only."""
    counts, edges = np.histogram(values, bins=histogram_bins(values))
    centres = (edges[1:] + edges[:-1]) / 2.0
    width = float(edges[1] - edges[0])
    bars = {
        "type": "bar",
        "x": singles(centres),
        "y": counts.tolist(),
        "width": width,
        "marker": {"color": colour, "opacity": 0.8},
        "showlegend": False,
        "hovertemplate": "%{x:.3f}: %{y}<extra></extra>",
    }
    layout = {"xaxis": axis(label), "yaxis": axis("Number"), "bargap": 0.0}
    return Plot(key=key, title=title, data=[bars], layout=layout, note=note)


def histogram_bins(values: NDArray[Any]) -> int:
    """Return the number of bins by Freedman and Diaconis, from 10 to 120."""
    if len(values) < 2:
        return 10
    low, high = np.percentile(values, (25, 75))
    width = 2.0 * float(high - low) / len(values) ** (1.0 / 3.0)
    span = float(values.max() - values.min())
    return int(np.clip(span / width, 10, 120)) if width > 0.0 else 10


def matrix(
    key: str, title: str, values: NDArray[Any], *, note: str, unit: str, diverging: bool = False
) -> Plot:
    """Return a matrix (N, N), such as of initiators and peers, as a coloured table; NaN is left out."""
    count = len(values)
    heat = {
        "type": "heatmap",
        "z": singles(values),
        "colorscale": "RdBu" if diverging else "Viridis",
        "hovertemplate": f"%{{y}} to %{{x}}: %{{z:.3g}} {plot_text(unit)}<extra></extra>",
        "xgap": 1,
        "ygap": 1,
        "colorbar": {"title": {"text": plot_text(unit)}, "thickness": 12},
        **({"zmid": 0.0} if diverging else {}),
    }
    if count <= 12:
        heat |= {"texttemplate": "%{z:.2g}"}
    ticks = {"tickmode": "linear", "tick0": 0, "dtick": max(1, count // 12)}
    layout = {
        "xaxis": axis("Peer", **ticks, constrain="domain", showgrid=False),
        "yaxis": axis(
            "Initiator", **ticks, autorange="reversed", scaleanchor="x", constrain="domain", showgrid=False
        ),
    }
    return Plot(key=key, title=title, data=[heat], layout=layout, note=note, height_px=400)
