"""Free flight equals Bullet's integration, and Bullet steps all vehicles with possible contacts."""

import itertools

import numpy as np
import pytest

from foundation.airframe.description import GRAVITY_M_S2
from foundation.airframe.files import IRIS
from foundation.geometry.rotations import quat_rotate
from harness.world.physics.bodies import BODY, near_something
from harness.world.physics.bullet import Bullet
from harness.world.physics.free_flight import MOST_RATE, coast
from harness.world.physics.world import RELEASE_RATIO, World

INERTIA = np.array(IRIS.inertia_kg_m2)
MASSES = np.full(60, IRIS.mass_kg), np.tile(INERTIA, (60, 1))
HALF_DIAGONAL_M = 0.5 * float(np.linalg.norm(IRIS.body.size_m))
CORNERS_FRD_M = 0.5 * np.array(IRIS.body.size_m) * list(itertools.product((-1.0, 1.0), repeat=3))


def thrown(rng, count, *, rate_rad_s):
    """Return bodies far from each other and from the ground, with random attitudes and motions."""
    rows = np.zeros(count, BODY)
    rows["pos_ned_m"] = rng.normal(size=(count, 3)) + np.arange(count)[:, None] * 20.0
    rows["pos_ned_m"][:, 2] = -500.0
    attitudes = rng.normal(size=(count, 4))
    rows["q_ned_frd"] = attitudes / np.linalg.norm(attitudes, axis=1)[:, None]
    rows["vel_ned_m_s"] = 10.0 * rng.normal(size=(count, 3))
    rows["omega_ned_rad_s"] = rate_rad_s * rng.normal(size=(count, 3))
    return rows


def differences(rows, others):
    """Return the largest difference by field; q and -q are the same attitude."""
    signs = np.sign(np.sum(rows["q_ned_frd"] * others["q_ned_frd"], axis=1))
    others = others.copy()
    others["q_ned_frd"] *= signs[:, None]
    return {name: float(np.abs(rows[name] - others[name]).max()) for name in BODY.names}


@pytest.mark.parametrize("step_s", [0.001, 0.004, 0.02])
@pytest.mark.parametrize("rate_rad_s", [0.0, 1e-5, 1e-2, 1.0, 30.0, 99.0])
def test_a_step_equals_bullets_except_for_rounding(step_s, rate_rad_s):
    """At small angular rates, where a series is used, and above Bullet's limits of rotation and rate."""
    rng = np.random.default_rng(3)
    before = thrown(rng, 16, rate_rad_s=rate_rad_s)
    bullet = Bullet([IRIS] * 60, step_s=step_s, gravity_m_s2=GRAVITY_M_S2)
    for i, row in enumerate(before):
        bullet.hold(i, row)
    applied = rng.normal(size=(16, 2, 3)) * [[[20.0], [2.0]]]
    free, bullets = np.zeros(16, BODY), np.zeros(16, BODY)
    coast(*MASSES, GRAVITY_M_S2, step_s, before, applied, free)
    bullet.step(before, applied, bullets)
    bullet.close()
    apart = differences(free, bullets)
    assert apart["pos_ned_m"] <= 2e-13  # of 500 m
    assert apart["vel_ned_m_s"] <= 2e-14
    assert apart["q_ned_frd"] <= 2e-14
    assert apart["omega_ned_rad_s"] <= 1e-12


