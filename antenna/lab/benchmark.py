"""Benchmark of the batch solver against NEC2, on one core each.

Both solve the same formations of eight dipoles, displaced by 0.5 m and tilted by 10 degrees, on a grid of 5
degrees. Set-up and compilation are not timed. Short runs of both alternate, and medians are compared, so that
other load on the machine affects both equally. The time of one core is the CPU time of the calling thread.
"""

import statistics
import time
from collections.abc import Callable
from itertools import islice

import numpy as np
from msgspec import Struct

from antenna.analysis.patterns import directions_deg, to_dbi
from antenna.lab.formations import Disorder, draws
from antenna.model.clearance import check_apart
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Array, ElementsTouch, Snapshot, grid
from antenna.solvers.batch.solver import SLICE, Batch, Currents

SHORT_DIPOLE = AntennaConfig(wavelength_m=10.0)
LONG_DIPOLE = AntennaConfig(wavelength_m=10.0, element_length_m=5.0, element_radius_m=0.001, segments=11)
DISORDER = Disorder(sigma_m=0.5, tilt_rad=float(np.radians(10.0)), seed=1)
SNAPSHOTS = 4 * SLICE
NEC2_AT_A_TIME = 2
LEAST_ROUNDS = 3


class Speed(Struct, frozen=True, kw_only=True):
    """Times of one kind of element: microseconds of one core per pattern, medians."""

    speedup: float
    """NEC2's time divided by the batch solver's, both with a refined maximum."""
    speedup_grid_only: float
    """The same for solution and grid only, without the search for the maximum."""
    nec2_us: float
    nec2_grid_only_us: float
    batch_us: float
    batch_grid_only_us: float
    batch_solve_us: float
    """Couplings and currents."""
    batch_far_field_us: float
    """Both polarisations on the grid, in decibels."""
    batch_maximum_us: float
    """Rest of ``batch_us``: refined maximum, average over the sphere, construction of patterns."""


class Benchmark(Struct, frozen=True, kw_only=True):
    """Result of ``benchmark``."""

    speedup_short_dipole: float
    speedup_5m_dipole: float
    speedup_two_cores: float
    """Shortest wall time with one thread divided by that with two, short dipoles."""
    speedup_short_dipole_grid_only: float
    speedup_5m_dipole_grid_only: float
    short_dipole: Speed
    dipole_5m: Speed
    elements: int
    directions: int
    rounds: int
    """Number of alternations per kind of element."""


def benchmark(seconds: float) -> Benchmark:
    """Measure for about ``seconds`` and at least `LEAST_ROUNDS` rounds; raises BackendUnavailable."""
    short, rounds = compare(SHORT_DIPOLE, seconds * 0.4)
    long, _ = compare(LONG_DIPOLE, seconds * 0.4)
    return Benchmark(
        speedup_short_dipole=short.speedup, speedup_5m_dipole=long.speedup,
        speedup_two_cores=two_cores(SHORT_DIPOLE, seconds * 0.2),
        speedup_short_dipole_grid_only=short.speedup_grid_only,
        speedup_5m_dipole_grid_only=long.speedup_grid_only,
        short_dipole=short, dipole_5m=long,
        elements=len(_places(SHORT_DIPOLE)),
        directions=int(np.prod([len(angles) for angles in directions_deg(SHORT_DIPOLE.grid_deg)])),
        rounds=rounds,
    )  # fmt: skip


def compare(config: AntennaConfig, seconds: float) -> tuple[Speed, int]:
    """Time both solvers alternately; return the result and the number of rounds."""
    from antenna.solvers.nec2 import Nec2, PynecFarField  # noqa: PLC0415 - optional: PyNEC

    snapshots = formations(config, SNAPSHOTS)
    parts = [snapshots[first : first + SLICE] for first in range(0, SNAPSHOTS, SLICE)]
    batch, nec2 = Batch(config), Nec2(config)
    element = config.element()
    few = iter(snapshots * 1000)
    solved: list[Currents] = []

    def nec2_grids() -> None:
        for snapshot in islice(few, NEC2_AT_A_TIME):
            check_apart(snapshot, element, grounded=False)
            to_dbi(PynecFarField(snapshot, config).partial_gains(config.grid_deg))

    def solve() -> None:
        solved[:] = [batch.currents(part) for part in parts]

    def far_field() -> None:
        for radiating in solved:
            for gain in batch.gains(radiating):
                to_dbi(gain)

    times: dict[str, list[float]] = {}
    rounds, until = 0, time.monotonic() + seconds
    works: dict[str, tuple[Callable[[], object], int]] = {
        "nec2": (lambda: nec2.patterns(list(islice(few, NEC2_AT_A_TIME))), NEC2_AT_A_TIME),
        "nec2_grid_only": (nec2_grids, NEC2_AT_A_TIME),
        "batch": (lambda: batch.patterns(snapshots), SNAPSHOTS),
        "solve": (solve, SNAPSHOTS),
        "far_field": (far_field, SNAPSHOTS),
    }
    for work, _ in works.values():
        work()
    while rounds < LEAST_ROUNDS or time.monotonic() < until:
        for name, (work, count) in works.items():
            start = time.thread_time()
            work()
            times.setdefault(name, []).append((time.thread_time() - start) / count * 1e6)
        rounds += 1
    us = {name: statistics.median(measured) for name, measured in times.items()}
    grid_only_us = us["solve"] + us["far_field"]
    speed = Speed(
        speedup=us["nec2"] / us["batch"], speedup_grid_only=us["nec2_grid_only"] / grid_only_us,
        nec2_us=us["nec2"], nec2_grid_only_us=us["nec2_grid_only"],
        batch_us=us["batch"], batch_grid_only_us=grid_only_us,
        batch_solve_us=us["solve"], batch_far_field_us=us["far_field"],
        batch_maximum_us=us["batch"] - grid_only_us,
    )  # fmt: skip
    return speed, rounds


def two_cores(config: AntennaConfig, seconds: float) -> float:
    """Return the shortest wall time of one thread divided by that of two, on the same snapshots.

    The shortest time is used since other load only increases a wall time, with two threads even more.
    """
    snapshots = formations(config, 4 * SNAPSHOTS)
    solvers = [Batch(config, threads=threads) for threads in (1, 2)]
    wall_s: list[list[float]] = [[], []]
    for solver in solvers:
        solver.patterns(snapshots)
    until = time.monotonic() + seconds
    while len(wall_s[0]) < LEAST_ROUNDS or time.monotonic() < until:
        for solver, measured in zip(solvers, wall_s, strict=True):
            start = time.perf_counter()
            solver.patterns(snapshots)
            measured.append(time.perf_counter() - start)
    one, two = (min(measured) for measured in wall_s)
    return one / two


def formations(config: AntennaConfig, count: int) -> list[Snapshot]:
    """Return random formations without elements that touch."""
    element = config.element()

    def is_apart(snapshot: Snapshot) -> bool:
        try:
            check_apart(snapshot, element, grounded=False)
        except ElementsTouch:
            return False
        return True

    return list(islice(filter(is_apart, draws(_places(config), config, DISORDER)), count))


def _places(config: AntennaConfig) -> Array:
    return grid(8, 4, 0.85 * config.wavelength_m, 0.25 * config.wavelength_m)
