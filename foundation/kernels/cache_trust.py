"""Checks that only this user or root can write a cache of compiled kernels.

Numba executes what the cache holds: machine code and pickles. A file that another user can replace is code
that this user's processes run.
"""

import errno
import grp
import os
import pwd
import stat
from collections.abc import Iterator
from pathlib import Path

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


class UntrustedCache(RuntimeError):
    """Another user can write a cache of compiled kernels, or this user cannot read it; one line of text."""


def check_trusted(folder: Path, top: Path, *, variable: str) -> None:
    """Check a cache and its parents up to ``top``, as far as they exist.

    Each folder and file must belong to this user or root, and no other may write it; the files are checked if
    other users can reach them. A parent in which each user may delete only their own files (sticky, as /tmp)
    may be writable by all, and any may be writable by the group of this user's name without other members.

    ``variable`` names the environment variable that selects another folder. Raises UntrustedCache.
    """
    reason = None
    try:
        for parent in reversed(folder.parents):
            if parent == top or top in parent.parents:
                reason = reason or _fault(parent, parent.stat(), sticky_protects=True)
        status = folder.stat()
        reason = reason or _fault(folder, status, sticky_protects=False)
        _check_readable(folder, os.R_OK | os.X_OK)
        is_reachable = status.st_mode & (stat.S_IXGRP | stat.S_IXOTH)
        for path, status in _content(folder) if is_reachable and not reason else ():
            reason = reason or _fault(path, status, sticky_protects=False)
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


def _fault(path: Path, status: os.stat_result, *, sticky_protects: bool) -> str | None:
    """Return why a folder or file is not trusted, and what to do; None if it is."""
    if status.st_uid not in {os.geteuid(), 0}:
        return f"{path} belongs to {_user(status.st_uid)}: delete it"
    writers = status.st_mode & _OTHERS_WRITE
    if writers == stat.S_IWGRP and _is_own_group(status.st_gid):
        return None
    if not writers or (sticky_protects and status.st_mode & stat.S_ISVTX):
        return None
    return f"other users can write {path}: chmod -R go-w {path}"


def _is_own_group(group_id: int) -> bool:
    """Return whether a group is this user's alone, as on systems with a group for each user."""
    try:
        user, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(group_id)
    except KeyError:
        return False
    return group.gr_name == user.pw_name and user.pw_gid == group_id and {*group.gr_mem} <= {user.pw_name}


def _user(user_id: int) -> str:
    try:
        return f"the user {pwd.getpwuid(user_id).pw_name}"
    except KeyError:
        return f"the user with id {user_id}"
