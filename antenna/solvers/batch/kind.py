"""Response of one kind of element to incident fields, with a few currents instead of one per segment.

The elements of an array are equal and separated, so the incident field varies little along an element. Its
response is spanned by few current distributions: that of the element's source, and the strongest of its
responses to plane waves from all directions (a singular value decomposition). They are computed once for a
kind of element and a wavelength.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antenna.model.clearance import clearance_m, near_m, wire_ends_m
from antenna.model.elements import Element
from antenna.model.geometry import Array, Complex
from antenna.solvers.batch.moments import Segments, admittance

NODES = (1, 2, 3, 4, 6, 8, 12, 20, 40)
"""Numbers of points per wire that represent fields and currents, by level."""
SIGNIFICANT = 1e-4
"""Responses to plane waves below this fraction of the strongest are neglected."""
_DIRECTIONS = 60
_GAUSS_X, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(12)


class ElementKind(NamedTuple):
    """An element of N segments for compiled code: K current distributions, the first of 1 V at its source.

    They are represented by moments at M points, on all levels of `NODES`: exact for fields of a degree below
    the points per wire.
    """

    firsts: NDArray[np.int64]
    """(L + 1,) first point of each level."""
    places_m: Array
    """(M, 3) positions of the points, in the element's frame."""
    axes: Array
    """(M, 3) unit vectors along the wires at the points."""
    moments_am: Complex
    """(M, K) current times length of the K currents at the points."""
    scattering: Complex
    """(K, K) currents driven by a field, from its reactions (sum of moment times field) with the K."""
    feed_a: Complex
    """(K,) current of each at the source."""
    currents_a: Complex
    """(N, K) each current at the segments' centres."""
    projection: Complex
    """(K, N) combination of the K currents that radiates like currents at the centres."""
    centres_m: Array
    """(N, 3) centres of the segments; likewise their axes (N, 3), lengths and radii (N,)."""
    segment_axes: Array
    lengths_m: Array
    radii_m: Array
    spread: Array
    """(3, N, N) with the next field (N, N), the results of `antenna.solvers.batch.moments.admittance`."""
    admittance_s_m: Complex
    fed: int
    """Segment of the source."""
    wires_m: Array
    """(W, 2, 3) ends of the wires."""
    half_m: float
    """Half of the longest wire's length."""
    clearance_m: float
    """Least distance of two elements."""
    near_m: float
    """Distance below which couplings are computed by segments."""
    k_rad_m: float
    image: bool
    """Whether there is perfect ground at height 0."""


def make_kind(element: Element, wavelength_m: float, *, image: bool) -> ElementKind:
    """Return the data of an element at a wavelength."""
    k_rad_m = 2.0 * np.pi / wavelength_m
    segments = cut(element)
    admits, spread = admittance(segments, k_rad_m)
    source = np.zeros(len(segments.lengths_m))
    source[element.feed_segment] = 1.0 / segments.lengths_m[element.feed_segment]
    driven = admits @ source
    waves = _plane_waves(segments.centres_m, segments.axes, k_rad_m)
    responses = admits @ waves
    unit = driven / np.linalg.norm(driven)
    others = responses - np.outer(unit, unit.conj() @ responses)
    shapes, strengths, _ = np.linalg.svd(others, full_matrices=False)
    strongest = np.linalg.norm(responses, 2)
    kept = shapes[:, strengths > SIGNIFICANT * strongest] * np.linalg.norm(driven)
    currents = np.column_stack([driven, kept])
    nodes = [make_nodes(element, segments, spread @ currents, k_rad_m, count) for count in NODES]
    places_m, axes, moments_am = (np.concatenate(part) for part in zip(*nodes, strict=True))
    finest_m, finest_axes, finest_am = nodes[-1]
    waves = _plane_waves(finest_m, finest_axes, k_rad_m)
    reactions = finest_am.T @ waves
    coefficients = np.linalg.lstsq(currents, responses, rcond=None)[0]
    scattering: Complex = np.linalg.lstsq(reactions.T, coefficients.T, rcond=None)[0].T.astype(complex)
    _, _, alone_am = make_nodes(element, segments, spread, k_rad_m, NODES[-1])
    projection: Complex = np.linalg.lstsq(reactions.T, (alone_am.T @ waves).T, rcond=None)[0].astype(complex)
    return ElementKind(
        firsts=np.cumsum([0, *(len(level[0]) for level in nodes)]),
        places_m=places_m, axes=axes, moments_am=moments_am,
        scattering=np.ascontiguousarray(scattering),
        feed_a=currents[element.feed_segment].copy(),
        currents_a=currents,
        projection=np.ascontiguousarray(projection),
        centres_m=segments.centres_m, segment_axes=segments.axes,
        lengths_m=segments.lengths_m, radii_m=segments.radii_m,
        spread=spread, admittance_s_m=admits,
        fed=element.feed_segment,
        wires_m=wire_ends_m(element),
        half_m=0.5 * max(wire.length_m for wire in element.wires),
        clearance_m=clearance_m(element), near_m=near_m(wavelength_m),
        k_rad_m=k_rad_m, image=image,
    )  # fmt: skip


