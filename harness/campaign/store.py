"""A campaign's folder: one small file for every run that has ended, written whole or not at all.

runs/<digest>.json                 how it ended, and its summary
runs/<digest>.gains.parquet ...    series that were to be kept
table.parquet table.csv            one row per run, when all have ended
flying/                            run folders while they last
lock                               held by the campaign that flies into the folder
"""

import contextlib
import fcntl
import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec import Struct, structs

FAILED: Literal["failed"] = "failed"
TABLES = ("table.parquet", "table.csv")


class CampaignError(Exception):
    """A campaign cannot be flown; the text is one line for the user."""


class ClusterError(CampaignError):
    """The workers or their scheduler do not go on; the campaign can, once more."""


class Kept(Struct, frozen=True, kw_only=True):
    """A series as it was written, by which one that has been damaged is known."""

    size_bytes: int
    sha256: str


class Flown(Struct, frozen=True, kw_only=True):
    """A run that has ended."""

    digest: str
    status: str
    """``completed``, ``not_formed`` or ``failed``"""
    reason: str | None = None
    """One line, of all but those that are completed"""
    summary: dict[str, Any] = {}
    """As `harness.report.report.finish` has it; empty for one that failed"""
    settings: tuple[str, ...] = ()
    """Overrides of the campaign's scenario, with which it can be flown once more"""
    series: dict[str, Kept] = {}
    """What is kept of it, by name"""


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
            tables = (self.folder / f".{name}" for name in TABLES)
            for left in (*self._runs.glob(".*.json"), *self._runs.glob(".*.parquet"), *tables):
                if left.is_file():  # and whatever else somebody has put there stays
                    left.unlink()
            shutil.rmtree(self.flying, ignore_errors=True)
            try:
                yield
            finally:
                shutil.rmtree(self.flying, ignore_errors=True)

    def get(self, digest: str, keep: Iterable[str] = ()) -> Flown | None:
        """Give the run if it has ended, and with it its series ``keep``, whole; one that failed has none."""
        try:
            flown = msgspec.json.decode((self._runs / f"{digest}.json").read_bytes(), type=Flown)
        except (FileNotFoundError, msgspec.DecodeError):  # of another layout: it is flown again
            return None
        complete = flown.status == FAILED or all(self._is_whole(flown, name) for name in keep)
        return flown if complete and flown.digest == digest else None

    def _is_whole(self, flown: Flown, name: str) -> bool:
        kept, path = flown.series.get(name), self.series_path(flown.digest, name)
        try:
            if kept is None or path.stat().st_size != kept.size_bytes:
                return False
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest() == kept.sha256
        except FileNotFoundError:
            return False

    def put(self, flown: Flown, series: dict[str, bytes]) -> Flown:
        """Write a run down for good, and return what is kept of it.

        Its series come first, so that who finds the run finds them. A run that is there and did not fail is
        not replaced by one that did, as it may when it is flown again for one more series; and what was kept
        of it stays.
        """
        before = self.get(flown.digest)
        if before is not None and before.status == FAILED:
            before = None
        if before is not None and flown.status == FAILED:
            return before
        kept = {} if before is None else dict(before.series)
        for name, content in series.items():
            write_whole(self.series_path(flown.digest, name), content)
            kept[name] = Kept(size_bytes=len(content), sha256=hashlib.sha256(content).hexdigest())
        flown = structs.replace(flown, series=kept)
        content = msgspec.json.format(msgspec.json.encode(flown), indent=1)
        write_whole(self._runs / f"{flown.digest}.json", content + b"\n")
        return flown

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
    try:
        with beside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            beside.unlink()  # what it takes of a full disk is needed
        raise
