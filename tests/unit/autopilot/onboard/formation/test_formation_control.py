"""Formation control: the correction with and without distances, the reference, and height layers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onboard_world import article_places_ned_m

from autopilot.onboard.formation.formation_control import (
    ACCELERATION_M_S2,
    COAST_S,
    FADE_TIME_CONSTANT_S,
    JOIN_SPEED_M_S,
    LAG_MAX_M,
    OFFSET_RATE_M_S,
    Correction,
    FormationReference,
    joining_time_s,
)
from autopilot.onboard.formation.height_layers import (
    BACK_S,
    DRIFT_SIGMAS,
    GROUND_CLEARANCE_M,
    REACH_SIGMAS,
    SEPARATION_HEIGHT_M,
    HeightLayers,
    apart_s,
    layers,
)
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.parameters.config import RacetrackMotion

DT_S = 0.05
ZERO = np.zeros(2)


def settled_correction(offset_ne_m=(-1.2, 0.5)):
    """Return a correction on the ground with an autopilot that agrees with odometry: minus the offset."""
    correction = Correction()
    correction.update(ZERO, np.array(offset_ne_m), DT_S, at_once=True)
    return correction


def test_without_any_distance_there_is_no_correction():
    correction = Correction()
    for k in range(2_000):
        correction.update(np.array((0.01 * k, 1.0)), None, DT_S, at_once=k < 100)
        assert np.array_equal(correction.ne_m, ZERO)


def test_the_correction_is_the_autopilots_position_minus_the_true_one():
    # true = odometry + offset, autopilot = odometry + drift: the correction is drift - offset.
    correction = Correction()
    correction.update((0.3, -0.2), (-1.2, 0.5), DT_S, at_once=True)
    assert correction.ne_m == pytest.approx((1.5, -0.7))


def test_the_autopilots_drift_is_followed_without_delay():
    correction = settled_correction()
    before = np.array(correction.ne_m)
    correction.update((0.4, 0.0), (-1.2, 0.5), DT_S, at_once=False)
    assert correction.ne_m - before == pytest.approx((0.4, 0.0))


def test_a_new_estimate_is_applied_at_bounded_rate_in_the_air():
    correction = settled_correction()
    target = np.array((3.0, -2.0))
    for _ in range(400):
        before = np.array(correction.ne_m)
        correction.update(ZERO, target, DT_S, at_once=False)
        assert np.linalg.norm(correction.ne_m - before) <= OFFSET_RATE_M_S * DT_S + 1e-12
    assert correction.ne_m == pytest.approx(-target, abs=1e-3)


def test_without_distances_the_correction_freezes_then_fades():
    correction = settled_correction()
    frozen = np.array(correction.ne_m)
    for _ in range(round(COAST_S / DT_S) - 1):
        correction.update(ZERO, None, DT_S, at_once=False)
        assert np.array_equal(correction.ne_m, frozen)
    for _ in range(round(FADE_TIME_CONSTANT_S / DT_S)):
        correction.update(ZERO, None, DT_S, at_once=False)
    assert correction.ne_m == pytest.approx(frozen / np.e, rel=0.01)


def test_after_fading_the_correction_returns_without_a_jump():
    correction = settled_correction()
    for _ in range(1_000):
        correction.update(ZERO, None, DT_S, at_once=False)
    before = np.array(correction.ne_m)
    correction.update((0.1, 0.0), (-1.2, 0.5), DT_S, at_once=False)
    assert np.linalg.norm(correction.ne_m - before) <= OFFSET_RATE_M_S * DT_S + 1e-12
    for _ in range(400):
        correction.update((0.1, 0.0), (-1.2, 0.5), DT_S, at_once=False)
    assert correction.ne_m == pytest.approx((1.3, -0.5), abs=1e-3)


@settings(deadline=None, max_examples=15)  # up to 150 s of simulated motion each
@given(
    st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-20, 0)),
    st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-20, 0)),
    st.floats(0.3, 3.0),
)
def test_the_reference_reaches_its_target_within_its_limits_without_overshoot(start, target, climb_speed_m_s):
    reference = FormationReference(climb_speed_m_s=climb_speed_m_s)
    start, target = np.array(start), np.array(target)
    reference.reset(start, np.zeros(3))
    way = target - start
    for _ in range(3_000):
        vel_before = reference.vel_ned_m_s.copy()
        reference.advance(target, DT_S)
        vel, gone = reference.vel_ned_m_s, reference.pos_ned_m - start
        assert np.linalg.norm(vel[:2]) <= JOIN_SPEED_M_S + 1e-9
        assert abs(vel[2]) <= climb_speed_m_s + 1e-9
        assert np.linalg.norm((vel - vel_before)[:2]) <= ACCELERATION_M_S2 * DT_S + 1e-9
        assert abs(vel[2] - vel_before[2]) <= ACCELERATION_M_S2 * DT_S + 1e-9
        assert gone[:2] @ way[:2] <= way[:2] @ way[:2] + 1e-3 * np.linalg.norm(way[:2]) + 1e-9
        assert gone[2] * np.sign(way[2]) <= abs(way[2]) + 1e-3
        if is_at(reference, target):
            break
    assert np.array_equal(reference.pos_ned_m, target)
    assert np.array_equal(reference.vel_ned_m_s, np.zeros(3))


def is_at(reference, target_ned_m):
    """Return whether the reference is at a standing target, at rest."""
    return np.array_equal(reference.pos_ned_m, target_ned_m) and not reference.vel_ned_m_s.any()


def racetrack(heading="track"):
    motion = RacetrackMotion(speed_m_s=3.0, length_m=30.0, radius_m=25.0, heading=heading)
    return FormationPlan(article_places_ned_m(), 0.0, motion)


def advance(reference, state, **kwargs):
    reference.advance(
        state.pos_ned_m, DT_S,
        target_vel_ned_m_s=state.vel_ned_m_s, target_acc_ned_m_s2=state.acc_ned_m_s2, **kwargs,
    )  # fmt: skip


def test_a_joined_reference_equals_the_plan():
    """Exactly, on two laps with all their transitions: no lag, and the plan's feed-forward."""
    plan, reference = racetrack(), FormationReference(climb_speed_m_s=1.5)
    reference.reset(plan.own(0, 0.0).pos_ned_m, np.zeros(3))
    for k in range(1, 3_000):
        state = plan.own(0, k * DT_S - 5.0)
        advance(reference, state)
        assert np.array_equal(reference.pos_ned_m, state.pos_ned_m)
        assert np.array_equal(reference.vel_ned_m_s, state.vel_ned_m_s)
        assert np.array_equal(reference.acc_ned_m_s2, state.acc_ned_m_s2)


