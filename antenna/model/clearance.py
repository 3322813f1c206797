"""Positions of an array's wires, and clearances between its elements: touching elements have no pattern."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from antenna.model.elements import Element
from antenna.model.geometry import Array, ElementsTouch, Snapshot

SEGMENT_MATCH = 1e-3
"""Wire ends closer than this part of a segment are one node in NEC2 (User's Guide, structure geometry)."""
ALIKE_M = 1e-9
"""Distances that differ by less are equal: the first counts, independent of rounding."""
GROUND = -1
"""Index of the ground in place of an element."""
NEAR_RAD = 0.45
"""Phase of the wave over the distance within which elements count as near."""
CREDIBLE = 0.8, 1.25
"""Credible range of radiated over input power: within 1 dB."""
LOSSY = 0.0, 1.05
"""The same over a lossy ground."""


class Nearest(NamedTuple):
    """Two elements, or one and the `GROUND`, and the distance of their wires."""

    first: int
    second: int
    distance_m: float


def wire_ends_m(element: Element) -> Array:
    """Return starts and ends of the wires (W, 2, 3), in the element's frame."""
    return np.array([(wire.start_m, wire.end_m) for wire in element.wires])


def placed_wires_m(snapshot: Snapshot, element: Element) -> Array:
    """Return starts and ends of the wires of all elements (n, W, 2, 3), in the array's frame."""
    turned = np.einsum("nxy,wey->nwex", snapshot.rotations, wire_ends_m(element))
    return np.asarray(turned + snapshot.centres_m[:, None, None])


def clearance_m(element: Element) -> float:
    """Return the least allowed distance between the wire axes of two elements.

    NEC2 does not detect parallel wires that overlap, and joins ends that nearly meet.
    """
    return max(
        max(2.0 * wire.radius_m, SEGMENT_MATCH * wire.length_m / wire.segments) for wire in element.wires
    )


def near_m(wavelength_m: float) -> float:
    """Return the distance within which elements count as near each other: `NEAR_RAD` of the wave's phase.

    The near field of an element exceeds its radiated field by the cube of that phase, so that small relative
    errors of a coupling are significant for the radiated power.
    """
    return NEAR_RAD * wavelength_m / (2.0 * math.pi)


def credible(average_gain: float, *, lossy: bool = False) -> bool:
    """Whether the radiated power matches the input power; a ``lossy`` ground may absorb any part of it."""
    least, most = LOSSY if lossy else CREDIBLE
    return least < average_gain < most


def reach_m(element: Element) -> float:
    """Return the distance of the farthest wire end from the element's centre."""
    return float(np.linalg.norm(wire_ends_m(element), axis=-1).max())


def check_apart(snapshot: Snapshot, element: Element, *, grounded: bool) -> Nearest:
    """Return the two nearest elements; raises `ElementsTouch` if they, or one and the ground, touch."""
    placed_m, n = placed_wires_m(snapshot, element), len(snapshot.centres_m)
    pair, distance_m, (apart_m, image_apart_m) = np.empty(2, np.int64), np.empty(1), np.empty((2, n, n))
    measure(placed_m, grounded, np.empty_like(placed_m), apart_m, image_apart_m, pair, distance_m)
    found = Nearest(int(pair[0]), int(pair[1]), float(distance_m[0]))
    if found.distance_m <= clearance_m(element):
        raise ElementsTouch(*found)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def measure(
    ends_m: Array, grounded: bool,  # noqa: FBT001  # numba has no keyword-only arguments
    ends_image_m: Array, apart_m: Array, image_apart_m: Array, nearest: NDArray[np.int64], nearest_m: Array,
) -> None:  # fmt: skip
    """Write the two nearest of n elements, (2,), and the distance of their wires, (1,).

    If the second is `GROUND`, the distance is the height of the first one's lowest point; for a single
    element in free space it is infinite. The wires are ``ends_m`` (n, W, 2, 3). Also written are the wires of
    the images in the ground, the distances (n, n) of elements for i < j, and of elements and images (n, n)
    for i <= j.
    """
    n = len(ends_m)
    nearest[0], nearest[1], nearest_m[0] = 0, GROUND, np.inf
    if grounded:
        for i in range(n):
            lowest_m = np.inf
            for wire in range(ends_m.shape[1]):
                for end in range(2):
                    place_m, image_m = ends_m[i, wire, end], ends_image_m[i, wire, end]
                    image_m[0], image_m[1], image_m[2] = place_m[0], place_m[1], -place_m[2]
                    lowest_m = min(lowest_m, place_m[2])
            if lowest_m < nearest_m[0] - ALIKE_M:
                nearest[0], nearest_m[0] = i, lowest_m
    for i in range(n):
        for j in range(i, n):
            if grounded:
                image_apart_m[i, j] = least_distance_m(ends_m[i], ends_image_m[j])
            if i == j:
                continue
            apart_m[i, j] = least_distance_m(ends_m[i], ends_m[j])
            if apart_m[i, j] < nearest_m[0] - ALIKE_M:
                nearest[0], nearest[1], nearest_m[0] = i, j, apart_m[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def least_distance_m(wires_m: Array, others_m: Array) -> float:
    """Return the least distance of the wires (W, 2, 3) of two elements."""
    least_m = np.inf
    for a in range(len(wires_m)):
        for b in range(len(others_m)):
            distance_m = segment_distance_m(wires_m[a, 0], wires_m[a, 1], others_m[b, 0], others_m[b, 1])
            least_m = min(least_m, distance_m)
    return least_m


@njit(cache=True, nogil=True, error_model="numpy")
def segment_distance_m(p_m: Array, q_m: Array, r_m: Array, s_m: Array) -> float:
    """Return the least distance between the segments from p to q and from r to s, (3,), of positive length.

    Ericson, Real-Time Collision Detection, 5.1.9: nearest points of the lines, clamped to the segments.
    """
    aa = bb = ab = ac = bc = 0.0
    for x in range(3):
        a, b, c = q_m[x] - p_m[x], s_m[x] - r_m[x], p_m[x] - r_m[x]
        aa += a * a
        bb += b * b
        ab += a * b
        ac += a * c
        bc += b * c
    sine_squared = aa * bb - ab * ab
    s = 0.0
    if sine_squared > 1e-12 * aa * bb:
        s = min(max((ab * bc - ac * bb) / sine_squared, 0.0), 1.0)
    t = min(max((ab * s + bc) / bb, 0.0), 1.0)
    s = min(max((ab * t - ac) / aa, 0.0), 1.0)
    square = 0.0
    for x in range(3):
        d = p_m[x] + s * (q_m[x] - p_m[x]) - r_m[x] - t * (s_m[x] - r_m[x])
        square += d * d
    return math.sqrt(square)
