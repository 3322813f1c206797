"""The door between the conventions of PyBullet and Gazebo's tables and those of everybody else.

Bullet knows no up and no north: gravity is an argument, so its world is simply given NED axes and its bodies
FRD ones. What is left to convert is the order of its quaternions, which `bullet` does as it reads them, and
body vectors of tables that are written in FLU.
"""

import numpy as np
from numpy.typing import ArrayLike

from foundation.types import Array


def frd_from_flu(vectors_flu: ArrayLike) -> Array:
    """Body vectors (..., 3) in forward-right-down from forward-left-up."""
    return np.asarray(vectors_flu, dtype=np.float64) * (1.0, -1.0, -1.0)
