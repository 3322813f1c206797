"""Frames of Foxglove: east, north, up (ENU) of the site and forward, left, up (FLU) of a body.

Pure functions on arrays of any leading shape. Positions are permuted and negated only: they keep every bit.
"""

import math

import numpy as np

from foundation.types import Array

_HALF = math.sqrt(0.5)


def enu_of_ned(ned: Array) -> Array:
    """Return vectors (..., 3) in ENU of vectors in NED."""
    enu = np.empty_like(ned)
    enu[..., 0], enu[..., 1] = ned[..., 1], ned[..., 0]
    np.negative(ned[..., 2], out=enu[..., 2])
    return enu


def flu_of_frd(frd: Array) -> Array:
    """Return vectors (..., 3) in FLU of vectors in FRD."""
    flu = np.array(frd)
    np.negative(flu[..., 1:], out=flu[..., 1:])
    return flu


def q_enu_flu_of(q_ned_frd: Array) -> Array:
    """Return rotations (..., 4) from FLU to ENU of rotations from FRD to NED; Hamilton, wxyz.

    It is q_enu_ned q_ned_frd q_frd_flu, with half turns about (1, 1, 0) and (1, 0, 0), multiplied out. Its
    sign is such that level flight to the north gives a positive w.
    """
    w, x, y, z = (q_ned_frd[..., k] for k in range(4))
    return np.stack([w + z, x + y, x - y, w - z], axis=-1) * _HALF
