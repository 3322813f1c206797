"""Checks that only this user or root can write a cache of compiled kernels.

Numba executes what the cache holds: machine code and pickles. A file that another user can replace is code
that this user's processes run.
"""

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from foundation.records.write_access import fault_of


class UntrustedCache(RuntimeError):
    """Another user can write a cache of compiled kernels, or this user cannot read it; one line of text."""


def check_trusted(folder: Path, top: Path, *, variable: str) -> None:
    """Check a cache and its parents up to ``top``, as far as they exist.

    Each folder and file must belong to this user or root, and no other may write it; the files are checked if
    other users can reach them. A parent in which each user may delete only their own files (sticky, as /tmp)
    may be writable by all, and any may be writable by the group of this user's name without other members.

    ``variable`` names the environment variable that selects another folder. Raises UntrustedCache.
    """
    reason: object = None
    try:
        for parent in reversed(folder.parents):
            if parent == top or top in parent.parents:
                reason = reason or fault_of(parent, parent.stat(), sticky_protects=True)
        status = folder.stat()
        reason = reason or fault_of(folder, status)
        _check_readable(folder, os.R_OK | os.X_OK)
        is_reachable = status.st_mode & (stat.S_IXGRP | stat.S_IXOTH)
        for path, status in _content(folder) if is_reachable and not reason else ():
            reason = reason or fault_of(path, status)
    except (FileNotFoundError, NotADirectoryError):
        pass  # what is not there is created by this user
    except PermissionError as error:
        reason = f"{error.filename} cannot be read: its owner can permit it, chmod -R a+rX {error.filename}"
    if reason is not None:
        raise UntrustedCache(
            f"compiled kernels in {folder} are not loaded: {reason}, or set {variable} to another folder"
        )


def _content(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield all that is below a folder; raises PermissionError for what cannot be read."""
    with os.scandir(folder) as entries:
        for entry in entries:
            try:
                status = entry.stat()
            except FileNotFoundError:  # a temporary file of a process that compiles
                continue
            path = Path(entry.path)
            yield path, status
            if entry.is_dir():
                yield from _content(path)
            elif path.suffix in {".nbi", ".nbc"}:
                _check_readable(path, os.R_OK)


def _check_readable(path: Path, mode: int) -> None:
    if not os.access(path, mode):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
