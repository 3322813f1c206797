"""The live view of a flight: viewer and feed as children of the launcher, which neither waits for."""

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
from harness.view.viewer import Viewer

END_LIMIT_S = 20.0
"""Wall time that the feed has after the flight for what a viewer still lacks"""
RECORD_LIMIT_S = 300.0
"""The same for what a recording lacks"""


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
        self._watch: threading.Thread | None = None
        self._is_ending = False

    def begin(self) -> None:
        """Start viewer and feed, once the run's folder exists. Raises ViewerError and OSError."""
        logs = self._run / "logs"
        arguments = [str(self._run)]
        if self._in_browser is not None:
            self.viewer = Viewer(logs / "viewer", in_browser=self._in_browser)
            arguments += ["--url", self.viewer.url]
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
        self._watch = threading.Thread(target=self._watch_feed, args=(self._feed,), daemon=True)
        self._watch.start()

    @property
    def feed_pid(self) -> int | None:
        """Process id of the feed, once it was started."""
        return None if self._feed is None else self._feed.pid

    def _watch_feed(self, feed: "subprocess.Popen[bytes]") -> None:
        status = feed.wait()
        if status != 0 and not self._is_ending:
            log = self._run / "logs" / "feed.log"
            self._note(
                f"the view has no data any more: its feed {ending(status)} (log: {log}); the flight goes on"
            )

    def end_feed(self) -> bool:
        """Let the feed send what is left of the flight, and end it; harmless when repeated.

        Returns whether it has sent the flight to its end.
        """
        feed = self._feed
        if feed is None:
            return False
        stdin: IO[bytes] | None = feed.stdin
        if stdin is not None and not stdin.closed:
            stdin.close()
        try:
            feed.wait(END_LIMIT_S if self._record is None else RECORD_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._is_ending = True
            feed.kill()
            feed.wait()
            self._note("the view lacks the end of the flight: its feed was too slow")
        self._feed = None
        return feed.returncode == 0

    def end(self) -> None:
        """End feed and viewer; harmless when repeated."""
        self._is_ending = True
        if self._feed is not None:
            self._feed.kill()
            self._feed.wait()
            self._feed = None
        if self.viewer is not None:
            self.viewer.close()