@pytest.mark.parametrize("since_s", [0.0, 7.0, 20.0, 33.0])
@pytest.mark.parametrize("apart_ned_m", [(6.0, -4.0, 3.0), (0.0, 0.4, 0.0), (-0.03, 0.0, -9.0)])
def test_a_plan_in_motion_is_joined_without_a_jump(since_s, apart_ned_m):
    """From rest, relative to the plan: the acceleration stays within its limit, the speed converges to it."""
    plan, reference = racetrack(), FormationReference(climb_speed_m_s=1.5)
    state = plan.own(3, since_s)
    reference.reset(np.add(state.pos_ned_m, apart_ned_m), np.zeros(3))
    fastest_m_s = max(np.linalg.norm(state.vel_ned_m_s), JOIN_SPEED_M_S)
    for k in range(1, 1_200):
        pos, vel = reference.pos_ned_m.copy(), reference.vel_ned_m_s.copy()
        state = plan.own(3, since_s + k * DT_S)
        advance(reference, state)
        # First-order prediction: the remainder is the acceleration and the plan's jerk.
        assert reference.pos_ned_m == pytest.approx(pos + DT_S * reference.vel_ned_m_s, abs=4e-3)
        assert np.linalg.norm(reference.vel_ned_m_s[:2] - vel[:2]) <= 4.0 * DT_S
        extra = reference.acc_ned_m_s2 - state.acc_ned_m_s2
        assert np.linalg.norm(extra[:2]) <= ACCELERATION_M_S2 + 1e-9
        assert abs(extra[2]) <= ACCELERATION_M_S2 + 1e-9
        # The relative speed is the plan's at first, and then decreases monotonically to the limit.
        relative = np.linalg.norm((reference.vel_ned_m_s - state.vel_ned_m_s)[:2])
        assert relative <= fastest_m_s + 1e-6
        fastest_m_s = max(min(fastest_m_s, relative), JOIN_SPEED_M_S)
    assert np.array_equal(reference.pos_ned_m, state.pos_ned_m)
    assert np.array_equal(reference.vel_ned_m_s, state.vel_ned_m_s)


