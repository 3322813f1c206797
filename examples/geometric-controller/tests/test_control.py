"""The law itself: hover, convergence from any attitude, and demands that can always be allocated."""

import math

import numpy as np
import pytest
from geometric_controller.control import (
    TORQUE_MAX,
    GeometricController,
    Settings,
    attitude_error,
    frame,
    rotation,
)

from autopilot.control import ControlParams
from autopilot.control.user_control import unit_torque_m
from coflight import (
    AttitudeSetpoint,
    ControllerContext,
    ControllerInputs,
    EstimatorState,
    RateSetpoint,
    TrajectorySetpoint,
)
from foundation.airframe.files import IRIS

PARAMS = ControlParams()
ZERO = np.zeros(3)
LEVEL = np.array((1.0, 0.0, 0.0, 0.0))
HOVER_THRUST = 0.53


def controller(settings=None):
    context = ControllerContext(instance=0, airframe=IRIS, unit_torque_m=unit_torque_m(PARAMS), params=PARAMS)
    return GeometricController(context, settings or Settings())


def inputs(setpoint, *, yaw_rad=0.0, controls_yaw=True, **state):
    values = {
        "q_ned_frd": LEVEL, "vel_ned_m_s": ZERO, "pos_ned_m": ZERO, "omega_frd_rad_s": ZERO,
        "acc_ned_m_s2": ZERO, "gyro_bias_rad_s": ZERO, "accel_bias_m_s2": ZERO, "pos_std_m": ZERO,
        "vel_std_m_s": ZERO, "attitude_std_rad": ZERO, "origin_lat_deg": 47.0, "origin_lon_deg": 8.0,
        "origin_alt_m": 488.0, "attitude_valid": True, "velocity_valid": True, "position_valid": True,
        "height_valid": True, "reset_counter": 0,
    }  # fmt: skip
    return ControllerInputs(
        state=EstimatorState(**(values | state)), setpoint=setpoint, yaw_rad=yaw_rad, dt_s=0.004,
        landed=False, climb_max_m_s=math.inf, hover_thrust=HOVER_THRUST, disturbance_ned_m_s2=ZERO,
        unallocated=ZERO, controls_yaw=controls_yaw,
    )  # fmt: skip


def random_attitude(rng):
    q = rng.standard_normal(4)
    return q / np.linalg.norm(q)


def test_at_its_place_it_demands_the_hover_thrust_and_no_torque():
    demand = controller().update(inputs(TrajectorySetpoint(pos_ned_m=ZERO, yaw_rad=0.0)))
    assert demand.thrust == pytest.approx(HOVER_THRUST)
    np.testing.assert_allclose(demand.torque, 0.0, atol=1e-12)


def test_the_wind_is_held_off_by_a_tilt_against_it():
    wind = inputs(TrajectorySetpoint(pos_ned_m=ZERO, yaw_rad=0.0))
    wind.disturbance_ned_m_s2 = np.array((2.0, 0.0, 0.0))  # towards the north
    against = controller().update(wind).torque[1]
    assert against > 0.0  # the nose goes up, which accelerates to the south
    wind.disturbance_ned_m_s2 = np.array((-2.0, 0.0, 0.0))
    assert controller().update(wind).torque[1] == pytest.approx(-against)


