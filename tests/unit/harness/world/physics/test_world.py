"""The world compared with closed forms: free fall, spin, trim, drift in wind, rest, friction, contact."""

import math

import numpy as np
import pytest

from foundation.airframe.description import GRAVITY_M_S2
from foundation.airframe.files import IRIS
from foundation.geometry.rotations import quat_from_rotation_vector, quat_multiply, quat_rotate
from harness.world.physics.world import World

STEP_US = 4_000
STEP_S = 0.004
HOVER = (math.sqrt(1.55 * 9.8066 / 4.0 / 5.84e-6) - 100.0) / 1000.0
GRAVITY_NED_M_S2 = np.array((0.0, 0.0, GRAVITY_M_S2))
INERTIA = np.array((0.029125, 0.029125, 0.055225))


def world_at(*pos_ned_m, yaw_rad=0.0, step_us=STEP_US):
    return World(
        airframes=[IRIS] * len(pos_ned_m), spawn_pos_ned_m=pos_ned_m, spawn_yaw_rad=yaw_rad, step_us=step_us
    )


def fly(world, controls, steps, *, armed=True, wind_n=(0.0, 0.0, 0.0), stopped=False):
    """Step with constant inputs, the same for every vehicle unless given per vehicle."""
    n = len(world.truth.pos_ned_m)
    controls = np.broadcast_to(np.asarray(controls, dtype=float), (n, 4)).copy()
    wind_n = np.broadcast_to(np.asarray(wind_n, dtype=float), (n, 3))
    for _ in range(steps):
        world.step(controls, np.full(n, armed), wind_n, rotors_stopped=np.full(n, stopped))
    return world.truth


def levelled_controls(truth, roll_trim_n_m=0.0):
    """Return controls (4,) that hold one vehicle level at hover thrust: a PD law on true tilt and rates."""
    w, x, y, _ = truth.q_ned_frd[0]
    roll_torque, pitch_torque, yaw_torque = -4.0 * 2.0 * w * np.array((x, y, 0.0)) - truth.omega_frd_rad_s[0]
    thrust_per_control_n = 2.0 * 5.84e-6 * (100.0 + 1000.0 * HOVER) * 1000.0
    roll_torque += roll_trim_n_m / (0.02 * 4.0 * 0.21 * thrust_per_control_n)
    mix = 0.02 * np.array(
        [
            -roll_torque + pitch_torque + yaw_torque,
            +roll_torque - pitch_torque + yaw_torque,
            +roll_torque + pitch_torque - yaw_torque,
            -roll_torque - pitch_torque - yaw_torque,
        ]
    )
    return HOVER + mix


def test_free_fall_is_exact():
    with world_at((3.0, -2.0, -200.0)) as world:
        for step in range(1, 501):
            truth = fly(world, 0.0, 1, armed=False)
            fallen_m = 0.5 * GRAVITY_M_S2 * (step * STEP_S) ** 2
            np.testing.assert_allclose(truth.pos_ned_m, [(3.0, -2.0, -200.0 + fallen_m)], atol=1e-10)
        np.testing.assert_allclose(truth.vel_ned_m_s, [(0.0, 0.0, GRAVITY_M_S2 * 2.0)], atol=1e-10)
        np.testing.assert_allclose(truth.acc_ned_m_s2, [(0.0, 0.0, GRAVITY_M_S2)], atol=1e-9)
        np.testing.assert_allclose(truth.specific_force_frd_m_s2, 0.0, atol=1e-9)


def tumbling_world():
    """One vehicle in free fall, rotors at rest, spinning about all axes."""
    world = world_at((0.0, 0.0, -2000.0), yaw_rad=0.7)
    fly(world, (1.0, 1.0, 0.0, 0.0), 150)
    fly(world, (0.9, 0.5, 0.5, 0.9), 25)
    fly(world, 0.0, 250, stopped=True)
    return world


