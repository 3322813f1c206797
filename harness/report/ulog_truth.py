"""Adds the ground truth, which only the simulator has, to the vehicles' ULogs.

The report appends subscriptions and samples of the topics that PX4 names ``..._groundtruth``, from the record
of the truth, at its rate (``run.record_rate_hz``) or the topic's if that is lower. They are ordinary messages
of the log, so every reader has them. An incomplete message, which a killed vehicle leaves at the end, is
removed before. An earlier truth is replaced: a report that was broken off is repeated.
"""

import math
import mmap
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from autopilot.logs.ulog_messages import HEADER, MAGIC, MESSAGE, subscription
from autopilot.logs.ulog_topics import DATA, NUMBER_OF, TOPICS, TRUTH_TOPICS, Topic
from autopilot.navigation.site_frame import site_ned_m
from autopilot.parameters.config import Site
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.records.record_log import read_blocks
from harness.records.run_folder import RunFolder
from harness.scenario.scenario import Scenario
from harness.simulator.truth_record import truth_record

Columns = dict[str, Any]
_SUBSCRIBES = ord("A")
_POSITION = NUMBER_OF["vehicle_local_position"]
_POSITION_DTYPE = TOPICS[_POSITION].dtype
_NUMBER_AT = 3
"""Offset of the subscription's number in a data message, and in a message that subscribes after its multi
id."""


class Contents(NamedTuple):
    """What a log has before the ground truth."""

    end: int
    """Bytes up to the last whole message that is not of the ground truth."""
    origin_deg: tuple[float, float] | None
    """Latitude and longitude of the vehicle's local frame; None while unknown."""


def add_truth(folder: RunFolder, scenario: Scenario) -> None:
    """Add the ground truth to the ULogs of a run's own vehicles that wrote one. Raises OSError."""
    logs = {i: path for i in range(scenario.agents) if (path := folder.ulog(i)).exists()}
    if not logs:
        return
    writers = {}
    for i, path in logs.items():
        with path.open("r+b") as file:
            contents = contents_of(file.fileno(), path.stat().st_size)
            if contents is None:
                continue
            file.truncate(contents.end)
            file.seek(contents.end)
            first = len(TOPICS)
            file.write(b"".join(subscription(first + k, topic) for k, topic in enumerate(TRUTH_TOPICS)))
        standing_m = scenario.vehicle.airframe_of(i).standing_height_m
        writers[i] = _TruthEncoder(scenario.site, contents.origin_deg, standing_m)
    for block in read_blocks(folder.raw_truth, truth_record(scenario.most_rotors)):
        for i, writer in writers.items():
            data = writer.encode(block[block["uav"] == i])
            with logs[i].open("ab") as file:
                file.write(data)


def contents_of(descriptor: int, size: int) -> Contents | None:
    """Return what an open file of a ULog has; None if it is none."""
    if size < HEADER.size:
        return None
    with mmap.mmap(descriptor, size, access=mmap.ACCESS_READ) as data:
        if data[: len(MAGIC)] != MAGIC:
            return None
        end, last = HEADER.size, None
        for at, kind, number in _messages(data, size):
            if kind == _SUBSCRIBES and number >= len(TOPICS):
                return Contents(at, _origin(data, last))
            end = at + MESSAGE.size + MESSAGE.unpack_from(data, at)[0]
            if kind == DATA and number == _POSITION:
                last = at
        return Contents(end, _origin(data, last))


def _messages(data: mmap.mmap, size: int) -> Iterator[tuple[int, int, int]]:
    """Yield offset, kind and number of the subscription of each whole message."""
    at = HEADER.size
    while at + MESSAGE.size <= size:
        length, kind = MESSAGE.unpack_from(data, at)
        if at + MESSAGE.size + length > size:
            return
        number_at = at + _NUMBER_AT + (kind == _SUBSCRIBES)
        number = int.from_bytes(data[number_at : number_at + 2], "little")
        yield at, kind, number
        at += MESSAGE.size + length


