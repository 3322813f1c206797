"""What is fused most often, a magnetic field and a pressure of one moment, in one compiled call.

The two come 25 times a second and are most of a filter's time beside its inertial samples: one call over
the filter's own block of memory instead of four, each with a dozen arrays to be looked into. What follows
from a refusal is `fusion`'s.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.estimation.horizon import Block, predict_now
from autopilot.estimation.kernels import POS, fuse_direct, fuse_field, is_sound
from autopilot.types import Array

LIMITS = np.dtype(
    [
        ("field_ned_gauss", "f8", 3),  # of the site
        ("field_off_max", "f8", 2),  # see `kernels.field_disturbed`
        ("heading_var_rad2", "f8"),
        ("heading_gate", "f8"),
        ("height_var_m2", "f8", (1,)),
        ("height_gate", "f8"),
        ("bias_limits", "f8", 2),
    ],
    align=True,
)
"""Noises, gates and limits."""


class Corrected(NamedTuple):
    """What became of the two, and of the filter."""

    heading_innovation_rad: float
    heading_var_rad2: float
    heading_ratio: float
    disturbed: bool
    """The field is not the site's."""
    height_innovation_m: float
    height_var_m2: float
    height_ratio: float
    sound: bool
    """As of `kernels.is_sound`, afterwards."""
    tilt_var_rad2: float
    """The larger one."""


@njit(cache=True)
def correct(
    block: Block, samples: Block, limits: NDArray[np.void], field_frd_gauss: Array, down_m: float,
    believed: bool,  # noqa: FBT001 - kernels take positions
) -> tuple[float, float, float, bool, float, float, float, bool, float]:  # fmt: skip
    """Fuse the heading of a magnetic field (3,), if ``believed``, then a height, and carry that to now.

    ``block`` and ``samples`` are as of `horizon.advance`, ``limits`` (1,) of `LIMITS`; returns the fields of
    `Corrected`.
    """
    here, by = block[0], limits[0]
    x, cov, bias_limits = here["x"], here["cov"], by["bias_limits"]
    turn_rad, turn_var, heading_ratio, disturbed = fuse_field(
        x, cov, field_frd_gauss, by["field_ned_gauss"], by["field_off_max"], by["heading_var_rad2"],
        by["heading_gate"], bias_limits, believed,
    )  # fmt: skip
    measured, rise_m, rise_var = np.empty(1), np.empty(1), np.empty(1)
    measured[0] = down_m
    height_ratio = fuse_direct(
        x, cov, POS + 2, measured, by["height_var_m2"], by["height_gate"], bias_limits, rise_m, rise_var
    )
    if height_ratio < 1.0 or (heading_ratio < 1.0 and believed and not disturbed):
        predict_now(block, samples)
    tilt_var = max(cov[0, 0], cov[1, 1])
    return (
        turn_rad, turn_var, heading_ratio, disturbed, rise_m[0], rise_var[0], height_ratio,
        is_sound(x, cov), tilt_var,
    )  # fmt: skip
