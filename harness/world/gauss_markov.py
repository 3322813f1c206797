"""First-order Gauss-Markov process of slow errors and gusts, computed for many steps at once."""

import numpy as np
from numba import njit

from foundation.types import Array

STEPS_AHEAD = 50
"""Steps whose random numbers are drawn together; they equal those drawn one by one."""


def gauss_markov_path(start: Array, kept: float, step_std: float | Array, fresh: Array) -> Array:
    """Return values (steps, ...) of ``x[k] = kept x[k-1] + step_std fresh[k]`` after ``start`` (...).

    ``fresh`` (steps, ...) are normal draws of unit variance; ``step_std`` is broadcast over the components.
    """
    rows = len(fresh), start.size
    std = np.array(np.broadcast_to(step_std, start.shape)).ravel()  # writable, as `start`
    path: Array = _path(start.ravel(), float(kept), std, np.ascontiguousarray(fresh).reshape(rows))
    return path.reshape(fresh.shape)


@njit(cache=True)
def _path(start: Array, kept: float, step_std: Array, fresh: Array) -> Array:
    """Return `gauss_markov_path` (steps, n) of n components; every other argument but ``kept`` is (n,)."""
    path = np.empty_like(fresh)
    before = start
    for step in range(len(fresh)):
        for i in range(len(start)):
            path[step, i] = kept * before[i] + step_std[i] * fresh[step, i]
        before = path[step]
    return path
