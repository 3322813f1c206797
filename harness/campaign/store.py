"""Tasks and results of a campaign's runs, and its folder.

A small file for every run that has ended is written atomically:

runs/<digest>.json                 status and summary of a run, with the hash of this content
runs/<digest>.gains.parquet ...    requested series
table.parquet table.csv            one row per run, when all have ended
report.html                        results on one page, for a browser
flying/                            temporary run folders
lock                               held by the campaign that uses the folder

Only the owner can read a folder that is created here. One that exists keeps its rights; ``runs`` and
``flying`` are private in it too, since they hold settings of the scenario.
"""

import contextlib
import fcntl
import hashlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec import Struct, structs

from foundation.records.private_files import FILE_MODE, make_private
from foundation.records.whole_file import sha256_of, write_whole
from foundation.records.write_access import fault_of
from harness.records.run_folder import NAME_ANOTHER, listed, names_in
from harness.scenario.scenario import Scenario

FAILED: Literal["failed"] = "failed"
_LOCK = "lock"
TABLES = ("table.parquet", "table.csv")
PAGE = "report.html"


class CampaignError(Exception):
    """An invalid campaign; the text is for the user."""


class ClusterError(CampaignError):
    """Workers or scheduler failed; the campaign can be continued by another call."""


class Kept(Struct, frozen=True, kw_only=True):
    """Size and hash of a stored series, to detect damage."""

    size_bytes: int
    sha256: str


class Flown(Struct, frozen=True, kw_only=True):
    """A run that has ended."""

    digest: str
    status: str
    """``completed``, ``not_formed`` or ``failed``"""
    reason: str | None = None
    """One line, unless completed"""
    summary: dict[str, Any] = {}
    """Result of `harness.report.report.finish`; empty for a failed run"""
    settings: tuple[str, ...] = ()
    """Overrides of the campaign's scenario, to repeat the run"""
    state: str = ""
    """Hash of sources and libraries"""
    series: dict[str, Kept] = {}
    """Stored series by name"""


class _Stored(Struct, frozen=True):
    """A run's file: its content, and the hash of the content's bytes, to detect changes."""

    sha256: str
    run: msgspec.Raw


class Flying(Struct, frozen=True):
    """The function that flies a run and returns its summary, with ``status`` and ``reason``."""

    function: str = "harness.launch.one_process:fly"
    """``module:name``; it is called with scenario, folder and the run's options"""
    measured_by: tuple[str, ...] = ()
    """Further modules that determine its summary, as paths from the root of the sources"""


PLAIN_FLIGHT = Flying()


class Task(Struct, frozen=True, kw_only=True):
    """A run for a worker."""

    digest: str
    state: str
    """Hash of the campaign's sources and libraries"""
    state_bytes: str
    """Hash of the sources' bytes, a faster check for identical files"""
    scenario: Scenario
    settings: tuple[str, ...]
    keep: tuple[str, ...]
    flying: Flying = PLAIN_FLIGHT
    options: dict[str, Any] = {}
    """Further arguments of the function that flies"""


def failed(task: Task, reason: str) -> Flown:
    """Return the result of a failed run."""
    return Flown(digest=task.digest, status=FAILED, reason=reason, settings=task.settings, state=task.state)


def is_campaign(folder: Path) -> bool:
    """Whether a folder is that of a campaign, complete or not."""
    return (folder / _LOCK).is_file()


def _read(content: bytes) -> Flown | None:
    """Return the run of a file's content; None if it was altered, or written by another version."""
    try:
        stored = msgspec.json.decode(content, type=_Stored)
        if hashlib.sha256(stored.run).hexdigest() != stored.sha256:
            return None
        return msgspec.json.decode(stored.run, type=Flown)
    except msgspec.DecodeError:
        return None


class Store:
    """Runs in a folder, which is created.

    Raises CampaignError if that fails, or if the folder has other content or can be written by others.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.flying = folder / "flying"
        self._runs, self._lock = folder / "runs", folder / _LOCK
        try:
            names = names_in(folder)
            if names and not is_campaign(folder):
                raise CampaignError(
                    f"{folder.resolve()} holds {listed(names)}, and a campaign needs a folder of its own: "
                    f"{NAME_ANOTHER}"
                )
            make_private(folder, exist_ok=True)
            fault = fault_of(folder, folder.stat())  # settings of runs in it are code that they execute
            if fault is not None:
                raise CampaignError(f"{fault}, or {NAME_ANOTHER}")
            os.close(os.open(self._lock, os.O_WRONLY | os.O_CREAT, FILE_MODE))  # marks a campaign's folder
            make_private(self._runs, exist_ok=True)
        except OSError as error:
            raise CampaignError(
                f"{folder}: cannot be a campaign's folder: {error.strerror}; {NAME_ANOTHER}"
            ) from None

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Lock the folder for one campaign, and delete temporary files of a killed one.

        Raises CampaignError if another campaign holds the lock.
        """
        with self._lock.open("wb") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise CampaignError(f"{self.folder}: another campaign flies into it") from None
            tables = (self.folder / f".{name}" for name in (*TABLES, PAGE))
            for left in (*self._runs.glob(".*.json"), *self._runs.glob(".*.parquet"), *tables):
                if left.is_file():  # foreign files are kept
                    left.unlink()
            shutil.rmtree(self.flying, ignore_errors=True)
            try:
                yield
            finally:
                shutil.rmtree(self.flying, ignore_errors=True)

    def get(
        self, digest: str, keep: Iterable[str] = (), *, on_altered: Callable[[Path], object] = lambda _: None
    ) -> Flown | None:
        """Return a stored run with all series ``keep`` (a failed run has none), or None: it is to be flown.

        ``on_altered`` is called with a file that is not as it was stored; such a run is not returned.
        """
        path = self._runs / f"{digest}.json"
        try:
            flown = _read(path.read_bytes())
        except FileNotFoundError:
            return None
        if flown is None or flown.digest != digest:
            on_altered(path)
            return None
        if flown.status == FAILED:
            return flown
        missing = [name for name in keep if not self._is_whole(flown, name)]
        for name in missing:
            if name in flown.series:
                on_altered(self.series_path(digest, name))
        return None if missing else flown

    def flights(self) -> list[Flown]:
        """Return all stored runs, of any sources, the oldest first; their series are not checked."""
        paths = sorted(self._runs.glob("[!.]*.json"), key=lambda path: (path.stat().st_mtime_ns, path.name))
        return [flown for path in paths if (flown := self.get(path.stem)) is not None]

    def _is_whole(self, flown: Flown, name: str) -> bool:
        kept, path = flown.series.get(name), self.series_path(flown.digest, name)
        try:
            if kept is None or path.stat().st_size != kept.size_bytes:
                return False
            return sha256_of(path) == kept.sha256
        except FileNotFoundError:
            return False

    def put(self, flown: Flown, series: dict[str, bytes]) -> Flown:
        """Store a run, and return its stored form.

        Series are written first, so that a stored run has its series. A failed run does not replace a stored
        one that did not fail, for example when it is flown again for another series; series that are stored
        already are kept.
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
        run = msgspec.json.format(msgspec.json.encode(flown), indent=1)
        stored = _Stored(sha256=hashlib.sha256(run).hexdigest(), run=msgspec.Raw(run))
        path = self._runs / f"{flown.digest}.json"
        write_whole(path, msgspec.json.encode(stored) + b"\n", private=True)
        return flown

    def series_path(self, digest: str, name: str) -> Path:
        """Return the path of a stored series."""
        return self._runs / f"{digest}.{name}.parquet"