def test_a_target_that_jumps_is_joined_again():
    reference = FormationReference(climb_speed_m_s=1.5)
    place = np.array((1.0, 2.0, -10.0))
    reference.reset(place, np.zeros(3))
    reference.advance(place, DT_S)
    assert is_at(reference, place)
    reference.advance(place - np.array((0.0, 0.0, 2.0)), DT_S)
    assert np.linalg.norm(reference.pos_ned_m - place) <= ACCELERATION_M_S2 * DT_S**2 + 1e-12


def test_the_reference_waits_for_a_vehicle_that_stays_behind():
    """It leads by at most the limit."""
    reference, still = FormationReference(climb_speed_m_s=1.5), np.zeros(3)
    for _ in range(100):
        reference.advance(np.array((50.0, 0.0, 0.0)), DT_S, vehicle_ned_m=still)
    assert LAG_MAX_M <= reference.pos_ned_m[0] <= LAG_MAX_M + JOIN_SPEED_M_S * DT_S + 1e-9


def test_the_reference_follows_a_vehicle_around_an_obstacle():
    """Within the limit, and ahead of the vehicle in the direction of the target."""
    reference, target = FormationReference(climb_speed_m_s=1.5), np.array((50.0, 0.0, 0.0))
    vehicle = np.zeros(3)
    reference.reset(vehicle, np.zeros(3))
    for k in range(460):
        vehicle[1] = 6.0 * np.sin(min(k, 400) * DT_S / 6.0)  # blocked ahead, it is moved across
        before = reference.pos_ned_m.copy()
        reference.advance(target, DT_S, vehicle_ned_m=vehicle)
        own_way_m = np.linalg.norm(reference.pos_ned_m - before)
        assert own_way_m <= (2.0 * JOIN_SPEED_M_S + 1.0) * DT_S + 1e-9
        assert np.linalg.norm(reference.pos_ned_m - vehicle) <= LAG_MAX_M + JOIN_SPEED_M_S * DT_S + 1e-9
    ahead = reference.pos_ned_m - vehicle
    towards = target - vehicle
    assert ahead @ towards > 0.9 * np.linalg.norm(ahead) * np.linalg.norm(towards)
    assert reference.pos_ned_m[0] > 0.5 * LAG_MAX_M


def test_the_plan_waits_for_no_vehicle():
    plan, reference = racetrack(), FormationReference(climb_speed_m_s=1.5)
    reference.reset(plan.own(0, 0.0).pos_ned_m, np.zeros(3))
    advance(reference, plan.own(0, 0.0))
    for k in range(1, 200):
        state = plan.own(0, k * DT_S)
        advance(reference, state, vehicle_ned_m=state.pos_ned_m + np.array((9.0, 0.0, 0.0)))
        assert np.array_equal(reference.pos_ned_m, state.pos_ned_m)


