"""Currents of many arrays with mutual coupling, and the power that their sources supply.

A vector current moment p at r' has, at r at the distance R in the direction of the unit vector u, the field
E = -(j eta k / 4 pi) (e^{-jkR} / R) [p (1 - j/kR - 1/(kR)^2) - (p.u)u (1 - 3j/kR - 3/(kR)^2)].
Its reaction with another moment is symmetric, so every pair is computed once. Over perfect ground each moment
has an image below it, with the horizontal components reversed.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from antenna.model.clearance import measure
from antenna.model.geometry import Array, Complex
from antenna.solvers.batch.kind import NODES, ElementKind
from antenna.solvers.batch.linear_algebra import eliminate
from antenna.solvers.batch.moments import ETA_OHM, mirror, turn
from antenna.solvers.batch.near import find_near, respond_together

COUPLING_ACCURACY = 1e-4
"""Target relative error of the coupling of two elements."""
SETTLED = 1e-10
"""Largest relative change of the currents in the last iteration."""
REPETITIONS = 12
LEVELS = np.array(NODES)


@njit(cache=True, nogil=True)
def level_for(distance_m: float, half_m: float) -> int:
    """Return the index into `NODES` for two wires of this half-length at this least distance.

    On a wire whose nearest source is d half-lengths away, a field's Legendre coefficients decay like those of
    a function analytic within the ellipse of parameter d + sqrt(d^2 + 1); both wires are integrated over.
    """
    d = distance_m / half_m
    needed = -math.log(COUPLING_ACCURACY) / math.log(d + math.sqrt(d * d + 1.0))
    for level in range(len(LEVELS) - 1):
        if LEVELS[level] >= needed:
            return level
    return len(LEVELS) - 1


@njit(cache=True, nogil=True, error_model="numpy")
def reactions(
    first_m: Array, first_axes: Array, second_m: Array, second_axes: Array, moments_am: Complex,
    k_rad_m: float, fields: Complex, found: Complex,
) -> None:  # fmt: skip
    """Add to ``found`` (K, K) the reactions of the first element's moments with the second's fields.

    ``fields`` (M, K) is a work array.
    """  # fmt: skip
    scale = ETA_OHM * k_rad_m / (4.0 * np.pi)
    currents = moments_am.shape[1]
    for p in range(len(first_m)):
        for c in range(currents):
            fields[p, c] = 0.0
        for q in range(len(second_m)):
            x, y = first_m[p, 0] - second_m[q, 0], first_m[p, 1] - second_m[q, 1]
            z = first_m[p, 2] - second_m[q, 2]
            r = 1.0 / math.sqrt(x * x + y * y + z * z)
            u0, u1, u2 = first_axes[p, 0], first_axes[p, 1], first_axes[p, 2]
            v0, v1, v2 = second_axes[q, 0], second_axes[q, 1], second_axes[q, 2]
            level = u0 * v0 + u1 * v1 + u2 * v2
            along = (u0 * x + u1 * y + u2 * z) * (v0 * x + v1 * y + v2 * z) * r * r
            kr = k_rad_m / r
            i = 1.0 / kr
            i2 = i * i
            real = level * (1.0 - i2) - along * (1.0 - 3.0 * i2)
            imag = (3.0 * along - level) * i
            sine, cosine = math.sin(kr), math.cos(kr)
            # -j (real + j imag) (cosine - j sine)
            a, b = real * cosine + imag * sine, imag * cosine - real * sine
            green = complex(b, -a) * (scale * r)
            for c in range(currents):
                fields[p, c] += green * moments_am[q, c]
    for b in range(currents):
        for c in range(currents):
            total = 0.0j
            for p in range(len(first_m)):
                total += moments_am[p, b] * fields[p, c]
            found[b, c] += total


@njit(cache=True, nogil=True, error_model="numpy")
def solve_arrays(
    kind: ElementKind, centres_m: Array, rotations: Array, voltages: Complex, currents: Complex,
    power_w: Array, nearest: NDArray[np.int64], nearest_m: Array,
) -> None:  # fmt: skip
    """Solve S arrays of n elements: centres (S, n, 3), rotations (S, n, 3, 3), voltages (S, n).

    Writes the currents (S, n, K), the power supplied by the sources (S,), and the two nearest elements of
    each array and their distance, (S, 2) and (S,), as `antenna.model.clearance.measure`. Arrays whose
    distance is at most the clearance are not solved.
    """
    arrays, n = voltages.shape
    kept, levels = len(kind.feed_a), len(kind.firsts) - 1
    most = kind.firsts[-1] - kind.firsts[-2]
    none = np.zeros(3)
    ends_m = np.empty((n, len(kind.wires_m), 2, 3))
    ends_image_m = np.empty((n, len(kind.wires_m), 2, 3))
    nodes_m, nodes_axes = np.empty((n, kind.firsts[-1], 3)), np.empty((n, kind.firsts[-1], 3))
    ready = np.empty((n, levels), np.bool_)
    apart_m, image_apart_m = np.empty((n, n)), np.empty((n, n))
    image_m, image_axes = np.empty((most, 3)), np.empty((most, 3))
    fields = np.empty((most, kept), np.complex128)
    reaction = np.empty((n, n, kept, kept), np.complex128)
    system = np.empty((n * kept, n * kept), np.complex128)
    source, answer = np.empty(n * kept, np.complex128), np.empty(n * kept, np.complex128)
    members, is_near = np.empty(n, np.int64), np.empty(n, np.bool_)
    for s in range(arrays):
        for i in range(n):
            for w in range(len(kind.wires_m)):
                turn(rotations[s, i], centres_m[s, i], kind.wires_m[w], ends_m[i, w])
        measure(ends_m, kind.image, ends_image_m, apart_m, image_apart_m, nearest[s], nearest_m[s : s + 1])
        if nearest_m[s] <= kind.clearance_m:
            continue
        near = members[: find_near(kind, apart_m, image_apart_m, members)]
        is_near[:] = False
        for i in near:
            is_near[i] = True
        ready[:] = False
        for i in range(n):
            for j in range(i, n):
                reaction[i, j] = 0.0
                if is_near[i] and is_near[j]:
                    continue
                for mirrored in range(2 if kind.image else 1):
                    if i == j and not mirrored:
                        continue
                    level = level_for(image_apart_m[i, j] if mirrored else apart_m[i, j], kind.half_m)
                    a, b = kind.firsts[level], kind.firsts[level + 1]
                    for e in (i, j):
                        if not ready[e, level]:
                            turn(rotations[s, e], centres_m[s, e], kind.places_m[a:b], nodes_m[e, a:b])
                            turn(rotations[s, e], none, kind.axes[a:b], nodes_axes[e, a:b])
                            ready[e, level] = True
                    other_m, other_axes = nodes_m[j, a:b], nodes_axes[j, a:b]
                    if mirrored:
                        mirror(other_m, other_axes, image_m, image_axes)
                        other_m, other_axes = image_m[: b - a], image_axes[: b - a]
                    reactions(
                        nodes_m[i, a:b], nodes_axes[i, a:b], other_m, other_axes,
                        kind.moments_am[a:b], kind.k_rad_m, fields, reaction[i, j],
                    )  # fmt: skip
        # the response of each is S times the reactions with all others' currents: (1 - S Z) a = V
        for i in range(n):
            for j in range(n):
                for b in range(kept):
                    for c in range(kept):
                        total = 0.0j
                        for d in range(kept):
                            z = reaction[i, j, d, c] if j >= i else reaction[j, i, c, d]
                            total += kind.scattering[b, d] * z
                        system[i * kept + b, j * kept + c] = total
        source[:] = 0.0
        for i in range(n):
            source[i * kept] = voltages[s, i]
        if len(near):
            power_w[s] = solve_near(kind, centres_m[s], rotations[s], near, system, source, answer)
        else:
            repeat(system, source, answer)
            power_w[s] = 0.0
            for i in range(n):
                fed_a = 0.0j
                for c in range(kept):
                    fed_a += answer[i * kept + c] * kind.feed_a[c]
                power_w[s] += 0.5 * (source[i * kept].conjugate() * fed_a).real
        for i in range(n):
            for c in range(kept):
                currents[s, i, c] = answer[i * kept + c]


@njit(cache=True, inline="always", nogil=True, error_model="numpy")
def solve_near(
    kind: ElementKind, centres_m: Array, rotations: Array, near: NDArray[np.int64], system: Complex,
    source: Complex, answer: Complex,
) -> float:  # fmt: skip
    """Solve a = V + C a as `repeat`, with a joint response of the near elements; return the power in watts.

    C (n K, n K), which is modified, excludes couplings among the near elements.
    """
    m, kept = len(near), len(kind.feed_a)
    together = np.empty((m * kept, m * kept), np.complex128)
    feeds_a = np.empty((m, m * kept), np.complex128)
    respond_together(kind, centres_m, rotations, near, together, feeds_a)
    size, joint = len(source), m * kept
    rows = np.empty(joint, np.int64)
    alone, answered = np.empty((joint, size), np.complex128), np.empty((joint, size), np.complex128)
    driven, driving = np.empty(joint, np.complex128), np.empty(joint, np.complex128)
    for r in range(joint):
        row = rows[r] = near[r // kept] * kept + r % kept
        driven[r] = source[row]
        for c in range(size):
            alone[r, c] = system[row, c]
    np.dot(together, alone, answered)
    np.dot(together, driven, driving)
    own = source.copy()
    for r in range(joint):
        own[rows[r]] = driving[r]
        for c in range(size):
            system[rows[r], c] = answered[r, c]
    repeat(system, own, answer)
    np.dot(alone, answer, driving)
    for r in range(joint):
        driven[r] += driving[r]
    fed_a = np.empty(m, np.complex128)
    np.dot(feeds_a, driven, fed_a)
    watts, k = 0.0, 0
    for i in range(len(centres_m)):
        at_feed = 0.0j
        if k < m and near[k] == i:
            at_feed = fed_a[k]
            k += 1
        else:
            for c in range(kept):
                at_feed += answer[i * kept + c] * kind.feed_a[c]
        watts += 0.5 * (source[i * kept].conjugate() * at_feed).real
    return watts


@njit(cache=True, nogil=True, error_model="numpy")
def repeat(coupling: Complex, source: Complex, answer: Complex) -> None:
    """Solve a = V + C a for the answer (n K,), by iteration if it converges, or else by elimination."""
    size = len(source)
    following = np.empty(size, np.complex128)
    for i in range(size):
        answer[i] = source[i]
    for _ in range(REPETITIONS):
        change, whole = 0.0, 0.0
        for i in range(size):
            total = source[i]
            for j in range(size):
                total += coupling[i, j] * answer[j]
            following[i] = total
        for i in range(size):
            d, w = following[i] - answer[i], following[i]
            change += d.real * d.real + d.imag * d.imag
            whole += w.real * w.real + w.imag * w.imag
            answer[i] = w
        if change <= SETTLED * SETTLED * whole:
            return
        if change > 0.1 * whole:
            break
    matrix, right = np.empty((size, size), np.complex128), np.empty((size, 1), np.complex128)
    for i in range(size):
        right[i, 0] = source[i]
        for j in range(size):
            matrix[i, j] = (1.0 if i == j else 0.0) - coupling[i, j]
    eliminate(matrix, right)
    for i in range(size):
        answer[i] = right[i, 0]
