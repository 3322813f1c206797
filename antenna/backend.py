"""What computes patterns: the interface of all solvers, and the choice of one by the settings."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Protocol

from antenna.config import AntennaConfig
from antenna.geometry import ElementsTouch, Snapshot
from antenna.patterns import Pattern


class BackendUnavailable(ImportError):
    """What a backend needs is not installed; the text is one line for the user."""


class Accuracy(StrEnum):
    """How far a backend's gains may be from NEC2's on the same wires."""

    REFERENCE = "NEC2 itself"
    SMALL_ELEMENTS = "within 0.01 dB of NEC2's maximum, and 0.1 dB of its pattern above -20 dBi"
    LARGE_ELEMENTS = "within 0.05 dB of NEC2's maximum, and 0.3 dB of its pattern above -20 dBi"


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
