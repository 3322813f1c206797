"""The flight with one row per instant: a group of columns for each vehicle, named ``uav0.pos_ned_m.n``."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

FORMATS = (".parquet", ".csv")


def widen(flight: pa.Table) -> pa.Table:
    """Return a table ``flight.parquet`` in its wide form, with the metadata of schema and fields.

    Columns: ``time_us``, then those of vehicle 0, of vehicle 1 and so on. Raises KeyError without the columns
    ``time_us`` and ``uav``, and ValueError unless every instant has all vehicles in the order of their
    numbers.
    """
    time_us, uav = (flight.column(name).to_numpy() for name in ("time_us", "uav"))
    vehicles = int(uav.max()) + 1 if len(uav) else 0
    if len(uav):
        of_instant_us = time_us[::vehicles]
        in_order = np.array_equal(uav, np.tile(np.arange(vehicles), len(of_instant_us)))
        if not in_order or np.any(time_us != np.repeat(of_instant_us, vehicles)):
            raise ValueError("an instant lacks a vehicle, or its vehicles are not in order")
        if np.any(np.diff(of_instant_us) <= 0):
            raise ValueError("an instant lacks a vehicle, or is there twice")
    of_vehicle = [each for each in flight.schema if each.name not in ("time_us", "uav")]
    fields, columns = [_named(flight.schema.field("time_us"), "time_us")], [_every(time_us, 0, vehicles)]
    for k in range(vehicles):
        for each in of_vehicle:
            fields.append(_named(each, f"uav{k}.{each.name}"))
            columns.append(_every(flight.column(each.name).to_numpy(), k, vehicles))
    about = (flight.schema.metadata or {}) | {b"row": b"a recorded instant (`run.record_rate_hz`)"}
    return pa.Table.from_arrays(columns, schema=pa.schema(fields, metadata=about))


def write_wide(flight: Path, target: Path) -> None:
    """Write the wide form of a table ``flight.parquet`` in one of the `FORMATS`, by the suffix of the target.

    A CSV file has no metadata. Raises OSError, and as `widen`.
    """
    table = widen(pq.read_table(flight))
    with target.open("wb") as file:
        if target.suffix == ".csv":
            pyarrow.csv.write_csv(table, file)
        else:
            pq.write_table(table, file, compression="zstd")


def _every(values: NDArray[Any], first: int, step: int) -> pa.Array:
    return pa.array(np.ascontiguousarray(values[first :: max(step, 1)]))


def _named(field: pa.Field, name: str) -> pa.Field:
    """Return the field with another name, without the number that Parquet gives to a column."""
    metadata = {key: text for key, text in (field.metadata or {}).items() if not key.startswith(b"PARQUET:")}
    return field.with_name(name).with_metadata(metadata)