def test_torque_free_spin_precesses_like_a_symmetric_top():
    """Body rates rotate about z at (Izz - Ixx)/Ixx wz; Bullet without the correction gains energy."""
    with tumbling_world() as world:
        start = world.truth
        spin = start.omega_frd_rad_s[0]
        assert np.linalg.norm(spin[:2]) > 2.0
        assert abs(spin[2]) > 2.0
        rate_rad_s = (INERTIA[2] - INERTIA[0]) / INERTIA[0] * spin[2]
        for step in range(1, 501):
            truth = fly(world, 0.0, 1, stopped=True)
            cos, sin = math.cos(rate_rad_s * step * STEP_S), math.sin(rate_rad_s * step * STEP_S)
            expected = (cos * spin[0] - sin * spin[1], sin * spin[0] + cos * spin[1], spin[2])
            np.testing.assert_allclose(truth.omega_frd_rad_s[0], expected, atol=1.5e-3 * np.linalg.norm(spin))
        energy_ratio = (INERTIA @ truth.omega_frd_rad_s[0] ** 2) / (INERTIA @ spin**2)
        assert energy_ratio == pytest.approx(1.0, abs=1e-4)
        before, after = (quat_rotate(t.q_ned_frd[0], INERTIA * t.omega_frd_rad_s[0]) for t in (start, truth))
        np.testing.assert_allclose(after, before, atol=1.5e-4 * np.linalg.norm(before))


def test_hover_trim_holds():
    """Except the descent during the rotors' start, which the thrust decelerates by g v / (25 m/s)."""
    with world_at((0.0, 0.0, -50.0)) as world:
        sinking_m_s = fly(world, HOVER, 250).vel_ned_m_s[0, 2]
        assert 0.05 < sinking_m_s < 0.3
        truth = fly(world, HOVER, 1)
        acc_ned_m_s2 = np.array([(0.0, 0.0, -GRAVITY_M_S2 * sinking_m_s / 25.0)])
        np.testing.assert_allclose(truth.acc_ned_m_s2, acc_ned_m_s2, atol=1e-6)
        still_m_s2 = np.array((0.0, 0.0, GRAVITY_M_S2))
        np.testing.assert_allclose(truth.specific_force_frd_m_s2, acc_ned_m_s2 - still_m_s2, atol=1e-6)


@pytest.mark.parametrize(("wind_n", "drift_m_s"), [(2.0, 3.54), (5.0, 8.85)])
def test_drift_at_hover_is_the_wind_over_the_rotor_drag(wind_n, drift_m_s):
    """Level at hover thrust, wind to the east: 0.565 N/(m/s). Time constant m/0.565 = 2.7 s; 8 of them.

    The drag acts 23 mm above the centre of mass, so that holding level takes that torque.
    """
    with world_at((0.0, 0.0, -300.0)) as world:
        for _ in range(round(22.0 / STEP_S)):
            controls = levelled_controls(world.truth, 0.023 * -0.565 * -world.truth.vel_ned_m_s[0, 1])
            truth = fly(world, controls, 1, wind_n=(0.0, wind_n, 0.0))
        assert truth.vel_ned_m_s[0, 1] == pytest.approx(drift_m_s, rel=5e-3)


@pytest.mark.parametrize(
    ("slower", "towards_ned"),
    [((0, 2), (1, 0)), ((1, 3), (-1, 0)), ((0, 3), (0, 1)), ((1, 2), (0, -1))],
    ids=["nose down goes north", "nose up goes south", "right down goes east", "left down goes west"],
)
def test_tilt_accelerates_in_the_right_direction(slower, towards_ned):
    controls = np.full(4, HOVER + 0.02)
    controls[list(slower)] -= 0.04
    with world_at((0.0, 0.0, -50.0)) as world:
        fly(world, HOVER, 50)
        truth = fly(world, controls, 90)
        assert truth.vel_ned_m_s[0, :2] @ towards_ned > 0.1
        across = truth.vel_ned_m_s[0, :2] @ (towards_ned[1], -towards_ned[0])
        assert abs(across) < 0.02 * np.linalg.norm(truth.vel_ned_m_s[0, :2])


def test_spawn_yaw_is_clockwise_from_north():
    controls = (HOVER - 0.02, HOVER + 0.02, HOVER - 0.02, HOVER + 0.02)  # nose down
    with world_at((0.0, 0.0, -50.0), yaw_rad=math.radians(90.0)) as world:
        fly(world, HOVER, 50)
        truth = fly(world, controls, 90)
        assert truth.vel_ned_m_s[0, 1] > 0.1
        assert abs(truth.vel_ned_m_s[0, 0]) < 1e-6


