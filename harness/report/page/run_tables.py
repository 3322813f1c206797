"""Reads what a run's page shows from its Parquet tables, one column or batch at a time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from harness.records.run_folder import RunFolder
from harness.records.table_reader import TableReader
from harness.report.page import channel_plots, ranging_plots, replay
from harness.report.page.channel_plots import ChannelStatistics, time_bins
from harness.report.page.ranging_plots import RangingStatistics

MOST_SENSOR_SERIES = 12
"""Values of own sensors that are drawn"""


class FlightColumns:
    """Columns of ``flight.parquet`` as arrays (T, N); each is read when it is used, and not kept."""

    def __init__(self, path: Path, vehicles: int) -> None:
        """Open the table. Raises OSError."""
        self._reader, self.vehicles = TableReader(path), vehicles
        self.time_s: NDArray[np.float64] = self._reader.column("time_us")[::vehicles] / 1e6
        self.alive: NDArray[np.bool_] = self.column("alive").astype(np.bool_)

    def __len__(self) -> int:
        return len(self.time_s)

    def column(self, name: str) -> NDArray[Any]:
        """Return a column (T, N). Raises KeyError, OSError."""
        return self._reader.column(name).reshape(-1, self.vehicles)

    def living(self, name: str) -> NDArray[np.float32]:
        """Return a column (T, N) of numbers, NaN where a vehicle is lost. Raises KeyError, OSError."""
        values = self.column(name).astype(np.float32)
        values[~self.alive] = np.nan
        return values

    def vectors(self, name: str, rows: NDArray[np.int64], components: str = "ned") -> NDArray[Any]:
        """Return a vector at some instants (K, N, 3). Raises KeyError, OSError."""
        return np.stack([self.column(f"{name}.{each}")[rows] for each in components], axis=-1)

    def length(self, name: str, other: str | None = None, components: str = "ned") -> NDArray[np.float32]:
        """Return the length (T, N) of a vector, or of its difference to another one, of living vehicles."""
        total = np.zeros((len(self), self.vehicles), np.float32)
        for each in components:
            values = self.column(f"{name}.{each}")
            if other is not None:
                values -= self.column(f"{other}.{each}")
            values *= values
            total += values
        total[~self.alive] = np.nan
        return np.sqrt(total, out=total)

    def tilt_deg(self) -> NDArray[np.float32]:
        """Return the angle (T, N) between the bodies' and the site's vertical, of living vehicles."""
        sine = self.length("q_ned_frd", components="xy")
        np.minimum(sine, 1.0, out=sine)
        return np.rad2deg(2.0 * np.arcsin(sine))

    def application_columns(self) -> list[str]:
        """Return the names of the columns of the on-board applications."""
        return [name for name in self._reader.names if name.startswith("app_")]

    def close(self) -> None:
        """Close the table."""
        self._reader.close()


def recorded_s(folder: RunFolder, simulated_s: float) -> float:
    """Return the time up to which figures of channel and ranging reach. Raises OSError.

    It is the end of the flight; of a run whose launcher was killed the channel may be recorded for longer.
    """
    reader = TableReader(folder.radio)
    starts_s = [float(frames["start_ns"].max()) / 1e9 for frames in reader.batches(["start_ns"])]
    reader.close()
    last_s = max(starts_s, default=0.0)
    return last_s if last_s > simulated_s + channel_plots.LEAST_BIN_S else simulated_s


def read_channel(folder: RunFolder, end_s: float, links: replay.Links | None) -> ChannelStatistics:
    """Return the statistics of the frames of a run, and add its datagrams to the links. Raises OSError."""
    found, reader = ChannelStatistics(end_s), TableReader(folder.radio)
    for frames in reader.batches(tuple({**dict.fromkeys(channel_plots.COLUMNS), **_LINK_COLUMNS})):
        found.add(frames, reader.texts)
        if links is not None:
            links.add_frames(frames, reader.texts["kind"])
    reader.close()
    return found


_LINK_COLUMNS = dict.fromkeys(replay.FRAME_COLUMNS)


def read_ranging(folder: RunFolder, end_s: float, links: replay.Links | None) -> RangingStatistics:
    """Return the statistics of the ranging sessions of a run, and add them to the links. Raises OSError."""
    found, reader = RangingStatistics(end_s), TableReader(folder.ftm)
    for sessions in reader.batches(ranging_plots.COLUMNS):
        found.add(sessions, reader.texts)
        if links is not None:
            links.add_sessions(sessions, reader.texts["status"])
    reader.close()
    return found


def read_sensors(
    folder: RunFolder, vehicles: int, end_s: float
) -> tuple[dict[tuple[str, str], NDArray[np.float32]], NDArray[np.float64], int]:
    """Return the scenario's own sensors for `harness.report.page.flight_plots.sensor_plots`.

    Least and greatest value of each interval (2 B, N) by sensor and column, the edges (B + 1,) of the
    intervals, and the number of further values. Raises OSError.
    """
    edges_s = time_bins(end_s)
    series: dict[tuple[str, str], NDArray[np.float32]] = {}
    left_out: set[tuple[str, str]] = set()
    if not folder.sensors.exists():
        return series, edges_s, 0
    reader, bins = TableReader(folder.sensors), len(edges_s) - 1
    for batch in reader.batches(("measured_us", "uav", "sensor", "column", "value")):
        at = np.clip(np.searchsorted(edges_s, batch["measured_us"] / 1e6, side="right") - 1, 0, bins - 1)
        columns = len(reader.texts["column"])
        kinds = batch["sensor"] * columns + batch["column"]
        for kind in np.unique(kinds).tolist():
            key = reader.texts["sensor"][kind // columns], reader.texts["column"][kind % columns]
            if key not in series:
                if len(series) >= MOST_SENSOR_SERIES:
                    left_out.add(key)
                    continue
                series[key] = np.full((2 * bins, vehicles), np.nan, np.float32)
            chosen = kinds == kind
            values = batch["value"][chosen].astype(np.float32)
            np.fmin.at(series[key][0::2], (at[chosen], batch["uav"][chosen]), values)
            np.fmax.at(series[key][1::2], (at[chosen], batch["uav"][chosen]), values)
    reader.close()
    return series, edges_s, len(left_out)


def read_events(folder: RunFolder) -> list[dict[str, Any]]:
    """Return the events of a run in their order, without a last line that was cut off. Raises OSError."""
    lines = folder.events.read_bytes().split(b"\n")[:-1]
    return [msgspec.json.decode(line, type=dict[str, Any]) for line in lines if line]


def failsafe_words(causes: Sequence[int], meanings: Mapping[str, str]) -> dict[str, str]:
    """Return the names of sets of causes, by the number of each set."""
    words = {}
    for value in causes:
        names = [text for bit, text in meanings.items() if value & int(bit)]
        words[str(value)] = ", ".join(names) or "failsafe"
    return words
