"""The folder of a router's Unix socket, which is closed to other users of the machine."""

import contextlib
import os
import re
import shutil
import tempfile
from pathlib import Path

SOCKET = "radio"
"""Name of the socket in its folder; Zenoh puts a lock file beside it."""
LONGEST_PATH_BYTES = 107
"""Longest path of a Unix socket on Linux."""
_RESERVED = re.compile(r"[?#]")
"""Characters with a meaning in a Zenoh endpoint."""


def make_socket_folder() -> Path:
    """Make a new folder of mode 0700, in the user's folder for sockets if there is one; returns its path.

    Raises OSError, also if its path is unusable for a socket.
    """
    for parent in filter(None, (os.environ.get("XDG_RUNTIME_DIR"), tempfile.gettempdir())):
        try:
            folder = Path(tempfile.mkdtemp(prefix="coflight-radio-", dir=parent)).absolute()
        except OSError:
            if parent == tempfile.gettempdir():
                raise
            continue
        if is_usable(folder / SOCKET):
            return folder
        folder.rmdir()
    raise OSError(
        f"{tempfile.gettempdir()}: no folder for the radio's socket, whose path has at most "
        f"{LONGEST_PATH_BYTES} bytes and no ? or #: set TMPDIR to another one"
    )


def is_usable(path: Path) -> bool:
    """Whether a Unix socket that a Zenoh endpoint names can have that path."""
    return len(os.fsencode(path)) <= LONGEST_PATH_BYTES and not _RESERVED.search(str(path))


def remove_socket(path: str | None) -> None:
    """Remove a socket, its lock file and their folder if it has nothing else, as far as possible."""
    if path is not None:
        for remove in (Path(path).unlink, Path(f"{path}.lock").unlink, Path(path).parent.rmdir):
            with contextlib.suppress(OSError):
                remove()


def remove_socket_folder(folder: Path) -> None:
    """Remove the folder with its content; harmless when repeated."""
    shutil.rmtree(folder, ignore_errors=True)


def unix_endpoint(path: str | Path) -> str:
    """Return the Zenoh endpoint of a Unix socket."""
    return f"unixsock-stream/{path}"
