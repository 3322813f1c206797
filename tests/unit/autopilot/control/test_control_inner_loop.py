"""The three stages in one compiled step are equal to the stages in sequence, to the bit."""

import math

import numpy as np
import pytest

from autopilot.control.allocation import Allocator
from autopilot.control.attitude import AttitudeController
from autopilot.control.block import new_block
from autopilot.control.inner_loop import InnerLoop
from autopilot.control.params import AllocationParams, AttitudeParams, RateParams
from autopilot.control.rates import RateController
from foundation.types import AttitudeSetpoint, RateSetpoint

DT_S = 0.004


def stages():
    return AttitudeController(AttitudeParams()), RateController(RateParams()), Allocator(AllocationParams())


def inner_loop():
    block = new_block()
    AttitudeController(AttitudeParams(), block)
    return InnerLoop(block, RateController(RateParams(), block), Allocator(AllocationParams(), block))


@pytest.mark.parametrize("airmode_above", [math.inf, 0.2])
@pytest.mark.parametrize("by_tilt", [False, True])
@pytest.mark.parametrize("integrate", [False, True])
def test_equals_the_stages_in_sequence(airmode_above, by_tilt, integrate):
    rng = np.random.default_rng(1)
    attitude, rates, allocator = stages()
    inner = inner_loop()
    for _ in range(200):
        q, q_setpoint = rng.normal(size=(2, 4))
        q, q_setpoint = q / np.linalg.norm(q), q_setpoint / np.linalg.norm(q_setpoint)
        omega = rng.normal(size=3)
        setpoint = AttitudeSetpoint(
            q_ned_frd=q_setpoint, yaw_rate_rad_s=float(rng.normal()), thrust=float(rng.uniform())
        )
        controls = inner.update(
            q, omega, setpoint, dt_s=DT_S, by_tilt=by_tilt, integrate=integrate, airmode_above=airmode_above
        )
        rate = attitude.update(q, setpoint)
        torque = rates.update(omega, rate, allocator.unallocated, dt_s=DT_S, integrate=integrate)
        thrust = setpoint.thrust * (max(attitude.tilt_cosine, 0.0) if by_tilt else 1.0)
        expected = allocator.allocate(thrust, torque, airmode=setpoint.thrust > airmode_above)
        np.testing.assert_array_equal(controls, expected)
        np.testing.assert_array_equal(inner.rate_setpoint_frd_rad_s, rate)
        np.testing.assert_array_equal(inner.torque, torque)


@pytest.mark.parametrize("airmode_above", [math.inf, 0.2])
@pytest.mark.parametrize("integrate", [False, True])
def test_rate_setpoints_are_limited_like_those_of_the_attitude(airmode_above, integrate):
    rng = np.random.default_rng(2)
    attitude, rates, allocator = stages()
    inner = inner_loop()
    limit = attitude.rate_max_rad_s
    for _ in range(200):
        omega, demand = rng.normal(size=(2, 3)) * 3.0
        setpoint = RateSetpoint(rate_frd_rad_s=demand, thrust=float(rng.uniform()))
        controls = inner.follow_rates(
            omega, setpoint, dt_s=DT_S, integrate=integrate, airmode_above=airmode_above
        )
        rate = np.clip(demand, -limit, limit)
        torque = rates.update(omega, rate, allocator.unallocated, dt_s=DT_S, integrate=integrate)
        expected = allocator.allocate(setpoint.thrust, torque, airmode=setpoint.thrust > airmode_above)
        np.testing.assert_array_equal(controls, expected)
        np.testing.assert_array_equal(inner.rate_setpoint_frd_rad_s, rate)


def test_a_reset_clears_the_state():
    inner, fresh = inner_loop(), inner_loop()
    level = np.array((1.0, 0.0, 0.0, 0.0))
    setpoint = AttitudeSetpoint(q_ned_frd=level, yaw_rate_rad_s=0.5, thrust=0.5)

    def controls(loop, omega):
        return loop.update(level, omega, setpoint, dt_s=DT_S, by_tilt=True, integrate=True, airmode_above=0.1)

    for _ in range(50):
        controls(inner, np.array((1.0, -0.5, 0.3)))
    inner.reset()
    assert not inner.torque.any()
    np.testing.assert_array_equal(controls(inner, np.zeros(3)), controls(fresh, np.zeros(3)))
