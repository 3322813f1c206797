"""Attitude and rate control as properties: errors shrink, limits hold, integrators stop at saturation."""

import math

import numpy as np
import pytest
from control_stages import AttitudeStage, RateStage

from autopilot.control.params import AttitudeParams, RateParams
from foundation.geometry.rotations import (
    quat_conjugate,
    quat_from_euler,
    quat_from_rotation_vector,
    quat_multiply,
    quat_rotate,
)
from foundation.types import AttitudeSetpoint

DT_S = 0.004


def setpoint(q, yaw_rate_rad_s=0.0):
    return AttitudeSetpoint(q_ned_frd=q, yaw_rate_rad_s=yaw_rate_rad_s, thrust=0.5)


def angle_rad(a, b):
    return 2.0 * math.acos(min(abs(float(a @ b)), 1.0))


def tilt_error_rad(a, b):
    down = np.array((0.0, 0.0, 1.0))
    return math.acos(np.clip(quat_rotate(a, down) @ quat_rotate(b, down), -1.0, 1.0))


def turned(q, rate_rad_s):
    """Return the attitude after one step at these rates, FRD."""
    product = quat_multiply(q, quat_from_rotation_vector(DT_S * rate_rad_s))
    return product / np.linalg.norm(product)


def attitudes():
    """All rotations with components from {-1, 0, 1}, including half turns, and some random ones."""
    rng = np.random.default_rng(5)
    grid = [np.array(c, dtype=float) for c in np.ndindex(3, 3, 3, 3)]
    some = [c - 1.0 for c in grid if np.any(c != 1.0)][::5]
    return [c / np.linalg.norm(c) for c in some + list(rng.standard_normal((8, 4)))]


@pytest.mark.parametrize("yaw_weight", [0.0, 0.4, 1.0])
def test_tilt_error_never_grows_from_any_attitude_to_any_other(yaw_weight):
    params = AttitudeParams(yaw_weight=yaw_weight, roll_rate_max_rad_s=100.0, pitch_rate_max_rad_s=100.0)
    for q_start in attitudes():
        for q_target in attitudes()[::3]:
            controller = AttitudeStage(params)
            q = q_start
            tilt = tilt_error_rad(q, q_target)
            for _ in range(250):
                q = turned(q, controller.update(q, setpoint(q_target)))
                now = tilt_error_rad(q, q_target)
                assert now <= tilt + 1e-7
                tilt = now
            if yaw_weight > 0.0:
                assert tilt < math.radians(2.0)


def test_whole_error_vanishes_with_yaw():
    controller = AttitudeStage(AttitudeParams())
    rng = np.random.default_rng(1)
    for _ in range(10):
        q, q_target = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 4)))
        for _ in range(2000):
            q = turned(q, controller.update(q, setpoint(q_target)))
        assert angle_rad(q, q_target) < 1e-3


def test_antipodal_quaternions_are_one_attitude():
    controller = AttitudeStage(AttitudeParams())
    for q in attitudes():
        for q_target in attitudes()[::7]:
            rate = controller.update(q, setpoint(q_target))
            if angle_rad(q, q_target) < math.pi - 1e-6:  # at half a turn both directions are equally short
                np.testing.assert_allclose(controller.update(-q, setpoint(q_target)), rate, atol=1e-9)
                np.testing.assert_allclose(controller.update(q, setpoint(-q_target)), rate, atol=1e-9)


def test_gains_about_each_axis():
    """Small errors: rate = gain x angle, also for yaw, whose error is weighted."""
    controller = AttitudeStage(AttitudeParams(roll_p=6.0, pitch_p=5.0, yaw_p=2.0, yaw_weight=0.4))
    level = np.array((1.0, 0.0, 0.0, 0.0))
    for axis, gain in enumerate((6.0, 5.0, 2.0)):
        rotation = np.zeros(3)
        rotation[axis] = 1e-3
        rate = controller.update(level, setpoint(quat_from_rotation_vector(rotation)))
        expected = np.zeros(3)
        expected[axis] = gain * 1e-3
        np.testing.assert_allclose(rate, expected, atol=1e-8)


