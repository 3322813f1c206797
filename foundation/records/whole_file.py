"""Writes a file so that readers find its old or its new content, never a part; hashes a file in pieces."""

import contextlib
import errno
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from foundation.records.private_files import open_private


def write_whole(path: Path, content: bytes, *, private: bool = False) -> None:
    """Write a file atomically, as `whole_file`."""
    with whole_file(path, private=private) as file:
        file.write(content)


@contextlib.contextmanager
def whole_file(path: Path, *, private: bool = False) -> Iterator[IO[bytes]]:
    """Open a file to be written atomically: readers find the old content, and the new when the block ends.

    An error or a signal in the block leaves the old file. ``private``: only the owner can read it, whatever
    the umask and the rights of the old file are. Of two programs that write a private file at once, the one
    that began first fails. Raises OSError with the name of the file.
    """
    temporary = path.with_name(f".{path.name}")
    is_own = True
    try:
        with os.fdopen(open_private(temporary), "wb") if private else temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            is_own = not private or _is_at(temporary, file.fileno())
        if not is_own:
            raise FileExistsError(errno.EEXIST, "another program writes it too", str(path))  # noqa: TRY301
        temporary.replace(path)
    except BaseException as error:
        if is_own:
            with contextlib.suppress(OSError):
                temporary.unlink()  # frees space on a full disk
        if isinstance(error, OSError) and error.filename is None:  # of a write, which has a descriptor only
            error.filename = str(path)
        raise


def _is_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal, read in pieces. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
