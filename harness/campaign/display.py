"""Progress display of a campaign: a bar with the remaining time, and a line for every failed run."""

import time
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

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
        self._left_s: float | None = None

    def landed(self, total: int, wall_s: float) -> None:
        """Add the completion of one more of ``total`` runs."""
        self._wall_landed_s.append(wall_s)
        done = len(self._wall_landed_s) - 1
        if done >= min(_SLOW_START, total):
            first = done // 4
            each_s = (wall_s - self._wall_landed_s[first]) / (done - first)
            self._left_s = (total - done) * each_s

    def left_s(self, wall_s: float) -> float | None:
        """Return the remaining time, at least 0; None before there is an estimate."""
        return None if self._left_s is None else max(0.0, self._left_s - (wall_s - self._wall_landed_s[-1]))


def duration_text(seconds: float | None) -> str:
    """Return ``3 h 05 min``, ``4 min 10 s``, ``9 s``, or ``?`` if unknown."""
    if seconds is None:
        return "?"
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"


class _TimeLeft(ProgressColumn):
    def __init__(self, pace: CampaignPace) -> None:
        super().__init__()
        self._pace = pace

    def render(self, task: Task) -> Text:
        left_s = 0.0 if task.finished else self._pace.left_s(time.monotonic())
        return Text(f"{duration_text(left_s)} left")


class CampaignDisplay:
    """Shows a campaign of ``total`` flights on a console: a bar on a terminal, periodic lines elsewhere.

    ``kept`` of them are stored already.
    """

    def __init__(self, console: Console, campaign: Campaign, *, total: int, kept: int) -> None:
        self._console, self._campaign = console, campaign
        self._pace = CampaignPace(time.monotonic())
        self.failed = 0
        """Number of failed runs"""
        self._wall_next_s = time.monotonic() + LINE_PERIOD_S
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _TimeLeft(self._pace))
        self._progress = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)
        self._task: TaskID = self._progress.add_task(campaign.name, total=total, completed=kept)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def on_landed(self, landed: Landed) -> None:
        """Advance the bar, and print a line if the run failed."""
        wall_s = time.monotonic()
        self._pace.landed(landed.total, wall_s)
        self._progress.advance(self._task)
        if landed.flown.status == FAILED:
            self.failed += 1
            self.note(f"{landed.run.describe(self._campaign)}: {landed.flown.reason}")
        last = landed.done == landed.total
        if not self._console.is_terminal and (wall_s >= self._wall_next_s or last):
            self._wall_next_s = wall_s + LINE_PERIOD_S
            failed = f", {self.failed} failed" if self.failed else ""
            left = "" if last else f", {duration_text(self._pace.left_s(wall_s))} left"
            self.note(f"{landed.done} of {landed.total} flown{failed}{left}")

    def note(self, line: str) -> None:
        """Print a permanent line of any length without wrapping."""
        self._progress.console.print(Text(line), soft_wrap=True)
