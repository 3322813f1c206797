"""The synthetic aperture that was flown: its snapshots in the antenna's frame, and its gain over time."""

from dataclasses import dataclass

import numpy as np
from msgspec import structs
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from antenna.config import AntennaConfig
from antenna.geometry import ElementsTouch, Snapshot, endfire_voltages
from antenna.parallel import compute_patterns
from antenna.patterns import Pattern
from harness.flight import Array, Flight

FIGURE_GRID_DEG = 1.5
"""Grid of patterns that are looked at: a wider one breaks lines of low gain into beads."""


@dataclass(frozen=True, slots=True)
class MissingPattern:
    """An instant of the flight that has no pattern, and why."""

    time_us: int
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class GainSeries:
    """The aperture over the flight, at the K instants that have a pattern."""

    time_us: NDArray[np.int64]
    """(K,)"""
    max_gain_dbi: Array
    """(K,)"""
    snapshots: tuple[Snapshot, ...]
    """K of them, in the antenna's frame."""
    patterns: tuple[Pattern, ...]
    """K of them."""
    missing: tuple[MissingPattern, ...]

    @property
    def median_index(self) -> int:
        """Which of the instants has the median maximum gain; raises ValueError when K is 0."""
        if len(self.patterns) == 0:
            raise ValueError("a series without patterns has no median")
        return int(np.argsort(self.max_gain_dbi, kind="stable")[(len(self.patterns) - 1) // 2])


def antenna_from_ned(heading_rad: float) -> Array:
    """(3, 3) matrix that maps NED components into the antenna's frame of a formation with this heading.

    y, the end-fire axis, points along the heading, x to the right of it, z up.
    """
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    return np.array([[-s, c, 0.0], [c, s, 0.0], [0.0, 0.0, -1.0]])


def ideal_pattern(places_ned_m: Array, heading_rad: float, config: AntennaConfig) -> Pattern:
    """Pattern of the formation (N, 3) with every vehicle upright in its place; raises `ElementsTouch`.

    It is the same wherever the formation flies, for the antenna's frame turns with it.
    """
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(places_ned_m), 1))
    snapshot = antenna_snapshot(places_ned_m, upright, places_ned_m, heading_rad, config.wavelength_m)
    (pattern,) = compute_patterns(config, [snapshot])
    if isinstance(pattern, ElementsTouch):
        raise pattern
    return pattern


def antenna_snapshot(
    pos_ned_m: Array, q_ned_frd: Array, desired_pos_ned_m: Array, heading_rad: float, wavelength_m: float
) -> Snapshot:
    """Make the array of n vehicles at (n, 3) positions with (n, 4) attitudes, fed for desired places (n, 3).

    A dipole stands along its vehicle's vertical axis, positive upwards. The frame's origin is the centre of
    the places.
    """
    to_antenna = antenna_from_ned(heading_rad).T
    up_ned = Rotation.from_quat(q_ned_frd, scalar_first=True).apply([0.0, 0.0, -1.0])
    centre_ned_m = desired_pos_ned_m.mean(axis=0)
    return Snapshot(
        centres_m=(pos_ned_m - centre_ned_m) @ to_antenna,
        axes=up_ned @ to_antenna,
        voltages=endfire_voltages((desired_pos_ned_m - centre_ned_m) @ to_antenna, wavelength_m),
    )


def gain_series(flight: Flight, config: AntennaConfig, *, workers: int = 1) -> GainSeries:
    """Patterns of the flight at ``config.snapshot_rate_hz``.

    The elements of dead vehicles are left out; instants at which none lives, or two elements touch, are
    ``missing``.
    ``workers`` is as in `antenna.parallel.compute_patterns`.
    """
    sampled = flight.sampled(config.snapshot_rate_hz)
    missing = [
        MissingPattern(int(sampled.time_us[t]), "no vehicle is alive")
        for t in np.flatnonzero(~sampled.alive.any(axis=1))
    ]
    rows = np.flatnonzero(sampled.alive.any(axis=1))
    snapshots = []
    for t in rows:
        alive = sampled.alive[t]
        places_ned_m = sampled.desired_pos_ned_m[t, alive]
        snapshots.append(
            antenna_snapshot(
                sampled.pos_ned_m[t, alive],
                sampled.q_ned_frd[t, alive],
                places_ned_m,
                float(sampled.heading_rad[t]),
                config.wavelength_m,
            )
        )
    found: list[tuple[int, Snapshot, Pattern]] = []
    results = compute_patterns(config, snapshots, workers=workers)
    for t, snapshot, result in zip(rows, snapshots, results, strict=True):
        if isinstance(result, ElementsTouch):
            first, second = np.flatnonzero(sampled.alive[t])[[result.first, result.second]]
            missing.append(
                MissingPattern(int(sampled.time_us[t]), f"antennas of UAVs {first} and {second} touch")
            )
        else:
            found.append((int(sampled.time_us[t]), snapshot, result))
    return GainSeries(
        time_us=np.array([time_us for time_us, _, _ in found], dtype=np.int64),
        max_gain_dbi=np.array([pattern.max_gain_dbi for _, _, pattern in found]),
        snapshots=tuple(snapshot for _, snapshot, _ in found),
        patterns=tuple(pattern for _, _, pattern in found),
        missing=tuple(sorted(missing, key=lambda instant: instant.time_us)),
    )


def figure_patterns(
    series: GainSeries, places_ned_m: Array, heading_rad: float, config: AntennaConfig
) -> tuple[Pattern, Pattern]:
    """Patterns of the ideal formation (N, 3) and of the median instant, on a grid fine enough to look at."""
    fine = structs.replace(config, grid_deg=min(config.grid_deg, FIGURE_GRID_DEG))
    (flown,) = compute_patterns(fine, [series.snapshots[series.median_index]])
    if isinstance(flown, ElementsTouch):
        raise flown
    return ideal_pattern(places_ned_m, heading_rad, fine), flown
