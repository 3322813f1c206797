"""Statistics of the channel: frames by kind, station and time, collected from batches of the table."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.report.page.encoding import plot_text, singles
from harness.report.page.plots import BAD, GOOD, QUALITATIVE, Plot, axis, line, time_plot

TIME_BINS = 600
"""Intervals of the figures over time"""
LEAST_BIN_S = 0.1
COLUMNS = (
    "start_ns",
    "end_ns",
    "source",
    "kind",
    "mode",
    "bytes",
    "delivered",
    "collided",
    "lost_to_noise",
)
"""Columns of ``radio.parquet`` that are read"""
OUTCOMES = ("delivered", "collided", "lost_to_noise")
_FIELDS = ("frames", "bytes", "airtime_s", *OUTCOMES)


def time_bins(end_s: float) -> NDArray[np.float64]:
    """Return the edges (B + 1,) of equal intervals of a flight of ``end_s``, for figures over time."""
    count = int(np.clip(end_s / LEAST_BIN_S, 1, TIME_BINS))
    return np.linspace(0.0, max(end_s, LEAST_BIN_S), count + 1)


class ChannelStatistics:
    """Sums over the frames of a run; memory depends on kinds, stations and intervals, not on frames."""

    def __init__(self, end_s: float) -> None:
        self.edges_s = time_bins(end_s)
        self.by_kind: dict[str, NDArray[np.float64]] = {}
        """Sums of `_FIELDS` by kind"""
        self.by_mode: dict[str, NDArray[np.float64]] = {}
        self.by_source: dict[int, NDArray[np.float64]] = {}
        bins = len(self.edges_s) - 1
        self.kinds_over_time: dict[str, NDArray[np.int64]] = {}
        """Frames of each interval (B,) by kind"""
        self.outcomes_over_time = np.zeros((bins, len(OUTCOMES)), np.int64)

    def add(self, frames: Mapping[str, NDArray[Any]], texts: Mapping[str, Sequence[str]]) -> None:
        """Add frames: arrays of `COLUMNS`, kinds and modes as codes of ``texts``."""
        start_s = frames["start_ns"] / 1e9
        sums = np.column_stack(
            [np.ones(len(start_s)), frames["bytes"], (frames["end_ns"] - frames["start_ns"]) / 1e9]
            + [frames[name] for name in OUTCOMES]
        )
        for name, target in (("kind", self.by_kind), ("mode", self.by_mode)):
            for code, text in enumerate(texts[name]):
                chosen = frames[name] == code
                if chosen.any():
                    target[text] = target.get(text, 0.0) + sums[chosen].sum(axis=0)
        for source in np.unique(frames["source"]).tolist():
            total = sums[frames["source"] == source].sum(axis=0)
            self.by_source[source] = self.by_source.get(source, 0.0) + total
        bins = len(self.edges_s) - 1
        at = np.clip(np.searchsorted(self.edges_s, start_s, side="right") - 1, 0, bins - 1)
        for code, text in enumerate(texts["kind"]):
            found = np.bincount(at[frames["kind"] == code], minlength=bins)
            if found.any():
                self.kinds_over_time[text] = self.kinds_over_time.get(text, 0) + found
        for k, name in enumerate(OUTCOMES):
            self.outcomes_over_time[:, k] += np.bincount(at, frames[name], minlength=bins).astype(np.int64)

    def table(self, sums: Mapping[Any, NDArray[np.float64]]) -> list[dict[str, float]]:
        """Return the sums of one of the groups as rows with ``name`` and the fields."""
        return [
            {"name": name, **dict(zip(_FIELDS, values.tolist(), strict=True))}
            for name, values in sorted(sums.items(), key=lambda item: item[0])
        ]

    def plots(self) -> list[Plot]:
        """Return figures of frames by kind, and of receivers by outcome, over time; none without a frame."""
        if not self.by_kind:
            return []
        width_s = float(self.edges_s[1] - self.edges_s[0])
        middles_s = (self.edges_s[1:] + self.edges_s[:-1]) / 2.0
        kinds = [
            {
                "type": "scatter",
                "mode": "lines",
                "name": plot_text(kind),
                "stackgroup": "kinds",
                "x": singles(middles_s),
                "y": singles(found / width_s),
                "line": {"width": 0.5, "color": colour, "shape": "hvh"},
                "hovertemplate": f"{plot_text(kind)}: %{{y:.1f}} per s<extra></extra>",
            }
            for colour, (kind, found) in zip(
                QUALITATIVE * 4, sorted(self.kinds_over_time.items()), strict=False
            )
        ]
        note = f"mean over {width_s:.3g} s"
        total = self.outcomes_over_time.sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            shares = 100.0 * self.outcomes_over_time / total[:, np.newaxis]
        losses = [
            line(middles_s, shares[:, k], name, colour, hovertemplate=f"{name}: %{{y:.2f}} %<extra></extra>")
            for k, name, colour in ((1, "collided", BAD), (2, "lost to noise", "#b8860b"))
        ]
        return [
            time_plot(
                "frames", "Frames on the channel", "Frames per s", kinds, note=note, rangemode="tozero"
            ),
            time_plot(
                "losses",
                "Intended receivers that lost a frame",
                "Share (%)",
                losses,
                note=note,
                rangemode="tozero",
            ),
        ]


def occupancy_plot(time_us: NDArray[np.int64], busy_fraction: NDArray[np.float64]) -> Plot | None:
    """Return the busy fraction (K,), 0 to 1, in intervals ending at ``time_us`` (K,); None if K is 0."""
    if not len(time_us):
        return None
    percent = 100.0 * busy_fraction
    mean = float(percent.mean())
    data = [
        line(
            time_us / 1e6, percent, "busy", GOOD, showlegend=False, hovertemplate="%{y:.2f} %<extra></extra>"
        )
    ]
    interval = f"{np.diff(time_us)[0] / 1e6:.3g} s before each point" if len(time_us) > 1 else "the whole run"
    plot = time_plot(
        "occupancy",
        "Occupancy of the channel",
        "Channel busy (%)",
        data,
        rangemode="tozero",
        note=f"mean {mean:.2f} %; over {interval}",
    )
    plot.layout["shapes"] = [
        {
            "type": "line",
            "xref": "paper",
            "x0": 0,
            "x1": 1,
            "y0": mean,
            "y1": mean,
            "line": {"dash": "dash", "width": 1, "color": "#8a8f98"},
        }
    ]
    return plot


def losses_plot(stations: Sequence[dict[str, float]]) -> Plot | None:
    """Return losses by transmitting station: rows of `ChannelStatistics.table`; None without one."""
    if not stations:
        return None
    names = [str(row["name"]) for row in stations]
    data: list[dict[str, Any]] = []
    for key, name, colour in (("collided", "collided", BAD), ("lost_to_noise", "lost to noise", "#b8860b")):
        shares = [
            100.0 * row[key] / total if (total := sum(row[each] for each in OUTCOMES)) else 0.0
            for row in stations
        ]
        data.append(
            {
                "type": "bar",
                "name": name,
                "x": names,
                "y": [round(share, 4) for share in shares],
                "marker": {"color": colour},
                "hovertemplate": f"station %{{x}}, {name}: %{{y:.2f}} %<extra></extra>",
            }
        )
    return Plot(
        key="losses-by-station",
        title="Losses by transmitting station",
        data=data,
        layout={
            "barmode": "stack",
            "xaxis": axis("Station", type="category"),
            "yaxis": axis("Share of intended receivers (%)"),
        },
        note="of all frames of a station; numbers from that of UAVs on are guests",
    )
