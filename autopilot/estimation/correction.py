"""The most frequent update, an inertial sample with magnetic field and pressure, in one compiled call.

Field and pressure are measured 25 times a second and fused when the horizon reaches their time, in the step
of another inertial sample. The call works on three blocks of memory: it allocates nothing and few arrays have
to be unboxed. `fusion` handles rejected measurements.
"""

from struct import Struct

import numpy as np
from numba import njit

from autopilot.estimation.horizon import NOT_FINITE, Horizon, advance, predict_now
from autopilot.estimation.kernels import POS, fuse_direct, fuse_field, is_sound
from foundation.kernels.records import Records

STEP = np.dtype(
    [
        # the inertial sample
        ("time_us", "i8"),
        ("dt_s", "f8"),
        ("gyro_frd_rad_s", "f8", 3),
        ("accel_frd_m_s2", "f8", 3),
        # field and pressure of the same time, fused if the horizon reaches it
        ("pair_us", "i8"),
        ("believed", "i8"),  # whether the compass is used
        ("field_frd_gauss", "f8", 3),
        ("down_m", "f8", 1),
        # results
        ("heading_ratio", "f8"),
        ("height_ratio", "f8"),
        ("tilt_var_rad2", "f8"),  # the greater of the two axes
        ("disturbed", "i8"),  # the field differs from the site's
        ("sound", "i8"),  # result of `kernels.is_sound`
        ("heading_innovation_rad", "f8", 1),
        ("heading_var_rad2", "f8", 1),
        ("height_innovation_m", "f8", 1),
        ("height_var_m2", "f8", 1),
        # noises, gates and limits
        ("field_ned_gauss", "f8", 3),  # of the site
        ("field_off_max", "f8", 2),  # see `kernels.field_disturbed`
        ("heading_noise_var_rad2", "f8"),
        ("heading_gate", "f8"),
        ("height_noise_var_m2", "f8", 1),
        ("height_gate", "f8"),
        ("bias_limits", "f8", 2),
    ],
    align=True,
)
MEASURED = Struct("=q7dqq4d")
"""Sample and pair, packed at once because single writes to a row of an array are slow."""
CORRECTED = Struct("=3dqq")
"""The first five of the results."""
CORRECTED_AT = MEASURED.size


@njit(cache=True)
def correct(block: Records, samples: Records, step: Records) -> None:
    """Fuse heading and height of the pair, the heading if the compass is used; update the present estimate.

    ``block`` and ``samples`` are those of `horizon.advance`, ``step`` is (1,) of `STEP`.
    """
    here: Horizon = block[0]
    at = step[0]
    x, cov, bias_limits = here.x[:], here.cov[:], at["bias_limits"][:]
    compass_used = at["believed"] != 0
    turn_rad, turn_var, heading_ratio, disturbed = fuse_field(
        x, cov, at["field_frd_gauss"][:], at["field_ned_gauss"][:], at["field_off_max"][:],
        at["heading_noise_var_rad2"], at["heading_gate"], bias_limits, compass_used,
    )  # fmt: skip
    height_ratio = fuse_direct(
        x, cov, POS + 2, at["down_m"][:], at["height_noise_var_m2"][:], at["height_gate"], bias_limits,
        at["height_innovation_m"][:], at["height_var_m2"][:],
    )  # fmt: skip
    if height_ratio < 1.0 or (heading_ratio < 1.0 and compass_used and not disturbed):
        predict_now(block, samples)
    at["heading_innovation_rad"][0], at["heading_var_rad2"][0] = turn_rad, turn_var
    at["heading_ratio"], at["height_ratio"] = heading_ratio, height_ratio
    at["disturbed"], at["sound"] = disturbed, is_sound(x, cov)
    at["tilt_var_rad2"] = max(cov[0, 0], cov[1, 1])


@njit(cache=True)
def advance_and_correct(block: Records, samples: Records, step: Records) -> int:
    """Return the result of `horizon.advance` for the sample; call `correct` if the pair is due."""
    at = step[0]
    horizon_us = advance(
        block, samples, at["time_us"], at["dt_s"], at["gyro_frd_rad_s"][:], at["accel_frd_m_s2"][:]
    )
    if horizon_us != NOT_FINITE and horizon_us >= at["pair_us"]:
        correct(block, samples, step)
    return horizon_us
