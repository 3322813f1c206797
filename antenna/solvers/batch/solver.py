"""Backend ``batch``: compiled computation of patterns of many snapshots on several threads."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from antenna.analysis.patterns import Pattern, directions_deg, row_weights, times_finer, to_dbi
from antenna.model.clearance import credible, reach_m
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Array, Complex, ElementsTooNear, ElementsTouch, Snapshot
from antenna.solvers.batch.accuracy import batch_accuracy
from antenna.solvers.batch.coupling import solve_arrays
from antenna.solvers.batch.far_field import VECTOR, Single, radiate
from antenna.solvers.batch.kind import NODES, ElementKind, make_kind
from antenna.solvers.batch.maximum import survey_arrays
from antenna.solvers.batch.moments import ETA_OHM, turn

FAR_FIELD_NODES = ((0.03, 1), (0.15, 2), (0.5, 4), (1.0, 6), (1.8, 8), (3.3, 12), (8.0, 20), (np.inf, 40))
"""Points per wire for the far field, by upper limits of k times half-length."""
SLICE = 64
"""Snapshots per task of a thread, so that their patterns fit into the L2 cache."""


class Grid(NamedTuple):
    """The first quarter of a pattern's directions, for `radiate`."""

    cos_theta: Single
    sin_theta: Single
    cos_phi: Single
    sin_phi: Single


@njit(cache=True, nogil=True, error_model="numpy")
def place_points(
    kind: ElementKind, first: int, last: int, centres_m: Array, rotations: Array, currents: Complex,
    points_m: Array, axes: Array, moments: Complex,
) -> None:  # fmt: skip
    """Write the radiating points (S, N, 3) of S arrays: the kind's from ``first`` on, with images."""
    n, m = centres_m.shape[1], last - first
    none = np.zeros(3)
    for s in range(len(centres_m)):
        for i in range(n):
            a = i * m
            turn(rotations[s, i], centres_m[s, i], kind.places_m[first:last], points_m[s, a : a + m])
            turn(rotations[s, i], none, kind.axes[first:last], axes[s, a : a + m])
            for q in range(m):
                total = 0.0j
                for c in range(currents.shape[2]):
                    total += currents[s, i, c] * kind.moments_am[first + q, c]
                moments[s, a + q] = total
        if kind.image:
            for q in range(n * m):
                for x in range(3):
                    turned = -1.0 if x == 2 else 1.0
                    points_m[s, n * m + q, x] = turned * points_m[s, q, x]
                    axes[s, n * m + q, x] = -turned * axes[s, q, x]
                moments[s, n * m + q] = moments[s, q]


@njit(cache=True, nogil=True, error_model="numpy")
def radiate_arrays(
    points_m: Array, axes: Array, moments: Complex, wavelength_m: float, grid: Grid, gain_theta: Single,
    gain_phi: Single,
) -> None:  # fmt: skip
    """Write the partial gains (S, T, P) of S arrays of N points, whose moments are scaled for gains."""
    count = moments.shape[1]
    middle_m = np.empty(3)
    single, single_axes = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    single_moments = np.empty(count, np.complex64)
    for s in range(len(moments)):
        middle_m[:] = 0.0  # phases relative to the centre need only single precision
        for q in range(count):
            for x in range(3):
                middle_m[x] += points_m[s, q, x] / count
        for q in range(count):
            for x in range(3):
                single[q, x] = (points_m[s, q, x] - middle_m[x]) / wavelength_m
                single_axes[q, x] = axes[s, q, x]
            single_moments[q] = moments[s, q]
        radiate(
            single, single_axes, single_moments,
            grid.cos_theta, grid.sin_theta, grid.cos_phi, grid.sin_phi, gain_theta[s], gain_phi[s],
        )  # fmt: skip


