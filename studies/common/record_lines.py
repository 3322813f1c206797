"""Files of records, to which a study appends each result as it ends: one JSON object a line."""

from pathlib import Path
from typing import TypeVar

import msgspec

T = TypeVar("T")


class RecordsError(ValueError):
    """A file of records that cannot be used: one line."""


def read_records(path: Path, kind: type[T], begin: bytes) -> list[T]:
    """Return the records in a file, which is made if it does not exist.

    A last line without its end is cut off if it begins with ``begin``, as every record does. Raises
    `RecordsError` for a file that cannot be read and written, or has other content; it stays as it is.
    """
    try:
        with path.open("a+b") as file:
            file.seek(0)
            *lines, last = file.read().split(b"\n")
            records = [_decoded(path, number, line, kind) for number, line in enumerate(lines, 1)]
            if last and not _is_half_written(last, begin, is_first=not lines):
                _decoded(path, len(lines) + 1, last, kind)
            file.truncate(sum(len(line) + 1 for line in lines))
    except OSError as error:
        raise RecordsError(f"{path}: {error.strerror or error}") from None
    return records


def _is_half_written(line: bytes, begin: bytes, *, is_first: bool) -> bool:
    if not line.startswith(begin) and (is_first or not begin.startswith(line)):
        return False
    try:
        msgspec.json.decode(line)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return True
    return False


def _decoded(path: Path, number: int, line: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(line, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        text = f"{path}, line {number}: not a record of this study: {error}; give another file"
        raise RecordsError(text) from None


def append_record(path: Path, record: object) -> None:
    """Append a record, and return when it is in the file. Raises OSError."""
    with path.open("ab") as file:
        file.write(msgspec.json.encode(record) + b"\n")
