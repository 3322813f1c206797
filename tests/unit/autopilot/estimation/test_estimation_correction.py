"""Field and pressure in one call: to the bit the same as in sequence, accepted or rejected."""

import numpy as np
import pytest

from autopilot.estimation import kernels
from autopilot.estimation.correction import correct
from autopilot.estimation.fusion import Fusion, Jump
from autopilot.estimation.horizon import DelayedHorizon
from autopilot.estimation.params import EstimatorParams
from foundation.geometry.rotations import quat_rotate_inverse

PARAMS = EstimatorParams()
FIELD_NED_GAUSS = np.array(PARAMS.magnetic_field_ned_gauss)
PERIOD_US, STEP_S = 20_000, 4_000 * 1e-6
DELAY_US = 120_000
LEVEL = ((0.0, 0.0, 0.0), (0.0, 0.0, -9.80665))


def aligned():
    x = np.zeros(kernels.STATES)
    x[0] = 1.0
    delayed = DelayedHorizon(x, 0.01 * np.eye(kernels.ERRORS), time_us=0, delay_us=DELAY_US)
    return delayed, Fusion(PARAMS, delayed, ground_altitude_m=488.0, origin=None)


def one_after_the_other(delayed, fusion, time_us, field, altitude_m):
    mag_taken, baro_taken = fusion.fuse_mag(time_us, field), fusion.fuse_baro(time_us, altitude_m)
    if mag_taken or baro_taken:
        delayed.corrected()


def apart(delayed, fusion, time_us, field, altitude_m):
    fusion.advance(time_us, STEP_S, *LEVEL, None)
    one_after_the_other(delayed, fusion, time_us - DELAY_US, field, altitude_m)


def at_once(delayed, fusion, time_us, field, altitude_m):
    measured_us = time_us - DELAY_US
    fusion.advance(time_us, STEP_S, *LEVEL, (measured_us, field.tolist(), altitude_m))
    if fusion.done is None:
        one_after_the_other(delayed, fusion, measured_us, field, altitude_m)
    elif fusion.jumps:
        delayed.corrected()
    else:
        sound, tilt_var_rad2 = fusion.done
        assert sound == kernels.is_sound(delayed.x, delayed.cov)
        assert tilt_var_rad2 == max(delayed.cov[0, 0], delayed.cov[1, 1])
    return fusion.done is not None


def known(delayed, fusion):
    records = [
        (aiding.innovation.tobytes(), aiding.innovation_var.tobytes(), aiding.test_ratio, aiding.refused,
         aiding.measured_us, aiding.accepted_us)
        for aiding in (fusion.heading, fusion.height)
    ]  # fmt: skip
    return delayed.block.tobytes(), records, fusion.jumps, fusion.compass.disturbed, fusion.compass.faulty


@pytest.mark.parametrize("seed", [1, 2])
def test_one_call_is_equal_to_the_sequence(seed):
    """Includes fields that differ from the site's, rejected headings and heights, and resets to them."""
    rng = np.random.default_rng(seed)
    one, other = aligned(), aligned()
    jumps, taken_at_once = Jump.NONE, 0
    for k in range(1, 1_500):
        time_us = k * PERIOD_US
        turned_rad = 2.0 if 300 < k < 800 else 0.0
        q = np.array((np.cos(0.5 * turned_rad), 0.0, 0.0, np.sin(0.5 * turned_rad)))
        field = quat_rotate_inverse(q, FIELD_NED_GAUSS) + 0.005 * rng.standard_normal(3)
        if 100 < k < 130:
            field *= 3.0
        altitude_m = 488.0 + 0.3 * rng.standard_normal() + (80.0 if k > 900 else 0.0)
        for (delayed, fusion), fuse in ((one, apart), (other, at_once)):
            fusion.jumps = Jump.NONE
            for back in range(4, 0, -1):
                fusion.advance(time_us - 4_000 * back, STEP_S, *LEVEL, None)
            taken_at_once += bool(fuse(delayed, fusion, time_us, field, altitude_m))
        assert known(*one) == known(*other), k
        jumps |= other[1].jumps
    assert taken_at_once > 1_000
    assert jumps == Jump.YAW | Jump.HEIGHT
    assert other[1].heading.refused > 300
    assert other[1].height.refused > 100


def test_the_interpreter_and_the_compiler_give_the_same_bits():
    rng = np.random.default_rng(3)
    for believed in (True, False):
        delayed, fusion = aligned()
        for k in range(40):
            gyro, accel = rng.normal(0.0, 0.3, 3), rng.normal(0.0, 1.0, 3) - (0.0, 0.0, 9.8)
            fusion.advance(4_000 * (k + 1), STEP_S, gyro, accel, None)
        step = fusion._step
        step["field_frd_gauss"] = FIELD_NED_GAUSS + 0.02 * rng.standard_normal(3)
        step["down_m"], step["believed"] = -0.2, believed
        memories = []
        for kernel in (correct, getattr(correct, "py_func", correct)):
            block, given = delayed.block.copy(), step.copy()
            kernel(block, delayed.samples, given)
            memories.append(block.tobytes() + given.tobytes())
        assert memories[0] == memories[1]
