"""The rotor kernels compared with values and signs from the Iris's parameters."""

import math

import numpy as np
import pytest
from airframe_changes import changed

from foundation.airframe.files import IRIS
from foundation.geometry.rotations import quat_rotate, quat_rotate_inverse
from harness.world.physics.bodies import BODY
from harness.world.physics.environment import Surroundings
from harness.world.physics.rotors import kernel_model, rotor_speeds, wrenches

STEP_S = 0.004
MODEL = kernel_model([IRIS], step_s=STEP_S)
THREE = kernel_model([IRIS] * 3, step_s=STEP_S)
LEVEL = np.array([[1.0, 0.0, 0.0, 0.0]])
STILL = np.zeros((1, 3))
WEIGHT_N = 1.55 * 9.8066
HOVER_RAD_S = math.sqrt(WEIGHT_N / 4.0 / 5.84e-6)


def calm(vehicles=1):
    """Return surroundings: calm air with sea level's density, far above the ground, whole rotors."""
    return Surroundings(np.zeros((vehicles, 3)), np.ones(vehicles), np.ones((vehicles, 4)))


def bodies(q_ned_frd, vel_ned_m_s, omega_ned_rad_s, height_m=100.0):
    """Return rows (n,) of `BODY` at these heights."""
    rows = np.zeros(len(q_ned_frd), BODY)
    rows["q_ned_frd"], rows["vel_ned_m_s"], rows["omega_ned_rad_s"] = q_ned_frd, vel_ned_m_s, omega_ned_rad_s
    rows["pos_ned_m"][:, 2] = -height_m
    return rows


def level_wrench(rotor_speed_rad_s, vel_frd_m_s=(0.0, 0.0, 0.0), omega_frd_rad_s=(0.0, 0.0, 0.0)):
    """Return force and torque on a level vehicle heading north, for which NED equals FRD."""
    speeds = np.broadcast_to(np.asarray(rotor_speed_rad_s, dtype=float), (1, 4)).copy()
    force, torque = wrenches(
        MODEL, bodies(LEVEL, np.array([vel_frd_m_s]), np.array([omega_frd_rad_s])), speeds, calm()
    )
    return force[0], torque[0]


def run_motors(speed_rad_s, control, steps, *, powered=True):
    speed = np.full((1, 4), float(speed_rad_s))
    for _ in range(steps):
        speed = rotor_speeds(
            MODEL, speed, np.full((1, 4), control), np.array([powered]), np.zeros((1, 4), bool)
        )
    return speed[0]


def test_hover_speed_and_control_are_those_of_the_parameters():
    assert pytest.approx(806.7, abs=0.05) == HOVER_RAD_S
    force, torque = level_wrench(HOVER_RAD_S)
    np.testing.assert_allclose(force, (0.0, 0.0, -WEIGHT_N), atol=1e-12)
    np.testing.assert_allclose(torque, 0.0, atol=1e-12)
    assert run_motors(0.0, 0.707, 200)[0] == pytest.approx(HOVER_RAD_S, abs=0.4)


def test_full_thrust_is_1_86_weights():
    full_rad_s = run_motors(0.0, 1.0, 300)
    np.testing.assert_allclose(full_rad_s, 1100.0, rtol=1e-12)
    force, _ = level_wrench(full_rad_s)
    assert -force[2] / WEIGHT_N == pytest.approx(1.86, abs=0.005)


@pytest.mark.parametrize(
    ("start_rad_s", "control", "time_constant_s"), [(100.0, 0.9, 0.0125), (1000.0, 0.0, 0.025)]
)
def test_motors_lag_by_their_own_time_constant_up_and_down(start_rad_s, control, time_constant_s):
    target_rad_s = 100.0 + 1000.0 * control
    for steps in (1, 3, 10):
        left = math.exp(-steps * STEP_S / time_constant_s)
        expected_rad_s = target_rad_s + left * (start_rad_s - target_rad_s)
        np.testing.assert_allclose(run_motors(start_rad_s, control, steps), expected_rad_s, rtol=1e-12)


def test_unpowered_rotors_run_down_regardless_of_the_controls():
    np.testing.assert_allclose(
        run_motors(800.0, 1.0, 5, powered=False), 800.0 * math.exp(-5 * STEP_S / 0.025), rtol=1e-12
    )


@pytest.mark.parametrize(("control", "meant"), [(-3.0, 0.0), (7.0, 1.0), (math.nan, 0.0), (math.inf, 1.0)])
def test_controls_outside_their_range_are_limited(control, meant):
    np.testing.assert_array_equal(run_motors(300.0, control, 1), run_motors(300.0, meant, 1))


@pytest.mark.parametrize(
    ("faster", "axis", "sign"),
    [
        ((0, 1), 2, +1),  # counter-clockwise rotors: their reaction turns the body clockwise, yaw grows
        ((2, 3), 2, -1),
        ((0, 3), 0, -1),  # right side lifts: roll to the left
        ((1, 2), 0, +1),
        ((0, 2), 1, +1),  # front lifts: nose up
        ((1, 3), 1, -1),
    ],
)
def test_faster_rotors_rotate_the_body_in_the_right_direction(faster, axis, sign):
    speeds = np.full(4, HOVER_RAD_S)
    speeds[list(faster)] += 50.0
    _, torque = level_wrench(speeds)
    assert sign * torque[axis] > 0.0
    # per pair: 2 k (w1^2 - w0^2) times the arm: 0.06 m about z, (0.22 + 0.20)/2 m about x, 0.13 m about y
    arm_m = (0.21, 0.13, 0.06)[axis]
    extra_n = 2.0 * 5.84e-6 * ((HOVER_RAD_S + 50.0) ** 2 - HOVER_RAD_S**2)
    assert abs(torque[axis]) == pytest.approx(extra_n * arm_m, rel=1e-9)


