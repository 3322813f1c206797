"""All segments of an array at once, as NEC2 has them: for elements too near for their few strongest currents.

Such an array is a collision in the making, and rare.
"""

import numpy as np
from numba import njit

from antenna.batch.coupling import turn
from antenna.batch.moments import admittance, write_fields
from antenna.batch.response import cut, make_nodes
from antenna.elements import Element
from antenna.geometry import Array, Complex, Snapshot


class Dense:
    """Solver of single arrays of one kind of element."""

    def __init__(self, element: Element, wavelength_m: float, *, nodes: int, image: bool) -> None:
        """``nodes``: points of each wire that stand for its current; ``image``: over perfect ground."""
        self._k_rad_m = 2.0 * np.pi / wavelength_m
        self._segments = cut(element)
        self._fed = element.feed_segment
        self._image = image
        _, self._spread = admittance(self._segments, self._k_rad_m)
        points = make_nodes(element, self._segments, self._spread, self._k_rad_m, nodes)
        self._to_points_m: Complex = points.moments_am

    def solve(self, snapshot: Snapshot) -> tuple[Complex, float]:
        """Moments (n, M) of the elements' points, A m, and the power (W) that the sources feed in."""
        own, n = self._segments, len(snapshot.voltages)
        count = len(own.lengths_m)
        impedance = np.empty((n * count, n * count), complex)
        write_impedance(
            snapshot.centres_m, snapshot.rotations,
            own.centres_m, own.axes, own.lengths_m, own.radii_m, self._spread, self._k_rad_m, self._image,
            impedance,
        )  # fmt: skip
        field = np.zeros((n, count), complex)
        field[:, self._fed] = -snapshot.voltages / own.lengths_m[self._fed]
        currents = np.linalg.solve(impedance, field.ravel()).reshape(n, count)
        power_w = 0.5 * float((snapshot.voltages.conj() @ currents[:, self._fed]).real)
        return currents @ self._to_points_m.T, power_w


@njit(cache=True, nogil=True, error_model="numpy")
def write_impedance(
    places_m: Array,
    rotations: Array,
    centres_m: Array,
    axes: Array,
    lengths_m: Array,
    radii_m: Array,
    spread: Array,
    k_rad_m: float,
    image: bool,  # noqa: FBT001  # numba knows no keyword-only arguments
    impedance: Complex,
) -> None:
    """Write the fields at all n x N centres for a current at each of them, (n N, n N).

    No element is joined to another. N segments of one are given in its frame, with their ``spread`` (3, N, N)
    as `admittance` has it.
    """
    n, count = len(places_m), len(lengths_m)
    none = np.zeros(3)
    all_m, all_axes = np.empty((n, count, 3)), np.empty((n, count, 3))
    for i in range(n):
        turn(rotations[i], places_m[i], centres_m, all_m[i])
        turn(rotations[i], none, axes, all_axes[i])
    below_m, below_axes = np.empty((count, 3)), np.empty((count, 3))
    fields, below = np.empty((count, count, 3), np.complex128), np.zeros((count, count, 3), np.complex128)
    for j in range(n):
        if image:
            below_m[:], below_axes[:] = all_m[j], -all_axes[j]
            below_m[:, 2] *= -1.0
            below_axes[:, 2] *= -1.0
        for i in range(n):
            write_fields(all_m[i], all_axes[i], radii_m, all_m[j], all_axes[j], lengths_m, k_rad_m, fields)
            if image:  # its currents run against those above along the axes' images: a sine turns round
                write_fields(all_m[i], all_axes[i], radii_m, below_m, below_axes, lengths_m, k_rad_m, below)
                fields[:, :, 0] += below[:, :, 0]
                fields[:, :, 1] -= below[:, :, 1]
                fields[:, :, 2] += below[:, :, 2]
            for p in range(count):
                for m in range(count):
                    total = 0.0j
                    for q in range(count):
                        for c in range(3):
                            total += fields[p, q, c] * spread[c, q, m]
                    impedance[i * count + p, j * count + m] = total
