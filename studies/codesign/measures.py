"""Flights of the experiment: their measures from the tables of the run folder, and a track at a low rate.

The formation of these flights does not move, so the desired places are those of the scenario.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.parquet as pq
from msgspec import Struct
from numpy.typing import NDArray

from foundation.types import Array
from harness.launch import one_process
from harness.launch.process_commands import RADIO
from harness.records.flight import Flight
from harness.records.run_folder import RunFolder
from harness.records.tables import read_flight
from harness.report.flown_array import gain_series
from harness.report.formation_error import formation_error
from harness.scenario.scenario import Scenario
from harness.world.faults import AnyFault

TRACK_PERIOD_S = 0.2
GAIN_RATE_HZ = 1.0
FLOWN_HEIGHT_M = 0.5
"""Height above the site's origin from which a vehicle counts as airborne"""
_NS_PER_US = 1_000


class Measures(Struct, frozen=True, kw_only=True):
    """Measures of one flight; lengths in metres, times in simulated seconds unless stated otherwise.

    Measures of the formation start when it is reached; they are None if it was not reached. A formation is
    sound until two vehicles touch or one falls.
    """

    formed_s: float | None
    simulated_s: float
    wall_s: float
    real_time_factor: float | None
    collisions: int
    """Number of contacts, whole flight"""
    first_collision_s: float | None
    """From the start"""
    down: int
    """Vehicles that are not airborne at the end"""
    least_distance_m: float | None
    """Between any two airborne vehicles, whole flight"""
    least_distance_formed_m: float | None = None
    shape_m: float | None = None
    """Horizontal rms after the best rigid alignment, of the sound formation"""
    shape_whole_m: float | None = None
    """The same until the end, including vehicles that touched or fell"""
    absolute_m: float | None = None
    """Horizontal rms distance from the places, of the sound formation"""
    vertical_m: float | None = None
    """Rms of height errors about their mean over the vehicles, of the sound formation"""
    estimate_m: float | None = None
    """Shape error of the vehicles' position estimates relative to the truth: the part of localisation"""
    control_m: float | None = None
    """Shape error of the vehicles' position estimates relative to the places: the part of control"""
    busy_fraction: float | None = None
    sessions_per_s: float | None = None
    """Ranging sessions that ended, completed or not"""
    completed_fraction: float | None = None
    beacons_lost_fraction: float | None = None
    """Share of the beacons received by a station that its host lost, whole flight"""
    longest_silence_s: float | None = None
    """Longest time without a measured distance"""
    range_offsets_m: tuple[float | None, ...] = ()
    """Median of measured less true distance of each vehicle's sessions; None without sessions"""
    gain_dbi: tuple[float, ...] = ()
    """Maximum gain every second of the sound formation, if requested"""
    track_mm: tuple[tuple[int, ...], ...] = ()
    """North and east of each vehicle relative to its place, vehicle by vehicle, every `TRACK_PERIOD_S`"""

    @property
    def gain_mean_dbi(self) -> float | None:
        """Mean over the flight."""
        return float(np.mean(self.gain_dbi)) if self.gain_dbi else None

    @property
    def gain_std_db(self) -> float | None:
        """Standard deviation over the flight."""
        return float(np.std(self.gain_dbi, ddof=1)) if len(self.gain_dbi) > 1 else None

    @property
    def track_ne_m(self) -> Array:
        """Track (T, N, 2) relative to the places, starting at the formation."""
        return np.array(self.track_mm, dtype=float).reshape(len(self.track_mm), -1, 2) / 1e3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightTables:
    """Tables of a run: T instants of N vehicles, in the site's NED frame."""

    flown: Flight
    air_us: NDArray[np.int64]
    """(K,)"""
    busy_ns: NDArray[np.int64]
    """(K,) since the start"""
    session_us: NDArray[np.int64]
    """(M,) end times of ranging sessions"""
    session_ok: NDArray[np.bool_]
    """(M,) whether the session returned a distance"""
    session_by: NDArray[np.int64]
    """(M,) initiators"""
    session_error_m: Array
    """(M,) measured less true distance, if the session returned one"""
    collisions_us: tuple[int, ...]
    beacons_received: int
    """Receptions of beacons by stations"""
    beacons_lost: int
    """Received beacons that a host lost"""

    def rows(self, begin_us: int, end_us: int) -> "FlightTables":
        """Return the instants and events in [begin_us, end_us]; the beacon counts are not restricted."""
        time_us = self.flown.time_us
        air = (self.air_us >= begin_us) & (self.air_us <= end_us)
        sessions = (self.session_us > begin_us) & (self.session_us <= end_us)
        return replace(
            self, flown=self.flown.at(np.flatnonzero((time_us >= begin_us) & (time_us <= end_us))),
            air_us=self.air_us[air], busy_ns=self.busy_ns[air], session_us=self.session_us[sessions],
            session_ok=self.session_ok[sessions], session_by=self.session_by[sessions],
            session_error_m=self.session_error_m[sessions],
            collisions_us=tuple(time_us for time_us in self.collisions_us if begin_us <= time_us <= end_us),
        )  # fmt: skip

    @property
    def in_the_air(self) -> NDArray[np.bool_]:
        """(T, N) whether the vehicle is airborne."""
        return self.flown.alive & (self.flown.pos_ned_m[..., 2] < -FLOWN_HEIGHT_M)


