"""Data of one kind of element at one wavelength, for compiled code."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antenna.model.clearance import clearance_m, near_m, wire_ends_m
from antenna.model.elements import Element
from antenna.model.geometry import Array, Complex
from antenna.solvers.batch.response import respond


class ElementKind(NamedTuple):
    """An element's response in plain arrays: K currents as points, on all levels of `NODES`, N segments."""

    firsts: NDArray[np.int64]
    """(L + 1,) first point of each level."""
    places_m: Array
    """(M, 3) positions of the points, in the element's frame."""
    axes: Array
    """(M, 3) unit vectors along the wires at the points."""
    moments_am: Complex
    """(M, K) moments of the K currents at the points."""
    scattering: Complex
    """(K, K) currents driven by a field, from its reactions with the K currents."""
    feed_a: Complex
    """(K,) current of each at the source."""
    currents_a: Complex
    """(N, K) each current at the segments' centres."""
    projection: Complex
    """(K, N) combination of the K currents that radiates like currents at the centres."""
    centres_m: Array
    """(N, 3) centres of the segments; the next three fields are also of the segments."""
    segment_axes: Array
    """(N, 3)"""
    lengths_m: Array
    """(N,)"""
    radii_m: Array
    """(N,)"""
    spread: Array
    """(3, N, N) second result of `antenna.solvers.batch.moments.admittance`."""
    admittance_s_m: Complex
    """(N, N) first result of the same."""
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
    response = respond(element, wavelength_m)
    segments = response.segments
    sizes = [len(nodes.places_m) for nodes in response.nodes]
    return ElementKind(
        firsts=np.concatenate([[0], np.cumsum(sizes)]),
        places_m=np.concatenate([nodes.places_m for nodes in response.nodes]),
        axes=np.concatenate([nodes.axes for nodes in response.nodes]),
        moments_am=np.concatenate([nodes.moments_am for nodes in response.nodes]),
        scattering=np.ascontiguousarray(response.scattering),
        feed_a=response.currents_a[element.feed_segment].copy(),
        currents_a=response.currents_a,
        projection=np.ascontiguousarray(response.projection),
        centres_m=segments.centres_m,
        segment_axes=segments.axes,
        lengths_m=segments.lengths_m,
        radii_m=segments.radii_m,
        spread=response.spread,
        admittance_s_m=response.admittance_s_m,
        fed=element.feed_segment,
        wires_m=wire_ends_m(element),
        half_m=0.5 * max(wire.length_m for wire in element.wires),
        clearance_m=clearance_m(element),
        near_m=near_m(wavelength_m),
        k_rad_m=2.0 * np.pi / wavelength_m,
        image=image,
    )
