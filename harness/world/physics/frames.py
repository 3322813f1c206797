"""Conversion from the axes of Gazebo's tables to those of coflight.

Bullet's axes are arbitrary because gravity is an argument: its world has NED axes and its bodies FRD axes.
The order of its quaternions is converted in `bullet`; body vectors of Gazebo's tables, in FLU, are converted
here.
"""

import numpy as np
from numpy.typing import ArrayLike

from foundation.types import Array


def frd_from_flu(vectors_flu: ArrayLike) -> Array:
    """Convert body vectors (..., 3) from forward-left-up to forward-right-down."""
    return np.asarray(vectors_flu, dtype=np.float64) * (1.0, -1.0, -1.0)
