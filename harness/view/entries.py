"""What is shown, independent of a viewer: entries, each of an entity at some instants or at all times."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255"""


def colour_of(text: str) -> Colour:
    """Return the colour of a text ``#rrggbb``."""
    red, green, blue = bytes.fromhex(text.removeprefix("#"))
    return red, green, blue


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