def test_yaw_rate_is_about_the_vertical():
    q = quat_from_euler(0.3, -0.4, 1.0)
    rate = AttitudeStage(AttitudeParams()).update(q, setpoint(q, yaw_rate_rad_s=0.5))
    np.testing.assert_allclose(quat_rotate(q, rate), (0.0, 0.0, 0.5), atol=1e-12)


def test_rate_limits_and_thrust_axis_cosine():
    params = AttitudeParams(roll_rate_max_rad_s=1.0, pitch_rate_max_rad_s=2.0, yaw_rate_max_rad_s=0.5)
    controller = AttitudeStage(params)
    for q in attitudes():
        for q_target in attitudes():
            rate = controller.update(q, setpoint(q_target, yaw_rate_rad_s=3.0))
            assert np.all(np.abs(rate) <= (1.0, 2.0, 0.5))
            cosine = math.cos(tilt_error_rad(q, q_target))
            assert controller.record.tilt_cosine == pytest.approx(cosine, abs=1e-9)


def rate_update(controller, rate=0.0, demand=0.0, unallocated=0.0, *, integrate=True):
    full = [np.full(3, v) for v in (rate, demand, unallocated)]
    return controller.update(*full, dt_s=DT_S, integrate=integrate)


def test_rate_terms():
    params = RateParams(roll_k=2.0, roll_p=0.1, roll_i=0.0, roll_d=0.0, roll_ff=0.05)
    torque = rate_update(RateStage(params), rate=1.0, demand=3.0)
    assert torque[0] == pytest.approx(2.0 * 0.1 * (3.0 - 1.0) + 0.05 * 3.0)


def test_derivative_opposes_acceleration_and_is_filtered():
    controller = RateStage(
        RateParams(roll_k=1.0, roll_p=0.0, roll_i=0.0, roll_d=0.01, derivative_cutoff_hz=30.0)
    )
    rate_update(controller, rate=0.0)
    alpha = DT_S / (DT_S + 1.0 / (2.0 * math.pi * 30.0))
    assert rate_update(controller, rate=0.1)[0] == pytest.approx(-0.01 * alpha * 0.1 / DT_S)
    for k in range(2, 200):  # a steady acceleration of 25 rad/s^2 passes unchanged
        torque = rate_update(controller, rate=0.1 * k)
    assert torque[0] == pytest.approx(-0.01 * 0.1 / DT_S, rel=1e-6)


def test_first_sample_causes_no_derivative():
    controller = RateStage(RateParams(roll_p=0.0, roll_i=0.0))
    assert rate_update(controller, rate=2.0)[0] == 0.0


def test_integral_stops_at_its_limit_and_on_saturation_but_unwinds():
    controller = RateStage(RateParams(roll_k=1.0, roll_i=0.2, integral_max=0.05))
    rate_update(controller, demand=1.0)
    fade = 1.0 - (1.0 / math.radians(400.0)) ** 2
    assert controller.integral[0] == pytest.approx(0.2 * fade * DT_S)
    for _ in range(1000):
        rate_update(controller, demand=1.0)
    assert controller.integral[0] == 0.05
    rate_update(controller, demand=-1.0, unallocated=0.1)  # saturated in that direction, less is possible
    assert controller.integral[0] < 0.05
    held = controller.integral[0]
    rate_update(controller, demand=1.0, unallocated=0.1)
    rate_update(controller, demand=1.0, integrate=False)
    assert controller.integral[0] == held


def test_reset_clears_the_rate_controller():
    controller = RateStage(RateParams())
    for _ in range(10):
        rate_update(controller, demand=1.0)
    controller.reset()
    assert not controller.integral.any()


def test_quaternion_helpers_agree_with_this_file():
    q = quat_from_euler(0.1, 0.2, 0.3)
    assert angle_rad(quat_multiply(q, quat_conjugate(q)), np.array((1.0, 0.0, 0.0, 0.0))) < 1e-7
