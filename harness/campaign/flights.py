"""One run of a campaign in this process: flies, reports, returns the requested series, leaves no files."""

import pkgutil
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

from antenna.solvers.interface import BackendUnavailable
from antenna.solvers.selection import make_backend
from foundation.kernels.cache_trust import UntrustedCache
from foundation.kernels.use_cache import use_kernel_cache
from foundation.system_error import described
from harness.campaign.store import Flown, Task, failed
from harness.launch import kernel_cache
from harness.launch.run_messages import SetupError
from harness.records.run_folder import RunFolder

OF_THE_MACHINE = (
    OSError,
    MemoryError,
    SetupError,
    BackendUnavailable,
    UntrustedCache,
    kernel_cache.CompileError,
)
"""Errors of the machine, which the same run may not have elsewhere or later: a full disk, a missing solver, a
cache of compiled kernels that others can write"""
_OF_THIS_RUN = re.compile(r" \(pid \d+\)| \(log: [^)]*\)")
"""Parts of error messages that differ from run to run and refer to deleted files."""


class NoSeries(RuntimeError):
    """A run has no such series; the text is the reason in one line."""


def fly_task(task: Task, folder: Path) -> tuple[Flown, dict[str, bytes]]:
    """Fly a run in a folder below ``folder``; a failure of the run is part of the result.

    Returns its outcome and its series. A formation that is not reached is also a result; errors
    `OF_THE_MACHINE` are raised.
    """
    make_backend(task.scenario.antenna)  # a missing solver is reported before the flight
    use_kernel_cache()
    kernel_cache.prepare(lambda _line: None)
    with tempfile.TemporaryDirectory(dir=folder, prefix="run-", ignore_cleanup_errors=True) as path:
        run = RunFolder(Path(path))
        try:
            summary = pkgutil.resolve_name(task.flying.function)(task.scenario, run.path, **task.options)
            note = summary["max_gain_dbi"].get("note") if task.keep else None
            series = read_series(run, task.keep, antenna_note=note)
        except OF_THE_MACHINE:
            raise
        except Exception as error:  # noqa: BLE001  the campaign continues after a failed run
            return failed(task, one_line(error, run.path)), {}
    status, reason = summary["status"], summary["reason"]
    flown = Flown(
        digest=task.digest,
        status=status,
        reason=reason,
        summary=summary,
        settings=task.settings,
        state=task.state,
    )
    return flown, series


def read_series(folder: RunFolder, names: Sequence[str], *, antenna_note: str | None) -> dict[str, bytes]:
    """Return series of a run's folder by their names (`harness.campaign.definition.KEPT`).

    ``antenna_note`` is the summary's reason for missing gains. Raises `NoSeries`, OSError.
    """
    if "gains" in names and not folder.gains.exists():
        raise NoSeries(f"no gains to keep: {antenna_note}")
    return {name: (folder.path / f"{name}.parquet").read_bytes() for name in names}


def one_line(error: Exception, folder: Path) -> str:
    """Return an error message that is reproducible for the same run."""
    text = described(error)
    return _OF_THIS_RUN.sub("", text).replace(f"{folder}/", "")
