"""The live view of a flight: viewer and feed as children of the launcher, which neither waits for."""

import contextlib
import os
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO

from foundation.processes.socket_owners import MARK
from harness.launch.death_report import ending
from harness.launch.process_commands import bound_module
from harness.launch.spawner import spawn
from harness.view.viewer import Viewer, last_line

END_LIMIT_S = 20.0
"""Wall time that the feed has after the flight for what a viewer still lacks"""
RECORD_LIMIT_S = 300.0
"""The same for what a recording lacks"""
SILENT_S = 3.0
"""Wall time after which a line says what is waited for"""


class LiveView:
    """Shows or records a flight from `begin` to `end`; ``note`` receives lines for the user.

    ``in_browser``: None for no viewer.
    """

    def __init__(
        self, run: Path, *, in_browser: bool | None, record: Path | None, note: Callable[[str], None]
    ) -> None:
        self._run, self._record, self._note, self._in_browser = run, record, note, in_browser
        self.viewer: Viewer | None = None
        self._feed: subprocess.Popen[bytes] | None = None
        self._is_flying = True
        self._is_ending = False

    def begin(self) -> None:
        """Start viewer and feed, once the run's folder exists. Raises ViewerError and OSError."""
        logs = self._run / "logs"
        arguments = [str(self._run)]
        if self._in_browser is not None:
            self.viewer = Viewer(logs / "viewer", in_browser=self._in_browser)
            arguments += ["--url", self.viewer.url]
            threading.Thread(target=self._watch_viewer, args=(self.viewer,), daemon=True).start()
        if self._record is not None:
            arguments += ["--record", str(self._record)]
        environment = {name: text for name, text in os.environ.items() if name != MARK}
        with (logs / "feed.log").open("wb") as log:
            self._feed = spawn(
                bound_module("harness.view.feed_program", *arguments),
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=log,
                process_group=0,
                env=environment | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )
        threading.Thread(target=self._watch_feed, args=(self._feed,), daemon=True).start()

    @property
    def feed_pid(self) -> int | None:
        """Process id of the feed, once it was started."""
        return None if self._feed is None else self._feed.pid

    def _watch_viewer(self, viewer: Viewer) -> None:
        viewer.wait()
        if self._is_flying and not self._is_ending:
            self._note("the viewer was closed, or has ended; the flight goes on")

    def _watch_feed(self, feed: "subprocess.Popen[bytes]") -> None:
        status = feed.wait()
        if status == 0 or self._is_ending:
            return
        log = self._run / "logs" / "feed.log"
        cause = last_line(log) if status > 0 else ""
        end = f"{ending(status)}{cause and f', {cause}'}"
        self._note(f"the view has no data any more: its feed {end} (log: {log}); the flight goes on")

    def end_feed(self) -> bool:
        """Let the feed send what is left of the flight, and end it; harmless when repeated.

        Returns whether it has sent the flight to its end.
        """
        self._is_flying = False
        feed = self._feed
        if feed is None:
            return False
        if self._record is None and self.viewer is not None and not self.viewer.is_open:
            self._end_feed_now(feed)
            return False
        stdin: IO[bytes] | None = feed.stdin
        if stdin is not None and not stdin.closed:
            stdin.close()
        limit_s = END_LIMIT_S if self._record is None else RECORD_LIMIT_S
        with contextlib.suppress(subprocess.TimeoutExpired):
            feed.wait(SILENT_S)
        if feed.poll() is None:
            self._note(f"waiting for the view's feed, which is behind, for up to {limit_s:g} s")
        try:
            feed.wait(limit_s)
        except subprocess.TimeoutExpired:
            self._end_feed_now(feed)
            self._note("the view lacks the end of the flight: its feed was too slow")
        self._feed = None
        return feed.returncode == 0

    def _end_feed_now(self, feed: "subprocess.Popen[bytes]") -> None:
        self._is_ending = True
        feed.kill()
        feed.wait()
        self._feed = None

    def end(self) -> None:
        """End feed and viewer; harmless when repeated."""
        self._is_ending = True
        if self._feed is not None:
            self._end_feed_now(self._feed)
        if self.viewer is not None:
            self.viewer.close()
