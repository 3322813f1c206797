"""Arrow arrays made of their buffers.

`pyarrow.array` imports pandas if it is installed, for data of that library: 45 MB in every process that
writes a table. The functions here give the same arrays without it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def numbers(values: NDArray[Any], *, missing: NDArray[np.bool_] | None = None) -> pa.Array:
    """Return numbers or booleans (n,) as an Arrow array; ``missing`` (n,) marks those that are null.

    Memory of contiguous numbers is shared with ``values``.
    """
    packed = (
        np.packbits(values, bitorder="little") if values.dtype == np.bool_ else np.ascontiguousarray(values)
    )
    kind = pa.from_numpy_dtype(values.dtype)
    return pa.Array.from_buffers(kind, len(values), [_validity(missing), pa.py_buffer(packed)])


def texts(values: Sequence[str | None]) -> pa.Array:
    """Return strings as an Arrow array; None is null."""
    encoded = [(value or "").encode() for value in values]
    offsets = np.zeros(len(values) + 1, dtype=np.int32)
    np.cumsum([len(each) for each in encoded], out=offsets[1:])
    validity = _validity(np.array([value is None for value in values], dtype=np.bool_))
    buffers = [validity, pa.py_buffer(offsets), pa.py_buffer(b"".join(encoded))]
    return pa.Array.from_buffers(pa.string(), len(values), buffers)


def _validity(missing: NDArray[np.bool_] | None) -> pa.Buffer | None:
    """Return the bitmap of the values that are there; None if all are."""
    if missing is None or not missing.any():
        return None
    return pa.py_buffer(np.packbits(~missing, bitorder="little"))