@pytest.mark.parametrize("distance_m", [0.5, 2.0, 4.0, 9.0])
@pytest.mark.parametrize("climb_speed_m_s", [0.3, 1.5])
def test_joining_takes_the_predicted_time(distance_m, climb_speed_m_s):
    """Within the resolution of the steps: braking ends in a step."""
    reference = FormationReference(climb_speed_m_s=climb_speed_m_s)
    target, steps = np.array((0.0, 0.0, -distance_m)), 0
    while not is_at(reference, target):
        reference.advance(target, DT_S)
        steps += 1
    assert steps * DT_S == pytest.approx(joining_time_s(distance_m, climb_speed_m_s), abs=4 * DT_S)
    assert joining_time_s(0.0, climb_speed_m_s) == 0.0


def heights_m(places_ned_m, found):
    return -places_ned_m[:, 2] + SEPARATION_HEIGHT_M * found


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000), st.integers(1, 20), st.floats(0.0, 3.0), st.floats(1.0, 60.0))
def test_places_within_reach_get_heights_apart_and_none_near_the_ground(seed, count, gps_std_m, extent_m):
    rng = np.random.default_rng(seed)
    places = np.column_stack((rng.uniform(-1, 1, (count, 2)) * extent_m, -rng.uniform(2.0, 12.0, count)))
    found = layers(places, gps_std_m)
    height_m = heights_m(places, found)
    apart_m = np.linalg.norm(places[:, None, :2] - places[None, :, :2], axis=2)
    within = np.triu(apart_m < REACH_SIGMAS * np.sqrt(2.0) * gps_std_m, k=1)
    assert (np.abs(height_m[:, None] - height_m[None, :])[within] > SEPARATION_HEIGHT_M - 1e-5).all()
    assert (height_m[found < 0] >= GROUND_CLEARANCE_M).all()
    assert np.array_equal(found, layers(places, gps_std_m))


def test_the_articles_grid_needs_two_layers():
    """4 sigma sqrt(2) 1.5 m is 8.49 m: rows 2.5 m apart are within reach, columns 8.5 m apart are not."""
    assert set(layers(article_places_ned_m(), 1.5)) == {0, 1}
    # At half the wavelength every 2 x 2 block lies within reach: at least four are needed.
    half = article_places_ned_m(4.25, 1.25)
    assert set(layers(half, 1.5)) == {-1, 0, 1, 2}
    # 4 sigma sqrt(2) 0.4 m is 2.26 m
    assert not layers(article_places_ned_m(), 0.4).any()


def timeline(events, *, until_s, own=4):
    """Return times and heights of every change, at 20 Hz; ``events`` (time_s, supported) in order."""
    height_layers = HeightLayers(own=own, places_ned_m=article_places_ned_m(), gps_std_m=1.5)
    changes, supported, known_m = [], True, 0.0
    for k in range(round(until_s / DT_S)):
        time_s = k * DT_S
        for at_s, value in events:
            if time_s >= at_s - 1e-9:
                supported = value
        height_m = height_layers.update(round(time_s * 1e6), supported=supported)
        assert height_m == height_layers.height_m
        if height_m != known_m:
            changes.append((round(time_s, 3), height_m))
            known_m = height_m
    return changes


def test_a_layer_is_reached_when_coasting_ends_and_left_after_lasting_support():
    leave_s = 1.0 + COAST_S - joining_time_s(SEPARATION_HEIGHT_M, 1.5)
    changes = timeline([(1.0, False), (30.0, True)], until_s=50.0)
    assert [height_m for _, height_m in changes] == [SEPARATION_HEIGHT_M, 0.0]
    assert leave_s <= changes[0][0] <= leave_s + DT_S + 1e-9
    assert changes[1][0] == pytest.approx(30.0 + BACK_S)


