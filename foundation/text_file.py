"""Reads a text file that a user has named; an error says in words why it cannot be read."""

import errno
from pathlib import Path

MOST_BYTES = 16_000_000
"""More is refused: a device such as /dev/zero has no end."""
_REASONS = {
    errno.ENOENT: "there is no such file",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EISDIR: "it is a folder, not a file",
    errno.EACCES: "this user may not read it",
    errno.ENAMETOOLONG: "the name is too long",
    errno.ELOOP: "it is a symbolic link to itself",
}


class TextFileError(Exception):
    """A file cannot be read as text; the text is one line with its path."""


def read_text(path: Path) -> str:
    """Return the contents of a UTF-8 file, with or without byte order mark. Raises TextFileError."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as error:
        reason = _REASONS.get(error.errno or 0, error.strerror or str(error))
        raise TextFileError(f"{path}: {reason}") from None
    except ValueError:  # a null byte in the path
        raise TextFileError(f"{str(path)!r}: this is no path of a file") from None
    if len(content) > MOST_BYTES:
        raise TextFileError(f"{path}: it is larger than {MOST_BYTES // 1_000_000} MB")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise TextFileError(f"{path}: it is not text (UTF-8)") from None
