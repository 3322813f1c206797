"""Virtual file system that stations may read: a dictionary of paths; nothing else can be accessed.

Files on disk are added by the process; files with current values are generated when they are opened.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

LOG_FOLDER = "/fs/microsd/log"
"""PX4's log folder, in which stations search for logs."""
_MOST_PARTS = 16


class Readable(Protocol):
    """An opened file."""

    def size(self) -> int:
        """Current size in bytes."""
        ...

    def read(self, offset: int, count: int) -> bytes:
        """Up to ``count`` bytes from ``offset``; fewer, or none, at the end."""
        ...


class Contents(NamedTuple):
    """A file in memory."""

    data: bytes

    def size(self) -> int:
        """Size in bytes."""
        return len(self.data)

    def read(self, offset: int, count: int) -> bytes:
        """Up to ``count`` bytes from ``offset``."""
        return self.data[offset : offset + count]


class Log(NamedTuple):
    """A flight log, as stations list it."""

    path: str
    file: Readable
    time_utc_s: int
    """Time of its start in seconds since 1970; 0 if unknown."""


class Entry(NamedTuple):
    """Entry of a folder."""

    name: str
    size: int | None
    """Size in bytes; None for a folder."""


Opener = Callable[[str], Readable | None]
"""Opens the file; the argument is the part of the path after a question mark. None: no such file."""


class FileStore:
    """Files by path, and the list of logs."""

    def __init__(self) -> None:
        self._openers: dict[tuple[str, ...], Opener] = {}
        self.logs: list[Log] = []
        """Indexed by MAVLink log number."""

    def add(self, path: str, opener: Opener) -> None:
        """Add a file at a path, which is absolute or begins with ``@``."""
        self._openers[_parts(path)] = opener

    def add_log(self, log: Log) -> None:
        """Add a log to the list of logs and as a file at its path."""
        self.logs.append(log)
        self.add(log.path, lambda _query: log.file)

    def open(self, path: str) -> Readable | None:
        """Return the file at a path; None if there is none."""
        bare, _, query = path.partition("?")
        opener = self._openers.get(_parts(bare))
        return None if opener is None else opener(query)

    def list(self, path: str) -> list[Entry] | None:
        """Entries of a folder, sorted by name; None if there is no such folder."""
        folder = _parts(path)
        found: dict[str, Opener | None] = {}
        for parts, opener in self._openers.items():
            if len(parts) > len(folder) and parts[: len(folder)] == folder:
                found[parts[len(folder)]] = opener if len(parts) == len(folder) + 1 else None
        entries = [Entry(name, _size(opener)) for name, opener in sorted(found.items())]
        return entries or (None if folder else [])


def _size(opener: Opener | None) -> int | None:
    """Size of a file in bytes; None for a folder."""
    file = None if opener is None else opener("")
    return None if file is None else file.size()


def _parts(path: str) -> tuple[str, ...]:
    """Split a path into names; ``..`` is an ordinary name that matches no file."""
    return tuple(part for part in path.split("/", _MOST_PARTS) if part not in {"", "."})