def test_sensors_of_the_step_integrate_to_the_state():
    """Strapdown integration of mean rate and specific force of a rough flight gives the true state."""
    rng = np.random.default_rng(5)
    with world_at((0.0, 0.0, -100.0), yaw_rad=0.4) as world:
        fly(world, HOVER, 60)
        start = world.truth
        q, vel, pos = start.q_ned_frd[0], start.vel_ned_m_s[0], start.pos_ned_m[0]
        for step in range(250):
            if step % 20 == 0:
                controls = levelled_controls(world.truth) + rng.uniform(-0.1, 0.1, 4)
            truth = fly(world, controls, 1, wind_n=(1.0, -2.0, 0.5))
            half_turn = quat_from_rotation_vector(0.5 * STEP_S * truth.mean_omega_frd_rad_s[0])
            mid_q = quat_multiply(q, half_turn)
            q = quat_multiply(mid_q, half_turn)
            acc = quat_rotate(mid_q, truth.specific_force_frd_m_s2[0]) + GRAVITY_NED_M_S2
            pos = pos + STEP_S * (vel + 0.5 * STEP_S * acc)
            vel = vel + STEP_S * acc
        assert np.linalg.norm(truth.omega_frd_rad_s[0]) > 0.3
        np.testing.assert_allclose(np.abs(q @ truth.q_ned_frd[0]), 1.0, atol=1e-8)
        np.testing.assert_allclose(vel, truth.vel_ned_m_s[0], atol=3e-4)
        np.testing.assert_allclose(pos, truth.pos_ned_m[0], atol=1e-4)


def test_vehicles_on_the_ground_are_at_rest():
    places = [(4.0 * i, -3.0 * i, -IRIS.standing_height_m) for i in range(4)]
    with world_at(*places, yaw_rad=1.0) as world:
        settled = fly(world, 0.0, 50, armed=False)
        truth = fly(world, 0.0, 1000, armed=False)
        assert world.on_ground.all()
        assert world.vehicle_contacts == ()
        np.testing.assert_allclose(truth.pos_ned_m, places, atol=2e-5)  # Bullet lets contacts sink by 10 um
        np.testing.assert_allclose(truth.pos_ned_m, settled.pos_ned_m, atol=1e-8)
        np.testing.assert_allclose(truth.vel_ned_m_s, 0.0, atol=1e-8)
        np.testing.assert_allclose(truth.omega_frd_rad_s, 0.0, atol=1e-7)
        np.testing.assert_allclose(
            truth.specific_force_frd_m_s2, np.tile((0.0, 0.0, -GRAVITY_M_S2), (4, 1)), atol=1e-5
        )


def test_specific_force_before_the_first_step_is_that_of_rest():
    with world_at((0.0, 0.0, -1.0)) as world:
        np.testing.assert_array_equal(world.truth.specific_force_frd_m_s2, [(0.0, 0.0, -GRAVITY_M_S2)])


def test_friction_holds_0_8_of_the_weight():
    limit_n = 0.8 * 1.55 * GRAVITY_M_S2
    places = [(0.0, 0.0, -IRIS.standing_height_m), (0.0, 5.0, -IRIS.standing_height_m)]
    with world_at(*places) as world:
        fly(world, 0.0, 50, armed=False)
        truth = fly(world, 0.0, 250, armed=False, wind_n=[(0.95 * limit_n, 0, 0), (1.05 * limit_n, 0, 0)])
        assert truth.pos_ned_m[0, 0] == pytest.approx(0.0, abs=1e-3)
        # the remaining force accelerates: 0.05 x 0.8 g for 1 s
        assert truth.pos_ned_m[1, 0] == pytest.approx(0.5 * 0.05 * 0.8 * GRAVITY_M_S2, rel=0.05)