@pytest.mark.parametrize("axis", [0, 1])
def test_drag_at_hover_is_0_565_newton_per_metre_per_second(axis):
    vel = np.zeros(3)
    vel[axis] = 2.0
    force, torque = level_wrench(HOVER_RAD_S, vel)
    assert force[axis] == pytest.approx(-0.565 * 2.0, rel=1e-3)
    assert force[1 - axis] == 0.0
    # drag acts in the plane of the hubs, 23 mm above the centre of mass: moving north lifts the nose
    assert torque[1 - axis] == pytest.approx((1, -1)[axis] * 0.565 * 2.0 * 0.023, rel=1e-3)


@pytest.mark.parametrize(
    ("climb_m_s", "part"),
    [(0.0, 1.0), (12.5, 0.5), (25.0, 0.0), (40.0, 0.0), (-2.5, 1.1), (-5.0, 1.2), (-10.0, 1.2)],
)
def test_thrust_falls_off_linearly_in_a_climb_and_rises_as_much_in_a_slow_descent(climb_m_s, part):
    force, _ = level_wrench(HOVER_RAD_S, (0.0, 0.0, -climb_m_s))
    assert -force[2] == pytest.approx(part * WEIGHT_N, abs=1e-12)


def test_yaw_torque_does_not_fall_off_in_a_climb():
    _, torque = level_wrench((900.0, 900.0, 700.0, 700.0), (0.0, 0.0, -30.0))
    assert torque[2] == pytest.approx(0.06 * 5.84e-6 * 2.0 * (900.0**2 - 700.0**2), rel=1e-12)


def test_rolling_moment_opposes_forward_flight_on_a_counter_clockwise_rotor_only():
    """A lone rotor 0 (counter-clockwise) flying north; without the hub force the rolling moment remains."""
    force, torque = level_wrench((500.0, 0.0, 0.0, 0.0), (3.0, 0.0, 0.0))
    hub_frd_m = np.array((0.13, 0.22, -0.023))
    np.testing.assert_allclose(
        torque - np.cross(hub_frd_m, force), (-500.0 * 1e-6 * 3.0, 0.0, 0.06 * 5.84e-6 * 500.0**2)
    )
    _, balanced = level_wrench(500.0, (0.0, 3.0, 0.0))
    assert balanced[1] == pytest.approx(0.0, abs=1e-15)


def test_drag_uses_the_speed_of_each_hub():
    """A pure yaw rate moves each hub sideways at r times the rate: in-plane drag opposes it."""
    _, torque = level_wrench(HOVER_RAD_S, omega_frd_rad_s=(0.0, 0.0, 2.0))
    arms_squared_m2 = 2.0 * (0.13**2 + 0.22**2) + 2.0 * (0.13**2 + 0.20**2)
    assert torque[2] == pytest.approx(-1.75e-4 * HOVER_RAD_S * arms_squared_m2 * 2.0, rel=1e-9)


def test_the_wrench_rotates_with_the_vehicle():
    """Equal body-frame inputs give equal body-frame wrenches at any attitude; rows are independent."""
    rng = np.random.default_rng(1)
    vehicles = 20
    q = rng.standard_normal((vehicles, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    vel_frd, omega_frd, speeds = (3.0, -1.0, 0.5), (0.3, 2.0, -1.0), (700.0, 800.0, 900.0, 650.0)
    vel_ned = np.array([quat_rotate(row, np.array(vel_frd)) for row in q])
    omega_ned = np.array([quat_rotate(row, np.array(omega_frd)) for row in q])
    force, torque = wrenches(
        kernel_model([IRIS] * vehicles, step_s=STEP_S),
        bodies(q, vel_ned, omega_ned),
        np.tile(speeds, (vehicles, 1)),
        calm(vehicles),
    )
    expected_force, expected_torque = level_wrench(speeds, vel_frd, omega_frd)
    for row in range(vehicles):
        np.testing.assert_allclose(quat_rotate_inverse(q[row], force[row]), expected_force, atol=1e-12)
        np.testing.assert_allclose(quat_rotate_inverse(q[row], torque[row]), expected_torque, atol=1e-12)


def test_compiled_and_interpreted_kernels_agree():
    rng = np.random.default_rng(2)
    q = rng.standard_normal((3, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    vel, omega = rng.standard_normal((2, 3, 3))
    speeds = rng.uniform(0.0, 1100.0, (3, 4))
    controls, stopped = rng.uniform(-0.5, 1.5, (3, 4)), rng.random((3, 4)) < 0.5
    armed = np.array((True, False, True))
    near_ground = bodies(q, vel, omega, height_m=rng.uniform(0.0, 1.0, 3))
    around = Surroundings(rng.standard_normal((3, 3)), rng.uniform(0.7, 1.0, 3), rng.random((3, 4)))
    model = kernel_model([changed(body={"drag_n_s_m": 0.2})] * 3, step_s=STEP_S, ground_effect=True)
    interpreted = getattr(wrenches, "py_func", wrenches)
    np.testing.assert_allclose(
        wrenches(model, near_ground, speeds, around),
        interpreted(model, near_ground, speeds, around),
        rtol=1e-12,
        atol=1e-12,
    )
    interpreted = getattr(rotor_speeds, "py_func", rotor_speeds)
    np.testing.assert_allclose(
        rotor_speeds(THREE, speeds, controls, armed, stopped),
        interpreted(THREE, speeds, controls, armed, stopped),
        rtol=1e-12,
    )