class Directions:
    """A grid of directions with precomputed values."""

    def __init__(self, step_deg: float, *, grounded: bool) -> None:
        self.theta_deg, self.phi_deg = directions_deg(step_deg)
        self.shape = len(self.theta_deg), len(self.phi_deg)
        self.weights = row_weights(len(self.theta_deg), grounded=grounded)
        theta = np.radians(self.theta_deg[: len(self.theta_deg) // 2 + 1])
        columns = len(self.phi_deg) // 2
        phi = np.zeros(-(-columns // VECTOR) * VECTOR)
        phi[:columns] = np.radians(self.phi_deg[:columns])
        self.grid = Grid(*(f(angle).astype(np.float32) for angle in (theta, phi) for f in (np.cos, np.sin)))


class Currents(NamedTuple):
    """Radiating points (S, N, 3) of S arrays, N each, and their axes."""

    points_m: Array
    axes: Array
    moments: Complex
    """(S, N) scaled so that |sum of moment times axis times e^{jk r.p}|^2 across r is the gain."""
    nearest: NDArray[np.int64]
    """(S, 2) nearest elements, and their distance (S,), from `antenna.model.clearance.measure`."""
    nearest_m: Array


class Batch:
    """Patterns of arrays of equal elements, in free space or over perfect ground."""

    name = "batch"

    def __init__(self, config: AntennaConfig, *, threads: int = 1) -> None:
        self._config = config
        self._threads = threads
        self._element = config.element()
        image = config.ground == "perfect"
        self.kind = make_kind(self._element, config.wavelength_m, image=image)
        self._reach_m = reach_m(self._element)
        self.accuracy = batch_accuracy(config)
        size = self.kind.k_rad_m * self.kind.half_m
        level = NODES.index(next(count for limit, count in FAR_FIELD_NODES if size < limit))
        self._first, self._last = int(self.kind.firsts[level]), int(self.kind.firsts[level + 1])
        self.directions = Directions(config.grid_deg, grounded=image)
        self._step_deg = float(self.directions.theta_deg[1])

    def patterns(self, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
        """See `antenna.solvers.interface.Backend`; results do not depend on the number of threads."""
        slices = [snapshots[first : first + SLICE] for first in range(0, len(snapshots), SLICE)]
        if self._threads <= 1 or len(slices) <= 1:
            found = [self._of_slice(part) for part in slices]
        else:
            with ThreadPoolExecutor(self._threads) as pool:
                found = list(pool.map(self._of_slice, slices))
        return [result for part in found for result in part]

    def _of_slice(self, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
        """Solve a slice; snapshots with equal numbers of elements and equal grids are solved together."""
        alike: dict[tuple[int, int], list[int]] = {}
        for s, snapshot in enumerate(snapshots):
            times = times_finer(
                snapshot.centres_m, self._reach_m, self._config.wavelength_m, self._step_deg, self.kind.image
            )
            alike.setdefault((len(snapshot.voltages), times), []).append(s)
        results: dict[int, Pattern | ElementsTouch] = {}
        for (_, times), indices in alike.items():
            found = self._of_alike([snapshots[s] for s in indices], times)
            results |= zip(indices, found, strict=True)
        return [results[s] for s in range(len(snapshots))]

    def _of_alike(self, snapshots: Sequence[Snapshot], times: int) -> list[Pattern | ElementsTouch]:
        directions = self.directions
        if times > 1:
            directions = Directions(self._step_deg / times, grounded=self.kind.image)
        radiating = self.currents(snapshots)
        gain_theta, gain_phi = self.gains(radiating, directions)
        maximum, average = np.empty((len(snapshots), 3)), np.empty(len(snapshots))
        survey_arrays(
            np.array([snapshot.centres_m for snapshot in snapshots]),
            radiating.points_m, radiating.axes, radiating.moments, self._config.wavelength_m,
            gain_theta, gain_phi, directions.weights, maximum, average,
        )  # fmt: skip
        if times > 1:
            gain_theta, gain_phi = (gain[:, ::times, ::times].copy() for gain in (gain_theta, gain_phi))
        return self._patterns(
            radiating, to_dbi(gain_theta, gain_theta), to_dbi(gain_phi, gain_phi), maximum, average
        )

    def currents(self, snapshots: Sequence[Snapshot]) -> Currents:
        """Return the currents of snapshots with equal numbers of elements."""
        kind, count = self.kind, len(snapshots)
        centres_m = np.array([snapshot.centres_m for snapshot in snapshots])
        rotations = np.array([snapshot.rotations for snapshot in snapshots])
        voltages = np.array([snapshot.voltages for snapshot in snapshots], complex)
        n = voltages.shape[1]
        currents, power_w = np.zeros((count, n, len(kind.feed_a)), complex), np.zeros(count)
        nearest, nearest_m = np.empty((count, 2), np.int64), np.empty(count)
        solve_arrays(kind, centres_m, rotations, voltages, currents, power_w, nearest, nearest_m)
        points = n * (self._last - self._first) * (2 if kind.image else 1)
        points_m, axes = np.empty((2, count, points, 3))
        moments = np.empty((count, points), complex)
        place_points(kind, self._first, self._last, centres_m, rotations, currents, points_m, axes, moments)
        apart = nearest_m > kind.clearance_m
        radiates = apart & np.isfinite(power_w) & (power_w > 0.0)
        watts = np.where(radiates, power_w, np.inf)
        moments *= np.sqrt(kind.k_rad_m**2 * ETA_OHM / (8.0 * np.pi * watts))[:, None]
        moments[~radiates] = 0.0
        return Currents(points_m, axes, moments, nearest, nearest_m)

    def gains(self, radiating: Currents, directions: Directions | None = None) -> tuple[Single, Single]:
        """Return linear partial gains (S, T, P) on the grid, or in other directions."""
        directions = directions or self.directions
        shape = len(radiating.moments), *directions.shape
        gain_theta, gain_phi = np.empty(shape, np.float32), np.empty(shape, np.float32)
        radiate_arrays(
            radiating.points_m, radiating.axes, radiating.moments, self._config.wavelength_m,
            directions.grid, gain_theta, gain_phi,
        )  # fmt: skip
        if self.kind.image:
            below = shape[1] // 2 + 1
            gain_theta[:, below:] = gain_phi[:, below:] = 0.0
        return gain_theta, gain_phi

    def _patterns(
        self, radiating: Currents, theta_dbi: Array, phi_dbi: Array, maximum: Array, average: Array
    ) -> list[Pattern | ElementsTouch]:
        results: list[Pattern | ElementsTouch] = []
        rows = zip(
            radiating.nearest.tolist(), radiating.nearest_m.tolist(), maximum.tolist(), average.tolist(),
            strict=True,
        )  # fmt: skip
        for s, ((first, second), distance_m, (gain_dbi, theta_deg, phi_deg), mean) in enumerate(rows):
            if distance_m <= self.kind.clearance_m:
                results.append(ElementsTouch(first, second, distance_m))
            elif not math.isfinite(gain_dbi) or (distance_m < self.kind.near_m and not credible(mean)):
                results.append(ElementsTooNear(first, second, distance_m))
            else:
                results.append(Pattern(
                    theta_deg=self.directions.theta_deg, phi_deg=self.directions.phi_deg,
                    theta_gain_dbi=theta_dbi[s], phi_gain_dbi=phi_dbi[s], max_gain_dbi=gain_dbi,
                    max_theta_deg=min(theta_deg, 180.0 - theta_deg) if self.kind.image else theta_deg,
                    max_phi_deg=phi_deg, average_gain=mean, backend=self.name,
                ))  # fmt: skip
        return results
