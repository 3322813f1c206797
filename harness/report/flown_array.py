"""The flown antenna array: its snapshots in the antenna's frame, and its gain over time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from msgspec import structs
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from antenna.analysis.patterns import Pattern
from antenna.model.clearance import GROUND
from antenna.model.config import AntennaConfig
from antenna.model.geometry import ElementsTooNear, ElementsTouch, Snapshot
from antenna.solvers.parallel import compute_patterns
from antenna.solvers.ports import feed
from foundation.types import Array
from harness.records.flight import Flight

ELEMENT_TO_FRD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""An element's axes on its vehicle: x to the right, y forward, z up, as the antenna's for an upright
vehicle."""
_AT_ONCE = 128
"""Patterns that a worker computes together: whole slices of the batch solver, so that results are the same"""
_NO_GRID: dict[str, Any] = dict.fromkeys(("theta_deg", "phi_deg"), np.empty(0)) | dict.fromkeys(
    ("theta_gain_dbi", "phi_gain_dbi"), np.empty((0, 0))
)
FIGURE_GRID_DEG = 1.5
"""Grid of patterns in figures, between which they are interpolated: fine enough for nulls."""


class NoFeed(Exception):
    """The array has no feed for its settings; the text is one line."""


@dataclass(frozen=True, slots=True)
class MissingPattern:
    """An instant of the flight without a pattern, and the reason."""

    time_us: int
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class GainSeries:
    """The array over the flight, at the K instants with a pattern."""

    time_us: NDArray[np.int64]
    """(K,)"""
    max_gain_dbi: Array
    """(K,)"""
    patterns: tuple[Pattern, ...]
    """K of them."""
    median_index: int | None
    """Index of the instant with the median maximum gain; None if K is 0."""
    median_snapshot: Snapshot | None
    """The array at that instant, in the antenna's frame."""
    missing: tuple[MissingPattern, ...]


def antenna_from_ned(heading_rad: float) -> Array:
    """Return the (3, 3) matrix from NED to the antenna's frame of a formation with this heading.

    y, the end-fire axis, points along the heading, x to the right of it, z up.
    """
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    return np.array([[-s, c, 0.0], [c, s, 0.0], [0.0, 0.0, -1.0]])


def ideal_pattern(places_ned_m: Array, heading_rad: float, config: AntennaConfig) -> Pattern:
    """Return the pattern of the formation (N, 3) with every vehicle upright in its place.

    It does not depend on the formation's motion because the antenna's frame rotates with it. Raises
    `ElementsTouch`, `NoFeed`.
    """
    (pattern,) = compute_patterns(config, [upright_snapshot(places_ned_m, heading_rad, config)])
    if isinstance(pattern, ElementsTouch):
        raise pattern
    return pattern


def upright_snapshot(places_ned_m: Array, heading_rad: float, config: AntennaConfig) -> Snapshot:
    """Return the array of `ideal_pattern`; raises `ElementsTouch`, `NoFeed`."""
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(places_ned_m), 1))
    return antenna_snapshot(
        places_ned_m, upright, places_ned_m, heading_rad, config, believed_pos_ned_m=places_ned_m
    )


def antenna_snapshot(
    pos_ned_m: Array,
    q_ned_frd: Array,
    desired_pos_ned_m: Array,
    heading_rad: float,
    config: AntennaConfig,
    *,
    believed_pos_ned_m: Array | None = None,
) -> Snapshot:
    """Return the array of n vehicles at positions (n, 3) with attitudes (n, 4) and desired positions (n, 3).

    ``config.feeds_for`` selects the positions for which the feeds are computed: desired, estimated or true
    ones; for the first two, elements are assumed to be upright. The frame's origin is the centre of the
    desired positions, on the ground if there is one. Raises `ElementsTouch` if the feeds depend on the
    coupling of the elements and that cannot be computed, `NoFeed` if there are none for these positions, such
    as Hansen and Woodyard's for a single row, and ValueError if estimated positions were not recorded.
    """
    from_ned = antenna_from_ned(heading_rad)
    origin_ned_m = desired_pos_ned_m.mean(axis=0)
    if config.ground != "none":
        origin_ned_m[2] = 0.0
    q = Rotation.from_quat(q_ned_frd, scalar_first=True).as_matrix()
    rotations = from_ned @ q @ ELEMENT_TO_FRD
    fed_ned_m = {"places": desired_pos_ned_m, "estimates": believed_pos_ned_m, "truth": pos_ned_m}[
        config.feeds_for
    ]
    if fed_ned_m is None:
        raise ValueError(
            "the feeds are for the positions that the vehicles estimate, which were not recorded"
        )
    attitudes = rotations if config.feeds_for == "truth" else None
    try:
        voltages = feed(
            (fed_ned_m - origin_ned_m) @ from_ned.T,
            config,
            attitudes,
            places_m=(desired_pos_ned_m - origin_ned_m) @ from_ned.T,
        )
    except ValueError as error:
        raise NoFeed(str(error)) from None
    return Snapshot(centres_m=(pos_ned_m - origin_ned_m) @ from_ned.T, rotations=rotations, voltages=voltages)


