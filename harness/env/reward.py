"""What a reward depends on, the default reward, and the call of the user's. No I/O."""

from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from foundation.extension_failure import ExtensionFailure, failure

END_PENALTY = 100.0
"""Subtracted by `hold_place` for a UAV that ends."""


class EnvState(Struct, frozen=True, kw_only=True):
    """State of all N UAVs after a step, in order of their numbers; arrays are not to be written to.

    Positions and velocities are the simulator's true ones, which no UAV has: a reward may use them, a policy
    must not.
    """

    time_s: float
    """Time since the episode's begin."""
    period_s: float
    """Time of one step."""
    pos_ned_m: NDArray[np.float64]
    """(N, 3) true positions; NED from the site's origin."""
    vel_ned_m_s: NDArray[np.float64]
    """(N, 3) true velocities, NED."""
    places_ned_m: NDArray[np.float64]
    """(N, 3) places of the scenario's formation."""
    actions: NDArray[np.float64]
    """(N, A) actions of this step; NaN for UAVs that had none."""
    observations: NDArray[np.float32]
    """(N, O)"""
    ended: NDArray[np.bool_]
    """(N,) UAVs that ended in this step, by a collision or otherwise."""


Reward = Callable[[EnvState], Any]
"""Returns N numbers, one for each UAV."""


def hold_place(state: EnvState) -> NDArray[np.float64]:
    """Return minus the distance from the own place times the time of a step, m s; the end costs 100."""
    distance_m = np.linalg.norm(state.pos_ned_m - state.places_ned_m, axis=1)
    value: NDArray[np.float64] = -state.period_s * distance_m - END_PENALTY * state.ended
    return value


def rewards(function: Reward, state: EnvState) -> NDArray[np.float64]:
    """Return the rewards (N,) of a function. Raises ExtensionFailure, one line that names it."""
    name = getattr(function, "__qualname__", type(function).__qualname__)
    title = f"reward {getattr(function, '__module__', type(function).__module__)}:{name}"
    try:
        values = np.asarray(function(state), dtype=np.float64)
    except Exception as error:
        raise failure(title, error) from error
    agents = len(state.ended)
    if values.shape != (agents,) or not np.isfinite(values).all():
        text = np.array2string(values, threshold=10).replace("\n", "")
        raise ExtensionFailure(f"{title}: returned {text:.200}; expected {agents} finite numbers")
    return values