def test_a_dropped_vehicle_ends_level_on_the_ground_without_bouncing():
    with world_at((0.0, 0.0, -0.5)) as world:
        highest_after_impact_m = 0.0
        for _ in range(500):
            truth = fly(world, 0.0, 1, armed=False)
            if world.on_ground[0]:
                highest_after_impact_m = max(highest_after_impact_m, -truth.pos_ned_m[0, 2])
        assert highest_after_impact_m < IRIS.standing_height_m + 0.005
        np.testing.assert_allclose(truth.q_ned_frd[0], (1.0, 0.0, 0.0, 0.0), atol=1e-6)
        np.testing.assert_allclose(truth.vel_ned_m_s, 0.0, atol=1e-6)


def test_take_off_leaves_the_ground():
    with world_at((0.0, 0.0, -IRIS.standing_height_m)) as world:
        fly(world, 0.5, 100)
        assert world.on_ground[0]
        truth = fly(world, 0.8, 100)
        assert not world.on_ground[0]
        assert truth.vel_ned_m_s[0, 2] < -0.3


def test_colliding_vehicles_are_named_and_do_not_pass_through_each_other():
    """The wind drives 0 and 2 towards each other, from north and south; 1 flies beside them."""
    with world_at((1.0, 0.0, -100.0), (0.0, 5.0, -100.0), (-1.0, 0.0, -100.0)) as world:
        wind_n = [(-4.0, 0.0, 0.0), (0.0, 0.0, 0.0), (4.0, 0.0, 0.0)]
        touched_at_step = None
        for step in range(1, 401):
            truth = fly(world, HOVER, 1, wind_n=wind_n)
            if world.vehicle_contacts and touched_at_step is None:
                touched_at_step = step
                (contact,) = world.vehicle_contacts
                assert (contact.first, contact.second) == (0, 2)
                assert contact.pos_ned_m[0] == pytest.approx(0.0, abs=0.05)
            assert truth.pos_ned_m[0, 0] > truth.pos_ned_m[2, 0]
        # each goes 1 m - 0.235 m at 4/1.55 m/s^2, in still air 0.77 s, a little longer against the drag
        assert touched_at_step is not None
        assert 0.77 <= touched_at_step * STEP_S < 0.95
        assert not world.on_ground.any()


def test_a_stopped_vehicle_falls_and_the_others_do_not():
    with world_at((0.0, 0.0, -50.0), (3.0, 0.0, -50.0)) as world:
        for _ in range(250):
            world.step(
                np.full((2, 4), HOVER),
                np.ones(2, bool),
                np.zeros((2, 3)),
                rotors_stopped=np.array([True, False]),
            )
        assert world.truth.vel_ned_m_s[0, 2] == pytest.approx(GRAVITY_M_S2 * 1.0, rel=1e-6)
        assert world.truth.vel_ned_m_s[1, 2] < 1.0


def test_equal_worlds_give_equal_bytes_and_do_not_disturb_each_other():
    places = [(0.0, 0.3 * i, -0.2 - 0.3 * i) for i in range(4)]  # they fall onto each other and the ground
    rng = np.random.default_rng(3)
    inputs = [(rng.uniform(0.0, 1.0, (4, 4)), rng.normal(0.0, 2.0, (4, 3))) for _ in range(300)]
    powered, running = np.ones(4, bool), np.zeros(4, bool)

    def step(world, controls, wind_n):
        world.step(controls, powered, wind_n, rotors_stopped=running)
        truth = world.truth
        return truth.pos_ned_m.tobytes() + truth.q_ned_frd.tobytes() + truth.specific_force_frd_m_s2.tobytes()

    with world_at(*places) as alone:
        expected = [step(alone, *each) for each in inputs]
    with world_at(*places) as first, world_at((0.0, 0.0, -9.0)) as other, world_at(*places) as second:
        for each, bytes_alone in zip(inputs, expected, strict=True):
            fly(other, 0.9, 1)
            assert step(first, *each) == bytes_alone
            assert step(second, *each) == bytes_alone


def test_a_spawn_below_the_ground_is_refused():
    with pytest.raises(
        ValueError, match=r"vehicle 1 spawns with its centre 0 m down, but it stands at -0\.055 m"
    ):
        world_at((0.0, 0.0, -1.0), (0.0, 2.0, 0.0))


def test_close_may_be_repeated():
    world = world_at((0.0, 0.0, -1.0))
    world.close()
    world.close()
