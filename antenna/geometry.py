"""Where the elements of the synthetic aperture are, how they are fed, and whether they are apart.

The antenna's frame has x along the broadside axis, y along the end-fire axis, where the main lobe points,
and z up. Directions have the article's angles: theta from +z, phi from +x towards +y.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Voltages = NDArray[np.complex128]


class ElementsTouch(Exception):
    """Two elements of a snapshot touch or cross, so that no antenna pattern exists."""

    def __init__(self, first: int, second: int, distance_m: float) -> None:
        super().__init__(first, second, distance_m)
        self.first = first
        self.second = second
        self.distance_m = distance_m

    def __str__(self) -> str:
        return f"elements {self.first} and {self.second} touch: their axes are {self.distance_m:.2g} m apart"


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The array at one instant: n dipoles, each fed at its centre."""

    centres_m: Array
    """(n, 3) in the antenna's frame."""
    axes: Array
    """(n, 3) unit vectors along the dipoles, antenna's frame; a voltage is positive towards the axis."""
    voltages: Voltages
    """(n,) peak volts."""

    def __post_init__(self) -> None:
        """Raise ValueError unless the three belong together and are finite."""
        n = len(self.centres_m)
        shapes = self.centres_m.shape, self.axes.shape, self.voltages.shape
        if n == 0 or shapes != ((n, 3), (n, 3), (n,)):
            raise ValueError(f"a snapshot of n >= 1 elements has shapes (n, 3), (n, 3), (n,), not {shapes}")
        if not np.isfinite(self.centres_m).all():
            raise ValueError("a snapshot's positions are finite")
        if not np.isfinite(self.voltages).all() or not self.voltages.any():
            raise ValueError("a snapshot's voltages are finite, and one is not zero")
        if not np.allclose(np.linalg.norm(self.axes, axis=1), 1.0, atol=1e-6, rtol=0.0):
            raise ValueError("a snapshot's dipole axes are unit vectors")


def grid(count: int, columns: int, broadside_spacing_m: float, endfire_spacing_m: float) -> Array:
    """(count, 3) places of a planar grid in the antenna's frame, z = 0.

    Place k stands in column ``k % columns`` along x and in row ``k // columns`` along y. The origin is the
    centre of the grid whose last row is full, whether or not ``count`` fills it.
    """
    if count < 1 or columns < 1:
        raise ValueError(f"a grid has at least one place and one column, not {count} and {columns}")
    row, column = np.divmod(np.arange(count), columns)
    x_m = (column - (columns - 1) / 2) * broadside_spacing_m
    y_m = (row - row[-1] / 2) * endfire_spacing_m
    return np.stack([x_m, y_m, np.zeros(count)], axis=1)


def endfire_voltages(places_m: Array, wavelength_m: float) -> Voltages:
    """(n,) feeds exp(-j k y) of an ordinary end-fire array towards +y, for (n, 3) places in its frame."""
    phase_rad = -2.0 * np.pi / wavelength_m * places_m[:, 1]
    voltages: Voltages = np.exp(1j * phase_rad)
    return voltages


def vertical_snapshot(places_m: Array, wavelength_m: float) -> Snapshot:
    """Make the undisturbed array: vertical dipoles at (n, 3) places, with the feeds of these places."""
    axes = np.tile([0.0, 0.0, 1.0], (len(places_m), 1))
    return Snapshot(places_m, axes, endfire_voltages(places_m, wavelength_m))


def check_apart(snapshot: Snapshot, length_m: float, clearance_m: float) -> None:
    """Raise `ElementsTouch` for the first two dipoles whose axes come nearer than ``clearance_m``."""
    half_m = 0.5 * length_m * snapshot.axes
    starts_m, ends_m = snapshot.centres_m - half_m, snapshot.centres_m + half_m
    for i, j in combinations(range(len(half_m)), 2):
        if np.linalg.norm(snapshot.centres_m[i] - snapshot.centres_m[j]) >= length_m + clearance_m:
            continue
        distance_m = segment_distance_m(starts_m[i], ends_m[i], starts_m[j], ends_m[j])
        if distance_m < clearance_m:
            raise ElementsTouch(i, j, distance_m)


def segment_distance_m(start_a_m: Array, end_a_m: Array, start_b_m: Array, end_b_m: Array) -> float:
    """Least distance between two straight segments, each of (3,) end points and of a length above zero.

    Ericson, Real-Time Collision Detection, 5.1.9: the nearest points of the lines, clamped to the segments.
    """
    along_a, along_b, between = end_a_m - start_a_m, end_b_m - start_b_m, start_a_m - start_b_m
    aa, bb, ab = along_a @ along_a, along_b @ along_b, along_a @ along_b
    a_between, b_between = along_a @ between, along_b @ between
    sine_squared = aa * bb - ab * ab
    parallel = sine_squared <= 1e-12 * aa * bb
    s = 0.0 if parallel else np.clip((ab * b_between - a_between * bb) / sine_squared, 0.0, 1.0)
    t = np.clip((ab * s + b_between) / bb, 0.0, 1.0)
    s = np.clip((ab * t - a_between) / aa, 0.0, 1.0)
    return float(np.linalg.norm(between + s * along_a - t * along_b))
