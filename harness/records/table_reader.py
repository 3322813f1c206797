"""Reads a Parquet table by columns or in batches, as NumPy arrays and without pandas.

Conversions of Arrow import pandas if it is installed, 45 MB; here the arrays are views of Arrow's buffers.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

BATCH_ROWS = 8_192
_BUFFER_BYTES = 65_536
"""Of a column's compressed data that is read at once; without a buffer it is the column of a row group"""
_KINDS = {"double": "float64", "float": "float32", "halffloat": "float16"}
"""Names of NumPy's types by those of Arrow, where they differ"""


class TableReader:
    """A Parquet table with numbers, Booleans and dictionary-coded texts, none of them null."""

    def __init__(self, path: Path) -> None:
        """Open the table. Raises OSError."""
        before = pa.default_memory_pool()
        pa.set_memory_pool(pa.system_memory_pool())  # kept by the file; it returns what is freed at once
        try:
            self._file = pq.ParquetFile(path, pre_buffer=False, buffer_size=_BUFFER_BYTES)
        finally:
            pa.set_memory_pool(before)
        self.names: list[str] = self._file.schema_arrow.names
        self.rows: int = self._file.metadata.num_rows
        self.texts: dict[str, list[str]] = {}
        """Texts by their codes, of each column of texts that was read; it grows with every batch"""
        self._codes: dict[str, dict[str, int]] = {}

    def column(self, name: str) -> NDArray[Any]:
        """Return a column of all rows; of texts their codes. Raises KeyError, OSError."""
        if name not in self.names:
            raise KeyError(name)
        found, first = None, 0
        for part in self.batches([name]):
            values = part[name]
            if found is None:
                found = np.empty(self.rows, values.dtype)
            found[first : first + len(values)] = values
            first += len(values)
        return np.empty(0) if found is None else found

    def batches(self, names: Sequence[str], *, rows: int = BATCH_ROWS) -> Iterator[dict[str, NDArray[Any]]]:
        """Yield some columns in batches of at most ``rows`` rows, in order. Raises OSError."""
        for batch in self._file.iter_batches(batch_size=rows, columns=list(names), use_threads=False):
            yield {name: self._values(name, batch.column(name)) for name in names}

    def _values(self, name: str, array: pa.Array) -> NDArray[Any]:
        if pa.types.is_dictionary(array.type):
            known = self._codes.setdefault(name, {})
            texts = [str(text) for text in array.dictionary.to_pylist()]
            codes = [known.setdefault(text, len(known)) for text in texts]
            self.texts[name] = list(known)
            indices = numbers_of(array.indices)
            return np.array(codes, np.int32)[indices] if len(indices) else np.empty(0, np.int32)
        return numbers_of(array)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def numbers_of(array: pa.Array) -> NDArray[Any]:
    """Return the numbers or Booleans of an Arrow array without nulls; numbers as a view of its memory."""
    if pa.types.is_boolean(array.type):
        bits = np.frombuffer(array.buffers()[1], np.uint8)
        return np.unpackbits(bits, bitorder="little", count=array.offset + len(array))[array.offset :].astype(
            np.bool_
        )
    kind = np.dtype(_KINDS.get(str(array.type), str(array.type)))
    if not len(array):
        return np.empty(0, kind)
    return np.frombuffer(array.buffers()[1], kind, len(array), array.offset * kind.itemsize)
