"""Stated accuracy of the batch solver for a kind of element, within the range compared with NEC2."""

import math

from antenna.model.clearance import SEGMENT_MATCH, reach_m
from antenna.model.config import AntennaConfig
from antenna.model.elements import THIN_WIRE_SLENDERNESS, Element
from antenna.solvers.interface import Accuracy

SMALL_EXTENT = 0.3 / (2.0 * math.pi)
"""Largest distance of a wire end of small elements, in wavelengths: about a tenth of the wave in total."""
LARGEST_EXTENT = 0.25
LONGEST_SEGMENT = 0.1
LARGEST_LOOP = 0.1
LARGEST_DECK = 1.0 / 6.0
"""Limits of the comparison with NEC2, in wavelengths; segments are also limited by NEC2's guide."""
FEWEST_SIDES = 8
"""Least sides of a loop; with 3 sides, 1 m circumference at 10 m, the maximum differs by 0.85 dB."""
FAINTEST = 2.5e14
"""Largest (wavelength / wire)^3 (wavelength / segment)^2, to which NEC2's error in the power of small
elements is proportional: reactance over resistance, and cancellation of constant and cosine currents."""
ROUNDING = 1.0 + 1e-9


def batch_accuracy(config: AntennaConfig) -> Accuracy:
    """Return the accuracy of the batch solver for an element, as far as it was compared with NEC2."""
    element = config.element()
    segments_m = [wire.length_m / wire.segments for wire in element.wires]
    extent, longest, shortest, wire = (
        length_m / config.wavelength_m / ROUNDING
        for length_m in (
            reach_m(element), max(segments_m), min(segments_m), sum(wire.length_m for wire in element.wires)
        )
    )  # fmt: skip
    first_true = {
        Accuracy.LONG_SEGMENTS: longest > LONGEST_SEGMENT,
        Accuracy.SHORT_SEGMENTS: min(w.slenderness for w in element.wires) * ROUNDING < THIN_WIRE_SLENDERNESS,
        Accuracy.WIDE_LOOP: config.element_kind == "loop" and wire > LARGEST_LOOP,
        Accuracy.COARSE_LOOP: config.element_kind == "loop" and config.segments < FEWEST_SIDES,
        Accuracy.LARGE_DECK: config.element_kind == "deck" and wire > LARGEST_DECK,
        Accuracy.RING_DECK: config.element_kind == "deck" and _has_ring(element),
        Accuracy.LARGEST_ELEMENTS: extent > LARGEST_EXTENT,
        Accuracy.FAINT_ELEMENTS: wire**-3 * shortest**-2 > FAINTEST,
        Accuracy.SMALL_ELEMENTS: extent < SMALL_EXTENT,
    }
    return next((accuracy for accuracy, is_so in first_true.items() if is_so), Accuracy.LARGE_ELEMENTS)


def _has_ring(element: Element) -> bool:
    """Whether the wires contain a closed loop."""
    places_m: list[tuple[float, float, float]] = []
    parts: list[int] = []
    for wire in element.wires:
        match_m, joined = SEGMENT_MATCH * wire.length_m / wire.segments, []
        for end_m in (wire.start_m, wire.end_m):
            place = next((n for n, at_m in enumerate(places_m) if math.dist(at_m, end_m) < match_m), None)
            if place is None:
                place = len(places_m)
                places_m.append(end_m)
                parts.append(place)
            joined.append(parts[place])
        if joined[0] == joined[1]:
            return True
        parts = [joined[0] if part == joined[1] else part for part in parts]
    return False
