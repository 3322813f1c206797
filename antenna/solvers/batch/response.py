"""Response of one element to incident fields, with a few currents instead of one per segment.

The elements of an array are equal and separated, so the incident field varies little along an element. Its
response is spanned by few current distributions: that of the element's source, and the strongest of its
responses to plane waves from all directions (a singular value decomposition). They are computed once for a
kind of element and a wavelength.
"""

from dataclasses import dataclass

import numpy as np

from antenna.model.elements import Element
from antenna.model.geometry import Array, Complex
from antenna.solvers.batch.moments import Segments, admittance

NODES = (1, 2, 3, 4, 6, 8, 12, 20, 40)
"""Numbers of points per wire that represent fields and currents, by level."""
SIGNIFICANT = 1e-4
"""Responses to plane waves below this fraction of the strongest are neglected."""
_DIRECTIONS = 60
_GAUSS_X, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """The K currents of an element as moments at M points, exact for fields of degree M / wires - 1."""

    places_m: Array
    """(M, 3) in the element's frame."""
    axes: Array
    """(M, 3) unit vectors along the wires at the points."""
    moments_am: Complex
    """(M, K) current times length."""


@dataclass(frozen=True, slots=True, eq=False)
class ElementResponse:
    """K current distributions of an element; the first is that of 1 V at its source."""

    nodes: tuple[Nodes, ...]
    """Points by level, see `NODES`."""
    scattering: Complex
    """(K, K) currents driven by a field, from its reactions (sum of moment times field) with the K."""
    currents_a: Complex
    """(N, K) each current at the segments' centres."""
    projection: Complex
    """(K, N) combination of the K currents that radiates like currents at the centres."""
    segments: Segments
    """The N segments."""
    admittance_s_m: Complex
    """(N, N) first result of `antenna.solvers.batch.moments.admittance`."""
    spread: Array
    """(3, N, N) second result of the same."""


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


def respond(element: Element, wavelength_m: float) -> ElementResponse:
    """Return the current distributions of an element and their response to fields."""
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
    nodes = tuple(make_nodes(element, segments, spread @ currents, k_rad_m, count) for count in NODES)
    finest = nodes[-1]
    reactions = finest.moments_am.T @ _plane_waves(finest.places_m, finest.axes, k_rad_m)
    coefficients = np.linalg.lstsq(currents, responses, rcond=None)[0]
    scattering: Complex = np.linalg.lstsq(reactions.T, coefficients.T, rcond=None)[0].T.astype(complex)
    alone = make_nodes(element, segments, spread, k_rad_m, NODES[-1]).moments_am
    segment_reactions = alone.T @ _plane_waves(finest.places_m, finest.axes, k_rad_m)
    projection: Complex = np.linalg.lstsq(reactions.T, segment_reactions.T, rcond=None)[0].astype(complex)
    return ElementResponse(nodes, scattering, currents, projection, segments, admits, spread)


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
) -> Nodes:
    """Represent K currents, A, B and C on N segments (3, N, K), by ``count`` Gauss points on each wire.

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
    return Nodes(np.concatenate(places), np.concatenate(axes), np.concatenate(moments))
