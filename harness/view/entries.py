"""What is shown, independent of a viewer: entries, each of an entity at some instants or at all times."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]
PALETTE: tuple[Colour, ...] = (
    (57, 106, 177), (218, 124, 48), (62, 150, 81), (204, 37, 41), (107, 76, 154), (148, 139, 61),
    (23, 162, 184), (214, 93, 177),
)  # fmt: skip
"""Colours of the vehicles, in turn"""


def vehicle_colour(vehicle: int) -> Colour:
    """Return the colour of a vehicle."""
    return PALETTE[vehicle % len(PALETTE)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Entry:
    """Data of one entity; ``kind`` is the name of the viewer's archetype, ``fields`` are its components."""

    path: str
    kind: str
    fields: dict[str, Any] = field(default_factory=dict)
    """Values by component: of all instants, one after the other"""
    others: "tuple[Entry, ...]" = ()
    """Of other kinds, with the same path and instants: one message holds all"""
    times_us: NDArray[np.int64] | None = None
    """(T,) simulated times; None: at all times"""
    lengths: NDArray[np.int64] | None = None
    """(T,) number of values of each instant; None: one value each"""


def at_all_times(path: str, kind: str, **fields: Any) -> Entry:  # noqa: ANN401  components of any type
    """Return an entry without a time."""
    return Entry(path=path, kind=kind, fields=fields)
