"""Figures of the flight: map, heights, speeds, errors, batteries, numbers of applications and of sensors."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.unit_names import unit_of
from harness.report.formation_error import ErrorSeries, FormationError
from harness.report.page.encoding import plot_text, singles
from harness.report.page.envelope import MOST_POINTS, Envelope, envelope
from harness.report.page.plots import Plot, axis, line, rate_note, time_plot, vehicle_lines
from harness.report.vehicle_colours import vehicle_colours

MAP_PX = 440
MOST_HEIGHTS = 16
"""Largest number of different desired heights that are drawn"""


def map_rows(instants: int, vehicles: int) -> NDArray[np.int64]:
    """Return the instants of which the map shows positions, with the first and the last."""
    most = max(100, MOST_POINTS // max(vehicles, 1) // 2)
    return np.unique(np.linspace(0, max(instants - 1, 0), min(instants, most)).astype(np.int64))


def map_plot(
    time_s: NDArray[Any], pos_ned_m: NDArray[Any], desired_pos_ned_m: NDArray[Any], *, note: str
) -> Plot:
    """Return the tracks from above: positions (P, N, 3), NaN of lost vehicles, and desired ones."""
    data: list[dict[str, Any]] = []
    moves = bool((desired_pos_ned_m != desired_pos_ned_m[0]).any())
    colours = vehicle_colours(pos_ned_m.shape[1])
    for i, colour in enumerate(colours):
        more = {
            "meta": {"uav": i},
            "showlegend": False,
            "customdata": singles(time_s),
            "hovertemplate": "east %{x:.2f} m, north %{y:.2f} m<br>t = %{customdata:.2f} s"
            f"<extra>UAV {i}</extra>",
        }
        data.append(line(pos_ned_m[:, i, 1], pos_ned_m[:, i, 0], f"UAV {i}", colour, **more))
        if moves:
            north_m, east_m = desired_pos_ned_m[:, i, 0], desired_pos_ned_m[:, i, 1]
            planned = line(east_m, north_m, "desired", "#8a8f98", meta={"uav": i}, showlegend=False)
            data.append(
                planned | {"line": {"color": "#8a8f98", "width": 0.7, "dash": "dot"}, "hoverinfo": "skip"}
            )
    last = desired_pos_ned_m[-1]
    data.append(
        {
            "type": "scatter",
            "mode": "markers",
            "name": "desired place at the end",
            "x": singles(last[:, 1]),
            "y": singles(last[:, 0]),
            "marker": {
                "symbol": "cross-thin",
                "size": 11,
                "color": colours,
                "line": {"width": 2, "color": colours},
            },
            "hovertemplate": "east %{x:.2f} m, north %{y:.2f} m<extra>desired place</extra>",
            "showlegend": False,
        }
    )
    layout = {
        "xaxis": axis("East (m)"),
        "yaxis": axis("North (m)", scaleanchor="x"),
        "hovermode": "closest",
    }
    return Plot(key="map", title="Tracks", data=data, layout=layout, note=note, height_px=MAP_PX)


def heights_plot(time_s: NDArray[Any], down_m: Envelope, desired_down_m: Envelope, *, bin_s: float) -> Plot:
    """Return heights over the site, and the different desired ones."""
    data = vehicle_lines(time_s[down_m.rows], -down_m.values, digits=2, unit="m")
    heights = np.unique(-desired_down_m.values, axis=1)[:, :MOST_HEIGHTS]
    for k in range(heights.shape[1]):
        dashed = line(time_s[desired_down_m.rows], heights[:, k], "desired", "#8a8f98", hoverinfo="skip")
        data.append(
            dashed
            | {
                "line": {"color": "#8a8f98", "width": 1, "dash": "dash"},
                "showlegend": k == 0,
            }
        )
    plot = time_plot("heights", "Heights", "Height over the site (m)", data, note=rate_note(bin_s))
    return replace(plot, height_px=MAP_PX)


def vehicle_plot(
    key: str,
    title: str,
    label: str,
    time_s: NDArray[Any],
    values: NDArray[Any],
    *,
    digits: int = 2,
    unit: str = "",
    note: str = "",
    **layout: Any,  # noqa: ANN401  settings of the axis
) -> Plot | None:
    """Return a figure of values (T, N) over all recorded instants; None without a number."""
    found = envelope(values)
    if not np.isfinite(found.values).any():
        return None
    bin_s = bin_seconds(time_s, found)
    data = vehicle_lines(time_s[found.rows], found.values, digits=digits, unit=unit)
    text = f"{note}; {rate_note(bin_s)}" if note else rate_note(bin_s)
    return time_plot(key, title, label, data, note=text, **layout)


def bin_seconds(time_s: NDArray[Any], found: Envelope) -> float:
    """Return the duration of a bin of an envelope; 0 if every instant is in it."""
    if found.bin_rows == 1 or len(time_s) < 2:
        return 0.0
    return float(time_s[-1] - time_s[0]) / (len(time_s) - 1) * found.bin_rows


class ErrorEnvelopes:
    """Envelopes of the errors of the formation, each with the RMS over the vehicles as its last series."""

    def __init__(self, time_us: NDArray[np.int64], error: FormationError) -> None:
        self.time_s = time_us / 1e6
        self.absolute, self.shape = (_error_envelope(each) for each in (error.absolute, error.shape))
        self.rms_m = error.absolute.rms_m, error.shape.rms_m


def _error_envelope(series: ErrorSeries) -> Envelope:
    error_m = np.where(series.valid, series.error_m, np.nan)
    defined = series.valid.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        over_all_m = np.sqrt((series.error_m**2 * series.valid).sum(axis=1) / defined)
    return envelope(np.column_stack([error_m, over_all_m]))


def error_plots(errors: ErrorEnvelopes) -> list[Plot]:
    """Return figures of absolute and shape errors."""
    plots = []
    for key, title, found, rms_m in (
        ("error-absolute", "Formation error, from the desired places", errors.absolute, errors.rms_m[0]),
        (
            "error-shape",
            "Formation error, shape: after the best rigid alignment",
            errors.shape,
            errors.rms_m[1],
        ),
    ):
        time_s = errors.time_s[found.rows]
        data = vehicle_lines(time_s, found.values[:, :-1], unit="m")
        data.append(
            line(time_s, found.values[:, -1], "RMS over UAVs", "currentColor", hovertemplate="%{y:.3f} m")
        )
        rms = "not defined" if rms_m is None else f"RMS {rms_m:.3f} m"
        note = f"{rms}; {rate_note(bin_seconds(errors.time_s, found))}"
        plots.append(time_plot(key, title, "Error (m)", data, note=note, rangemode="tozero"))
    return plots


def number_plot(key: str, name: str, time_s: NDArray[Any], values: NDArray[Any]) -> Plot | None:
    """Return a figure of a number that applications report, by the name of its column."""
    unit = unit_of(name)
    label = f"{name} ({unit})" if unit else name
    return vehicle_plot(
        key,
        name,
        plot_text(label),
        time_s,
        values,
        digits=3,
        unit=unit,
        note="reported by the on-board applications",
    )


def sensor_plots(
    series: Mapping[tuple[str, str], NDArray[np.float32]], edges_s: NDArray[Any], *, left_out: int
) -> list[Plot]:
    """Return a figure for each value of the scenario's own sensors.

    ``series`` has the least and greatest value of each bin (2 B, N) by sensor and column, and ``edges_s``
    (B + 1,) the ends of the bins.
    """
    starts, middles = edges_s[:-1], (edges_s[1:] + edges_s[:-1]) / 2.0
    time_s = np.column_stack([starts, middles]).ravel()
    plots = []
    for number, ((sensor, column), values) in enumerate(sorted(series.items())):
        unit = unit_of(column)
        label = plot_text(f"{column} ({unit})" if unit else column)
        data = vehicle_lines(time_s, values, unit=unit)
        for each in data:
            each["connectgaps"] = True
        note = rate_note(float(edges_s[1] - edges_s[0]))
        if left_out:
            note += f"; {left_out} further values are in sensors.parquet"
        plots.append(time_plot(f"sensor-{number}", f"{sensor}: {column}", label, data, note=note))
    return plots