def _origin(data: mmap.mmap, at: int | None) -> tuple[float, float] | None:
    """Return the reference of the vehicle_local_position at an offset."""
    if at is None:
        return None
    sample = np.frombuffer(data[at : at + _POSITION_DTYPE.itemsize], _POSITION_DTYPE)[0]
    origin_deg = float(sample["ref_lat"]), float(sample["ref_lon"])
    return None if math.isnan(origin_deg[0]) else origin_deg


class _TruthEncoder:
    """Encodes the truth of one vehicle in the frames of its own estimates."""

    def __init__(self, site: Site, origin_deg: tuple[float, float] | None, standing_m: float) -> None:
        """``standing_m``: height of the centre of mass above the ground, where the vehicle's height is 0."""
        self._site = site
        self._ref_deg = origin_deg or (site.latitude_deg, site.longitude_deg)
        north_m, east_m, _ = site_ned_m(site, *self._ref_deg, site.altitude_m)
        self._origin_ned_m = np.array((north_m, east_m, -standing_m))
        self._ref_alt_m = site.altitude_m + standing_m
        self._last_us = 0
        self._ref_us: int | None = None

    def encode(self, truth: NDArray[Any]) -> bytes:
        """Return the samples of records (n,) of `truth_record`."""
        truth = truth[truth["time_us"] > 0]  # viewers take a time of 0 for an invalid one
        if not len(truth):
            return b""
        time_us, q = truth["time_us"], truth["q_ned_frd"]
        before_us = np.concatenate(([self._last_us], time_us[:-1]))
        self._last_us = int(time_us[-1])
        if self._ref_us is None:
            self._ref_us = int(time_us[0])
        local_m, vel_m_s = truth["pos_ned_m"] - self._origin_ned_m, truth["vel_ned_m_s"]
        lat_deg, lon_deg, alt_m = ned_to_geodetic(
            truth["pos_ned_m"],
            origin_lat_deg=self._site.latitude_deg,
            origin_lon_deg=self._site.longitude_deg,
            origin_alt_m=self._site.altitude_m,
        )
        w, x, y, z = q.T
        found: tuple[Columns, ...] = (
            {"xyz": truth["omega_frd_rad_s"], "xyz_derivative": math.nan},
            {"q": q, "delta_q_reset": np.tile((1.0, 0.0, 0.0, 0.0), (len(q), 1))},
            {
                "x": local_m[:, 0], "y": local_m[:, 1], "z": local_m[:, 2],
                "vx": vel_m_s[:, 0], "vy": vel_m_s[:, 1], "vz": vel_m_s[:, 2], "z_deriv": vel_m_s[:, 2],
                "heading": np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
                "ref_timestamp": self._ref_us, "ref_lat": self._ref_deg[0], "ref_lon": self._ref_deg[1],
                "ref_alt": self._ref_alt_m,
                **dict.fromkeys(
                    ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid", "xy_global", "z_global"), True
                ),
                **dict.fromkeys(_UNKNOWN, math.nan),
            },
            {
                "lat": lat_deg, "lon": lon_deg, "alt": alt_m, "alt_ellipsoid": alt_m, "lat_lon_valid": True,
                "alt_valid": True, "terrain_alt": self._site.altitude_m, "terrain_alt_valid": True,
            },
        )  # fmt: skip
        return b"".join(
            _samples(len(TOPICS) + k, topic, columns, time_us, before_us)
            for k, (topic, columns) in enumerate(zip(TRUTH_TOPICS, found, strict=True))
        )


_UNKNOWN = (
    "ax", "ay", "az", "heading_var", "unaided_heading", "tilt_var", "dist_bottom", "dist_bottom_var",
)  # fmt: skip
"""Fields of the true position that the record does not have."""


def _samples(
    number: int, topic: Topic, columns: Columns, time_us: NDArray[np.int64], before_us: NDArray[np.int64]
) -> bytes:
    """Return the samples of a topic at the first instants in each of its periods."""
    chosen = time_us // topic.period_us > before_us // topic.period_us
    samples = np.zeros(np.count_nonzero(chosen), topic.dtype)
    samples["size"], samples["kind"], samples["topic"] = topic.size, DATA, number
    samples["timestamp"] = samples["timestamp_sample"] = time_us[chosen]
    for field, values in columns.items():
        samples[field] = values[chosen] if np.shape(values)[:1] == time_us.shape else values
    return samples.tobytes()
