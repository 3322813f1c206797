"""The door to Rerun: entries are sent to a viewer or a file. No other module imports it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from foundation.records.private_files import write_private
from harness.view.camera import Camera
from harness.view.entries import Entry

TIMELINE = "simulated_time"
FLUSH_LIMIT_S = 5.0
"""Wall time to wait for a viewer at the end"""


class RerunSink:
    """A recording that is sent to the viewer at ``url``, to a file that only its owner can read, or both.

    Raises OSError if the file cannot be written.
    """

    def __init__(self, name: str, *, url: str | None = None, file: Path | None = None) -> None:
        self._recording = rr.RecordingStream("coflight", send_properties=False)
        sinks: list[rr.GrpcSink | rr.FileSink] = []
        if file is not None:
            write_private(file, b"")
            sinks.append(rr.FileSink(str(file)))
        if url is not None:
            sinks.append(rr.GrpcSink(url))
        self._recording.set_sinks(*sinks)
        self._recording.send_recording_name(name)

    def arrange(self, camera: Camera) -> None:
        """Send the arrangement of views, with the place from which the scene is seen at first."""
        self._recording.send_blueprint(_blueprint(camera))

    def send(self, entries: Sequence[Entry]) -> None:
        """Send entries."""
        for entry in entries:
            if entry.times_us is None:
                self._send_static(entry)
            elif len(entry.times_us):
                self._send_columns(entry)

    def _send_static(self, entry: Entry) -> None:
        if entry.kind.startswith("ViewCoordinates."):
            value = getattr(rr.ViewCoordinates, entry.kind.rpartition(".")[2])
        else:
            value = getattr(rr, entry.kind)
            value = (value.from_fields if "strips" not in entry.fields else value)(**entry.fields)
        self._recording.log(entry.path, value, static=True)

    def _send_columns(self, entry: Entry) -> None:
        columns = []
        for part in (entry, *entry.others):
            of_part = getattr(rr, part.kind).columns(**part.fields)
            columns += of_part if part.lengths is None else of_part.partition(part.lengths)
        times = rr.TimeColumn(TIMELINE, duration=np.asarray(entry.times_us).astype("timedelta64[us]"))
        self._recording.send_columns(entry.path, indexes=[times], columns=columns)

    def close(self) -> bool:
        """Send what is left, and return whether all has arrived.

        A viewer that is gone is waited for `FLUSH_LIMIT_S` at most.
        """
        is_whole = True
        try:
            self._recording.flush(timeout_sec=FLUSH_LIMIT_S)
        except (RuntimeError, ValueError):  # the viewer is gone
            is_whole = False
        self._recording.disconnect()
        return is_whole


_EVENT_COLUMNS = rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["LogLevel", "Body"])
"""Without the entity's path, which says the same as the text"""


def _plot(name: str, origin: str, *, legend: bool = False) -> rrb.TimeSeriesView:
    """Return a plot; a legend covers part of it, and is left out where title or scene say the same."""
    shown = rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend)
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=shown)


def _blueprint(camera: Camera) -> rrb.Blueprint:
    scene = rrb.Spatial3DView(
        origin="world",
        name="Swarm",
        line_grid=rrb.LineGrid3D(visible=True, spacing=5.0),
        eye_controls=rrb.EyeControls3D(
            position=camera.position_ned_m, look_target=camera.target_ned_m, eye_up=[0.0, 0.0, -1.0]
        ),
    )
    plots = rrb.Vertical(
        _plot("Formation error, m", "plots/error", legend=True),
        _plot("Height, m", "plots/height"),
        _plot("Maximum gain, dBi", "plots/gain"),
        _plot("Channel busy, %", "plots/channel"),
    )
    more = rrb.Vertical(
        _plot("Receptions of frames, 1/s", "plots/frames", legend=True),
        _plot("Ranging error (measured - true), m", "plots/ranging"),
        _plot("Battery, %", "plots/battery"),
    )
    lower = rrb.Horizontal(
        rrb.StateTimelineView(origin="states", name="Modes and failsafes"),
        rrb.TextLogView(origin="log", name="Events", columns=_EVENT_COLUMNS),
        column_shares=[3, 2],
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                scene,
                rrb.Tabs(_named(plots, "Flight"), _named(more, "Radio and battery")),
                column_shares=[3, 2],
            ),
            lower,
            row_shares=[3, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        auto_views=False,
    )


def _named(container: rrb.Vertical, name: str) -> rrb.Vertical:
    container.name = name
    return container