def test_a_flight_of_five_seconds_equals_bullets():
    """Accumulated rounding errors are 2e-12 m of about 100 m."""
    rng = np.random.default_rng(5)
    free = thrown(rng, 8, rate_rad_s=1.0)
    bullets = free.copy()
    bullet = Bullet([IRIS] * 60, step_s=0.004, gravity_m_s2=GRAVITY_M_S2)
    for i, row in enumerate(free):
        bullet.hold(i, row)
    for _ in range(1_250):
        applied = rng.normal(size=(8, 2, 3)) * [[[5.0], [0.02]]]
        applied[:, 0, 2] -= IRIS.mass_kg * GRAVITY_M_S2
        was_free, was_bullets = free, bullets
        free, bullets = np.zeros(8, BODY), np.zeros(8, BODY)
        coast(*MASSES, GRAVITY_M_S2, 0.004, was_free, applied, free)
        bullet.step(was_bullets, applied, bullets)
    bullet.close()
    assert max(differences(free, bullets).values()) < 1e-10


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("field", "applied_as"), [("vel_ned_m_s", 0), ("omega_ned_rad_s", 1)])
@pytest.mark.parametrize("axis", range(3))
def test_bullet_limits_rates_as_free_flight_does(field, applied_as, axis, sign):
    """A force exceeds the limit in one step, along each axis; gravity adds 0.04 m/s."""
    before = np.zeros(1, BODY)
    before["pos_ned_m"], before["q_ned_frd"] = (0.0, 0.0, -500.0), (1.0, 0.0, 0.0, 0.0)
    before[field][0, axis] = 99.9 * sign
    applied = np.zeros((1, 2, 3))
    applied[0, applied_as, axis] = 1e3 * sign
    bullet = Bullet([IRIS] * 60, step_s=0.004, gravity_m_s2=GRAVITY_M_S2)
    bullet.hold(0, before[0])
    free, bullets = np.zeros(1, BODY), np.zeros(1, BODY)
    coast(*MASSES, GRAVITY_M_S2, 0.004, before, applied, free)
    bullet.step(before, applied, bullets)
    bullet.close()
    assert free[field][0, axis] == bullets[field][0, axis] == sign * MOST_RATE
    assert max(differences(free, bullets).values()) <= 2e-13


def near(rows, was_near=None):
    flags = np.zeros(len(rows), dtype=bool) if was_near is None else np.array(was_near)
    changed = near_something(rows, 4.0 * HALF_DIAGONAL_M, RELEASE_RATIO, flags)
    return changed, flags.tolist()


def test_a_body_within_reach_is_near_until_it_is_a_quarter_farther_away():
    reach_m = 4.0 * HALF_DIAGONAL_M
    rows = np.zeros(3, BODY)
    rows["pos_ned_m"] = [(0, 0, -0.49 * reach_m), (0, 0, -10.0), (0.99 * reach_m, 0.99 * reach_m, -10.0)]
    assert near(rows) == (True, [True] * 3)
    assert near(rows, [True] * 3) == (False, [True] * 3)
    rows["pos_ned_m"] = [(0, 0, -0.6 * reach_m), (0, 0, -10.0), (1.2 * reach_m, 0.0, -10.0)]
    assert near(rows) == (False, [False] * 3)
    assert near(rows, [True] * 3) == (False, [True] * 3)
    assert near(rows, [False, True, False]) == (True, [False] * 3)
    rows["pos_ned_m"] = [(0, 0, -0.63 * reach_m), (0, 0, -10.0), (1.26 * reach_m, 0.0, -10.0)]
    assert near(rows, [True] * 3) == (True, [False] * 3)


