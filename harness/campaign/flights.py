"""One run of a campaign, whole, in this process: fly, report, keep what is asked for, leave no files."""

import re
import tempfile
from pathlib import Path

from harness.campaign.series import read_series
from harness.campaign.store import Flown
from harness.campaign.worker import Task, failed
from harness.one_process import fly
from harness.run_folder import RunFolder

_OF_THIS_RUN = re.compile(r" \(pid \d+\)| \(log: [^)]*\)")
"""What differs from run to run, and leads to files that are gone."""


def fly_task(task: Task, folder: Path) -> tuple[Flown, dict[str, bytes]]:
    """Fly it in a folder below ``folder``; whatever goes wrong is in the result, and the rest goes on.

    Returns how it ended, and its series. A formation that is not reached is a result as well.
    """
    with tempfile.TemporaryDirectory(dir=folder, prefix="run-", ignore_cleanup_errors=True) as path:
        run = RunFolder(Path(path))
        try:
            summary = fly(task.scenario, run.path)
            series = read_series(run, task.keep, antenna_note=summary["max_gain_dbi"].get("note"))
        except Exception as error:  # noqa: BLE001  one run's failure is not the campaign's
            return failed(task, one_line(error, run.path)), {}
    status, reason = summary["status"], summary["reason"]
    flown = Flown(digest=task.digest, status=status, reason=reason, summary=summary, settings=task.settings)
    return flown, series


def one_line(error: Exception, folder: Path) -> str:
    """Say what went wrong in words that the same run would say again."""
    text = f"{type(error).__name__}: {error}".rstrip(": ").splitlines()[0]
    return _OF_THIS_RUN.sub("", text).replace(f"{folder}/", "")