def test_the_attitude_converges_from_any_attitude_within_a_quarter_turn():
    rng, own = np.random.default_rng(1), controller()
    inertia = np.array(IRIS.inertia_kg_m2)
    unit_nm = np.array(unit_torque_m(PARAMS)) * IRIS.propulsion.range_n
    for _ in range(20):
        desired = random_attitude(rng)
        axis = rng.standard_normal(3)
        angle_rad = rng.uniform(0.1, 0.5 * math.pi)
        attitude = rotation(desired) @ turn(axis / np.linalg.norm(axis) * angle_rad)
        omega = ZERO
        setpoint = AttitudeSetpoint(q_ned_frd=desired, yaw_rate_rad_s=0.0, thrust=0.5)
        for _ in range(1000):
            moment = inputs(setpoint, omega_frd_rad_s=omega)
            moment.state.q_ned_frd[:] = quaternion(attitude)
            torque = np.asarray(own.update(moment).torque) * unit_nm
            omega = omega + 0.004 * (torque - np.cross(omega, inertia * omega)) / inertia
            attitude = attitude @ turn(0.004 * omega)
        assert np.linalg.norm(attitude_error(attitude, rotation(desired))) < 1e-2


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 180.0])
def test_without_control_of_yaw_a_roll_is_corrected_at_any_heading(heading_deg):
    level = AttitudeSetpoint(q_ned_frd=LEVEL, yaw_rate_rad_s=0.0, thrust=0.5)
    rolled = quaternion(turn(np.radians((0.0, 0.0, heading_deg))) @ turn(np.array((0.1, 0.0, 0.0))))
    unit_nm = np.array(unit_torque_m(PARAMS)) * IRIS.propulsion.range_n
    demand = controller().update(inputs(level, controls_yaw=False, q_ned_frd=rolled))
    alpha = np.asarray(demand.torque) * unit_nm / IRIS.inertia_kg_m2
    np.testing.assert_allclose(alpha, (-Settings().attitude_1_s2 * math.sin(0.1), 0.0, 0.0), atol=1e-9)


def turn(vector):
    """Return the rotation matrix (3, 3) of a rotation vector (3,)."""
    angle = np.linalg.norm(vector)
    half = 0.5 * angle
    axis = vector / angle if angle > 0.0 else vector
    return rotation(np.array((math.cos(half), *(math.sin(half) * axis))))


def quaternion(matrix):
    """Return the unit quaternion (4,), wxyz, of a rotation matrix, as the eigenvector of Bar-Itzhack's K."""
    m = matrix
    k = np.array((
        (m[0, 0] - m[1, 1] - m[2, 2], 0.0, 0.0, 0.0),
        (m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0.0, 0.0),
        (m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0.0),
        (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m.trace()),
    ))  # fmt: skip
    _, vectors = np.linalg.eigh(k)  # reads the lower triangle
    x, y, z, w = vectors[:, -1]
    return np.array((w, x, y, z))


def test_the_frame_of_a_force_has_its_direction_and_the_heading():
    attitude = frame(np.array((1.0, 2.0, -9.0)), 0.7)
    np.testing.assert_allclose(attitude.T @ attitude, np.eye(3), atol=1e-12)
    assert np.linalg.det(attitude) == pytest.approx(1.0)
    np.testing.assert_allclose(np.cross(attitude[:, 2], (1.0, 2.0, -9.0)), 0.0, atol=1e-12)
    assert attitude[:, 1] @ (math.cos(0.7), math.sin(0.7), 0.0) == pytest.approx(0.0, abs=1e-12)


def test_every_demand_can_be_allocated():
    rng, own = np.random.default_rng(2), controller()
    for _ in range(500):
        big = 10.0 ** rng.uniform(-1, 3)
        setpoint = [
            TrajectorySetpoint(pos_ned_m=big * rng.standard_normal(3), yaw_rad=float(rng.uniform(-3, 3))),
            TrajectorySetpoint(vel_ned_m_s=big * rng.standard_normal(3), yaw_rate_rad_s=1.0),
            TrajectorySetpoint(acc_ned_m_s2=big * rng.standard_normal(3)),
            AttitudeSetpoint(q_ned_frd=random_attitude(rng), yaw_rate_rad_s=0.5, thrust=float(rng.uniform())),
            RateSetpoint(rate_frd_rad_s=rng.standard_normal(3), thrust=float(rng.uniform())),
        ][rng.integers(5)]
        state = {
            "pos_ned_m": big * rng.standard_normal(3),
            "vel_ned_m_s": big * rng.standard_normal(3),
            "omega_frd_rad_s": 10.0 * rng.standard_normal(3),
            "q_ned_frd": random_attitude(rng),
            "position_valid": bool(rng.integers(2)),
        }
        demand = own.update(inputs(setpoint, **state))
        assert 0.0 <= demand.thrust <= 1.0
        assert np.abs(demand.torque).max() <= TORQUE_MAX