def test_free_bodies_cannot_touch_anything():
    """A free body is at least 0.25 m from the ground and from others, at any attitude.

    Others are as near as their shapes' spheres: a bound, for which no two attitudes need be tried.
    """
    rng = np.random.default_rng(2)
    with World(
        airframes=[IRIS], spawn_pos_ned_m=[(0.0, 0.0, -9.0)], spawn_yaw_rad=0.0, step_us=4_000
    ) as world:
        reach_m, release_ratio = world._model.reach_m, world._model.release_ratio
    free_ones, nearest_ground_m, nearest_other_m = 0, np.inf, np.inf
    for _ in range(2_000):
        rows, flags = np.zeros(2, BODY), rng.random(2) < 0.5
        rows["q_ned_frd"] = rng.normal(size=(2, 4))
        rows["q_ned_frd"] /= np.linalg.norm(rows["q_ned_frd"], axis=1)[:, None]
        rows["pos_ned_m"][0, 2] = -rng.uniform(0.0, 1.5 * reach_m)
        rows["pos_ned_m"][1] = rows["pos_ned_m"][0] + rng.uniform(-1.5, 1.5, 3) * reach_m
        near_something(rows, reach_m, release_ratio, flags)
        for row in rows[~flags]:
            corners_m = [quat_rotate(row["q_ned_frd"], corner)[2] for corner in CORNERS_FRD_M]
            nearest_ground_m = min(nearest_ground_m, -row["pos_ned_m"][2] - max(corners_m))
            free_ones += 1
        if not flags.all():  # a free body must not be reached by one in Bullet
            apart_m = np.linalg.norm(rows["pos_ned_m"][1] - rows["pos_ned_m"][0])
            nearest_other_m = min(nearest_other_m, apart_m - 2.0 * HALF_DIAGONAL_M)
    assert free_ones > 500
    assert 0.25 < nearest_ground_m < 0.5  # and the limit is not wider than necessary
    assert 0.25 < nearest_other_m < 1.0


def test_vehicles_change_between_free_flight_and_bullet():
    """One stays on the ground, one rises, drops and lands again, others fly: each moves as if it were alone.

    What Bullet holds besides does not matter to a vehicle that touches none of it.
    """
    spawn = [(0.0, 0.0, -0.055), (5.0, 0.0, -0.055), (10.0, 0.0, -30.0), (15.0, 0.0, -30.0)]

    def fly(places):
        """Return heights by step, and the vehicles in Bullet by step."""
        n = len(places)
        held, truths = [], []
        with World(
            airframes=[IRIS] * len(places), spawn_pos_ned_m=places, spawn_yaw_rad=0.7, step_us=4_000
        ) as world:
            for step in range(900):
                controls = np.array([CONTROLS[place](step) for place in places])[:, None].repeat(4, axis=1)
                world.step(controls, np.ones(n, bool), np.zeros((n, 3)), rotors_stopped=np.zeros(n, bool))
                held.append(set(world._bullet.holds))
                truths.append(world.truth.rows.copy())
        return np.array(truths), held

    CONTROLS = {  # noqa: N806
        spawn[0]: lambda _: 0.0,
        spawn[1]: lambda step: 0.9 if step < 200 else 0.6,
        spawn[2]: lambda _: 0.7,
        spawn[3]: lambda _: 0.71,
    }
    together, held = fly(spawn)
    assert held[0] == {0, 1}
    assert {0} in held
    assert held[-1] == {0, 1}  # it has landed
    assert -together["pos_ned_m"][:, 1, 2].min() > 3.0
    for i, place in enumerate(spawn):
        alone, _ = fly([place])
        for name in ("pos_ned_m", "vel_ned_m_s", "omega_frd_rad_s"):
            np.testing.assert_allclose(alone[name][:, 0], together[name][:, i], rtol=0.0, atol=1e-6)


def test_two_that_meet_in_flight_are_stepped_by_bullet_and_collide():
    places = [(0.0, 0.0, -30.0), (0.0, 0.0, -34.0)]
    contacts = []
    with World(
        airframes=[IRIS] * len(places), spawn_pos_ned_m=places, spawn_yaw_rad=0.0, step_us=4_000
    ) as world:
        for _ in range(400):
            controls = np.array([[0.707] * 4, [0.0] * 4])
            world.step(controls, np.ones(2, bool), np.zeros((2, 3)), rotors_stopped=np.zeros(2, bool))
            contacts += [(each.first, each.second) for each in world.vehicle_contacts]
            heights_m = -world.truth.pos_ned_m[:, 2]
            assert heights_m[1] - heights_m[0] > 0.05  # the upper one does not pass through
            if contacts and not world._bullet.holds:
                break
    assert contacts
    assert contacts[0] == (0, 1)
