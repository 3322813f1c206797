"""Writes a reported run as one MCAP file: reads its tables in pieces, and maps each to messages."""

from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from foundation.records.record_log import READ_ROWS
from foundation.records.whole_file import whole_file
from harness.export.links import LinkTable
from harness.export.log_messages import LogMessages, event_topics
from harness.export.mcap_file import McapFile
from harness.export.messages import Message, Topic
from harness.export.radio_messages import RECEPTION_ROW, RadioMessages
from harness.export.scene import Scene
from harness.export.swarm_messages import (
    formation_messages,
    formation_topic,
    gain_messages,
    gain_topic,
    sensor_messages,
    sensor_topic,
)
from harness.export.vehicle_messages import VehicleMessages
from harness.records.columns import origin
from harness.records.pieces import Piece, flight_layout, pieces_of_tables
from harness.records.run_folder import NotARun, RunFolder, read_scenario
from harness.records.tables import flight_of
from harness.scenario.scenario import Scenario
from harness.simulator.motion_start import flown_start_us

STEP_US = 1_000_000
"""Simulated time that is in memory at once."""
SELDOM_US = 100_000
"""Period of the scene's links and of positions on the Earth."""
SUFFIX = ".mcap"
METADATA, SUMMARY = "coflight.run", "coflight.summary"
"""Names of the records of metadata."""
_WALL = ("wall_s", "real_time_factor", "profile")
"""What differs between equal runs."""


def write_mcap(folder: RunFolder, target: Path) -> None:
    """Write a reported run as an MCAP file, which only its owner can read.

    Readers find the whole file or none. Equal runs give equal bytes. Raises NotARun, OSError, and KeyError or
    ValueError for tables of another scenario.
    """
    scenario = read_scenario(folder)
    if not folder.flight.is_file():
        raise NotARun(f"{folder.path}: no run that has ended: it has no {folder.flight.name}")
    run = _Run(folder, scenario)
    with whole_file(target, private=True) as stream:
        file = McapFile(stream, epoch_ns=run.epoch_ns)
        for topic in run.topics:
            file.add_topic(topic)
        for name, content in run.metadata.items():
            file.add_metadata(name, content)
        for piece in pieces_of_tables(folder, scenario, step_us=STEP_US):
            file.add(sorted(run.messages(piece), key=itemgetter(0)))
        file.finish()


