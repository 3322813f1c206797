"""Statistics of ranging: sessions by status and pair, errors over time and distance, from batches."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.report.page.channel_plots import time_bins
from harness.report.page.plots import GOOD, Plot, axis, histogram, line, matrix, time_plot

COLUMNS = ("measured_ns", "initiator", "peer", "status", "distance_m", "true_distance_m")
"""Columns of ``ftm.parquet`` that are read"""
COMPLETED = "ok"
PERCENTILES = (5.0, 50.0, 95.0)
MOST_TIMES = 150
"""Intervals with percentiles; each has 20 sessions or so in a flight of a minute"""
MOST_MATRIX = 64
"""Largest number of stations with a matrix of pairs"""


class RangingStatistics:
    """Results of ranging; time, distance and error of each completed one are kept (12 byte)."""

    def __init__(self, end_s: float) -> None:
        self._end_s = end_s
        self.by_status: dict[str, int] = {}
        self._pairs: dict[tuple[int, int], NDArray[np.float64]] = {}
        """Sessions, completed ones, sum and sum of squares of errors, by initiator and peer"""
        self._kept: list[NDArray[np.float32]] = []

    def add(self, sessions: Mapping[str, NDArray[Any]], texts: Mapping[str, Sequence[str]]) -> None:
        """Add sessions: arrays of `COLUMNS`, the status as codes of ``texts``."""
        names = texts["status"]
        for code, count in enumerate(np.bincount(sessions["status"], minlength=len(names)).tolist()):
            if count:
                self.by_status[names[code]] = self.by_status.get(names[code], 0) + count
        completed = sessions["status"] == (names.index(COMPLETED) if COMPLETED in names else -1)
        error_m = np.where(completed, sessions["distance_m"] - sessions["true_distance_m"], 0.0)
        sums = np.column_stack([np.ones(len(error_m)), completed, error_m, error_m**2])
        pairs, inverse = np.unique(
            np.column_stack([sessions["initiator"], sessions["peer"]]), axis=0, return_inverse=True
        )
        totals = np.zeros((len(pairs), 4))
        np.add.at(totals, inverse.ravel(), sums)
        for (initiator, peer), total in zip(pairs.tolist(), totals, strict=True):
            self._pairs[initiator, peer] = self._pairs.get((initiator, peer), 0.0) + total
        kept = (sessions["measured_ns"] / 1e9, sessions["true_distance_m"], error_m)
        self._kept.append(np.column_stack([each[completed] for each in kept]).astype(np.float32))

    def errors(self) -> NDArray[np.float32]:
        """Return time in s, true distance and error in m of every completed session (M, 3)."""
        self._kept = [np.concatenate(self._kept)] if self._kept else [np.empty((0, 3), np.float32)]
        return self._kept[0]

    def pair_rows(self) -> list[tuple[int, int, int, int, float | None, float | None]]:
        """Return initiator, peer, sessions, completed ones, mean error and its deviation, by pair."""
        rows = []
        for (initiator, peer), (count, completed, total, squares) in sorted(self._pairs.items()):
            mean = total / completed if completed else None
            spread = None
            if completed > 1:
                spread = float(np.sqrt(max(squares - total * total / completed, 0.0) / (completed - 1)))
            rows.append((initiator, peer, int(count), int(completed), mean, spread))
        return rows

    def plots(self) -> list[Plot]:
        """Return figures of errors and pairs; none without a session."""
        if not self._pairs:
            return []
        found, plots = self.errors(), list[Plot]()
        if len(found):
            error_m = found[:, 2].astype(np.float64)
            spread_m = float(error_m.std(ddof=1)) if len(error_m) > 1 else 0.0
            note = (
                f"{len(error_m)} sessions, mean {error_m.mean():.4f} m, standard deviation {spread_m:.4f} m"
            )
            plots += [
                histogram(
                    "ranging-error",
                    "Ranging errors",
                    "Measured less true distance (m)",
                    error_m,
                    note=note,
                    colour=GOOD,
                ),
                self._over_time(found),
                _over_distance(found),
            ]
        return plots + self._matrices()

    def _over_time(self, found: NDArray[np.float32]) -> Plot:
        edges_s = time_bins(self._end_s)
        edges_s = np.linspace(0.0, edges_s[-1], min(len(edges_s) - 1, MOST_TIMES) + 1)
        middles_s, low, middle, high = _percentiles(found[:, 0], found[:, 2], edges_s)
        note = f"of the sessions in every {edges_s[1] - edges_s[0]:.3g} s"
        return time_plot(
            "ranging-over-time",
            "Ranging errors over time",
            "Error (m)",
            _band(middles_s, low, middle, high),
            note=note,
        )

    def _matrices(self) -> list[Plot]:
        stations = 1 + max(max(pair) for pair in self._pairs)
        if stations > MOST_MATRIX or min(min(pair) for pair in self._pairs) < 0:
            return []
        share, mean = np.full((2, stations, stations), np.nan)
        for initiator, peer, count, completed, mean_m, _ in self.pair_rows():
            share[initiator, peer] = 100.0 * completed / count
            if mean_m is not None:
                mean[initiator, peer] = mean_m
        plots = [
            matrix(
                "ranging-share", "Completed sessions by pair", share, note="of the pair's requests", unit="%"
            )
        ]
        if np.isfinite(mean).any():
            plots.append(
                matrix(
                    "ranging-mean",
                    "Mean ranging error by pair",
                    mean,
                    unit="m",
                    diverging=True,
                    note="measured less true distance",
                )
            )
        return plots


def _percentiles(
    at: NDArray[Any], values: NDArray[Any], edges: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return the middles of the intervals between ``edges`` with values, and 5 %, median and 95 % there.

    The first and the last interval have what lies before and after the edges, too.
    """
    interval = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    order = np.argsort(interval, kind="stable")
    bounds = np.searchsorted(interval[order], np.arange(len(edges)))
    middles, rows = [], []
    for k, (first, last) in enumerate(itertools.pairwise(bounds)):
        if last > first:
            middles.append((edges[k] + edges[k + 1]) / 2.0)
            rows.append(np.percentile(values[order[first:last]], PERCENTILES))
    low, middle, high = np.array(rows).reshape(-1, 3).T
    return np.array(middles), low, middle, high


