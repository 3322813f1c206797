"""Common part of the NEC2 backends: checks of snapshots and patterns, one array at a time."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from antenna.analysis.patterns import FLOOR_DBI, Pattern, decimated, directions_deg, make_pattern, times_finer
from antenna.model.clearance import GROUND, Nearest, check_apart, credible, near_m, placed_wires_m, reach_m
from antenna.model.config import AntennaConfig
from antenna.model.geometry import Array, ElementsTooNear, ElementsTouch, Snapshot
from antenna.solvers.interface import Accuracy

SMALL_RAD = 0.3
"""Reach in phase below which elements radiate so little that NEC2's real ground is inaccurate."""
LEAST_HEIGHT_SMALL_LAMBDA = 0.49
"""Least height of their lowest point over real ground, in wavelengths. From here on PyNEC and nec2c agree to
0.01 dB, at 0.3 to 0.8 dB, and lower the input power of PyNEC's sources is negative."""
LEAST_HEIGHT_LAMBDA = 0.25
"""Least height of larger elements, for 0.05 dB."""


class NoPower(Exception):
    """The input power of the sources is not positive."""


class FarField(ABC):
    """One array solved by a NEC2 program."""

    def __init__(self, snapshot: Snapshot, config: AntennaConfig) -> None:
        self._snapshot = snapshot
        self._config = config
        self._grounded = config.ground != "none"

    def partial_gains(self, step_deg: float) -> Array:
        """Return linear gains (2, T, P) in the theta and phi polarisations on the grid of `directions_deg`.

        Raises NoPower.
        """
        theta_deg, phi_deg = directions_deg(step_deg)
        rows = len(theta_deg) // 2 + 1 if self._grounded else len(theta_deg)
        gains = np.zeros((2, len(theta_deg), len(phi_deg)))
        gains[:, :rows] = self._grid(rows, len(phi_deg), float(theta_deg[1]))
        return gains

    def gains_dbi(self, theta_deg: Array, phi_deg: Array) -> Array:
        """Return total gains in directions, all of one shape; below a ground those of the mirror image."""
        if self._grounded:
            theta_deg = np.minimum(theta_deg, 180.0 - theta_deg)
        pairs = zip(theta_deg.ravel().tolist(), phi_deg.ravel().tolist(), strict=True)
        return np.array(self._towards_dbi(list(pairs))).reshape(theta_deg.shape)

    @abstractmethod
    def _grid(self, rows: int, columns: int, step_deg: float) -> Array:
        """Return partial gains (2, rows, columns) on a grid that begins at the zenith."""

    @abstractmethod
    def _towards_dbi(self, directions_deg: Sequence[tuple[float, float]]) -> Sequence[float] | Array:
        """Return the total gain in each direction (theta, phi)."""


class Nec2Solver:
    """Patterns of arrays of equal elements, solved one by one."""

    name: str
    accuracy = Accuracy.REFERENCE
    far_field: type[FarField]

    def __init__(self, config: AntennaConfig) -> None:
        self._config = config
        self._element = config.element()
        self._grounded = config.ground != "none"

    def patterns(self, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
        """See `antenna.solvers.interface.Backend`."""
        results: list[Pattern | ElementsTouch] = []
        for snapshot in snapshots:
            try:
                results.append(self.pattern(snapshot))
            except ElementsTouch as touch:
                results.append(touch)
        return results

    def pattern(self, snapshot: Snapshot) -> Pattern:
        """Return the pattern of one snapshot; raises `ElementsTouch`, `ElementsTooNear`, program errors."""
        config = self._config
        found = check_apart(snapshot, self._element, grounded=self._grounded)
        self._check_height(snapshot)
        theta_deg, _ = directions_deg(config.grid_deg)
        step_deg = float(theta_deg[1])
        reach, wavelength_m = reach_m(self._element), config.wavelength_m
        times = times_finer(snapshot.centres_m, reach, wavelength_m, step_deg, self._grounded)
        far_field = self.far_field(snapshot, config)
        try:
            theta_gain, phi_gain = far_field.partial_gains(step_deg / times)
            pattern = make_pattern(
                theta_gain, phi_gain, far_field.gains_dbi, snapshot, wavelength_m, self.name,
                grounded=self._grounded,
            )  # fmt: skip
        except NoPower:
            raise ElementsTooNear(*found) from None
        self._check_credible(pattern, found)
        return decimated(pattern, times)

    def _check_height(self, snapshot: Snapshot) -> None:
        """Raise `ElementsTooNear` for the lowest element if it is too low over real ground."""
        if self._config.ground != "real":
            return
        small = 2.0 * math.pi * reach_m(self._element) / self._config.wavelength_m < SMALL_RAD
        least_m = (LEAST_HEIGHT_SMALL_LAMBDA if small else LEAST_HEIGHT_LAMBDA) * self._config.wavelength_m
        heights_m = placed_wires_m(snapshot, self._element)[..., 2].min(axis=(1, 2))
        lowest = int(heights_m.argmin())
        if heights_m[lowest] < least_m:
            raise ElementsTooNear(lowest, GROUND, float(heights_m[lowest]))

    def _check_credible(self, pattern: Pattern, found: Nearest) -> None:
        """Raise `ElementsTooNear` without radiated power, or with a wrong balance of near elements."""
        lossy = self._config.ground == "real"
        doubtful = lossy or found.distance_m < near_m(self._config.wavelength_m)
        balanced = credible(pattern.average_gain, lossy=lossy)
        if pattern.max_gain_dbi <= FLOOR_DBI or (doubtful and not balanced):
            raise ElementsTooNear(*found)
