"""The files that stations may read: a dictionary of paths, and nothing outside of it can be named.

A file is something that can be read at a place; what reads it is given by whoever adds it, so that a file on
a disk is the edge's, and one that is made of present values is made when it is opened.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

LOG_FOLDER = "/fs/microsd/log"
"""Where PX4 has its logs, and stations look for them."""
_MOST_PARTS = 16


class Readable(Protocol):
    """What an opened file is."""

    def size(self) -> int:
        """Bytes that are there by now."""
        ...

    def read(self, offset: int, count: int) -> bytes:
        """Up to ``count`` bytes from a place; fewer, or none, at the end."""
        ...


class Contents(NamedTuple):
    """A file in memory."""

    data: bytes

    def size(self) -> int:
        """All of it."""
        return len(self.data)

    def read(self, offset: int, count: int) -> bytes:
        """Part of it."""
        return self.data[offset : offset + count]


class Log(NamedTuple):
    """A flight's log, as stations list it."""

    path: str
    file: Readable
    time_utc_s: int
    """When it was begun, in seconds since 1970; 0 where that is not known."""


class Entry(NamedTuple):
    """One of a folder."""

    name: str
    size: int | None
    """None of a folder."""


Opener = Callable[[str], Readable | None]
"""Makes the file; it is given what follows a question mark in the path, and may have nothing for it."""


class FileStore:
    """Paths and what is there."""

    def __init__(self) -> None:
        self._openers: dict[tuple[str, ...], Opener] = {}
        self.logs: list[Log] = []
        """By their numbers in MAVLink."""

    def add(self, path: str, opener: Opener) -> None:
        """Have a file at a path, which is absolute or begins with ``@``."""
        self._openers[_parts(path)] = opener

    def add_log(self, log: Log) -> None:
        """Have a log, also as a file at its path."""
        self.logs.append(log)
        self.add(log.path, lambda _query: log.file)

    def open(self, path: str) -> Readable | None:
        """The file at a path; None if there is none."""
        bare, _, query = path.partition("?")
        opener = self._openers.get(_parts(bare))
        return None if opener is None else opener(query)

    def list(self, path: str) -> list[Entry] | None:
        """What is in a folder, by name; None if there is no such folder."""
        folder = _parts(path)
        found: dict[str, Opener | None] = {}
        for parts, opener in self._openers.items():
            if len(parts) > len(folder) and parts[: len(folder)] == folder:
                found[parts[len(folder)]] = opener if len(parts) == len(folder) + 1 else None
        entries = [Entry(name, _size(opener)) for name, opener in sorted(found.items())]
        return entries or (None if folder else [])


def _size(opener: Opener | None) -> int | None:
    """Bytes of a file; None of a folder."""
    file = None if opener is None else opener("")
    return None if file is None else file.size()


def _parts(path: str) -> tuple[str, ...]:
    """Names on the way to a file; those that mean another folder are names like others, of nothing."""
    return tuple(part for part in path.split("/", _MOST_PARTS) if part not in {"", "."})
