"""The three stages in one compiled step are equal to the stages in sequence, to the bit."""

import math

import numpy as np
import pytest
from control_stages import AttitudeStage, RateStage

from autopilot.control import ControlParams, FlightController
from autopilot.control.allocation import Allocator
from autopilot.control.inner_loop import follow_attitude, follow_rates
from autopilot.control.params import AllocationParams, AttitudeParams, RateParams
from autopilot.control.state import CascadeState
from foundation.types import AttitudeSetpoint

DT_S = 0.004


def stages():
    return AttitudeStage(AttitudeParams()), RateStage(RateParams()), Allocator(AllocationParams())


def cascade():
    """Return (1,) of `CascadeState` with the default settings."""
    return FlightController(ControlParams()).block


@pytest.mark.parametrize("airmode_above", [math.inf, 0.2])
@pytest.mark.parametrize("by_tilt", [False, True])
@pytest.mark.parametrize("integrate", [False, True])
def test_equals_the_stages_in_sequence(airmode_above, by_tilt, integrate):
    rng = np.random.default_rng(1)
    attitude, rates, allocator = stages()
    block = cascade()
    rates.start(np.zeros(3))
    inner: CascadeState = block[0]
    inner.by_tilt = by_tilt
    for _ in range(200):
        q, q_setpoint = rng.normal(size=(2, 4))
        q, q_setpoint = q / np.linalg.norm(q), q_setpoint / np.linalg.norm(q_setpoint)
        omega = rng.normal(size=3)
        yaw_rate_rad_s, thrust = float(rng.normal()), float(rng.uniform())
        follow_attitude(block, q, omega, q_setpoint, yaw_rate_rad_s, thrust, DT_S, integrate, airmode_above)
        setpoint = AttitudeSetpoint(q_ned_frd=q_setpoint, yaw_rate_rad_s=yaw_rate_rad_s, thrust=thrust)
        rate = attitude.update(q, setpoint)
        torque = rates.update(omega, rate, allocator.record.unallocated, dt_s=DT_S, integrate=integrate)
        applied = thrust * (max(attitude.record.tilt_cosine, 0.0) if by_tilt else 1.0)
        expected = allocator.allocate(applied, torque, airmode=thrust > airmode_above)
        np.testing.assert_array_equal(inner.allocation.controls[: len(expected)], expected)
        np.testing.assert_array_equal(inner.rate_setpoint_frd_rad_s, rate)
        np.testing.assert_array_equal(inner.torque, torque)


@pytest.mark.parametrize("airmode_above", [math.inf, 0.2])
@pytest.mark.parametrize("integrate", [False, True])
def test_rate_setpoints_are_limited_like_those_of_the_attitude(airmode_above, integrate):
    rng = np.random.default_rng(2)
    attitude, rates, allocator = stages()
    block = cascade()
    rates.start(np.zeros(3))
    inner: CascadeState = block[0]
    limit = attitude.record.rate_max_rad_s
    for _ in range(200):
        omega, demand = rng.normal(size=(2, 3)) * 3.0
        thrust = float(rng.uniform())
        follow_rates(block, omega, demand, thrust, DT_S, integrate, airmode_above)
        rate = np.clip(demand, -limit, limit)
        torque = rates.update(omega, rate, allocator.record.unallocated, dt_s=DT_S, integrate=integrate)
        expected = allocator.allocate(thrust, torque, airmode=thrust > airmode_above)
        np.testing.assert_array_equal(inner.allocation.controls[: len(expected)], expected)
        np.testing.assert_array_equal(inner.rate_setpoint_frd_rad_s, rate)
