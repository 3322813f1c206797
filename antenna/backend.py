"""What computes patterns: the interface of all solvers, and the choice of one by the settings."""

from collections.abc import Sequence
from typing import Protocol

from antenna.config import AntennaConfig
from antenna.geometry import ElementsTouch, Snapshot
from antenna.patterns import Pattern


class BackendUnavailable(ImportError):
    """What a backend needs is not installed; the text is one line for the user."""


class Backend(Protocol):
    """A solver, set up for one kind of element, one wavelength and one grid.

    It takes many snapshots at once, since some solvers are fast only then.
    """

    name: str

    def patterns(self, snapshots: Sequence[Snapshot]) -> list[Pattern | ElementsTouch]:
        """One result for each snapshot, in order; that of elements that touch is `ElementsTouch`."""
        ...


def make_backend(config: AntennaConfig) -> Backend:
    """Set up the backend that ``config`` names.

    Raises `BackendUnavailable`: NEC2 needs PyNEC, which is optional.
    """
    from antenna.nec2 import Nec2  # noqa: PLC0415 - optional: PyNEC is needed only by those who compute with it

    return Nec2(config)
