"""Joint response of elements that are near each other, computed with all segments instead of few currents.

The currents c at all centres of m such elements follow from their fields there, c = A (F c) + Q y, where y
(m K) are the currents that sources and the fields of all other elements drive in each of them alone: c =
(1 - A F)^-1 Q y. For the other elements they are represented by the K currents that radiate like them, a =
P c = T y; the currents through the sources are exact.
"""

import numpy as np
from numba import njit

from antenna.analysis.maxima import Index
from antenna.model.geometry import Array, Complex
from antenna.solvers.batch.kind import ElementKind
from antenna.solvers.batch.linear_algebra import eliminate
from antenna.solvers.batch.moments import mirror, turn, write_fields


@njit(cache=True, nogil=True, error_model="numpy")
def find_near(kind: ElementKind, apart_m: Array, image_apart_m: Array, members: Index) -> int:
    """Write the indices of elements near another one or an image, (n,), in order; return their number."""
    n, count = len(members), 0
    for i in range(n):
        near = kind.image and image_apart_m[i, i] < kind.near_m
        for j in range(n):
            a, b = min(i, j), max(i, j)
            near = near or (i != j and apart_m[a, b] < kind.near_m)
            near = near or (i != j and kind.image and image_apart_m[a, b] < kind.near_m)
        if near:
            members[count] = i
            count += 1
    return count


@njit(cache=True, inline="always", nogil=True, error_model="numpy")
def respond_together(
    kind: ElementKind, places_m: Array, rotations: Array, members: Index, together: Complex, feeds_a: Complex
) -> None:
    """Write T (m K, m K), and the currents through the sources for y, (m, m K), of m near elements."""
    m, count, kept = len(members), len(kind.lengths_m), len(kind.feed_a)
    matrix = np.zeros((m * count, m * count), np.complex128)
    right = np.zeros((m * count, m * kept), np.complex128)
    centres_m, axes, none = np.empty((m, count, 3)), np.empty((m, count, 3)), np.zeros(3)
    below_m, below_axes = np.empty((count, 3)), np.empty((count, 3))
    for i in range(m):
        turn(rotations[members[i]], places_m[members[i]], kind.centres_m, centres_m[i])
        turn(rotations[members[i]], none, kind.segment_axes, axes[i])
        for p in range(count):
            matrix[i * count + p, i * count + p] = 1.0
            for c in range(kept):
                right[i * count + p, i * kept + c] = kind.currents_a[p, c]
    fields = np.empty((count, count, 3), np.complex128)
    made, driven = np.empty((count, count), np.complex128), np.empty((count, count), np.complex128)
    for j in range(m):
        mirror(centres_m[j], axes[j], below_m, below_axes)
        for i in range(m):
            made[:] = 0.0
            if i != j:
                write_fields(
                    centres_m[i], axes[i], kind.radii_m, centres_m[j], axes[j], kind.lengths_m, kind.k_rad_m,
                    fields,
                )  # fmt: skip
                add_spread(fields, kind.spread, 1.0, made)
            if kind.image:
                write_fields(
                    centres_m[i], axes[i], kind.radii_m, below_m, below_axes, kind.lengths_m, kind.k_rad_m,
                    fields,
                )  # fmt: skip
                add_spread(fields, kind.spread, -1.0, made)
            if i != j or kind.image:
                np.dot(kind.admittance_s_m, made, driven)
                for p in range(count):
                    for q in range(count):
                        matrix[i * count + p, j * count + q] -= driven[p, q]
    eliminate(matrix, right)
    currents = np.empty((count, m * kept), np.complex128)
    for i in range(m):
        for p in range(count):
            for c in range(m * kept):
                currents[p, c] = right[i * count + p, c]
        np.dot(kind.projection, currents, together[i * kept : (i + 1) * kept])
        for c in range(m * kept):
            feeds_a[i, c] = currents[kind.fed, c]


@njit(cache=True, nogil=True, error_model="numpy")
def add_spread(fields: Complex, spread: Array, sine: float, made: Complex) -> None:
    """Add to ``made`` (N, N) the fields at N centres of a current at each centre.

    ``fields`` (N, N, 3) are those of A, B and C.
    ``sine`` is -1 for the currents of an image, which are opposite to those above along the axes' images.
    """
    count = len(made)
    for p in range(count):
        for q in range(count):
            a, b, c = fields[p, q, 0], sine * fields[p, q, 1], fields[p, q, 2]
            for k in range(count):
                made[p, k] += a * spread[0, q, k] + b * spread[1, q, k] + c * spread[2, q, k]