def read_tables(folder: RunFolder, scenario: Scenario) -> FlightTables:
    """Read the tables of a run."""
    air = _columns(folder.air, ["time_us", "busy_ns"])
    sessions = _columns(folder.ftm, ["measured_ns", "status", "initiator", "distance_m", "true_distance_m"])
    received, lost = _beacons(folder)
    events = [msgspec.json.decode(line) for line in folder.events.read_bytes().splitlines() if line]
    return FlightTables(
        flown=read_flight(folder, scenario),
        air_us=air["time_us"].astype(np.int64),
        busy_ns=air["busy_ns"].astype(np.int64),
        session_us=sessions["measured_ns"].astype(np.int64) // _NS_PER_US,
        session_ok=np.asarray(sessions["status"] == "ok", dtype=np.bool_),
        session_by=sessions["initiator"].astype(np.int64),
        session_error_m=sessions["distance_m"] - sessions["true_distance_m"],
        collisions_us=tuple(event["time_us"] for event in events if event["event"] == "collision"),
        beacons_received=received,
        beacons_lost=lost,
    )


def _beacons(folder: RunFolder) -> tuple[int, int]:
    """Return the emulator's counts of received and lost beacons of a one-process run."""
    manifest = msgspec.json.decode(folder.manifest.read_bytes())
    (counters,) = (
        process["details"][RADIO]["counters"]
        for process in manifest["processes"]
        if RADIO in process["details"]
    )
    return sum(counters["broadcasts_delivered"]), counters["lost_by_hosts"]


def _columns(path: Any, names: list[str]) -> dict[str, NDArray[Any]]:  # noqa: ANN401  any path that pyarrow accepts
    table = pq.read_table(path, columns=names)
    return {name: table.column(name).to_numpy() for name in names}


def measure(
    tables: FlightTables, scenario: Scenario, *, formed_us: int | None, wall_s: float, gains: bool
) -> Measures:
    """Return the measures of a run."""
    end_us = int(tables.flown.time_us[-1]) if len(tables.flown.time_us) else 0
    first_us = min(tables.collisions_us, default=None)
    numbers: dict[str, Any] = {
        "formed_s": None if formed_us is None else formed_us / 1e6,
        "simulated_s": end_us / 1e6,
        "wall_s": wall_s,
        "real_time_factor": end_us / 1e6 / wall_s if wall_s else None,
        "collisions": len(tables.collisions_us),
        "first_collision_s": None if first_us is None else first_us / 1e6,
        "down": int((~tables.in_the_air[-1]).sum()) if len(tables.flown.time_us) else scenario.agents,
        "least_distance_m": _least_distance_m(tables),
        "beacons_lost_fraction": (
            tables.beacons_lost / tables.beacons_received if tables.beacons_received else None
        ),
    }
    if formed_us is None:
        return Measures(**numbers)
    whole = tables.rows(formed_us, end_us)
    numbers |= _over_the_air(whole, scenario.agents)
    numbers["least_distance_formed_m"] = _least_distance_m(whole)
    numbers["shape_whole_m"] = formation_error(whole.flown).shape.horizontal_rms_m
    numbers["track_mm"] = _track_mm(whole.flown)
    fallen_us = whole.flown.time_us[~whole.in_the_air.all(axis=1)][:1].tolist()
    sound = whole.rows(formed_us, min((*whole.collisions_us, *fallen_us), default=end_us + 1) - 1)
    if len(sound.flown):
        numbers |= _errors(sound.flown)
        if gains:
            antenna = msgspec.structs.replace(scenario.antenna, snapshot_rate_hz=GAIN_RATE_HZ)
            gains_dbi = gain_series(sound.flown, antenna).max_gain_dbi
            numbers["gain_dbi"] = tuple(round(float(gain_dbi), 4) for gain_dbi in gains_dbi)
    return Measures(**numbers)


