"""The records of a run in pieces of simulated time: what viewers and exports read.

`pieces_of_tables` reads a reported run in bounded memory, `harness.records.live_pieces` the raw logs of a
flight that goes on. Both give the same pieces of the same flight.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from autopilot.logs.vehicle_record import vehicle_record
from foundation.records.record_log import READ_ROWS
from harness.records.run_folder import NotARun, RunFolder
from harness.records.tables import column_fields, flight_record
from harness.scenario.scenario import Scenario
from harness.simulator.truth_record import AIR_RECORD, SENSOR_RECORD, truth_record
from netsim.emulator.log_layout import FRAME_LOG, SESSION_LOG

Rows = NDArray[Any]
"""Records (n,) of a structured dtype"""
Event = dict[str, Any]
"""An event of events.jsonl: ``event`` is its kind, ``time_us`` its simulated time"""

GAIN_RECORD = np.dtype(
    [
        ("time_us", "i8"),
        ("max_gain_dbi", "f8"),
        ("max_theta_deg", "f8"),
        ("max_phi_deg", "f8"),
        ("pointing_error_deg", "f8"),
        ("missing", "O"),
    ]
)
"""A row of ``gains.parquet``; without a pattern the numbers are NaN and ``missing``, a str, is not empty."""
LATE_US = 10_000_000
"""Simulated time by which a ranging session may end later than a session of a later time of measurement."""
_BUFFER_BYTES = 65_536
"""Of a column that is read; without a buffer Parquet reads a million rows at once."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Piece:
    """All records of a run with ``after_us`` < time <= ``until_us``, in the order of their tables."""

    after_us: int
    until_us: int
    flight: Rows
    """(T, N) instants and vehicles, of the layout `flight_layout`"""
    frames: Rows
    """`FRAME_LOG`, by the time of their ends"""
    sessions: Rows
    """`SESSION_LOG`, by the time of their measurement"""
    air: Rows
    """`AIR_RECORD`"""
    sensors: Rows
    """`SENSOR_RECORD`, by the time of their arrival; empty without ``sensors.extra``"""
    events: list[Event]
    gains: Rows | None = None
    """`GAIN_RECORD`; None for a run without gains, or without tables"""


class Timed(NamedTuple):
    """How rows of a table are ordered."""

    field: str
    """Field of their time."""
    per_us: int = 1
    """Units of that field in a microsecond."""
    late_us: int = 0
    """Time by which a row may follow a row of a later time."""


FRAMES_BY = Timed("end_ns", 1_000)
SESSIONS_BY = Timed("measured_ns", 1_000, LATE_US)
ROWS_BY = Timed("time_us")


def flight_layout(folder: RunFolder, scenario: Scenario) -> np.dtype[Any]:
    """Return the layout of a run's flight: truth, estimates, numbers of the application, desired position.

    Raises OSError and msgspec.DecodeError.
    """
    own = vehicle_record(folder.applications().columns)
    return flight_record(truth_record(scenario.most_rotors), own)


def pieces_of_tables(folder: RunFolder, scenario: Scenario, *, step_us: int) -> Iterator[Piece]:
    """Yield the pieces of a reported run, each ``step_us`` long, from the start on; the last may be empty.

    Raises OSError, ValueError for a step below 1 us, and NotARun for tables of another version.
    """
    if step_us < 1:
        raise ValueError(f"step_us {step_us}: expected at least 1")
    flight = _table(folder.flight, flight_layout(folder, scenario))
    frames = _table(folder.radio, FRAME_LOG, FRAMES_BY)
    sessions = _table(folder.ftm, SESSION_LOG, SESSIONS_BY)
    air, sensors = _table(folder.air, AIR_RECORD), _table(folder.sensors, SENSOR_RECORD)
    gains = _table(folder.gains, GAIN_RECORD) if folder.gains.exists() else None
    events = deque(decode_events(folder.events.read_bytes().split(b"\n")))
    tables = [table for table in (flight, frames, sessions, air, sensors, gains) if table is not None]
    after_us = 0
    while True:
        until_us = after_us + step_us
        yield Piece(
            after_us=after_us,
            until_us=until_us,
            flight=flight.take(until_us).reshape(-1, scenario.agents),
            frames=frames.take(until_us),
            sessions=sessions.take(until_us),
            air=air.take(until_us),
            sensors=sensors.take(until_us),
            events=take_events(events, until_us),
            gains=None if gains is None else gains.take(until_us),
        )
        if not events and all(table.is_empty for table in tables):
            return
        after_us = until_us


