"""Converts the processes' binary logs to the run's Parquet tables, and these to the input of the analysis.

A field with several components becomes one column per component, named after its frame:
``pos_ned_m`` gives ``pos_ned_m.n``, ``.e`` and ``.d``. Rows are ordered by time, then vehicle; equal runs
give equal bytes.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from antenna.analysis.statistics import pointing_errors_deg
from antenna.solvers.ports import MAIN_LOBE_DEG
from autopilot.logs.vehicle_record import VEHICLE_RECORD, vehicle_record
from foundation.records.record_log import read
from harness.records import columns
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
) -> NDArray[Any]:
    """Write the Parquet files from the raw logs.

    ``desired`` returns the places (T, agents, 3), site NED, at T times in us.

    Returns the flight: records (instants, agents) of `flight_record`.
    """
    applications = folder.applications()
    layout = vehicle_record(applications.columns)
    flight = merge(
        read(folder.raw_truth, truth_record(scenario.most_rotors)),
        [read(folder.raw_vehicle(i), layout) for i in range(scenario.agents)],
    )
    flight["desired_pos_ned_m"] = desired(flight["time_us"][:, 0])
    about = columns.origin(scenario)
    for target, kind, records in (
        (folder.flight, columns.flight_kind(applications), flight.ravel()),
        (folder.radio, columns.RADIO, read(folder.raw_frames, FRAME_LOG)),
        (folder.ftm, columns.FTM, read(folder.raw_sessions, SESSION_LOG)),
        (folder.air, columns.AIR, read(folder.raw_air, AIR_RECORD)),
    ):
        _write(target, columns.describe(_table(records), kind, about))
    if scenario.sensors.extra:
        readings = _table(read(folder.raw_sensors, SENSOR_RECORD))
        _write(folder.sensors, columns.describe(readings, columns.SENSORS, about))
    if scenario.radio.log_receptions:
        table = receptions_table(read(folder.raw_receptions, RECEPTION_LOG))
        _write(folder.receptions, columns.describe(table, columns.RECEPTIONS, about))
    return flight


def receptions_table(records: NDArray[Any]) -> pa.Table:
    """Return rows of `RECEPTION_LOG` as the table ``receptions.parquet``, with names instead of codes."""
    table = _table(records)
    for name, texts in (("outcome", OUTCOMES), ("reception", STATES)):
        codes = pa.array(np.ascontiguousarray(records[name]).astype(np.int32))
        named = pa.DictionaryArray.from_arrays(codes, pa.array(texts))
        table = table.set_column(table.schema.get_field_index(name), name, named)
    return table


def flight_of(records: NDArray[Any], scenario: Scenario, *, start_us: int | None) -> Flight:
    """Return the flight of (T, N) records with the fields `_ANALYSED`.

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
    return make_flight(pq.read_table(folder.flight), scenario, start_us=flown_start_us(folder.events))


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
    filled = [dict(zip(GAIN_TYPES, (time_us, *rows[time_us]), strict=True)) for time_us in sorted(rows)]
    table = pa.Table.from_pylist(filled, schema=pa.schema(GAIN_TYPES))
    _write(path, columns.describe(table, columns.GAINS, columns.origin(scenario)))


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


def _table(records: NDArray[Any]) -> pa.Table:
    """Return records (rows,) as a table with a column for each component of a field."""
    arrays = {
        column: _array(np.ascontiguousarray(values))
        for name in records.dtype.names or ()
        for column, values in _columns(name, records[name])
    }
    return pa.table(arrays)


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


def _array(values: NDArray[Any]) -> pa.Array:
    if values.dtype.kind == "S":  # short names, such as a frame's kind
        return pa.array(np.char.decode(values, "ascii").tolist(), pa.string()).dictionary_encode()
    return pa.array(values)


def _labels(name: str, count: int) -> tuple[str, ...]:
    if name.startswith("q_") or "_q_" in name:
        return ("w", "x", "y", "z")
    if "frd" in name:
        return ("f", "r", "d")
    if count == 3:
        return ("n", "e", "d")
    return tuple(str(k) for k in range(count))
