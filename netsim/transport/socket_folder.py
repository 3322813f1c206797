"""The folder of a router's Unix socket, which is closed to other users of the machine."""

import contextlib
import fcntl
import os
import re
import shutil
import stat
import tempfile
from pathlib import Path

from foundation.records.private_files import open_private
from foundation.records.write_access import fault_of

SOCKET = "radio"
"""Name of the socket in its folder; Zenoh puts a lock file beside it."""
LOCK = "launcher.lock"
"""Name of the file that is locked by the process that has made the folder, as long as it lives."""
LONGEST_PATH_BYTES = 107
"""Longest path of a Unix socket on Linux."""
KEPT_S = 3_600.0
"""Age from which a folder without `LOCK` is removed: a process has died before it made the file."""
_PREFIX = "coflight-radio-"
_LAST_PARENT = "/tmp"  # noqa: S108  short, and the folder in it has a random name and mode 0700
_RESERVED = re.compile(r"[?#]")
"""Characters with a meaning in a Zenoh endpoint."""


class SocketFolder:
    """A new folder of mode 0700, in the user's folder for sockets if there is one; `remove` it at the end.

    Removes those of this user that killed processes have left. A parent that belongs to another user, or in
    which other users can replace the folder, is passed over. Raises OSError if there is no usable one.
    """

    def __init__(self) -> None:
        reasons = []
        for parent in map(Path, dict.fromkeys(filter(None, _parents()))):
            try:
                reason = _unusable(parent)
                if reason is None:
                    self.path, self._lock = _made(parent)
                    _remove_left(parent, self.path.stat().st_mtime)
                    return
            except OSError as error:
                reason = f"{parent}: {error.strerror}"
            reasons.append(reason)
        raise OSError(f"no folder for the radio's socket: {'; '.join(reasons)}; set TMPDIR to another one")

    def remove(self) -> None:
        """Remove the folder with its content as far as possible; harmless when repeated."""
        shutil.rmtree(self.path, ignore_errors=True)
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def is_usable(path: Path) -> bool:
    """Whether a Unix socket that a Zenoh endpoint names can have that path."""
    return len(os.fsencode(path)) <= LONGEST_PATH_BYTES and not _RESERVED.search(str(path))


def unix_endpoint(path: str | Path) -> str:
    """Return the Zenoh endpoint of a Unix socket."""
    return f"unixsock-stream/{path}"


def _parents() -> tuple[str | None, ...]:
    return os.environ.get("XDG_RUNTIME_DIR"), tempfile.gettempdir(), _LAST_PARENT


def _unusable(parent: Path) -> str | None:
    """Return why no socket folder can be in a parent; None if one can be. Raises OSError."""
    fault = fault_of(parent, parent.stat(), sticky_protects=True)
    if fault is not None:
        return fault.reason
    if not is_usable(parent.absolute() / f"{_PREFIX}12345678" / SOCKET):
        return f"{parent}: a socket's path has at most {LONGEST_PATH_BYTES} bytes and no ? or #"
    return None


def _made(parent: Path) -> tuple[Path, int]:
    """Return a new folder with the descriptor of its lock file. Raises OSError."""
    folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent)).absolute()
    try:
        return folder, _locked(folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _locked(folder: Path) -> int:
    """Return the descriptor of the folder's lock file, locked before it has its name. Raises OSError.

    Programs that this process starts do not inherit it.
    """
    temporary = folder / f".{LOCK}"
    descriptor = open_private(temporary)
    with contextlib.suppress(OSError):  # a file system without locks: no process removes the folder
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    temporary.rename(folder / LOCK)
    return descriptor


def _remove_left(parent: Path, now_s: float) -> None:
    """Remove the folders of this user's processes that have been killed; ``now_s`` is a new file's time."""
    for folder in parent.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):  # another process may remove it as well
            status = folder.lstat()
            if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
                continue
            if _is_left(folder, age_s=now_s - status.st_mtime):
                shutil.rmtree(folder, ignore_errors=True)


def _is_left(folder: Path, *, age_s: float) -> bool:
    """Whether no process holds a folder. Raises OSError, also if its file system has no locks."""
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return age_s > KEPT_S
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True
