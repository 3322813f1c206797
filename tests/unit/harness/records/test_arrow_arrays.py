"""Arrow arrays made of buffers against those of `pyarrow.array`, and what a report does not import."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray

from harness.records.arrow_arrays import numbers, texts

REPORT = """
import sys
from pathlib import Path

import numpy as np

import harness.cli.report
import harness.report.report
from antenna.analysis.statistics import gain_density
from harness.records.column_file import ColumnFile
from harness.records.tables import write_gains
from harness.report.flown_array import GainSeries, MissingPattern
from harness.scenario.scenario import Scenario

folder, layout = Path(sys.argv[1]), np.dtype([("time_us", "i8"), ("kind", "S4"), ("alive", "?")])
with ColumnFile(folder, layout, {name: (name, None) for name in layout.names}, rows=3) as found:
    found.append(np.zeros(3, layout))
    found.write(found.table(), folder / "table.parquet")
missing = (MissingPattern(1, "a reason"),)
series = GainSeries(
    time_us=np.empty(0, np.int64), max_gain_dbi=np.empty(0), patterns=(), median_index=None,
    median_snapshot=None, missing=missing,
)
write_gains(folder / "gains.parquet", series, Scenario(name="one"))
gain_density(np.arange(9.0))
large = ("pandas", "scipy.stats", "matplotlib.pyplot", "PyNEC", "xarray")
print([name for name in large if name in sys.modules])
"""


@pytest.mark.parametrize("rows", [0, 1, 7, 8, 9, 1000])
@pytest.mark.parametrize("kind", ["i2", "i4", "i8", "u1", "f4", "f8", "?"])
def test_numbers_equal_those_of_pyarrow(rows: int, kind: str) -> None:
    random = np.random.default_rng(rows)
    values: NDArray[Any] = random.integers(0, 2, rows).astype(kind)
    missing = random.random(rows) < 0.3
    assert numbers(values).equals(pa.array(values))
    assert numbers(values[::2]).equals(pa.array(values[::2]))
    array = numbers(values, missing=missing)
    array.validate(full=True)
    assert array.equals(pa.array(values, mask=missing))
    assert array.null_count == missing.sum()


def test_nan_is_a_value_and_not_missing() -> None:
    array = numbers(np.array([1.0, np.nan]))
    assert array.null_count == 0
    assert np.isnan(array[1].as_py())


@pytest.mark.parametrize(
    "values", [(), ("",), ("ok", "", "Ä → 漢"), ("ok", None), (None, None), tuple("abcdefghi")]
)
def test_texts_equal_those_of_pyarrow(values: tuple[str | None, ...]) -> None:
    array = texts(values)
    array.validate(full=True)
    assert array.equals(pa.array(values, pa.string()))


def test_a_report_imports_none_of_the_large_libraries_it_does_not_need(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", REPORT, str(tmp_path)], check=True, capture_output=True, text=True
    )
    assert done.stdout == "[]\n"
