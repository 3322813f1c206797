"""Converts the processes' binary logs to the run's Parquet tables, and these to the input of the analysis.

A field with several components becomes one column per component, named after its frame:
``pos_ned_m`` gives ``pos_ned_m.n``, ``.e`` and ``.d``. Rows are ordered by time, then vehicle; equal runs
give equal bytes.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from antenna.analysis.statistics import pointing_errors_deg
from antenna.solvers.ports import MAIN_LOBE_DEG
from autopilot.logs.vehicle_record import VEHICLE_RECORD, vehicle_record
from foundation.records.record_log import READ_ROWS, count, read_blocks, read_rows
from harness.records import columns
from harness.records.arrow_arrays import numbers, texts
from harness.records.column_file import ColumnFile
from harness.records.flight import Flight
from harness.records.run_folder import RunFolder
from harness.report.flown_array import GainSeries
from harness.scenario.scenario import Scenario
from harness.simulator.motion_start import flown_start_us, since_start_s
from harness.simulator.truth_record import AIR_RECORD, SENSOR_RECORD, truth_record
from netsim.emulator.log_layout import FRAME_LOG, RECEPTION_LOG, SESSION_LOG
from netsim.phy.receptions import OUTCOMES, STATES


def write_tables(
    folder: RunFolder, scenario: Scenario, desired: Callable[[NDArray[np.int64]], NDArray[np.float64]]
) -> ColumnFile:
    """Write the Parquet files from the raw logs, which are read in blocks.

    ``desired`` returns the places (T, agents, 3), site NED, at T times in us.

    Returns the columns of the flight, with the fields of `flight_record`, one row for each instant and
    vehicle.
    """
    applications, about = folder.applications(), columns.origin(scenario)
    logs: list[tuple[Path, columns.TableKind, Path, np.dtype[Any]]] = [
        (folder.radio, columns.RADIO, folder.raw_frames, FRAME_LOG),
        (folder.ftm, columns.FTM, folder.raw_sessions, SESSION_LOG),
        (folder.air, columns.AIR, folder.raw_air, AIR_RECORD),
    ]
    if scenario.sensors.extra:
        logs.append((folder.sensors, columns.SENSORS, folder.raw_sensors, SENSOR_RECORD))
    if scenario.radio.log_receptions:
        logs.append((folder.receptions, columns.RECEPTIONS, folder.raw_receptions, RECEPTION_LOG))
    for target, kind, log, layout in logs:
        with ColumnFile(folder.path, layout, column_fields(layout), rows=count(log, layout)) as found:
            for records in read_blocks(log, layout):
                found.append(records)
            table = found.table()
            if layout is RECEPTION_LOG:
                table = _with_names(table)
            found.write(columns.describe(table, kind, about), target)
    flight = _flight_columns(folder, scenario, desired)
    table = columns.describe(flight.table(), columns.flight_kind(applications), about)
    flight.write(table, folder.flight)
    return flight


def _flight_columns(
    folder: RunFolder, scenario: Scenario, desired: Callable[[NDArray[np.int64]], NDArray[np.float64]]
) -> ColumnFile:
    """Return the columns of the flight; see `write_tables`."""
    n, own = scenario.agents, vehicle_record(folder.applications().columns)
    truth = truth_record(scenario.most_rotors)
    layout = flight_record(truth, own)
    instants = count(folder.raw_truth, truth) // n
    vehicles = [_VehicleLog(folder.raw_vehicle(i), own) for i in range(n)]
    with contextlib.ExitStack() as stack:
        found = stack.enter_context(ColumnFile(folder.path, layout, column_fields(layout), rows=instants * n))
        at_once = max(1, READ_ROWS // n)
        for first in range(0, instants, at_once):
            rows = min(at_once, instants - first) * n
            block = read_rows(folder.raw_truth, truth, first * n, rows)
            flight = merge(
                block, [log.between(block["time_us"][0], block["time_us"][-1]) for log in vehicles]
            )
            flight["desired_pos_ned_m"] = desired(flight["time_us"][:, 0])
            found.append(flight.ravel())
        stack.pop_all()
    return found


class _VehicleLog:
    """The log of a vehicle's estimates, of which only the times are held in memory."""

    def __init__(self, path: Path, layout: np.dtype[Any]) -> None:
        self._path, self._layout = path, layout
        times = [block["time_us"].copy() for block in read_blocks(path, layout)]
        self._time_us = np.concatenate(times) if times else np.empty(0, np.int64)

    def between(self, first_us: int, last_us: int) -> NDArray[Any]:
        """Return records that include all from one time to another."""
        rows = np.flatnonzero((self._time_us >= first_us) & (self._time_us <= last_us))
        if not len(rows):
            return np.empty(0, self._layout)
        return read_rows(self._path, self._layout, int(rows[0]), int(rows[-1] - rows[0]) + 1)


