"""Append-only binary logs of fixed-size records.

What a process writes while it runs, and the report turns into tables.

Records are NumPy structured rows, written in whole blocks by row count alone, so equal runs give equal bytes
and a process that is killed leaves everything up to its last block readable.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK_ROWS = 64


class RecordLog:
    """Writer of one log file; makes or truncates it."""

    def __init__(self, path: str | Path, dtype: np.dtype[Any]) -> None:
        self._file = Path(path).open("wb")  # noqa: SIM115 - closed by close()
        self._dtype = dtype
        self._block_bytes = BLOCK_ROWS * dtype.itemsize
        self._rows: list[Any] = []
        self._packed = bytearray()
        """Rows that came packed, and do not fill a block yet."""

    def append(self, rows: Iterable[Any]) -> None:
        """Add rows: tuples in the order of the dtype's fields, or records of that dtype."""
        self._rows.extend(rows)
        while len(self._rows) >= BLOCK_ROWS:
            self._write(np.array(self._rows[:BLOCK_ROWS], dtype=self._dtype).tobytes())
            del self._rows[:BLOCK_ROWS]

    def append_array(self, rows: NDArray[np.void]) -> None:
        """Add rows (n,) of the dtype at once; a log gets all of its rows either so or by `append`."""
        self.append_packed(rows.tobytes())

    def append_packed(self, rows: bytes) -> None:
        """Add rows as `append_array`, whose bytes these are."""
        packed = self._packed
        packed += rows
        if len(packed) >= self._block_bytes:
            whole = len(packed) - len(packed) % self._block_bytes
            self._write(bytes(packed[:whole]))
            del packed[:whole]

    def close(self) -> None:
        """Write what is left, and close the file even if that fails. Harmless when repeated."""
        if not self._file.closed:
            with self._file:
                self._write(np.array(self._rows, dtype=self._dtype).tobytes() + self._packed)
                self._rows.clear()
                self._packed.clear()

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._file.flush()


def read(path: str | Path, dtype: np.dtype[Any]) -> NDArray[Any]:
    """All whole records of a log.

    None for a file that is missing. A record cut short by a kill is left out.
    """
    path = Path(path)
    if not path.exists():
        return np.empty(0, dtype=dtype)
    buffer = path.read_bytes()
    return np.frombuffer(buffer, dtype=dtype, count=len(buffer) // dtype.itemsize)