def _errors(flown: Flight) -> dict[str, float | None]:
    error = formation_error(flown)
    vertical_m = np.where(flown.alive, flown.pos_ned_m[..., 2] - flown.desired_pos_ned_m[..., 2], np.nan)
    living = flown.alive.any(axis=1)
    deviation_m = vertical_m[living] - np.nanmean(vertical_m[living], axis=1, keepdims=True)
    own_pos_ned_m = flown.believed_pos_ned_m
    assert own_pos_ned_m is not None  # noqa: S101  recorded in every run
    known = np.asarray(np.isfinite(own_pos_ned_m).all(axis=-1), dtype=np.bool_)
    believed = replace(
        flown, pos_ned_m=np.where(known[..., None], own_pos_ned_m, 0.0), alive=flown.alive & known
    )
    estimated = replace(believed, desired_pos_ned_m=flown.pos_ned_m)
    return {
        "shape_m": error.shape.horizontal_rms_m,
        "absolute_m": error.absolute.horizontal_rms_m,
        "vertical_m": float(np.sqrt(np.nanmean(deviation_m**2))) if living.any() else None,
        "estimate_m": formation_error(estimated).shape.horizontal_rms_m,
        "control_m": formation_error(believed).shape.horizontal_rms_m,
    }


def _over_the_air(tables: FlightTables, vehicles: int) -> dict[str, Any]:
    span_us = int(tables.flown.time_us[-1] - tables.flown.time_us[0]) if len(tables.flown.time_us) else 0
    air_us = int(tables.air_us[-1] - tables.air_us[0]) if len(tables.air_us) else 0
    busy_ns = int(tables.busy_ns[-1] - tables.busy_ns[0]) if len(tables.air_us) else 0
    sessions = len(tables.session_us)
    ranged_us = np.sort(tables.session_us[tables.session_ok])
    ends_us = tables.flown.time_us[[0, -1]] if span_us else ranged_us[:0]
    gaps_us = np.diff(np.concatenate((ends_us[:1], ranged_us, ends_us[1:])))
    own_m = [tables.session_error_m[tables.session_ok & (tables.session_by == i)] for i in range(vehicles)]
    return {
        "longest_silence_s": float(gaps_us.max()) / 1e6 if len(gaps_us) else None,
        "range_offsets_m": tuple(float(np.median(each)) if len(each) else None for each in own_m),
        "busy_fraction": busy_ns / (air_us * _NS_PER_US) if air_us else None,
        "sessions_per_s": sessions / (span_us * 1e-6) if span_us else None,
        "completed_fraction": float(tables.session_ok.mean()) if sessions else None,
    }


def _least_distance_m(tables: FlightTables) -> float | None:
    """Return the least distance over all pairs and instants with both airborne; None without any."""
    in_the_air, pos_ned_m, least_m = tables.in_the_air, tables.flown.pos_ned_m, np.inf
    for i in range(in_the_air.shape[1] - 1):
        both = in_the_air[:, i + 1 :] & in_the_air[:, i : i + 1]
        distance_m = np.linalg.norm(pos_ned_m[:, i + 1 :] - pos_ned_m[:, i : i + 1], axis=-1)
        least_m = min(least_m, float(np.min(distance_m, where=both, initial=np.inf)))
    return least_m if np.isfinite(least_m) else None


def _track_mm(flight: Flight) -> tuple[tuple[int, ...], ...]:
    sampled = flight.sampled(1.0 / TRACK_PERIOD_S)
    offsets_m: Array = (sampled.pos_ned_m - sampled.desired_pos_ned_m)[..., :2]
    rows: Sequence[Sequence[int]] = np.rint(1e3 * offsets_m).astype(int).reshape(len(sampled), -1).tolist()
    return tuple(map(tuple, rows))


def fly(scenario: Scenario, folder: Path, *, faults: Iterable[AnyFault], gains: bool) -> dict[str, Any]:
    """Fly with faults that are injected in formation; return the summary with only the flight's measures.

    See `harness.campaign.store.Flying`. A formation that is not reached is a valid result. Raises as
    `one_process.fly`.
    """
    summary = one_process.fly(scenario, folder, faults_in_formation=faults)
    formed_s = summary["formed_s"]
    measures = measure(
        read_tables(RunFolder(folder), scenario), scenario,
        formed_us=None if formed_s is None else round(formed_s * 1e6), wall_s=summary["wall_s"], gains=gains,
    )  # fmt: skip
    kept = {name: summary[name] for name in ("scenario", "seed", "status", "reason")}
    return kept | {"measures": msgspec.to_builtins(measures)}
