"""The records of a flight that goes on, in pieces of simulated time, from the raw logs as they grow.

A piece is given once all its records are in the logs. Nothing waits for a vehicle that is lost, or for a
process that writes no records for `PATIENCE_US` of simulated time: what it writes later is left out of the
flight's rows, and of the other tables is in a later piece.
"""

import contextlib
from collections import deque
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import IO, Any, Self

import numpy as np

from autopilot.logs.vehicle_record import vehicle_record
from foundation.records.record_log import READ_ROWS
from harness.records.pieces import (
    FRAMES_BY,
    ROWS_BY,
    SESSIONS_BY,
    Event,
    Piece,
    RowQueue,
    Rows,
    Timed,
    decode_events,
    take_events,
)
from harness.records.run_folder import RunFolder
from harness.records.tables import merge
from harness.scenario.scenario import Scenario
from harness.simulator.motion_start import since_start_s
from harness.simulator.truth_record import AIR_RECORD, SENSOR_RECORD, truth_record
from netsim.emulator.log_layout import FRAME_LOG, SESSION_LOG

PATIENCE_US = 1_000_000
"""Simulated time by which the records of a living vehicle and of the channel may be behind the truth."""
_CHUNK_BYTES = 1 << 20


class LivePieces:
    """Pieces of a run's raw logs, each ``step_us`` long; a context manager that closes the logs.

    ``folder`` and ``scenario`` are those of a run whose processes are ready. The logs stay readable after
    they are deleted. Raises ValueError for a step below 1 us, and as `RunFolder.applications`.
    """

    def __init__(self, folder: RunFolder, scenario: Scenario, *, step_us: int) -> None:
        if step_us < 1:
            raise ValueError(f"step_us {step_us}: expected at least 1")
        self._step_us, self._agents, self._plan = step_us, scenario.agents, scenario.plan()
        self._files = contextlib.ExitStack()
        self._ended = False
        truth, own = truth_record(scenario.most_rotors), vehicle_record(folder.applications().columns)
        self._truth = self._queue(folder.raw_truth, truth)
        self._vehicles = [self._queue(folder.raw_vehicle(i), own) for i in range(scenario.agents)]
        self._air = self._queue(folder.raw_air, AIR_RECORD)
        self._frames = self._queue(folder.raw_frames, FRAME_LOG, FRAMES_BY)
        self._sessions = self._queue(folder.raw_sessions, SESSION_LOG, SESSIONS_BY)
        self._sensors = self._queue(folder.raw_sensors, SENSOR_RECORD)
        self._lines = _Lines(self._files, folder.events)
        self._events: deque[Event] = deque()
        """Events that were read and are of later pieces."""
        self._start_us: int | None = None
        """Start of the formation's motion."""
        self._until_us = 0
        self._reached_us = [0] * scenario.agents
        """Time of each vehicle's last record."""
        self._air_us = 0

    def _queue(self, path: Path, layout: np.dtype[Any], by: Timed = ROWS_BY) -> RowQueue:
        return RowQueue(partial(_Log(self._files, path, layout).read), layout, by)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the logs; repeated calls have no effect."""
        self._files.close()

    def advance(self, *, ended: bool = False) -> Iterator[Piece]:
        """Yield the pieces that are complete and were not given yet.

        With ``ended`` the processes have closed their logs: all records are given.
        """
        before_us = -1
        while before_us != self._until_us:
            before_us = self._until_us
            self._read_events()
            complete_us = self._complete_us(ended=ended)
            while self._until_us + self._step_us <= complete_us:
                yield self._take(self._until_us + self._step_us)
        while ended and not self._is_empty():
            yield self._take(self._until_us + self._step_us)

    def _read_events(self) -> None:
        events = decode_events(self._lines.read())
        self._events += events
        for event in events:
            if event["event"] == "formationmoves":
                self._start_us = event["start_us"]

    def _complete_us(self, *, ended: bool) -> int:
        """Return the time up to which the records of all processes are in the logs."""
        if len(self._truth.rows) < READ_ROWS + 2 * self._agents:
            self._truth.read()
        truth = self._truth.rows
        instants = len(truth) // self._agents
        if ended:
            return int(truth["time_us"][-1]) if len(truth) else self._until_us
        if instants < 2:
            return self._until_us
        newest_us = int(truth["time_us"][(instants - 1) * self._agents])
        # events of an instant are written after its truth
        complete_us = int(truth["time_us"][(instants - 2) * self._agents])
        least_us = newest_us - PATIENCE_US
        self._air.fill(complete_us)
        if len(self._air.rows):
            self._air_us = int(self._air.rows["time_us"][-1])
        complete_us = min(complete_us, max(self._air_us, least_us))
        alive = truth["alive"][(instants - 1) * self._agents : instants * self._agents]
        for i in np.flatnonzero(alive):
            vehicle = self._vehicles[i]
            vehicle.fill(complete_us)
            if len(vehicle.rows):
                self._reached_us[i] = int(vehicle.rows["time_us"][-1])
            complete_us = min(complete_us, max(self._reached_us[i], least_us))
        return complete_us

    def _take(self, until_us: int) -> Piece:
        after_us, self._until_us = self._until_us, until_us
        return Piece(
            after_us=after_us,
            until_us=until_us,
            flight=self._flight(until_us),
            frames=self._frames.take(until_us),
            sessions=self._sessions.take(until_us),
            air=self._air.take(until_us),
            sensors=self._sensors.take(until_us),
            events=take_events(self._events, until_us),
        )

    def _flight(self, until_us: int) -> Rows:
        truth = self._truth.take(until_us)
        flight = merge(truth, [vehicle.take(until_us) for vehicle in self._vehicles])
        since_s = since_start_s(flight["time_us"][:, 0], self._start_us)
        flight["desired_pos_ned_m"] = self._plan.places(since_s)
        return flight

    def _is_empty(self) -> bool:
        """Whether all records were given; rows of vehicles without a truth are none."""
        tables = (self._truth, self._frames, self._sessions, self._air, self._sensors)
        return not self._events and all(table.is_empty for table in tables)


class _Log:
    """The end of a log that grows; the file may be created later."""

    def __init__(self, files: contextlib.ExitStack, path: Path, layout: np.dtype[Any]) -> None:
        self._files, self._path, self._layout = files, path, layout
        self._file: IO[bytes] | None = None
        self._rest = b""

    def read(self) -> Rows:
        """Return the next records, at most `READ_ROWS`."""
        data = self._rest + self._bytes(READ_ROWS * self._layout.itemsize - len(self._rest))
        rows = len(data) // self._layout.itemsize
        self._rest = data[rows * self._layout.itemsize :]
        return np.frombuffer(data, self._layout, count=rows)

    def _bytes(self, most: int) -> bytes:
        if self._file is None:
            try:
                self._file = self._files.enter_context(self._path.open("rb", buffering=0))
            except FileNotFoundError:
                return b""
        return self._file.read(most)


class _Lines:
    """The lines of a text file that grows."""

    def __init__(self, files: contextlib.ExitStack, path: Path) -> None:
        self._bytes = _Log(files, path, np.dtype("u1"))
        self._unfinished = b""

    def read(self) -> list[bytes]:
        """Return the lines that are complete and were not returned yet."""
        while len(data := self._bytes.read()):
            self._unfinished += data.tobytes()
        *lines, self._unfinished = self._unfinished.split(b"\n")
        return lines
