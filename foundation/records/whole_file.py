"""Writes a file so that readers find its old or its new content, never a part; hashes a file in pieces."""

import contextlib
import hashlib
import os
from pathlib import Path

from foundation.records.private_files import open_private


def write_whole(path: Path, content: bytes, *, private: bool = False) -> None:
    """Write a file atomically: readers find the new or the old content.

    ``private``: only the owner can read it, whatever the umask and the rights of the old file are. Raises
    OSError with the name of the file.
    """
    temporary = path.with_name(f".{path.name}")
    try:
        with os.fdopen(open_private(temporary), "wb") if private else temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()  # frees space on a full disk
        if isinstance(error, OSError) and error.filename is None:  # of a write, which has a descriptor only
            error.filename = str(path)
        raise


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal, read in pieces. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
