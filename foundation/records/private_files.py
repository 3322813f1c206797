"""Creates folders and files that only their owner can read, whatever the umask is.

A folder that exists keeps its rights: its owner has chosen them.
"""

import contextlib
import os
from pathlib import Path

FOLDER_MODE, FILE_MODE = 0o700, 0o600
PARENT_MODE = 0o755
"""Of folders that other users may read and not write; the umask removes rights of it."""


def make_private(folder: Path, *, exist_ok: bool = False) -> None:
    """Create a folder with `FOLDER_MODE`, and missing parents, which other users may read but not write.

    Raises OSError, and FileExistsError for a folder that exists, without ``exist_ok``.
    """
    for parent in reversed(folder.parents):
        if not parent.exists():
            with contextlib.suppress(FileExistsError):  # another process has just created it
                parent.mkdir(PARENT_MODE)
    try:
        folder.mkdir(FOLDER_MODE)
    except FileExistsError:
        if not exist_ok or not folder.is_dir():
            raise


def open_private(path: Path, *, readable: bool = False) -> int:
    """Create a file with `FILE_MODE`, instead of any other of its name; returns its descriptor for writing.

    It is ``readable`` by the descriptor too if so. Raises OSError.
    """
    with contextlib.suppress(FileNotFoundError):
        path.unlink()
    access = os.O_RDWR if readable else os.O_WRONLY
    return os.open(path, access | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, FILE_MODE)


def write_private(path: Path, content: bytes) -> None:
    """Write a file with `FILE_MODE`, in place of any other of that name. Raises OSError."""
    with os.fdopen(open_private(path), "wb") as file:
        file.write(content)
