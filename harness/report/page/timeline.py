"""What happened when: phases, modes and failsafes of every vehicle as bars, events as marks and in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autopilot.logs.vehicle_record import NO_PHASE
from harness.records.event_words import Level, in_words
from harness.report.page.encoding import plot_text
from harness.report.page.plots import BAD, NEUTRAL, QUALITATIVE, TIME, Plot, axis

MOST_BARS = 3_000
"""Bars of the time line; with more, phases and modes are shown at fewer instants"""
MOST_EVENTS = 500
"""Events that are marked and listed; all are in events.jsonl"""
MODE_COLOURS = ("#a9b4c2", "#c9bfae", "#9fc3b5", "#b9a7c7", "#c2b280", "#8fa3b8", "#d0b5b5", "#b5c99a")
_ROW_PX, _MANY_ROW_PX, _MANY = 38, 16, 16


@dataclass(frozen=True, slots=True)
class Segment:
    """A value of one vehicle over a time."""

    vehicle: int
    value: int
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class EventRow:
    """An event in words."""

    time_s: float
    vehicle: int | None
    """None: of the whole run"""
    kind: str
    text: str
    is_bad: bool


def segments(time_s: NDArray[Any], values: NDArray[Any], alive: NDArray[np.bool_]) -> list[Segment]:
    """Return the times of constant values (T, N) of living vehicles, by vehicle and time.

    A segment ends at the first instant of the next one, or at the last instant at which its vehicle lived. Of
    very many changes, such as of a mode that alternates, only those at some instants are found.
    """
    if not len(time_s):
        return []
    rows = np.arange(len(time_s))
    while True:
        shown = np.where(alive[rows], values[rows].astype(np.int32), -1).astype(np.int32)
        changes = np.count_nonzero(shown[1:] != shown[:-1])
        if changes + shown.shape[1] <= MOST_BARS or len(rows) < 3:
            break
        rows = rows[::2] if len(rows) % 2 else np.append(rows[::2], rows[-1])
    found = []
    for i in range(shown.shape[1]):
        column = shown[:, i]
        starts = np.flatnonzero(np.diff(column, prepend=column[0] - 1))
        ends = np.append(starts[1:], len(rows) - 1)
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            if column[start] >= 0:
                found.append(
                    Segment(i, int(column[start]), float(time_s[rows[start]]), float(time_s[rows[end]]))
                )
    return found


def event_rows(events: Sequence[Mapping[str, Any]]) -> list[EventRow]:
    """Return the events of ``events.jsonl`` in words, in their order."""
    found = []
    for event in events:
        words = in_words(event)
        text = words.text[:1].upper() + words.text[1:]
        is_bad = words.level is not Level.INFO
        found.append(EventRow(event["time_us"] / 1e6, words.vehicle, str(event["event"]), text, is_bad))
    return found


def shown_events(events: Sequence[EventRow]) -> list[EventRow]:
    """Return the events that are marked and listed, in their order; of many, failures first."""
    chosen = sorted(range(len(events)), key=lambda k: not events[k].is_bad)[:MOST_EVENTS]
    return [events[k] for k in sorted(chosen)]


def timeline_plot(
    lanes: Mapping[str, tuple[Sequence[Segment], Mapping[str, str]]],
    events: Sequence[EventRow],
    *,
    vehicles: int,
    end_s: float,
) -> Plot:
    """Return the time line.

    ``lanes`` are the segments of phases (``Phase``), modes (``Mode``) and failsafes (``Failsafe``), each with
    the meanings of its values; a lane without segments is left out.
    """
    data: list[dict[str, Any]] = []
    present = {name: lane for name, lane in lanes.items() if lane[0]}
    places = {"Phase": (-0.40, 0.40), "Mode": (0.02, 0.24), "Failsafe": (0.28, 0.12)}
    if "Phase" not in present:
        places["Mode"] = (-0.40, 0.64)
    for lane, (found, meanings) in present.items():
        first_of_lane, colour = True, cycle(MODE_COLOURS if lane == "Mode" else QUALITATIVE)
        for value in dict.fromkeys(each.value for each in found):
            chosen = [each for each in found if each.value == value]
            offset, width = places[lane]
            name = meanings.get(str(value), f"{lane.lower()} {value}")
            bar = {
                "type": "bar",
                "orientation": "h",
                "name": plot_text(name),
                "legendgroup": lane,
                "y": [each.vehicle + offset + width / 2.0 for each in chosen],
                "base": [round(each.start_s, 3) for each in chosen],
                "x": [round(each.end_s - each.start_s, 3) for each in chosen],
                "width": width,
                "marker": {"color": BAD if lane == "Failsafe" else next(colour)},
                "customdata": [[each.vehicle, each.start_s, each.end_s] for each in chosen],
                "hovertemplate": f"{lane}: {plot_text(name)}<br>%{{customdata[1]:.2f}} to "
                "%{customdata[2]:.2f} s<extra>UAV %{customdata[0]}</extra>",
            }
            if first_of_lane:
                bar["legendgrouptitle"] = {"text": lane}
                first_of_lane = False
            data.append(bar)
    data += _marks(shown_events(events))
    labels = list(range(0, vehicles, 1 if vehicles <= _MANY else 4))
    row_px = _ROW_PX if vehicles <= _MANY else _MANY_ROW_PX
    layout = {
        "barmode": "overlay",
        "hovermode": "closest",
        "xaxis": TIME | {"range": [0, max(end_s, 1e-3)], "zeroline": False},
        "yaxis": axis(
            "",
            tickvals=[-1, *labels],
            ticktext=["run", *(f"UAV {i}" for i in labels)],
            range=[vehicles - 0.4, -1.6],
            showgrid=False,
            zeroline=False,
        ),
        "legend": {"orientation": "v", "x": 1.01, "y": 1.0, "tracegroupgap": 6},
    }
    return Plot(
        key="timeline",
        title="What happened when",
        data=data,
        layout=layout,
        is_wide=True,
        over_time=True,
        height_px=max(300, 110 + row_px * (vehicles + 1)),
        note="" if present else "The run has no records of the vehicles.",
    )


def _marks(events: Sequence[EventRow]) -> list[dict[str, Any]]:
    """Return the events as marks: those of the run above the vehicles."""
    data = []
    for name, symbol, colour, chosen in (
        ("failures, faults", "x", BAD, [each for each in events if each.is_bad]),
        ("events", "diamond", NEUTRAL, [each for each in events if not each.is_bad]),
    ):
        if chosen:
            data.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": name,
                    "legendgroup": "Events",
                    "x": [each.time_s for each in chosen],
                    "y": [-1 if each.vehicle is None else each.vehicle for each in chosen],
                    "marker": {
                        "symbol": symbol,
                        "size": 10,
                        "color": colour,
                        "line": {"width": 1, "color": "#fff"},
                    },
                    "text": [plot_text(each.text) for each in chosen],
                    "hovertemplate": "%{text}<br>t = %{x:.3f} s<extra></extra>",
                }
            )
    if data:
        data[0]["legendgrouptitle"] = {"text": "Events"}
    return data


def phases_of(values: NDArray[Any]) -> NDArray[Any]:
    """Return the phases (T, N) with -1 where a vehicle has no application."""
    return np.where(values == NO_PHASE, -1, values.astype(np.int32))
