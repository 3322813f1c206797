"""Interface of all antenna solvers: `Backend`, its stated accuracy, and the error if it is unavailable."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Protocol

from antenna.analysis.patterns import Pattern
from antenna.model.geometry import ElementsTouch, Snapshot


class BackendUnavailable(ImportError):
    """A requirement of a backend is not installed; the text is one line for the user."""


class Accuracy(StrEnum):
    """Differences between a backend's gains and NEC2's for the same wires."""

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


class Backend(Protocol):
    """A solver for one kind of element, one wavelength and one grid.

    It solves many snapshots per call, since some solvers are fast only then.
    """

    name: str
    accuracy: Accuracy

    def patterns(self, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
        """Return one result per snapshot, in order; `ElementsTouch` if elements touch."""
        ...