def _with_names(receptions: pa.Table) -> pa.Table:
    """Return the table of receptions with names instead of codes."""
    for name, meanings in (("outcome", OUTCOMES), ("reception", STATES)):
        codes = receptions[name].cast(pa.int32()).combine_chunks()
        named = pa.DictionaryArray.from_arrays(codes, texts(meanings))
        receptions = receptions.set_column(receptions.schema.get_field_index(name), name, named)
    return receptions


def column_fields(layout: np.dtype[Any]) -> dict[str, tuple[str, int | None]]:
    """Return field and component of each column of a layout, in the order of the table."""
    found: dict[str, tuple[str, int | None]] = {}
    for name in layout.names or ():
        if layout[name].shape:
            found |= {column: (name, k) for k, column in enumerate(column_names(name, layout[name]))}
        else:
            found[name] = name, None
    return found


def flight_in(flight: ColumnFile, scenario: Scenario, *, start_us: int | None) -> Flight:
    """Return the flight of the columns of `write_tables` as views of them; ``start_us`` as in `flight_of`."""
    fields = {name: flight.array(name) for name in _ANALYSED}
    shape = -1, scenario.agents
    records = {name: values.reshape(*shape, *values.shape[1:]) for name, values in fields.items()}
    return replace(flight_of(records, scenario, start_us=start_us), release=flight.release)


def flight_of(
    records: NDArray[Any] | Mapping[str, NDArray[Any]], scenario: Scenario, *, start_us: int | None
) -> Flight:
    """Return the flight of (T, N) records with the fields `_ANALYSED`, or of arrays (T, N, ...) by field.

    ``start_us``: start of the formation's motion; None if it never moved.
    """
    time_us = records["time_us"][:, 0]
    return Flight(
        time_us=time_us,
        pos_ned_m=records["pos_ned_m"],
        q_ned_frd=records["q_ned_frd"],
        desired_pos_ned_m=records["desired_pos_ned_m"],
        heading_rad=scenario.plan().headings(since_start_s(time_us, start_us)),
        alive=records["alive"],
        believed_pos_ned_m=records["onboard_pos_ned_m"],
        standing_height_m=tuple(airframe.standing_height_m for airframe in scenario.airframes()),
    )


def make_flight(table: pa.Table, scenario: Scenario, *, start_us: int | None) -> Flight:
    """Return the flight of a run's table ``flight.parquet``; ``start_us`` as in `flight_of`.

    Raises KeyError or ValueError for a table of another scenario.
    """
    kind = np.dtype([(name, FLIGHT_RECORD[name]) for name in _ANALYSED])
    records = np.empty(table.num_rows, dtype=kind)
    for name in _ANALYSED:
        for column, values in _columns(name, records[name]):
            values[:] = table.column(column).to_numpy()
    return flight_of(records.reshape(-1, scenario.agents), scenario, start_us=start_us)


def read_flight(folder: RunFolder, scenario: Scenario) -> Flight:
    """Read the flight of a reported run; raises OSError, and as `make_flight`."""
    analysed = [column for name in _ANALYSED for column in column_names(name, FLIGHT_RECORD[name])]
    table = pq.read_table(folder.flight, columns=analysed)
    return make_flight(table, scenario, start_us=flown_start_us(folder.events))


def write_gains(path: Path, series: GainSeries, scenario: Scenario) -> None:
    """Write the antenna's maximum gain over time, one row per instant: the columns of `columns.GAINS`."""
    names = ("max_gain_dbi", "max_theta_deg", "max_phi_deg")
    errors_deg = pointing_errors_deg(series.patterns, *MAIN_LOBE_DEG).tolist()
    rows: dict[int, tuple[float | str | None, ...]] = {
        time_us: (*(getattr(pattern, name) for name in names), error_deg, None)
        for time_us, pattern, error_deg in zip(
            series.time_us.tolist(), series.patterns, errors_deg, strict=True
        )
    }
    rows |= {instant.time_us: (None, None, None, None, instant.reason) for instant in series.missing}
    ordered = [(time_us, *rows[time_us]) for time_us in sorted(rows)]
    arrays = [_gain_column(kind, [row[k] for row in ordered]) for k, kind in enumerate(GAIN_TYPES.values())]
    table = pa.Table.from_arrays(arrays, schema=pa.schema(GAIN_TYPES))
    _write(path, columns.describe(table, columns.GAINS, columns.origin(scenario)))


