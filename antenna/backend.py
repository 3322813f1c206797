"""What computes patterns: the interface of all solvers, and the choice of one by the settings."""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Protocol

from antenna.clearance import SEGMENT_MATCH, reach_m
from antenna.config import AntennaConfig
from antenna.elements import THIN_WIRE_SLENDERNESS, Element
from antenna.geometry import ElementsTouch, Snapshot
from antenna.patterns import Pattern

SMALL_EXTENT = 0.3 / (2.0 * math.pi)
"""Small elements are within a tenth of the wavelength: the farthest end's distance, in wavelengths."""
LARGEST_EXTENT = 0.25
LONGEST_SEGMENT = 0.1
LARGEST_LOOP = 0.1
LARGEST_DECK = 1.0 / 6.0
"""What is compared with NEC2, in wavelengths; segments are also as long as NEC2's guide has them."""
FEWEST_SIDES = 8
"""Of a loop; with 4 and 3 sides, 1 m round at 10 m, the maximum differs by 0.08 and 0.85 dB."""
FAINTEST = 2.5e14
"""Of (wavelength / wire)^3 (wavelength / segment)^2, as which NEC2's error in the power of small elements
grows: an element's reactance over its resistance, and digits lost where constant and cosine are alike."""
ROUNDING = 1.0 + 1e-9


class BackendUnavailable(ImportError):
    """What a backend needs is not installed; the text is one line for the user."""


class Accuracy(StrEnum):
    """How far a backend's gains may be from NEC2's on the same wires."""

    REFERENCE = "NEC2 itself"
    SMALL_ELEMENTS = "within 0.01 dB of NEC2's maximum, and 0.1 dB of its pattern above -20 dBi"
    LARGE_ELEMENTS = "within 0.05 dB of NEC2's maximum, and 0.3 dB of its pattern above -20 dBi"
    FAINT_ELEMENTS = (
        "within 0.01 dB of NEC2's greatest directivity, and 0.1 dB of its pattern but for the power"
    )
    LONG_SEGMENTS = "not held against NEC2: segments longer than a tenth of the wavelength"
    SHORT_SEGMENTS = "not held against NEC2: segments shorter than 8 radii of their wire"
    WIDE_LOOP = "not held against NEC2: a loop more than a tenth of the wavelength round"
    COARSE_LOOP = "not held against NEC2: a loop of fewer than 8 sides"
    LARGE_DECK = "not held against NEC2: a deck of more wire than a sixth of the wavelength"
    RING_DECK = "not held against NEC2: a deck with a ring of wires"
    LARGEST_ELEMENTS = "not held against NEC2: elements larger than half the wavelength"


def batch_accuracy(config: AntennaConfig) -> Accuracy:
    """What the batch solver claims for an element: no more than what it has been compared for."""
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
    """Whether a wire joins ends that are joined already."""
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


class Backend(Protocol):
    """A solver, set up for one kind of element, one wavelength and one grid.

    It takes many snapshots at once, since some solvers are fast only then.
    """

    name: str
    accuracy: Accuracy

    def patterns(self, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
        """One result for each snapshot, in order; that of elements that touch is `ElementsTouch`."""
        ...


def make_backend(config: AntennaConfig, *, threads: int = 1) -> Backend:
    """Set up the backend that ``config`` names; ``threads`` are for those that can use them.

    Raises `BackendUnavailable`: NEC2 needs PyNEC, nec2c the program of that name.
    """
    match config.backend:
        case "batch":
            from antenna.batch.solver import Batch  # noqa: PLC0415 - compiles on import of its kernels

            return Batch(config, threads=threads)
        case "nec2":
            from antenna.nec2 import Nec2  # noqa: PLC0415 - optional: PyNEC is needed by those alone who use it

            return Nec2(config)
        case "nec2c":
            from antenna.nec2c import Nec2c  # noqa: PLC0415 - starts a program

            return Nec2c(config)
