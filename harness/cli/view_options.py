"""The view of a flight as the command line requests it: options, lines for the user, the end."""

import contextlib
import os
import sys
from collections.abc import Callable
from pathlib import Path

from harness.view.live_view import LiveView
from harness.view.viewer import ViewerError, check_installed, has_display

NO_DISPLAY = "there is no display, so the viewer is shown in a browser"


class FlightView:
    """The view of one flight; ``note`` prints a line. Raises ViewerError if it was requested in vain."""

    def __init__(
        self, run: Path, *, window: bool, web: bool, record: Path | None, note: Callable[[str], None]
    ) -> None:
        check_installed()
        check_record(record)
        shown = window or web
        in_browser = (web or not has_display()) if shown else None
        if in_browser and not web:
            note(NO_DISPLAY)
        self._note, self._record = note, record
        self._view = LiveView(run, in_browser=in_browser, record=record, note=note)

    def begin(self) -> None:
        """Show a flight whose processes are ready; it goes on if that fails."""
        try:
            self._view.begin()
        except (ViewerError, OSError) as error:
            self._view.end()
            self._note(f"there is no view of this flight: {error}")
            return
        viewer = self._view.viewer
        if viewer is not None and viewer.in_browser:
            self._note(f"open {viewer.address}")

    def end_feed(self) -> None:
        """Send the rest of the flight, whose logs are closed."""
        is_whole = self._view.end_feed()
        if self._record is not None and is_whole:
            self._note(f"recorded into {self._record}: rerun {self._record} opens it")
        elif self._record is not None and self._record.exists():
            self._note(f"{self._record} is not whole; coflight replay RUN --record FILE writes all of it")

    def keep_open(self) -> None:
        """Wait until the user is done: until the window is closed or, at a terminal, Ctrl-C."""
        viewer = self._view.viewer
        if viewer is None or not viewer.is_open or (viewer.in_browser and not sys.stdin.isatty()):
            return
        where = f"at {viewer.address} until Ctrl-C" if viewer.in_browser else "until it is closed, or Ctrl-C"
        self._note(f"the viewer stays open {where}")
        with contextlib.suppress(KeyboardInterrupt):  # the usual end
            viewer.wait()

    def close(self) -> None:
        """End feed and viewer; harmless when repeated."""
        self._view.end()


def check_record(path: Path | None) -> None:
    """Raise ViewerError unless a recording can be written to a path."""
    if path is None:
        return
    if path.suffix != ".rrd":
        raise ViewerError(f"--record {path}: expected a name that ends in .rrd")
    if not path.parent.is_dir():
        raise ViewerError(f"--record {path}: there is no folder {path.parent}")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise ViewerError(f"--record {path}: no permission to write into the folder {path.parent}")
    if path.exists():
        raise ViewerError(f"--record {path}: it exists; name a new file")