class RowQueue:
    """Rows of a table, taken by time in the order of the table.

    ``read`` returns the next rows of the table, none if there are none now. Rows are held from the time that
    is taken to ``late_us`` later.
    """

    def __init__(self, read: Callable[[], Rows], layout: np.dtype[Any], by: Timed = ROWS_BY) -> None:
        self._read, self._by = read, by
        self.rows: Rows = np.empty(0, layout)
        """Rows that were read and not yet taken"""

    def fill(self, until_us: int) -> None:
        """Read until a row is later than a time, or there are no rows."""
        while self._latest() <= until_us * self._by.per_us and self.read():
            pass

    def read(self) -> bool:
        """Read the next rows; returns whether there are some."""
        more = self._read()
        if len(more):
            self.rows = np.concatenate([self.rows, more])
        return len(more) > 0

    def _latest(self) -> int:
        return int(self.rows[self._by.field].max()) if len(self.rows) else -1

    def take(self, until_us: int) -> Rows:
        """Return and remove the rows of times up to ``until_us``."""
        self.fill(until_us + self._by.late_us)
        due = self.rows[self._by.field] <= until_us * self._by.per_us
        taken, self.rows = self.rows[due], self.rows[~due]
        return taken

    @property
    def is_empty(self) -> bool:
        """Whether there are no more rows now."""
        return not (len(self.rows) or self.read())


def _table(path: Path, layout: np.dtype[Any], by: Timed = ROWS_BY) -> RowQueue:
    """Return the rows of a table, read in batches; of a table that does not exist there are none."""
    batches = _batches(path, layout) if path.exists() else iter(())
    return RowQueue(lambda: next(batches, np.empty(0, layout)), layout, by)


def _batches(path: Path, layout: np.dtype[Any]) -> Iterator[Rows]:
    columns = column_fields(layout)
    with pq.ParquetFile(path, buffer_size=_BUFFER_BYTES) as file:
        if missing := [name for name in columns if name not in file.schema_arrow.names]:
            raise NotARun(f"{path}: of another version: it has no column {missing[0]}")
        for batch in file.iter_batches(READ_ROWS, columns=[*columns], use_threads=False):
            if not len(batch):
                continue
            rows = np.empty(len(batch), layout)
            for name, (field, component) in columns.items():
                values = _values(batch.column(name), layout[field])
                (rows[field] if component is None else rows[field][:, component])[:] = values
            yield rows


def _values(column: pa.Array, kind: np.dtype[Any]) -> NDArray[Any]:
    """Return a column as numbers, as strings of bytes (dtype S) or as str objects (dtype O)."""
    if kind.kind == "O":
        return np.array([text or "" for text in column.to_pylist()], dtype=object)
    if isinstance(column, pa.DictionaryArray):
        names = np.array([name.encode("ascii") for name in column.dictionary.to_pylist()], dtype=kind)
        named: NDArray[Any] = names[column.indices.to_numpy(zero_copy_only=False)]
        return named
    values: NDArray[Any] = column.to_numpy(zero_copy_only=False)
    return values


def decode_events(lines: list[bytes]) -> list[Event]:
    """Return the events of lines by time; one that was cut off when its process ended is left out."""
    found: list[Event] = []
    for line in lines:
        try:
            event = msgspec.json.decode(line, type=Event)
        except msgspec.DecodeError:
            continue
        if isinstance(event.get("time_us"), int):
            found.append(event)
    return sorted(found, key=itemgetter("time_us"))


def take_events(events: deque[Event], until_us: int) -> list[Event]:
    """Return and remove the events up to a time; they are in order of time."""
    taken: list[Event] = []
    while events and events[0]["time_us"] <= until_us:
        taken.append(events.popleft())
    return taken
