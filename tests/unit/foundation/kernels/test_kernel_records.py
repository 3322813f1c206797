"""Records and tables that compiled and plain Python code share. 5 s."""

import os
import shutil
import subprocess
import sys
from typing import Annotated

import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from foundation.kernels.records import new_records, opener, record_dtype, table

PROGRAM = "from tests_of_records import changed; print(changed().tolist())"


class Header:
    columns: int
    row_at: int
    cell_at: int
    ready: bool
    level_mw: float


class Row:
    count: int
    draws: Annotated[NDArray[np.float64], 2]


HEADER, ROW = record_dtype(Header), record_dtype(Row)
open_header, row_of, cell_of = opener(Header), table("row_at", Row), table("cell_at", Row, columns="columns")


@njit
def change(block):
    """Set every field of the header, of the last row and of the last cell."""
    header = open_header(block)
    header.ready = True
    header.level_mw = 0.5
    row = row_of(header, 2)
    row.count += 7
    row.draws[1] = 2.5
    cell_of(header, 1, 3).count = header.columns


def changed():
    """Return a block with 3 rows and 2 x 4 cells after `change`."""
    at = HEADER.itemsize
    cells_at = at + 3 * ROW.itemsize
    block = np.zeros((cells_at + 8 * ROW.itemsize) // 8, np.int64)
    header = block[: at // 8].view(HEADER)
    header["columns"], header["row_at"], header["cell_at"] = 4, at, cells_at
    change(block)
    return block


def test_dtype_has_the_fields_of_the_class_in_their_order():
    assert HEADER.names == ("columns", "row_at", "cell_at", "ready", "level_mw")
    assert [HEADER[name].str for name in HEADER.names] == ["<i8", "<i8", "<i8", "<i8", "<f8"]
    assert ROW["draws"].shape == (2,)
    assert ROW.itemsize == 24


def test_fields_of_header_rows_and_cells_are_where_numpy_sees_them():
    block = changed()
    header = block[: HEADER.itemsize // 8].view(HEADER)[0]
    assert (header.ready, header.level_mw) == (1, 0.5)
    rows = np.ndarray(3, ROW, block, HEADER.itemsize)
    cells = np.ndarray((2, 4), ROW, block, HEADER.itemsize + rows.nbytes)
    assert rows["count"].tolist() == [0, 0, 7]
    assert rows["draws"].tolist() == [[0.0, 0.0], [0.0, 0.0], [0.0, 2.5]]
    assert cells["count"].tolist() == [[0, 0, 0, 0], [0, 0, 0, 4]]


@pytest.mark.parametrize("disabled", ["0", "1"])
def test_compiled_and_plain_code_change_the_same_bytes(disabled, tmp_path):
    shutil.copy(__file__, tmp_path / "tests_of_records.py")
    path = os.pathsep.join([str(tmp_path), *sys.path])
    environment = os.environ | {"NUMBA_DISABLE_JIT": disabled, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str(changed().tolist())


def test_dtype_of_a_class_is_one_object():
    """Numba recognises an array by the identity of its dtype."""
    assert record_dtype(Row) is record_dtype(Row)
    assert new_records(Row).dtype is record_dtype(Row)
