"""First-order Gauss-Markov process of slow errors and gusts, computed for many steps at once."""

import numpy as np
from numba import njit

from foundation.types import Array

STEPS_AHEAD = 50
"""Steps whose random numbers are drawn together; they equal those drawn one by one."""


@njit(cache=True)
def gauss_markov_path(start: Array, kept: float, step_std: float | Array, fresh: Array) -> Array:
    """Return values (steps, ...) of ``x[k] = kept x[k-1] + step_std fresh[k]`` after ``start`` (...).

    ``fresh`` (steps, ...) are normal draws of unit variance; ``step_std`` is broadcast over the components.
    """
    path = np.empty_like(fresh)
    value = start
    for step in range(len(fresh)):
        value = kept * value + step_std * fresh[step]
        path[step] = value
    return path