def _band(
    x: NDArray[Any], low: NDArray[Any], middle: NDArray[Any], high: NDArray[Any]
) -> list[dict[str, Any]]:
    edge = {"showlegend": False, "hoverinfo": "skip"}
    upper = line(x, high, "95 %", GOOD, **edge) | {"line": {"width": 0, "color": GOOD}}
    lower = line(
        x, low, "5 % to 95 %", GOOD, fill="tonexty", fillcolor="rgba(47,158,98,0.22)", hoverinfo="skip"
    )
    lower |= {"line": {"width": 0, "color": GOOD}}
    return [upper, lower, line(x, middle, "median", GOOD, hovertemplate="median %{y:.4f} m<extra></extra>")]


def _over_distance(found: NDArray[np.float32]) -> Plot:
    distance_m = found[:, 1]
    low_m, high_m = float(distance_m.min()), float(distance_m.max())
    edges_m = np.linspace(low_m, max(high_m, low_m + 1e-3) * (1.0 + 1e-6), 31)
    middles_m, low, middle, high = _percentiles(distance_m, found[:, 2], edges_m)
    data = _band(middles_m, low, middle, high)
    data[2]["mode"] = "lines+markers"
    layout = {"xaxis": axis("True distance (m)"), "yaxis": axis("Error (m)")}
    return Plot(
        key="ranging-over-distance",
        title="Ranging errors over distance",
        data=data,
        layout=layout,
        note=f"of the sessions in every {edges_m[1] - edges_m[0]:.3g} m",
    )
