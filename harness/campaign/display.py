"""Progress display of a campaign: a bar with rate and remaining time, and a line for every failed run."""

import time
from collections.abc import Callable, Iterable
from typing import Self

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn
from rich.text import Text

from foundation.durations import duration_text
from harness.campaign.definition import Campaign
from harness.campaign.running import Landed
from harness.campaign.store import FAILED

LINE_PERIOD_S = 10.0
"""Wall time between two lines without a bar."""
_SLOW_START = 2
"""Completed runs before the remaining time is estimated."""


class CampaignPace:
    """Estimate of the remaining wall time, s, by the rate of completed runs.

    The first quarter of the completed runs is ignored, during which workers start and compile.
    """

    def __init__(self, wall_begin_s: float) -> None:
        self._wall_landed_s = [wall_begin_s]
        self._simulated_s = [0.0]
        self._left_s: float | None = None
        self.per_minute: float | None = None
        """Runs completed per minute of wall time; None before there is an estimate."""
        self.factor: float | None = None
        """Simulated over wall time, of all workers together; None without an estimate or simulated times."""

    def landed(self, total: int, wall_s: float, simulated_s: float = 0.0) -> None:
        """Add the completion of one more of ``total`` runs, which simulated ``simulated_s``."""
        self._wall_landed_s.append(wall_s)
        self._simulated_s.append(self._simulated_s[-1] + simulated_s)
        done = len(self._wall_landed_s) - 1
        if done >= min(_SLOW_START, total):
            first = done // 4
            wall_used_s = wall_s - self._wall_landed_s[first]
            each_s = wall_used_s / (done - first)
            self._left_s = (total - done) * each_s
            if wall_used_s > 0.0:
                self.per_minute = 60.0 / each_s
                self.factor = (self._simulated_s[-1] - self._simulated_s[first]) / wall_used_s or None

    def elapsed_s(self, wall_s: float) -> float:
        """Return the wall time since the start."""
        return wall_s - self._wall_landed_s[0]

    def rate_text(self) -> str:
        """Return the rate of runs and the real-time factor, as far as they are known; may be empty."""
        parts = [f"{self.per_minute:.1f} per min"] if self.per_minute is not None else []
        if self.factor is not None:
            parts.append(f"{self.factor:.1f} x real time")
        return ", ".join(parts)

    def left_s(self, wall_s: float) -> float | None:
        """Return the remaining time, at least 0; None before there is an estimate."""
        return None if self._left_s is None else max(0.0, self._left_s - (wall_s - self._wall_landed_s[-1]))


class _Bar(Progress):
    """A bar with the number of runs, above a line of ``state``."""

    def __init__(self, console: Console, state: Callable[[], str]) -> None:
        self._state = state
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        super().__init__(*columns, console=console, disable=not console.is_terminal, transient=True)

    def get_renderables(self) -> Iterable[RenderableType]:
        """Yield the bar and the line."""
        yield self.make_tasks_table(self.tasks)
        yield Text(self._state(), no_wrap=True, overflow="ellipsis")


class CampaignDisplay:
    """Shows a campaign of ``total`` flights on a console: a bar on a terminal, periodic lines elsewhere.

    ``kept`` of them are stored already.
    """

    def __init__(self, console: Console, campaign: Campaign, *, total: int, kept: int) -> None:
        self._console, self._campaign = console, campaign
        self._pace = CampaignPace(time.monotonic())
        self.failed = 0
        """Number of failed runs"""
        self._last = False
        self._wall_next_s = time.monotonic() + LINE_PERIOD_S
        self._progress = _Bar(console, lambda: self.state(time.monotonic()))
        self._task: TaskID = self._progress.add_task(campaign.name, total=total, completed=kept)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def on_landed(self, landed: Landed) -> None:
        """Advance the bar, and print a line if the run failed."""
        wall_s = time.monotonic()
        simulated_s = landed.flown.summary.get("simulated_s")
        self._pace.landed(landed.total, wall_s, simulated_s or 0.0)
        if landed.flown.status == FAILED:
            self.failed += 1
            self.note(f"{landed.run.describe(self._campaign)}: {landed.flown.reason}")
        self._progress.advance(self._task)
        self._last = landed.done == landed.total
        if not self._console.is_terminal and (wall_s >= self._wall_next_s or self._last):
            self._wall_next_s = wall_s + LINE_PERIOD_S
            self.note(f"{landed.done} of {landed.total} flown, {self.state(wall_s)}")

    def state(self, wall_s: float) -> str:
        """Return rate, failed runs, elapsed and, except after the last run, remaining wall time."""
        parts = [self._pace.rate_text(), f"{self.failed} failed" if self.failed else ""]
        parts.append(f"{duration_text(self._pace.elapsed_s(wall_s))} elapsed")
        parts.append("" if self._last else f"{duration_text(self._pace.left_s(wall_s))} left")
        return ", ".join(filter(None, parts))

    def note(self, line: str) -> None:
        """Print a permanent line of any length without wrapping."""
        self._progress.console.print(Text(line), soft_wrap=True)
