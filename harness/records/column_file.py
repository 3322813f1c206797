"""Columns of a table in a temporary file: filled in blocks of records, written as Parquet, read as arrays.

The file has no name, and is mapped into memory for reading only. The system keeps of it what fits, so a long
flight takes no more memory than a short one.
"""

import io
import mmap
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from harness.records.arrow_arrays import numbers, texts

_ALIGNMENT_BYTES = 64
_CODE = np.dtype("i4")


class ColumnFile:
    """Columns of ``rows`` records of a layout; a context manager that frees them.

    ``columns`` maps the names of columns to fields and components, None for a field with one value. Strings
    (dtype S) are kept as codes. ``folder`` is where the file is; on NFS it has a name until it is freed.
    """

    def __init__(
        self, folder: Path, layout: np.dtype[Any], columns: Mapping[str, tuple[str, int | None]], *, rows: int
    ) -> None:
        self.rows = rows
        self._layout, self._columns = layout, columns
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  closed by `close`
        self._texts: dict[str, dict[bytes, int]] = {}
        """Codes by string, in the order of their first appearance, by field."""
        self._offsets: dict[str, int] = {}
        self._spacing: dict[str, int] = {}
        """Bytes between the columns of two components, by field."""
        end = 0
        for name, (field, component) in columns.items():
            size = -(-self._kind(field).itemsize * rows // _ALIGNMENT_BYTES) * _ALIGNMENT_BYTES
            self._offsets[name], self._spacing[field] = end, size
            if component in {None, 0}:
                self._offsets[field] = end
            if layout[field].kind == "S":
                self._texts[field] = {}
            end += size
        self._size_bytes = end
        self._filled = 0
        self._map: mmap.mmap | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _kind(self, field: str) -> np.dtype[Any]:
        """Return the type of a value in the file."""
        kind = self._layout[field].base
        return _CODE if kind.kind == "S" else kind

    def append(self, records: NDArray[Any]) -> None:
        """Add records (n,) of the layout. Raises OSError."""
        for name, (field, component) in self._columns.items():
            values = records[field] if component is None else records[field][:, component]
            if field in self._texts:
                values = self._codes(field, values)
            self._file.seek(self._offsets[name] + self._filled * values.itemsize)
            self._file.write(np.ascontiguousarray(values).data)
        self._filled += len(records)

    def _codes(self, field: str, values: NDArray[Any]) -> NDArray[np.int32]:
        codes = self._texts[field]
        found, first, inverse = np.unique(values, return_index=True, return_inverse=True)
        for k in np.argsort(first):
            codes.setdefault(found[k], len(codes))
        return np.array([codes[text] for text in found], dtype=_CODE)[inverse]

    def _mapped(self) -> mmap.mmap:
        if self._map is None:
            if self._filled != self.rows:
                raise ValueError(f"{self._filled} of {self.rows} records are there")
            self._file.flush()
            self._file.truncate(max(self._size_bytes, 1))
            self._map = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
            self._file.close()  # the map has a descriptor of its own
        return self._map

    def array(self, field: str) -> NDArray[Any]:
        """Return a field, (rows,) or (rows, components), as a read-only view; of strings their codes."""
        kind, components = self._kind(field), self._layout[field].shape
        shape = (self.rows, *components)
        strides = (kind.itemsize, self._spacing[field])[: len(shape)]
        return np.ndarray(shape, kind, self._mapped(), self._offsets[field], strides)

    def table(self) -> pa.Table:
        """Return the columns as an Arrow table, whose memory is the file's."""
        columns = {}
        for name, (field, component) in self._columns.items():
            values = self.array(field)
            array = numbers(values if component is None else values[:, component])
            if field in self._texts:
                names = texts([text.decode("ascii") for text in self._texts[field]])
                array = pa.DictionaryArray.from_arrays(array, names)
            columns[name] = array
        return pa.table(columns)

    def write(self, table: pa.Table, path: Path) -> None:
        """Write a table with columns of this file as Parquet. Raises OSError."""
        before = pa.default_memory_pool()
        pa.set_memory_pool(pa.system_memory_pool())  # returns what is freed at once
        try:
            with _Sink(path, self) as file:
                pq.write_table(table, file, compression="zstd")
        finally:
            pa.set_memory_pool(before)
            before.release_unused()  # what the encoder has used

    def release(self) -> None:
        """Return the memory of what was read to the system; it is read again from the file when needed."""
        if self._map is not None:
            self._map.madvise(mmap.MADV_DONTNEED)

    def close(self) -> None:
        """Close a file that was not read; the space of one that was is freed with the last view of it."""
        self._file.close()


class _Sink(io.BufferedWriter):
    """A file that returns the memory of the columns to the system while they are written."""

    def __init__(self, path: Path, columns: ColumnFile) -> None:
        super().__init__(io.FileIO(path, "w"))
        self._columns = columns

    def write(self, data: Any, /) -> int:  # noqa: ANN401  any buffer
        """Write bytes; returns their number."""
        self._columns.release()
        return super().write(data)