def test_near_places_are_left_before_odometry_drift_closes_the_gap():
    """A gap of 0.65 m is three sigma of two odometries after 2.3 s: too short for a climb of 3.5 s."""
    places = article_places_ned_m(4.25, 1.25)
    room_s = 0.5 * (0.65 / (DRIFT_SIGMAS * 0.1)) ** 2
    assert apart_s(places[1:, :2] - places[0, :2], 0.1) == pytest.approx(room_s)
    assert room_s < joining_time_s(SEPARATION_HEIGHT_M, 1.5)
    height_layers = HeightLayers(own=5, places_ned_m=places, gps_std_m=1.5)
    assert height_layers.update(0, supported=True) == 0.0
    assert height_layers.update(50_000, supported=False) == 2.0 * SEPARATION_HEIGHT_M
    # Better odometry allows `COAST_S` at any spacing; a lone UAV has no limit.
    assert apart_s(places[1:, :2] - places[0, :2], 0.01) > COAST_S
    assert apart_s(np.zeros((0, 2)), 0.1) == np.inf


def test_short_losses_and_short_returns_have_no_effect():
    assert timeline([(k + part, part > 0.0) for k in range(40) for part in (0.0, 0.5)], until_s=40.0) == []
    flicker = [(1.0, False), *((20.0 + 4.0 * k + part, part == 0.0) for k in range(5) for part in (0.0, 3.0))]
    changes = timeline(flicker, until_s=40.0)
    assert [height_m for _, height_m in changes] == [SEPARATION_HEIGHT_M]


def test_a_uav_with_a_layer_watches_those_that_stay():
    """One of a pair within reach stays at height 0; if it loses support, the other must climb."""
    places = article_places_ned_m()
    found = layers(places, 1.5)
    for own in range(len(places)):
        height_layers = HeightLayers(own=own, places_ned_m=places, gps_std_m=1.5)
        assert height_layers.layer_m == SEPARATION_HEIGHT_M * found[own]
        # the other UAV of the same column, for those with a layer
        assert height_layers.watched == (((own + 4) % 8,) if found[own] else ())


def test_height_layers_prevent_collisions_by_gps_errors():
    """Two UAVs of a column, 2.5 m apart, with corrections that fade into GPS errors of 1.5 m per axis, 60 s.

    20 pairs for 5 minutes: horizontally many pass within 0.6 m; with layers and height errors of 0.3 m none
    does, from the loss on.
    """
    rng = np.random.default_rng(5)
    places = np.array(((0.0, 0.0, -10.0), (2.5, 0.0, -10.0)))
    met, nearest_m = 0, np.inf
    for _ in range(20):
        corrections = [Correction(), Correction()]
        for correction in corrections:
            correction.update(ZERO, ZERO, DT_S, at_once=True)
        references = [FormationReference(climb_speed_m_s=1.5) for _ in range(2)]
        ways = [HeightLayers(own=k, places_ned_m=places, gps_std_m=1.5) for k in range(2)]
        for reference, place in zip(references, places, strict=True):
            reference.reset(place, np.zeros(3))
        bias, height_error_m = 1.5 * rng.standard_normal((2, 2)), 0.3 * rng.standard_normal(2)
        start = bias.copy()
        level_nearest_m = np.inf
        true_ned_m = np.zeros((2, 3))
        for k in range(round(300.0 / 0.25)):
            keep = np.exp(-0.25 / 60.0)
            bias = keep * bias + 1.5 * np.sqrt(1.0 - keep**2) * rng.standard_normal((2, 2))
            for j in range(2):
                # The autopilot follows its bias, odometry does not: the drift is the change of the bias.
                corrections[j].update(bias[j] - start[j], None if k else ZERO, 0.25, at_once=not k)
                height_m = ways[j].update(k * 250_000, supported=False)
                for _ in range(5):
                    references[j].advance(places[j] + (0.0, 0.0, -height_m), DT_S)
                true_ned_m[j] = references[j].pos_ned_m
                true_ned_m[j, :2] += corrections[j].ne_m - (bias[j] - start[j])
                true_ned_m[j, 2] += height_error_m[j]
            way_m = true_ned_m[1] - true_ned_m[0]
            level_nearest_m = min(level_nearest_m, np.hypot(*way_m[:2]))
            nearest_m = min(nearest_m, np.linalg.norm(way_m))
        met += level_nearest_m < 0.6
    assert met >= 5
    assert nearest_m > 1.0
