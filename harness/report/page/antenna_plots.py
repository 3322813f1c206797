"""Figures of the antenna: maximum gain over time and its distribution, cuts of the patterns."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antenna.analysis.patterns import Pattern
from harness.report.flown_array import GainSeries
from harness.report.page.encoding import singles
from harness.report.page.envelope import envelope
from harness.report.page.flight_plots import bin_seconds
from harness.report.page.plots import BAD, GOOD, NEUTRAL, Plot, histogram, line, rate_note, time_plot

LEAST_DBI_BELOW_MAX = 40.0
"""Range of the polar figures"""
_IDEAL, _FLOWN = NEUTRAL, "#4c78a8"


def gain_plots(series: GainSeries, ideal: Pattern | None) -> list[Plot]:
    """Return the maximum gain over time and its distribution; none without a pattern."""
    if not len(series.patterns):
        return []
    time_s = series.time_us / 1e6
    found = envelope(series.max_gain_dbi[:, np.newaxis])
    data = [
        line(
            time_s[found.rows],
            found.values[:, 0],
            "flown",
            _FLOWN,
            hovertemplate="%{y:.3f} dBi<extra></extra>",
        )
    ]
    if ideal is not None:
        ends_s = time_s[[0, -1]]
        data.append(line(ends_s, np.full(2, ideal.max_gain_dbi), "every UAV upright in its place", _IDEAL))
        data[-1]["line"] = {"color": _IDEAL, "width": 1.4, "dash": "dash"}
    if series.missing:
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "no pattern",
                "marker": {"symbol": "x", "color": BAD},
                "x": [each.time_us / 1e6 for each in series.missing[:200]],
                "y": [float(series.max_gain_dbi.min())] * len(series.missing[:200]),
                "text": [each.reason for each in series.missing[:200]],
                "hovertemplate": "%{text}<extra></extra>",
            }
        )
    plot = time_plot("gain", "Maximum gain", "Gain (dBi)", data, note=rate_note(bin_seconds(time_s, found)))
    note = f"{len(series.patterns)} instants in formation"
    return [
        plot,
        histogram(
            "gain-density",
            "Distribution of the maximum gain",
            "Gain (dBi)",
            series.max_gain_dbi,
            note=note,
            colour=_FLOWN,
        ),
    ]


def pattern_plots(ideal: Pattern, flown: Pattern) -> list[Plot]:
    """Return cuts of the ideal pattern and of that at the instant of median maximum gain."""
    top_dbi = float(np.ceil(max(ideal.max_gain_dbi, flown.max_gain_dbi)))
    low_dbi = top_dbi - LEAST_DBI_BELOW_MAX
    horizon = [(name, colour, each.phi_deg, _row(each, 90.0)) for name, colour, each in _both(ideal, flown)]
    upright = [(name, colour, *_circle(each, 90.0)) for name, colour, each in _both(ideal, flown)]
    return [
        _polar(
            "pattern-horizon",
            "Pattern, horizontal cut",
            horizon,
            low_dbi,
            top_dbi,
            "theta = 90°; angle: phi, from broadside (0°) to end fire (90°)",
        ),
        _polar(
            "pattern-upright",
            "Pattern, vertical cut",
            upright,
            low_dbi,
            top_dbi,
            "phi = 90° and 270°; angle: theta, 0° is up, 90° is end fire",
        ),
    ]


def _both(ideal: Pattern, flown: Pattern) -> tuple[tuple[str, str, Pattern], ...]:
    return ("every UAV upright in its place", _IDEAL, ideal), ("flown, median instant", GOOD, flown)


def _row(pattern: Pattern, theta_deg: float) -> NDArray[Any]:
    row: NDArray[Any] = pattern.gain_dbi[int(np.argmin(np.abs(pattern.theta_deg - theta_deg)))]
    return row


def _circle(pattern: Pattern, phi_deg: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the angles from up and gains of the great circle through both poles at an azimuth."""
    gain_dbi = pattern.gain_dbi
    there, back = (
        gain_dbi[:, int(np.argmin(np.abs(pattern.phi_deg - angle)))] for angle in (phi_deg, phi_deg + 180.0)
    )
    angles = np.concatenate([pattern.theta_deg, 360.0 - pattern.theta_deg[-2:0:-1]])
    return angles, np.concatenate([there, back[-2:0:-1]])


def _polar(
    key: str,
    title: str,
    cuts: list[tuple[str, str, NDArray[Any], NDArray[Any]]],
    low_dbi: float,
    top_dbi: float,
    note: str,
) -> Plot:
    data = [
        {
            "type": "scatterpolar",
            "mode": "lines",
            "name": name,
            "theta": singles(np.append(angle_deg, angle_deg[0])),
            "r": singles(np.maximum(np.append(gain_dbi, gain_dbi[0]), low_dbi)),
            "line": {"color": colour, "width": 1.6, "dash": "dash" if k == 0 else "solid"},
            "hovertemplate": "%{theta:.1f}°: %{r:.2f} dBi<extra></extra>",
        }
        for k, (name, colour, angle_deg, gain_dbi) in enumerate(cuts)
    ]
    layout = {
        "polar": {
            "radialaxis": {
                "range": [low_dbi, top_dbi],
                "ticksuffix": " dBi",
                "nticks": 5,
                "angle": 22.5,
                "tickangle": 22.5,
            },
            "angularaxis": {"rotation": 90, "direction": "clockwise"},
        },
    }
    return Plot(key=key, title=title, data=data, layout=layout, note=note, height_px=420)
