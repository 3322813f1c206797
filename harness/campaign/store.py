"""A campaign's folder: one small file for every run that has ended, written whole or not at all.

runs/<digest>.json                 how it ended, and its summary
runs/<digest>.gains.parquet ...    series that were to be kept
table.parquet table.csv            one row per run, when all have ended
flying/                            run folders while they last
lock                               held by the campaign that flies into the folder
"""

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec import Struct

FAILED: Literal["failed"] = "failed"


class CampaignError(Exception):
    """A campaign cannot be flown; the text is one line for the user."""


class ClusterError(CampaignError):
    """The workers or their scheduler do not go on; the campaign can, once more."""


class Flown(Struct, frozen=True, kw_only=True):
    """A run that has ended."""

    digest: str
    status: str
    """``completed``, ``not_formed`` or ``failed``"""
    reason: str | None = None
    """One line, of all but those that are completed"""
    summary: dict[str, Any] = {}
    """As `harness.report.finish` has it; empty for one that failed"""
    settings: tuple[str, ...] = ()
    """Overrides of the campaign's scenario, with which it can be flown once more"""


class Store:
    """Runs in a folder, which is made; raises CampaignError if it cannot be."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.flying = folder / "flying"
        self._runs = folder / "runs"
        try:
            self._runs.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CampaignError(f"{folder}: cannot be a campaign's folder: {error.strerror}") from None

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Hold the folder for one campaign, and tidy up what one that was killed has left.

        Raises CampaignError if another one has it.
        """
        with alone(self.folder):
            for left in self._runs.glob(".*"):
                left.unlink()
            shutil.rmtree(self.flying, ignore_errors=True)
            try:
                yield
            finally:
                shutil.rmtree(self.flying, ignore_errors=True)

    def get(self, digest: str, keep: Iterable[str] = ()) -> Flown | None:
        """Give the run if it has ended, and with it its series ``keep``; one that failed has none."""
        try:
            flown = msgspec.json.decode((self._runs / f"{digest}.json").read_bytes(), type=Flown)
        except (FileNotFoundError, msgspec.DecodeError):  # of another layout: it is flown again
            return None
        complete = flown.status == FAILED or all(self.series_path(digest, name).exists() for name in keep)
        return flown if complete and flown.digest == digest else None

    def put(self, flown: Flown, series: dict[str, bytes]) -> None:
        """Write a run down for good; its series come first, so that who finds the run finds them."""
        for name, content in series.items():
            write_whole(self.series_path(flown.digest, name), content)
        content = msgspec.json.format(msgspec.json.encode(flown), indent=1)
        write_whole(self._runs / f"{flown.digest}.json", content + b"\n")

    def series_path(self, digest: str, name: str) -> Path:
        """Where a kept series is."""
        return self._runs / f"{digest}.{name}.parquet"


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold a folder for one campaign, however it ends. Raises CampaignError if another one has it."""
    with (folder / "lock").open("wb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise CampaignError(f"{folder}: another campaign flies into it") from None
        yield


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that whoever reads it finds all of it or what was there before."""
    beside = path.with_name(f".{path.name}")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