class _Run:
    """A run's topics, metadata, and messages by piece."""

    def __init__(self, folder: RunFolder, scenario: Scenario) -> None:
        self.epoch_ns = scenario.run.epoch_unix_us * 1_000
        self._scenario, applications = scenario, folder.applications()
        self._summary = _decoded(folder.summary)
        manifest = _decoded(folder.manifest)
        self._start_us = flown_start_us(folder.events)
        self._formed_us = _formed_us(self._summary, manifest)
        self._stations = scenario.agents + len(scenario.channel.guests)
        self._links = LinkTable(self._stations)
        self._receptions = _Receptions(folder.receptions) if folder.receptions.is_file() else None
        self._vehicles = VehicleMessages(
            scenario, applications, flight_layout(folder, scenario), epoch_ns=self.epoch_ns
        )
        self._radio = RadioMessages(with_receptions=self._receptions is not None)
        self._log = LogMessages(applications, epoch_ns=self.epoch_ns)
        self._scene = Scene(scenario, epoch_ns=self.epoch_ns)
        self._last_period = -1
        self.topics: list[Topic] = [
            *self._vehicles.topics, *self._scene.topics, *self._radio.topics, *event_topics(),
        ]  # fmt: skip
        self.topics += [formation_topic()] if self._formed_us is not None else []
        self.topics += [gain_topic()] if folder.gains.is_file() else []
        self.topics += _sensor_topics(folder.sensors) if folder.sensors.is_file() else []
        self.metadata = {
            METADATA: _about(scenario, self._summary, manifest),
            SUMMARY: dict(_flat({k: v for k, v in self._summary.items() if k not in _WALL})),
        }

    def messages(self, piece: Piece) -> Iterator[Message]:
        """Yield the messages of the next piece, in no order."""
        flight, seldom = piece.flight, self._seldom(piece.flight)
        yield from self._radio.frames(piece.frames)
        if self._receptions is None:
            self._links.add_frames(piece.frames)
        else:
            rows, of_frame = self._receptions.of(len(piece.frames))
            ends_ns = piece.frames["end_ns"][of_frame]
            self._links.add_receptions(rows, ends_ns, piece.frames["kind"][of_frame])
            yield from self._radio.receptions(rows, ends_ns)
        yield from self._radio.sessions(piece.sessions)
        yield from self._radio.occupancy(piece.air)
        yield from self._vehicles.messages(flight, seldom)
        yield from self._scene.messages(flight, seldom, self._links)
        yield from self._log.changes(flight)
        yield from self._log.events(piece.events)
        yield from self._formation(flight)
        yield from sensor_messages(piece.sensors)
        if piece.gains is not None:
            yield from gain_messages(piece.gains)

    def _seldom(self, flight: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which instants (T,) are the first of a period."""
        periods = flight["time_us"][:, 0] // SELDOM_US
        chosen = np.diff(periods, prepend=self._last_period) > 0
        if len(periods):
            self._last_period = int(periods[-1])
        return chosen

    def _formation(self, flight: NDArray[Any]) -> Iterator[Message]:
        if self._formed_us is not None:
            flight = flight[flight["time_us"][:, 0] >= self._formed_us]
            if len(flight):
                yield from formation_messages(flight_of(flight, self._scenario, start_us=self._start_us))


def _decoded(path: Path) -> dict[str, Any]:
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except FileNotFoundError:
        raise NotARun(f"{path.parent}: it has no {path.name}") from None
    except msgspec.DecodeError as error:
        raise NotARun(f"{path}: not JSON: {error}") from None


def _formed_us(summary: dict[str, Any], manifest: dict[str, Any]) -> int | None:
    """Return from when the summary has errors of the formation; None: from never."""
    errors = summary.get("formation_rms_m") or {}
    return manifest.get("formed_us") if errors.get("absolute") is not None else None


def _about(scenario: Scenario, summary: dict[str, Any], manifest: dict[str, Any]) -> dict[str, str]:
    versions = {f"version.{name}": str(each) for name, each in manifest.get("versions", {}).items()}
    return {
        **origin(scenario),
        "agents": str(scenario.agents),
        "status": str(summary.get("status")),
        "log_sha256": str(summary.get("log_sha256")),
        **versions,
    }


def _flat(content: Any, path: str = "") -> Iterator[tuple[str, str]]:  # noqa: ANN401
    """Yield the values of a JSON object with their paths, such as ``vehicles.0.alive``; null is left out."""
    if isinstance(content, dict | list):
        items = content.items() if isinstance(content, dict) else enumerate(content)
        for key, value in items:
            yield from _flat(value, f"{path}.{key}" if path else str(key))
    elif content is not None:
        yield path, content if isinstance(content, str) else msgspec.json.encode(content).decode()


class _Receptions:
    """The rows of receptions.parquet, in the order of frames."""

    def __init__(self, path: Path) -> None:
        file = pq.ParquetFile(path, buffer_size=65_536)
        self._batches = file.iter_batches(READ_ROWS, use_threads=False)
        self._rows = np.empty(0, RECEPTION_ROW)
        self._frames = 0
        """Number of frames whose receptions were returned."""

    def of(self, frames: int) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """Return the receptions of the next frames, and for each the number of its frame among these."""
        first, self._frames = self._frames, self._frames + frames
        while not len(self._rows) or self._rows["frame"][-1] < self._frames:
            batch = next(self._batches, None)
            if batch is None:
                break
            rows = np.empty(len(batch), RECEPTION_ROW)
            for name in RECEPTION_ROW.names or ():
                rows[name] = batch.column(name).to_numpy(zero_copy_only=False)
            self._rows = np.concatenate([self._rows, rows])
        count = int(np.searchsorted(self._rows["frame"], self._frames))
        taken, self._rows = self._rows[:count], self._rows[count:]
        return taken, taken["frame"] - first


def _sensor_topics(path: Path) -> list[Topic]:
    """Return a topic for each sensor of each vehicle that has a reading."""
    found: dict[tuple[int, str], dict[str, None]] = {}
    with pq.ParquetFile(path, buffer_size=65_536) as file:
        for batch in file.iter_batches(READ_ROWS, columns=["uav", "sensor", "column"], use_threads=False):
            for uav, sensor, column in sorted(
                set(
                    zip(
                        *(batch.column(name).to_pylist() for name in ("uav", "sensor", "column")), strict=True
                    )
                )
            ):
                found.setdefault((uav, sensor), {})[column] = None
    return [sensor_topic(uav, sensor, list(columns)) for (uav, sensor), columns in sorted(found.items())]
