"""Snapshots of the synthetic aperture: positions, attitudes and feeds of its elements.

The antenna's frame has x along the broadside axis, y along the end-fire axis, where the main lobe points,
and z up. Directions have the article's angles: theta from +z, phi from +x towards +y.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Voltages = Complex


class ElementsTouch(Exception):
    """Two elements of a snapshot touch or cross, or one the ground (-1): there is no antenna pattern."""

    def __init__(self, first: int, second: int, distance_m: float) -> None:
        super().__init__(first, second, distance_m)
        self.first, self.second, self.distance_m = first, second, distance_m

    def __str__(self) -> str:
        if self.second < 0:
            return f"element {self.first} touches the ground: its lowest point is at {self.distance_m:.2g} m"
        return f"elements {self.first} and {self.second} touch: their axes are {self.distance_m:.2g} m apart"


class ElementsTooNear(ElementsTouch):
    """Two elements do not touch, but are too near for a credible solution of their currents.

    NEC2's thin-wire equations then result in a radiated power far from the input power.
    """

    def __str__(self) -> str:
        if not math.isfinite(self.distance_m):
            return f"element {self.first} has no credible solution"
        other = "the ground" if self.second < 0 else f"element {self.second}"
        return f"element {self.first} is too near {other} for a solution: {self.distance_m:.2g} m"


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The array at one instant: n equal elements, each with position, attitude and feed."""

    centres_m: Array
    """(n, 3) in the antenna's frame."""
    rotations: Array
    """(n, 3, 3) rotations from the elements' frames to the antenna's; a dipole is along its z axis."""
    voltages: Voltages
    """(n,) peak volts."""

    def __post_init__(self) -> None:
        """Raise ValueError unless shapes and values are valid."""
        n = len(self.centres_m)
        shapes = self.centres_m.shape, self.rotations.shape, self.voltages.shape
        if n == 0 or shapes != ((n, 3), (n, 3, 3), (n,)):
            raise ValueError(
                f"a snapshot of n >= 1 elements needs shapes (n, 3), (n, 3, 3), (n,), not {shapes}"
            )
        if not np.isfinite(self.centres_m).all():
            raise ValueError("a snapshot's positions are finite")
        if not np.isfinite(self.voltages).all() or not self.voltages.any():
            raise ValueError("a snapshot's voltages are finite, and one is not zero")
        if not _are_rotations(self.rotations):
            raise ValueError("a snapshot's rotations are rotations")

    @property
    def axes(self) -> Array:
        """(n, 3) z axes of the elements in the antenna's frame."""
        return self.rotations[:, :, 2]


@njit(cache=True, nogil=True)
def _are_rotations(matrices: Array) -> bool:
    """Whether all matrices (n, 3, 3) are rotations: orthonormal, right-handed columns."""
    for m in matrices:
        for i in range(3):
            for j in range(i, 3):
                product = m[0, i] * m[0, j] + m[1, i] * m[1, j] + m[2, i] * m[2, j]
                if not abs(product - (i == j)) < 1e-6:  # also rejects NaN
                    return False
        x, y = m[1, 0] * m[2, 1] - m[2, 0] * m[1, 1], m[2, 0] * m[0, 1] - m[0, 0] * m[2, 1]
        z = m[0, 0] * m[1, 1] - m[1, 0] * m[0, 1]
        if x * m[0, 2] + y * m[1, 2] + z * m[2, 2] < 0.0:
            return False
    return True


def along(axes: Array) -> Array:
    """Return the smallest rotations (n, 3, 3) that map z to unit vectors (n, 3)."""
    x, y, z = axes.T
    fold = 1.0 / np.where(z > -1.0 + 1e-12, 1.0 + z, np.inf)
    turned = np.stack([
        np.stack([1.0 - x * x * fold, -x * y * fold, x], -1),
        np.stack([-x * y * fold, 1.0 - y * y * fold, y], -1),
        np.stack([-x, -y, z], -1),
    ], axis=1)  # fmt: skip
    turned[z <= -1.0 + 1e-12] = np.diag([1.0, -1.0, -1.0])
    return np.asarray(turned)


def grid(count: int, columns: int, broadside_spacing_m: float, endfire_spacing_m: float) -> Array:
    """Return the positions (count, 3) of a planar grid in the antenna's frame, z = 0.

    Position k is in column ``k % columns`` along x and in row ``k // columns`` along y. The origin is the
    centre of the grid with a complete last row, also if ``count`` does not fill it.
    """
    if count < 1 or columns < 1:
        raise ValueError(f"a grid needs at least one position and one column, not {count} and {columns}")
    row, column = np.divmod(np.arange(count), columns)
    x_m = (column - (columns - 1) / 2) * broadside_spacing_m
    y_m = (row - row[-1] / 2) * endfire_spacing_m
    return np.stack([x_m, y_m, np.zeros(count)], axis=1)


def upright(places_m: Array, voltages: Voltages) -> Snapshot:
    """Return the ideal array of upright elements at positions (n, 3)."""
    return Snapshot(places_m, np.tile(np.eye(3), (len(places_m), 1, 1)), voltages)