def cut(element: Element) -> Segments:
    """Return the segments of an element's wires, one wire after the other."""
    parts = []
    for wire in element.wires:
        start_m, end_m = np.array(wire.start_m), np.array(wire.end_m)
        along = (np.arange(wire.segments) + 0.5)[:, None] / wire.segments
        axis = (end_m - start_m) / wire.length_m
        parts.append((
            start_m + along * (end_m - start_m),
            np.tile(axis, (wire.segments, 1)),
            np.full(wire.segments, wire.length_m / wire.segments),
            np.full(wire.segments, wire.radius_m),
        ))  # fmt: skip
    return Segments(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _plane_waves(places_m: Array, axes: Array, k_rad_m: float) -> Complex:
    """Return fields (M, W) along the axes of plane waves of 1 V/m from all directions, two polarisations."""
    turn = np.arange(_DIRECTIONS) * np.pi * (3.0 - np.sqrt(5.0))  # directions on a spiral, evenly spread
    cosine = 1.0 - (2.0 * np.arange(_DIRECTIONS) + 1.0) / _DIRECTIONS
    sine = np.sqrt(1.0 - cosine**2)
    towards = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], -1)
    theta_hat = np.stack([cosine * np.cos(turn), cosine * np.sin(turn), -sine], -1)
    phi_hat = np.stack([-np.sin(turn), np.cos(turn), np.zeros(_DIRECTIONS)], -1)
    phase = np.exp(1j * k_rad_m * places_m @ towards.T)
    waves: Complex = np.concatenate([axes @ theta_hat.T * phase, axes @ phi_hat.T * phase], axis=1)
    return waves


def make_nodes(
    element: Element, segments: Segments, abc: Array | Complex, k_rad_m: float, count: int
) -> tuple[Array, Array, Complex]:
    """Represent K currents, A, B and C on N segments (3, N, K), by ``count`` Gauss points on each wire.

    Returns places (M, 3), axes (M, 3) and moments (M, K) of the points, as in `ElementKind`.

    The moment at a point is the integral of the current times the polynomial that is 1 there and 0 at the
    wire's other points. So reactions with fields that are polynomials of lower degree are exact, also for
    currents with kinks.
    """
    points, _ = np.polynomial.legendre.leggauss(count)
    to_points = np.linalg.inv(np.polynomial.legendre.legvander(points, count - 1))
    a, b, c = abc
    places, axes, moments = [], [], []
    first = 0
    for wire in element.wires:
        start_m, end_m = np.array(wire.start_m), np.array(wire.end_m)
        moment = np.zeros((count, abc.shape[2]), complex)
        for j in range(first, first + wire.segments):
            half_m = 0.5 * float(segments.lengths_m[j])
            s_m = _GAUSS_X * half_m
            current = a[j] + np.outer(np.sin(k_rad_m * s_m), b[j]) + np.outer(np.cos(k_rad_m * s_m), c[j])
            on_wire = (2.0 * (j - first) + 1.0 + _GAUSS_X) / wire.segments - 1.0
            weight = np.polynomial.legendre.legvander(on_wire, count - 1) @ to_points
            moment += weight.T @ (_GAUSS_WEIGHTS[:, None] * half_m * current)
        first += wire.segments
        places.append(0.5 * (start_m + end_m) + 0.5 * points[:, None] * (end_m - start_m))
        axes.append(np.tile((end_m - start_m) / wire.length_m, (count, 1)))
        moments.append(moment)
    return np.concatenate(places), np.concatenate(axes), np.concatenate(moments)