def gain_series(
    flight: Flight, config: AntennaConfig, *, workers: int = 1, with_grids: bool = True
) -> GainSeries:
    """Return the patterns of the flight at ``config.snapshot_rate_hz``.

    The elements of lost vehicles are omitted. An instant is ``missing`` if no vehicle lives, two elements
    touch, or the living ones have no feeds: the policy has no solution, or it is for estimated positions and
    one is unknown.
    ``workers`` is as in `antenna.solvers.parallel.compute_patterns`. Without ``with_grids`` the patterns have
    no directions but the maximum, and take a hundredth of the memory.
    """
    sampled = flight.sampled(config.snapshot_rate_hz)
    missing: list[MissingPattern] = []
    found: list[tuple[int, Pattern]] = []
    snapshots = _snapshots(sampled, config, missing)
    while part := list(islice(snapshots, _AT_ONCE * max(2, workers))):
        results = compute_patterns(config, [snapshot for _, snapshot in part], workers=workers)
        for (t, _), result in zip(part, results, strict=True):
            if isinstance(result, ElementsTouch):
                time_us = int(sampled.time_us[t])
                missing.append(MissingPattern(time_us, describe_touch(result, living(sampled, t))))
            else:
                found.append((t, result if with_grids else replace(result, **_NO_GRID)))
    max_gain_dbi = np.array([pattern.max_gain_dbi for _, pattern in found])
    median = int(np.argsort(max_gain_dbi, kind="stable")[(len(found) - 1) // 2]) if found else None
    return GainSeries(
        time_us=sampled.time_us[[t for t, _ in found]],
        max_gain_dbi=max_gain_dbi,
        patterns=tuple(pattern for _, pattern in found),
        median_index=median,
        median_snapshot=None if median is None else snapshot_at(sampled, found[median][0], config),
        missing=tuple(sorted(missing, key=lambda instant: instant.time_us)),
    )


def _snapshots(
    sampled: Flight, config: AntennaConfig, missing: list[MissingPattern]
) -> Iterator[tuple[int, Snapshot]]:
    """Yield index and array of each instant that has one; the others are added to ``missing``."""
    for t, time_us in enumerate(sampled.time_us.tolist()):
        try:
            yield t, snapshot_at(sampled, t, config)
        except ElementsTouch as touch:
            missing.append(MissingPattern(time_us, describe_touch(touch, living(sampled, t))))
        except NoFeed as error:
            missing.append(MissingPattern(time_us, str(error)))


def snapshot_at(flight: Flight, t: int, config: AntennaConfig) -> Snapshot:
    """Return the array of the living vehicles at the flight's instant ``t``; raises as `antenna_snapshot`.

    Its element k is on the vehicle ``living(flight, t)[k]``.
    """
    alive, believed_ned_m = flight.alive[t], flight.believed_pos_ned_m
    if not alive.any():
        raise NoFeed("no vehicle is alive")
    if config.feeds_for == "estimates" and believed_ned_m is not None:
        without = np.flatnonzero(alive & ~np.isfinite(believed_ned_m[t]).all(axis=1)).tolist()
        if without:
            raise NoFeed(
                f"UAV {without[0]} has no position estimate"
                if len(without) == 1
                else f"UAVs {', '.join(map(str, without))} have no position estimate"
            )
    return antenna_snapshot(
        flight.pos_ned_m[t, alive],
        flight.q_ned_frd[t, alive],
        flight.desired_pos_ned_m[t, alive],
        float(flight.heading_rad[t]),
        config,
        believed_pos_ned_m=None if believed_ned_m is None else believed_ned_m[t, alive],
    )


def living(flight: Flight, t: int) -> list[int]:
    """Return the numbers of the vehicles that are alive at the flight's instant ``t``."""
    alive: list[int] = np.flatnonzero(flight.alive[t]).tolist()
    return alive


def describe_touch(touch: ElementsTouch, vehicles: Sequence[int]) -> str:
    """Return a line that names the touching antennas; element k is on ``vehicles[k]``."""
    near = isinstance(touch, ElementsTooNear)
    if touch.second == GROUND:
        what = "is too near the ground for a solution" if near else "touches the ground"
        return f"the antenna of UAV {vehicles[touch.first]} {what}"
    what = "are too near each other for a solution" if near else "touch"
    return f"antennas of UAVs {vehicles[touch.first]} and {vehicles[touch.second]} {what}"


def figure_patterns(
    series: GainSeries, places_ned_m: Array, heading_rad: float, config: AntennaConfig
) -> tuple[Pattern, Pattern]:
    """Return patterns of the ideal formation (N, 3) and of the median instant, on a grid for figures.

    Raises ValueError for a series without patterns.
    """
    if series.median_snapshot is None:
        raise ValueError("a series without patterns has no median")
    fine = structs.replace(config, grid_deg=min(config.grid_deg, FIGURE_GRID_DEG))
    (flown,) = compute_patterns(fine, [series.median_snapshot])
    if isinstance(flown, ElementsTouch):
        raise flown
    return ideal_pattern(places_ned_m, heading_rad, fine), flown
