"""The process behind slow random errors and gusts, worked out for many steps at once."""

import numpy as np
from numba import njit

from foundation.types import Array

STEPS_AHEAD = 50
"""Steps whose randomness is drawn together. A stream's numbers are the same as if drawn one by one."""


@njit(cache=True)
def gauss_markov_path(start: Array, kept: float, step_std: float | Array, fresh: Array) -> Array:
    """Values (steps, ...) of ``x[k] = kept x[k-1] + step_std fresh[k]`` after ``start`` (...).

    ``fresh`` (steps, ...) are normal draws of unit variance; ``step_std`` is broadcast over the components.
    """
    path = np.empty_like(fresh)
    value = start
    for step in range(len(fresh)):
        value = kept * value + step_std * fresh[step]
        path[step] = value
    return path
