"""A flight as arrays: input of the analysis and of the figures."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.airframe.files import IRIS
from foundation.types import Array


def _nothing() -> None:
    """Release no memory: the arrays are not those of a file."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flight:
    """True and desired states of N vehicles at T instants. Frame: the site's NED.

    Raises ValueError for inconsistent shapes. Values of lost vehicles are ignored.
    """

    time_us: NDArray[np.int64]
    """(T,) strictly increasing."""
    pos_ned_m: Array
    """(T, N, 3)"""
    q_ned_frd: Array
    """(T, N, 4) Hamilton, wxyz; maps FRD into NED."""
    desired_pos_ned_m: Array
    """(T, N, 3); use `numpy.broadcast_to` for a fixed formation."""
    heading_rad: Array
    """(T,) of the desired formation, clockwise from north."""
    alive: NDArray[np.bool_]
    """(T, N)"""
    believed_pos_ned_m: Array | None = None
    """(T, N, 3) positions estimated by the vehicles, NaN if unknown; None if not recorded."""
    standing_height_m: float | tuple[float, ...] = IRIS.standing_height_m
    """Height of the centre of mass of a landed vehicle, of all or (N,)."""
    release: Callable[[], None] = _nothing
    """Returns memory to the system that holds what was read of arrays in a file; they are read again."""

    def __post_init__(self) -> None:
        """Check the shapes."""
        instants, vehicles = self.alive.shape
        expected = {
            "time_us": (instants,),
            "pos_ned_m": (instants, vehicles, 3),
            "q_ned_frd": (instants, vehicles, 4),
            "desired_pos_ned_m": (instants, vehicles, 3),
            "heading_rad": (instants,),
        }
        if self.believed_pos_ned_m is not None:
            expected["believed_pos_ned_m"] = (instants, vehicles, 3)
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} is {getattr(self, name).shape}, and not {shape} as alive says")
        if self.alive.dtype != np.bool_ or np.any(np.diff(self.time_us) <= 0):
            raise ValueError("alive is boolean and time_us rises")

    def __len__(self) -> int:
        return len(self.time_us)

    def at(self, rows: NDArray[np.intp] | slice) -> "Flight":
        """Return the flight at some of its instants: views for a slice, else copies in C order."""
        series = {name: getattr(self, name) for name in _SERIES}
        present = {name: values for name, values in series.items() if values is not None}
        if isinstance(rows, slice):
            return replace(self, **{name: values[rows] for name, values in present.items()})
        copies: dict[str, Any] = {"release": _nothing}
        for name, values in present.items():
            copies[name] = np.ascontiguousarray(values[rows])
            self.release()
        return replace(self, **copies)

    def sampled(self, rate_hz: float) -> "Flight":
        """Return the instants at or next after whole periods of ``rate_hz`` since the first, each once."""
        if len(self) == 0:
            return self
        periods = np.arange(int((self.time_us[-1] - self.time_us[0]) * rate_hz / 1e6) + 1)
        sampled_us = self.time_us[0] + np.round(periods * 1e6 / rate_hz).astype(np.int64)
        rows = np.unique(np.searchsorted(self.time_us, sampled_us))
        return self.at(rows[rows < len(self)])


_SERIES = (
    "time_us",
    "pos_ned_m",
    "q_ned_frd",
    "desired_pos_ned_m",
    "heading_rad",
    "alive",
    "believed_pos_ned_m",
)
"""Fields whose first axis is time."""