def _gain_column(kind: pa.DataType, values: Sequence[Any]) -> pa.Array:
    if kind == pa.string():
        return texts(values)
    missing = np.array([value is None for value in values], dtype=np.bool_)
    filled = [0 if value is None else value for value in values]
    return numbers(np.array(filled, dtype=kind.to_pandas_dtype()), missing=missing)


def merge(truth: NDArray[Any], vehicles: list[NDArray[Any]]) -> NDArray[Any]:
    """Merge the truth (instants x vehicles rows) with each vehicle's records at the same times.

    Missing values are NaN or 0, and so are the desired places.

    Returns (instants, vehicles) records of `flight_record`. An incomplete instant is omitted.
    """
    n = len(vehicles)
    truth = truth[: len(truth) // n * n].reshape(-1, n)
    flight = np.zeros(truth.shape, dtype=flight_record(truth.dtype, vehicles[0].dtype))
    for name in truth.dtype.names or ():
        flight[name] = truth[name]
    times_us = truth["time_us"][:, 0]
    for i, rows in enumerate(vehicles):
        rows = rows[np.isin(rows["time_us"], times_us)]
        at = np.searchsorted(times_us, rows["time_us"])
        for name in _vehicle_fields(rows.dtype):
            if np.issubdtype(flight[name].dtype, np.floating):
                flight[name][:, i] = np.nan
            flight[name][at, i] = rows[name]
    return flight


def _vehicle_fields(vehicle: np.dtype[Any]) -> list[str]:
    """Return the fields of the vehicle's record that the truth's record does not have."""
    return [name for name in vehicle.names or () if name not in (OF_QUADROTORS.names or ())]


def flight_record(truth: np.dtype[Any], vehicle: np.dtype[Any] = VEHICLE_RECORD) -> np.dtype[Any]:
    """Return the layout of truth, as `truth_record`, estimates, as `vehicle_record`, and desired position."""
    return np.dtype(
        [(name, truth[name]) for name in truth.names or ()]
        + [(name, vehicle[name]) for name in _vehicle_fields(vehicle)]
        + [("desired_pos_ned_m", np.dtype(("f8", 3)))]
    )


OF_QUADROTORS = truth_record(4)
FLIGHT_RECORD = flight_record(OF_QUADROTORS)
"""Layout of a run of quadrotors; with more rotors it has more rotor speeds."""
_ANALYSED = ("time_us", "pos_ned_m", "q_ned_frd", "desired_pos_ned_m", "alive", "onboard_pos_ned_m")
"""Fields of which a `Flight` consists"""
GAIN_TYPES = {
    "time_us": pa.int64(), "max_gain_dbi": pa.float64(), "max_theta_deg": pa.float64(),
    "max_phi_deg": pa.float64(), "pointing_error_deg": pa.float64(), "missing": pa.string(),
}  # fmt: skip
"""Types of the columns of ``gains.parquet`` by name"""


def _write(path: Path, table: pa.Table) -> None:
    pq.write_table(table, path, compression="zstd")


def _columns(name: str, values: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the columns of a field, (rows,) or (rows, components), with their names, as views."""
    if values.ndim == 1:
        yield name, values
        return
    for k, label in enumerate(_labels(name, values.shape[1])):
        yield f"{name}.{label}", values[:, k]


def column_names(name: str, layout: np.dtype[Any]) -> list[str]:
    """Return the names of the columns that a field of that layout becomes."""
    return [column for column, _ in _columns(name, np.empty(0, [(name, layout)])[name])]


def _labels(name: str, count: int) -> tuple[str, ...]:
    if name.startswith("q_") or "_q_" in name:
        return ("w", "x", "y", "z")
    if "frd" in name:
        return ("f", "r", "d")
    if count == 3:
        return ("n", "e", "d")
    return tuple(str(k) for k in range(count))
