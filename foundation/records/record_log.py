"""Append-only binary logs of fixed-size records.

A process writes them while it runs, and the report converts them to tables. Records are rows of a NumPy
structured dtype. Blocks have a fixed number of rows, so equal runs write equal bytes, and after a kill all
blocks up to the last are readable.
"""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK_ROWS = 64
READ_ROWS = 16_384
"""Rows that a reader holds at a time"""


class RecordLog:
    """Writer of one log file, which is created or truncated.

    ``block_rows``: number of rows, multiples of which are written; 1 for a log that is read while it grows.
    The bytes of the file do not depend on it.
    """

    def __init__(self, path: str | Path, dtype: np.dtype[Any], *, block_rows: int = BLOCK_ROWS) -> None:
        self._file = Path(path).open("wb")  # noqa: SIM115 - closed by close()
        self._dtype = dtype
        self._block_rows = block_rows
        self._block_bytes = block_rows * dtype.itemsize
        self._rows: list[Any] = []
        self._packed = bytearray()
        """Packed rows that do not yet fill a block."""

    def append(self, rows: Iterable[Any]) -> None:
        """Add rows: tuples in the order of the dtype's fields, or records of that dtype."""
        self._rows.extend(rows)
        whole = len(self._rows) - len(self._rows) % self._block_rows
        if whole:
            self._write(np.array(self._rows[:whole], dtype=self._dtype).tobytes())
            del self._rows[:whole]

    def append_array(self, rows: NDArray[np.void]) -> None:
        """Add rows (n,) of the dtype; not to be mixed with `append` in one log."""
        self.append_packed(rows.tobytes())

    def append_packed(self, rows: bytes) -> None:
        """Add the bytes of rows, as `append_array`."""
        packed = self._packed
        packed += rows
        if len(packed) >= self._block_bytes:
            whole = len(packed) - len(packed) % self._block_bytes
            self._write(bytes(packed[:whole]))
            del packed[:whole]

    def close(self) -> None:
        """Write the remaining rows and close the file, also on errors; repeated calls have no effect."""
        if not self._file.closed:
            with self._file:
                self._write(np.array(self._rows, dtype=self._dtype).tobytes() + self._packed)
                self._rows.clear()
                self._packed.clear()

    def _write(self, data: bytes) -> None:
        try:
            self._file.write(data)
            self._file.flush()
        except OSError as error:
            error.filename = error.filename or self._file.name
            raise


def cut_to_blocks(path: str | Path, dtype: np.dtype[Any]) -> None:
    """Cut a log to whole blocks: those that a process with logs of usual blocks had written when killed.

    A missing file is none. Raises OSError.
    """
    path = Path(path)
    if path.exists():
        block_bytes = BLOCK_ROWS * dtype.itemsize
        os.truncate(path, path.stat().st_size // block_bytes * block_bytes)


def read(path: str | Path, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return all complete records of a log; an empty array if the file is missing.

    An incomplete last record, after a kill, is ignored.
    """
    path = Path(path)
    if not path.exists():
        return np.empty(0, dtype=dtype)
    buffer = path.read_bytes()
    return np.frombuffer(buffer, dtype=dtype, count=len(buffer) // dtype.itemsize)


def count(path: str | Path, dtype: np.dtype[Any]) -> int:
    """Return the number of complete records of a log; 0 if the file is missing."""
    path = Path(path)
    return path.stat().st_size // dtype.itemsize if path.exists() else 0


def read_rows(path: str | Path, dtype: np.dtype[Any], first: int, rows: int) -> NDArray[Any]:
    """Return at most ``rows`` complete records of a log from row ``first`` on."""
    rows = min(rows, count(path, dtype) - first)
    if rows <= 0:
        return np.empty(0, dtype=dtype)
    return np.fromfile(path, dtype=dtype, count=rows, offset=first * dtype.itemsize)


def read_blocks(path: str | Path, dtype: np.dtype[Any], *, rows: int = READ_ROWS) -> Iterator[NDArray[Any]]:
    """Yield the complete records of a log, as `read`, in blocks of at most ``rows`` rows."""
    for first in range(0, count(path, dtype), rows):
        yield read_rows(path, dtype, first, rows)
