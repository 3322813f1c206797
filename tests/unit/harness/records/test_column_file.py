"""Columns of a temporary file against the same records in memory: tables and files have equal bytes."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.typing import NDArray

from harness.records.column_file import ColumnFile

LAYOUT = np.dtype(
    [
        ("time_us", "i8"),
        ("uav", "i2"),
        ("alive", "?"),
        ("pos_ned_m", "f8", (3,)),
        ("q", "f4", (4,)),
        ("kind", "S16"),
    ]
)
COLUMNS = {
    "time_us": ("time_us", None), "uav": ("uav", None), "alive": ("alive", None),
    **{f"pos_ned_m.{label}": ("pos_ned_m", k) for k, label in enumerate("ned")},
    **{f"q.{label}": ("q", k) for k, label in enumerate("wxyz")},
    "kind": ("kind", None),
}  # fmt: skip


def records(rows: int) -> NDArray[Any]:
    random = np.random.default_rng(rows)
    made = np.zeros(rows, LAYOUT)
    made["time_us"], made["uav"] = np.arange(rows) // 8 * 40_000, np.arange(rows) % 8
    made["alive"], made["kind"] = random.random(rows) < 0.9, random.choice([b"beacon", b"ack", b"ftm"], rows)
    made["pos_ned_m"], made["q"] = random.normal(size=(rows, 3)), random.normal(size=(rows, 4))
    made["pos_ned_m"][random.random(rows) < 0.1] = np.nan
    return made


def in_memory(made: NDArray[Any]) -> pa.Table:
    """Return the table as it is made of records in memory, with the strings encoded by pyarrow."""
    columns = {}
    for name, (field, component) in COLUMNS.items():
        values = made[field] if component is None else made[field][:, component]
        if field == "kind":
            columns[name] = pa.array([each.decode() for each in values], pa.string()).dictionary_encode()
        else:
            columns[name] = pa.array(np.ascontiguousarray(values))
    return pa.table(columns)


@pytest.mark.parametrize("rows", [0, 1, 7, 5_000, 1_100_000])
@pytest.mark.parametrize("at_once", [1_000_000, 4_096])
def test_the_written_table_has_the_bytes_of_one_in_memory(rows: int, at_once: int, tmp_path: Path) -> None:
    made = records(rows)
    with ColumnFile(tmp_path, LAYOUT, COLUMNS, rows=rows) as found:
        for first in range(0, rows, at_once):
            found.append(made[first : first + at_once])
        found.write(found.table(), tmp_path / "file.parquet")
    pq.write_table(in_memory(made), tmp_path / "memory.parquet", compression="zstd")
    assert (tmp_path / "file.parquet").read_bytes() == (tmp_path / "memory.parquet").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file.parquet", "memory.parquet"]


def test_fields_are_views_that_outlive_the_file_and_a_release(tmp_path: Path) -> None:
    made = records(1_000)
    with ColumnFile(tmp_path, LAYOUT, COLUMNS, rows=1_000) as found:
        found.append(made)
        fields = {name: found.array(name) for name in ("time_us", "alive", "pos_ned_m", "q")}
    found.release()
    for name, values in fields.items():
        assert values.shape == made[name].shape
        assert np.array_equal(values, made[name], equal_nan=True)
        assert not values.flags.writeable


def test_records_that_are_missing_are_an_error(tmp_path: Path) -> None:
    with ColumnFile(tmp_path, LAYOUT, COLUMNS, rows=3) as found:
        found.append(records(2))
        with pytest.raises(ValueError, match="2 of 3 records are there"):
            found.table()


def test_the_memory_pool_of_the_program_stays(tmp_path: Path) -> None:
    before = pa.default_memory_pool().backend_name
    with ColumnFile(tmp_path, LAYOUT, COLUMNS, rows=0) as found:
        found.write(found.table(), tmp_path / "file.parquet")
    assert pa.default_memory_pool().backend_name == before
