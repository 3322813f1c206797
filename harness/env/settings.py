"""EnvSettings of an environment, and the layout of its observations and actions. No I/O."""

from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import ArrayLike, NDArray

from foundation.types import Vector

Floats = NDArray[np.float32]
MOST_POS_M = 10_000.0
"""Bound of positions and ranges in observations, which are limited to it."""
MOST_SPEED_M_S = 50.0
MOST_AGE_S = 10.0
"""Age of what has not been received yet, and of everything older."""
OWN = (
    "place_n_m", "place_e_m", "place_d_m", "pos_n_m", "pos_e_m", "pos_d_m", "vel_n_m_s", "vel_e_m_s",
    "vel_d_m_s",
)  # fmt: skip
"""Elements about the UAV itself: its place of the formation from its estimated position, that position in the
site's frame, its estimated velocity."""
NEIGHBOUR = (
    "pos_n_m", "pos_e_m", "pos_d_m", "vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "beacon_age_s", "range_m",
    "range_age_s",
)  # fmt: skip
"""Elements about each other UAV: the position in its last beacon from the own estimated one, the velocity in
the beacon, the beacon's age, the last measured range, its age. The numbers of its message follow."""


class EnvSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What actions mean, and what the radios send."""

    setpoint: Literal["velocity", "acceleration"] = "velocity"
    """Meaning of the first three numbers of an action."""
    speed_max_m_s: Annotated[float, Meta(gt=0.0, le=20.0)] = 3.0
    """Velocity of an action of 1, each axis; NED."""
    acc_max_m_s2: Annotated[float, Meta(gt=0.0, le=20.0)] = 3.0
    """Acceleration of an action of 1, each axis; NED."""
    message_size: Annotated[int, Meta(ge=0, le=256)] = 0
    """Numbers of an action that the UAV's beacons carry to the others."""
    radio: Literal["scheduled", "chosen"] = "scheduled"
    """scheduled: beacons and ranging at their periods. chosen: actions decide."""
    beacon_period_s: Annotated[float, Meta(ge=0.04, le=10.0)] = 0.2
    """Period of a UAV's beacons, rounded to multiples of the loop."""
    range_period_s: Annotated[float, Meta(ge=0.04, le=10.0)] = 0.2
    """Period in which a UAV ranges to one of the others, in turn; rounded as above."""

    def action_names(self) -> tuple[str, ...]:
        """Return the names of an action's elements, each within -1 to 1."""
        kind = "vel" if self.setpoint == "velocity" else "acc"
        messages = tuple(f"message_{i}" for i in range(self.message_size))
        chosen = ("send", "range") if self.radio == "chosen" else ()
        return (f"{kind}_n", f"{kind}_e", f"{kind}_d", *messages, *chosen)

    def observation_names(self, agents: int) -> tuple[str, ...]:
        """Return the names of an observation's elements, in a swarm of so many UAVs.

        ``next_1`` is the UAV with the next number, and so on around to that before the own.
        """
        of_neighbour = (*NEIGHBOUR, *(f"message_{i}" for i in range(self.message_size)))
        return (*OWN, *(f"next_{k}_{name}" for k in range(1, agents) for name in of_neighbour))

    def observation_bounds(self, agents: int) -> tuple[Floats, Floats]:
        """Return the least and the greatest value of each element of an observation."""
        names = self.observation_names(agents)
        low = np.array([-_most(name) if _is_signed(name) else 0.0 for name in names], np.float32)
        return low, np.array([_most(name) for name in names], np.float32)


def limited(observations: NDArray[np.float64], bounds: tuple[Floats, Floats]) -> Floats:
    """Return observations (..., O) within their bounds."""
    return np.clip(np.nan_to_num(observations), *bounds).astype(np.float32)


def checked_action(settings: EnvSettings, name: str, action: ArrayLike) -> NDArray[np.float64]:
    """Return an action (A,) limited to -1 to 1. Raises ValueError for another shape, or NaN."""
    values = np.asarray(action, dtype=np.float64)
    expected = len(settings.action_names())
    if values.shape != (expected,) or np.isnan(values).any():
        given = " ".join(f"{action!r:.200}".split())
        raise ValueError(f"env: action of {name}: {given}; expected {expected} numbers")
    return np.clip(values, -1.0, 1.0)


def _most(name: str) -> float:
    if name.endswith("_age_s"):
        return MOST_AGE_S
    if name.endswith("_m_s"):
        return MOST_SPEED_M_S
    return MOST_POS_M if name.endswith("_m") else 1.0


def _is_signed(name: str) -> bool:
    return not name.endswith(("_age_s", "range_m"))


class Neighbours:
    """What one UAV has received from the others and measured, in order of `EnvSettings.observation_names`."""

    def __init__(self, uav: int, agents: int, message_size: int) -> None:
        others = agents - 1
        self._uav, self._agents = uav, agents
        self._pos_ned_m = np.zeros((others, 3))
        self._vel_ned_m_s = np.zeros((others, 3))
        self._range_m = np.zeros(others)
        self._messages = np.zeros((others, message_size))
        self._beacon_us = np.full(others, -1)
        self._range_us = np.full(others, -1)
        """Times of reception and measurement; negative: never."""

    def _row(self, station: int) -> int:
        return (station - self._uav - 1) % self._agents

    def on_beacon(
        self, station: int, now_us: int, *, pos_ned_m: Vector, vel_ned_m_s: Vector, message: tuple[float, ...]
    ) -> None:
        """Store a beacon that was received at ``now_us``."""
        row = self._row(station)
        self._pos_ned_m[row], self._vel_ned_m_s[row], self._messages[row] = pos_ned_m, vel_ned_m_s, message
        self._beacon_us[row] = now_us

    def on_range(self, station: int, now_us: int, range_m: float) -> None:
        """Store a range that was measured at ``now_us``."""
        row = self._row(station)
        self._range_m[row], self._range_us[row] = range_m, now_us

    def observation(
        self, now_us: int, *, pos_ned_m: Vector, vel_ned_m_s: Vector, place_ned_m: Vector
    ) -> NDArray[np.float64]:
        """Return the observation at ``now_us``, not yet limited to its bounds."""
        pos = np.asarray(pos_ned_m)
        own = np.concatenate((np.asarray(place_ned_m) - pos, pos, vel_ned_m_s))
        if self._agents == 1:
            return own
        known = self._beacon_us[:, None] >= 0
        rows = np.concatenate(
            (
                np.where(known, self._pos_ned_m - pos, 0.0),
                self._vel_ned_m_s,
                _age_s(now_us, self._beacon_us)[:, None],
                self._range_m[:, None],
                _age_s(now_us, self._range_us)[:, None],
                self._messages,
            ),
            axis=1,
        )
        return np.concatenate((own, rows.ravel()))


def _age_s(now_us: int, time_us: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.where(time_us < 0, MOST_AGE_S, np.minimum((now_us - time_us) * 1e-6, MOST_AGE_S))
