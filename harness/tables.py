"""From the processes' binary logs to the run's columnar files.

A structured record's field of several components becomes one column each, named after its frame:
``pos_ned_m`` gives ``pos_ned_m.n``, ``.e`` and ``.d``. Rows are in order of time, then vehicle; equal runs
give equal bytes.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from antenna.ports import MAIN_LOBE_DEG
from antenna.statistics import pointing_errors_deg
from autopilot.recording import VEHICLE_RECORD
from harness.analysis import GainSeries
from harness.recording import AIR_RECORD, TRUTH_RECORD
from harness.run_folder import RunFolder
from netsim.logs import FRAME_LOG, SESSION_LOG
from netsim.record_log import read


def write_tables(
    folder: RunFolder, agents: int, desired: Callable[[NDArray[np.int64]], NDArray[np.float64]]
) -> NDArray[Any]:
    """Make the Parquet files from the raw logs.

    ``desired`` gives the places (T, agents, 3), site NED, at T times in us.

    Returns the flight: records (instants, agents) of `FLIGHT_RECORD`.
    """
    flight = merge(
        read(folder.raw_truth, TRUTH_RECORD),
        [read(folder.raw_vehicle(i), VEHICLE_RECORD) for i in range(agents)],
    )
    flight["desired_pos_ned_m"] = desired(flight["time_us"][:, 0])
    _write(folder.flight, flight.ravel())
    for target, raw, dtype in (
        (folder.radio, folder.raw_frames, FRAME_LOG),
        (folder.ftm, folder.raw_sessions, SESSION_LOG),
        (folder.air, folder.raw_air, AIR_RECORD),
    ):
        _write(target, read(raw, dtype))
    return flight


def write_gains(path: Path, series: GainSeries) -> None:
    """Write the aperture's maximum gain over time, a row for each instant.

    ``max_theta_deg`` and ``max_phi_deg`` are its direction in the antenna's frame, ``pointing_error_deg`` the
    angle from there to +y. Where there is no pattern these are null, and ``missing`` says why.
    """
    names = ("max_gain_dbi", "max_theta_deg", "max_phi_deg")
    errors_deg = pointing_errors_deg(series.patterns, *MAIN_LOBE_DEG).tolist()
    rows: dict[int, tuple[float | str | None, ...]] = {
        time_us: (*(getattr(pattern, name) for name in names), error_deg, None)
        for time_us, pattern, error_deg in zip(
            series.time_us.tolist(), series.patterns, errors_deg, strict=True
        )
    }
    rows |= {instant.time_us: (None, None, None, None, instant.reason) for instant in series.missing}
    times_us = sorted(rows)
    columns = {"time_us": pa.array(times_us, pa.int64())}
    for k, name in enumerate((*names, "pointing_error_deg", "missing")):
        kind = pa.string() if name == "missing" else pa.float64()
        columns[name] = pa.array([rows[time_us][k] for time_us in times_us], kind)
    pq.write_table(pa.table(columns), path, compression="zstd")


def merge(truth: NDArray[Any], vehicles: list[NDArray[Any]]) -> NDArray[Any]:
    """Truth (instants x vehicles rows) beside what each vehicle recorded at the same times.

    NaN or 0 where it did not, and for the desired places, which neither knows.

    Returns (instants, vehicles) records of `FLIGHT_RECORD`. An instant that was cut short is left out.
    """
    n = len(vehicles)
    truth = truth[: len(truth) // n * n].reshape(-1, n)
    flight = np.zeros(truth.shape, dtype=FLIGHT_RECORD)
    for name in TRUTH_RECORD.fields or ():
        flight[name] = truth[name]
    times_us = truth["time_us"][:, 0]
    for i, rows in enumerate(vehicles):
        rows = rows[np.isin(rows["time_us"], times_us)]
        at = np.searchsorted(times_us, rows["time_us"])
        for name in _vehicle_fields():
            if np.issubdtype(flight[name].dtype, np.floating):
                flight[name][:, i] = np.nan
            flight[name][at, i] = rows[name]
    return flight


def _vehicle_fields() -> list[str]:
    """Fields of the vehicle's record that the truth does not have under the same name."""
    return [name for name in VEHICLE_RECORD.names or () if name not in (TRUTH_RECORD.names or ())]


FLIGHT_RECORD = np.dtype(
    [(name, TRUTH_RECORD[name]) for name in TRUTH_RECORD.names or ()]
    + [(name, VEHICLE_RECORD[name]) for name in _vehicle_fields()]
    + [("desired_pos_ned_m", np.dtype(("f8", 3)))]
)
"""Truth, estimates, and where the vehicle should have been, by the formation's plan."""


def _write(path: Path, records: NDArray[Any]) -> None:
    columns: dict[str, NDArray[Any]] = {}
    for name in records.dtype.names or ():
        values = records[name]
        if values.ndim == 1:
            columns[name] = values
            continue
        for k, label in enumerate(_labels(name, values.shape[1])):
            columns[f"{name}.{label}"] = np.ascontiguousarray(values[:, k])
    arrays = {name: _array(values) for name, values in columns.items()}
    pq.write_table(pa.table(arrays), path, compression="zstd")


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
