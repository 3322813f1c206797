"""The rotor kernels for any airframe: hover, tilted rotors, vehicles of different airframes side by side."""

import numpy as np
import pytest
from airframe_changes import changed
from msgspec import structs

from foundation.airframe.description import GRAVITY_M_S2
from foundation.airframe.files import IRIS, load, names
from foundation.geometry.rotations import quat_from_rotation_vector, quat_rotate
from harness.world.physics.bodies import BODY
from harness.world.physics.environment import Surroundings
from harness.world.physics.rotors import kernel_model, wrenches
from harness.world.physics.world import World

STEP_US = 4_000
ALL = [load(name) for name in names()]


def bodies(count, vel=(0.0, 0.0, 0.0), omega=(0.0, 0.0, 0.0)):
    rows = np.zeros(count, BODY)
    rows["q_ned_frd"] = (1.0, 0.0, 0.0, 0.0)
    rows["vel_ned_m_s"], rows["omega_ned_rad_s"] = vel, omega
    rows["pos_ned_m"][:, 2] = -100.0
    return rows


def around(count, rotors):
    return Surroundings(np.zeros((count, 3)), np.ones(count), np.ones((count, rotors)))


def test_each_airframe_hovers_beside_the_others():
    """Speeds beyond a vehicle's own rotors are not used."""
    speeds = np.array([[airframe.hover_rad_s] * 8 for airframe in ALL])
    force, torque = wrenches(
        kernel_model(ALL, step_s=0.004), bodies(len(ALL)), speeds, around(len(ALL), 8)
    )  # fmt: skip
    np.testing.assert_allclose(force[:, 2], [-airframe.mass_kg * GRAVITY_M_S2 for airframe in ALL])
    np.testing.assert_allclose(force[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(torque, 0.0, atol=1e-6)


def test_a_row_is_that_of_the_airframe_alone():
    rng = np.random.default_rng(1)
    speeds = rng.uniform(100.0, 900.0, (len(ALL), 8))
    motion = {"vel": (3.0, -1.0, 0.5), "omega": (0.3, 2.0, -1.0)}
    together = wrenches(
        kernel_model(ALL, step_s=0.004), bodies(len(ALL), **motion), speeds, around(len(ALL), 8)
    )  # fmt: skip
    for row, airframe in enumerate(ALL):
        count = len(airframe.rotors)
        alone = wrenches(
            kernel_model([airframe], step_s=0.004), bodies(1, **motion),
            np.ascontiguousarray(speeds[row : row + 1, :count]), around(1, count),
        )  # fmt: skip
        np.testing.assert_array_equal(alone[0][0], together[0][row])
        np.testing.assert_array_equal(alone[1][0], together[1][row])


def test_a_vehicle_with_all_axes_tilted_is_an_upright_one_that_is_rotated():
    """Hubs, axes and motion rotated together rotate force and torque."""
    turn = quat_from_rotation_vector(np.array((0.3, -0.2, 0.0)))
    rotated = changed(
        rotors=tuple(
            structs.replace(
                rotor,
                position_frd_m=tuple(quat_rotate(turn, np.array(rotor.position_frd_m)).tolist()),
                axis_frd=tuple(quat_rotate(turn, np.array((0.0, 0.0, -1.0))).tolist()),
            )
            for rotor in IRIS.rotors
        )
    )
    vel, omega = np.array((3.0, -1.0, 0.5)), np.array((0.3, 2.0, -1.0))
    speeds = np.array([[700.0, 800.0, 900.0, 650.0]])
    upright = wrenches(kernel_model([IRIS], step_s=0.004), bodies(1, vel, omega), speeds, around(1, 4))
    tilted = wrenches(
        kernel_model([rotated], step_s=0.004),
        bodies(1, quat_rotate(turn, vel), quat_rotate(turn, omega)), speeds, around(1, 4),
    )  # fmt: skip
    for of_upright, of_tilted in zip(upright, tilted, strict=True):
        np.testing.assert_allclose(of_tilted[0], quat_rotate(turn, of_upright[0]), atol=1e-12)


def test_a_mixed_world_stands_on_its_feet_and_hovers():
    """Landed vehicles rest at their own heights; others hold height at their hover control."""
    standing = [(3.0 * k, 0.0, -airframe.standing_height_m) for k, airframe in enumerate(ALL)]
    with World(airframes=ALL, spawn_pos_ned_m=standing, spawn_yaw_rad=0.0, step_us=STEP_US) as world:
        for _ in range(250):
            world.step(np.zeros((len(ALL), 8)), np.zeros(len(ALL), bool), np.zeros((len(ALL), 3)))
        np.testing.assert_allclose(world.truth.pos_ned_m, standing, atol=2e-3)
    controls = np.zeros((len(ALL), 8))
    for row, airframe in enumerate(ALL):
        unit = airframe.propulsion
        controls[row, : len(airframe.rotors)] = (airframe.hover_rad_s - unit.idle_rad_s) / unit.range_rad_s
    high = [(3.0 * k, 0.0, -100.0) for k in range(len(ALL))]
    with World(airframes=ALL, spawn_pos_ned_m=high, spawn_yaw_rad=0.0, step_us=STEP_US) as world:
        for _ in range(250):
            world.step(controls, np.ones(len(ALL), bool), np.zeros((len(ALL), 3)))
        assert np.abs(world.truth.acc_ned_m_s2[:, :2]).max() < 1e-9
        speeds = world.truth.rotor_speed_rad_s
        for row, airframe in enumerate(ALL):
            count = len(airframe.rotors)
            assert speeds[row, :count] == pytest.approx([airframe.hover_rad_s] * count, rel=1e-6)
            assert not speeds[row, count:].any()


def test_a_spawn_below_the_own_standing_height_is_refused():
    with pytest.raises(ValueError, match=r"vehicle 1 spawns .* it stands at -0\.227 m"):
        World(
            airframes=[IRIS, load("x500")], spawn_pos_ned_m=[(0.0, 0.0, -1.0), (5.0, 0.0, -0.2)],
            spawn_yaw_rad=0.0, step_us=STEP_US,
        )  # fmt: skip
