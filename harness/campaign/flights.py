"""One run of a campaign, whole, in this process: fly, report, keep what is asked for, leave no files."""

import re
import tempfile
from pathlib import Path

from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.selection import make_backend
from harness.campaign.series import read_series
from harness.campaign.store import Flown
from harness.campaign.task import Task, failed
from harness.launch import kernel_cache
from harness.launch.one_process import fly, use_kernel_cache
from harness.launch.processes import SetupError
from harness.records.run_folder import RunFolder

OF_THE_MACHINE = (OSError, MemoryError, SetupError, BackendUnavailable, kernel_cache.CompileError)
"""Trouble that the same run may not have elsewhere, or later: a full disk, a solver that is not there"""
_OF_THIS_RUN = re.compile(r" \(pid \d+\)| \(log: [^)]*\)")
"""What differs from run to run, and leads to files that are gone."""


def fly_task(task: Task, folder: Path) -> tuple[Flown, dict[str, bytes]]:
    """Fly it in a folder below ``folder``; what goes wrong with it is in the result, and the rest goes on.

    Returns how it ended, and its series. A formation that is not reached is a result as well, but trouble
    `OF_THE_MACHINE` is none, and is raised.
    """
    make_backend(task.scenario.antenna)  # one that cannot be had is said before the flight
    use_kernel_cache()
    kernel_cache.prepare(_unsaid)
    with tempfile.TemporaryDirectory(dir=folder, prefix="run-", ignore_cleanup_errors=True) as path:
        run = RunFolder(Path(path))
        try:
            summary = fly(task.scenario, run.path)
            series = read_series(run, task.keep, antenna_note=summary["max_gain_dbi"].get("note"))
        except OF_THE_MACHINE:
            raise
        except Exception as error:  # noqa: BLE001  one run's failure is not the campaign's
            return failed(task, one_line(error, run.path)), {}
    status, reason = summary["status"], summary["reason"]
    flown = Flown(digest=task.digest, status=status, reason=reason, summary=summary, settings=task.settings)
    return flown, series


def _unsaid(_line: str) -> None:
    pass


def one_line(error: Exception, folder: Path) -> str:
    """Say what went wrong in words that the same run would say again."""
    text = f"{type(error).__name__}: {error}".rstrip(": ").splitlines()[0]
    return _OF_THIS_RUN.sub("", text).replace(f"{folder}/", "")
