"""Collision avoidance: when it has no effect, minimality of the change, and crowds. Run time: 10 s."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from onboard_world import article_places_ned_m

from autopilot.onboard.formation.avoidance import (
    CLOSING_1_S,
    FRESH_US,
    GROWTH_M_S,
    KEEP_US,
    LEAD_S,
    SIGMAS,
    SPACING_SHARE,
    Avoidance,
    _nearest,
)
from autopilot.onboard.formation.formation_control import FormationReference
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.onboard.localisation.uncertainty import SEEN
from autopilot.parameters.config import RacetrackMotion

POSITION_P_1_S = 0.95
DENSE = article_places_ned_m(4.25, 1.25)
FAR_APART = np.array(((0.0, -50.0, -10.0), (0.0, 50.0, -10.0)))
STILL = np.zeros(3)


def as_seen(pos_ned_m, vel_ned_m_s, std_m, *, fresh=True):
    others = np.zeros(len(pos_ned_m), SEEN)
    others["pos_ned_m"], others["vel_ned_m_s"] = pos_ned_m, vel_ned_m_s
    others["std_m"], others["fresh"] = std_m, fresh
    return others


def change(
    positions, desired_ne_m_s=(0.0, 0.0), *, own=0, places=FAR_APART, velocities=None, std_m=0.0,
    radius_m=1.2, goal=None, plan_vel=None, avoidance=None, now_us=0, fresh=None, in_place=True,
):  # fmt: skip
    """Return one velocity change; ``in_place``: the own position is its place, regardless of ``places``."""
    positions = np.array(positions, float)
    n = len(positions)
    plan = places[:n].copy()
    if in_place:
        plan[own] = positions[own]
    avoidance = avoidance or Avoidance(own=own, places_ned_m=places[:n], radius_m=radius_m)
    change_ne_m_s = avoidance.velocity_change_ne_m_s(
        now_us,
        others=as_seen(
            positions,
            np.zeros((n, 3)) if velocities is None else np.array(velocities, float),
            std_m,
            fresh=True if fresh is None else np.array(fresh),
        ),
        plan_pos_ned_m=plan,
        plan_vel_ned_m_s=np.zeros((n, 3)) if plan_vel is None else np.array(plan_vel, float),
        goal_ned_m=positions[own] if goal is None else np.array(goal, float),
        desired_ne_m_s=np.array(desired_ne_m_s, float),
    )
    return np.array(change_ne_m_s)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 10_000), st.sampled_from((1.25, 2.5, 10.0)), st.floats(0.0, 3.0))
def test_in_formation_nothing_is_changed_up_to_a_fifth_of_the_spacing_at_any_uncertainty(
    seed, spacing_m, std_m
):
    """All UAVs return to their places by the position loop; the change is exactly zero."""
    rng = np.random.default_rng(seed)
    places = article_places_ned_m(3.4 * spacing_m, spacing_m)
    errors_m = np.zeros((8, 3))
    size_m, course_rad = 0.2 * spacing_m * rng.uniform(0, 1, 8), rng.uniform(-math.pi, math.pi, 8)
    errors_m[:, 0], errors_m[:, 1] = size_m * np.cos(course_rad), size_m * np.sin(course_rad)
    for own in range(8):
        desired = -POSITION_P_1_S * errors_m[own, :2]
        found = change(
            places + errors_m, desired, own=own, places=places, std_m=std_m, goal=places[own], in_place=False
        )
        assert np.array_equal(found, (0.0, 0.0))


def test_the_gap_closes_at_its_rate_half_by_each():
    """Head-on, 3 m apart, with a reach of 1.2 m + 2 sigma: each may close half of the gap per second."""
    gap_m = 3.0 - 1.2 - SIGMAS * 0.1
    found = change([(0, 0, -5), (3.0, 0, -5)], (2.0, 0.0), std_m=0.1, goal=(3.0, 0.0, -5))
    assert found == pytest.approx((0.5 * CLOSING_1_S * gap_m - 2.0, 0.0))
    # a pair that is too near separates, each by half
    found = change([(0, 0, -5), (1.0, 0, -5)], std_m=0.1)
    assert found == pytest.approx((0.5 * CLOSING_1_S * (1.0 - 1.4), 0.0))


def test_the_own_uav_compensates_a_neighbour_that_approaches_too_fast():
    """At 1 m/s, 2.5 m outside of the reach, the neighbour keeps to its half of the gap per second: no change.

    At 0.3 m from the reach it exceeds its half: the own UAV recedes at its speed, and faster by half of the
    gap that will be missing at the end of the lead.
    """
    far = change([(0, 0, -5), (1.2 + 2.5 + LEAD_S, 0, -5)], velocities=[STILL, (-1.0, 0, 0)])
    assert np.array_equal(far, (0.0, 0.0))
    near = change([(0, 0, -5), (1.5, 0, -5)], velocities=[STILL, (-1.0, 0, 0)])
    assert near == pytest.approx((-1.0 + 0.5 * CLOSING_1_S * (0.3 - LEAD_S * 1.0), 0.0))
    found = change([(0, 0, -5), (1.5, 0, -5)], velocities=[STILL, (1.0, 0, 0)])
    assert np.array_equal(found, (0.0, 0.0))


def test_the_formations_own_motion_is_no_approach():
    """Neighbours in place in a row that flies at 5 m/s along itself are equivalent to standing ones."""
    velocities = np.tile((5.0, 0.0, 0.0), (8, 1))
    for own in range(8):
        found = change(
            DENSE, (5.0, 0.0), own=own, places=DENSE, velocities=velocities, plan_vel=velocities, std_m=0.2
        )
        assert np.array_equal(found, (0.0, 0.0))


@settings(deadline=None, max_examples=200)
@given(
    st.floats(0.3, 2.5), st.floats(-math.pi, math.pi), st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
    st.floats(0.0, 0.5),
)  # fmt: skip
def test_a_pair_reacts_alike(distance_m, course_rad, vel_ne_m_s, std_m):
    """Turned by half a circle the two have the same inputs, so their changes are equal."""
    way = distance_m * np.array((math.cos(course_rad), math.sin(course_rad), 0.0))
    vel = np.array((*vel_ne_m_s, 0.0))
    given_ = {"velocities": [vel, -vel], "std_m": std_m}
    first = change([STILL, way], vel[:2], own=0, goal=50.0 * vel, **given_)
    second = change([STILL, way], -vel[:2], own=1, goal=way - 50.0 * vel, **given_)
    assert second == pytest.approx(-first, abs=1e-9)


def test_one_above_the_other_part_in_opposite_directions_unless_high_enough_apart():
    stacked = [(0, 0, -5), (0, 0, -5.5)]
    first, second = change(stacked, own=0), change(stacked, own=1)
    assert np.linalg.norm(first) > 0.3
    assert second == pytest.approx(-first)
    # a layer apart: unsure as one may be horizontally, above is above
    for own in (0, 1):
        apart = [(0, 0, -5), (0.0, 0, -7.0)]
        assert np.array_equal(change(apart, own=own, std_m=2.0), (0.0, 0.0))


@settings(deadline=None, max_examples=300)
@given(st.integers(0, 10_000), st.integers(1, 5))
@example(2560, 5)  # nearly parallel lines, for which the ascent is slowest
@example(3151, 4)
def test_the_velocity_is_the_nearest_one_that_keeps_all_bounds(seed, count):
    """Compare with all candidates: the desired velocity, its projections on the lines, and intersections.

    Bounds are kept to 5 mm/s. If two lines intersect at a small angle, that is a longer distance along them.
    """
    rng = np.random.default_rng(seed)
    course = rng.uniform(-math.pi, math.pi, count)
    normals = np.column_stack((np.cos(course), np.sin(course)))
    bounds = rng.uniform(-1.0, -0.05, count)  # zero velocity keeps them all
    desired = rng.uniform(-1.5, 1.5, 2)
    found = np.empty(2)
    _nearest(normals, bounds, desired, found)
    assert (normals @ found >= bounds - 0.005).all()
    least_m_s, best_m_s = (_least_change(normals, each, desired) for each in (bounds - 0.005, bounds))
    assert least_m_s - 1e-9 <= np.linalg.norm(found - desired) <= best_m_s + 0.005


def _least_change(normals, bounds, desired):
    """Return the distance from the desired velocity to the nearest one that keeps all bounds."""
    candidates = [desired, *(desired + (b - n @ desired) * n for n, b in zip(normals, bounds, strict=True))]
    for i, j in itertools.combinations(range(len(bounds)), 2):
        pair = normals[[i, j]]
        if abs(np.linalg.det(pair)) > 1e-9:
            candidates.append(np.linalg.solve(pair, bounds[[i, j]]))
    kept = [v for v in candidates if (normals @ v >= bounds - 1e-9).all()]
    return min(np.linalg.norm(v - desired) for v in kept)


def test_a_silent_neighbour_is_avoided_where_the_plan_has_it_for_some_time():
    avoidance = Avoidance(own=0, places_ned_m=FAR_APART, radius_m=1.2)
    at = {"avoidance": avoidance, "places": FAR_APART}
    beside = FAR_APART[1] - (0.0, 98.0, 0.0)  # 2 m from the own place
    positions = np.array((FAR_APART[0], beside))
    assert np.array_equal(change(positions, now_us=0, **at), (0.0, 0.0))
    # From then on there is no valid estimate of it: the position passed for it is ignored.
    positions[1] = (0.0, -50.0, -10.0)
    quiet = {"fresh": (False, False), **at}  # the own position counts, located or not
    early = change(positions, (0.0, 2.0), now_us=FRESH_US, **quiet)
    late = change(positions, (0.0, 2.0), now_us=3 * FRESH_US, **quiet)
    gap_m = 2.0 - 1.2 - SIGMAS * GROWTH_M_S * np.array((1.0, 3.0))
    assert (early[1], late[1]) == pytest.approx(tuple(0.5 * CLOSING_1_S * gap_m - 2.0))
    assert np.array_equal(change(positions, (0.0, 2.0), now_us=KEEP_US, **quiet), (0.0, 0.0))
    assert np.array_equal(change(positions, now_us=KEEP_US + 1, **quiet), (0.0, 0.0))


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_nan_and_infinity_do_not_reach_the_setpoint(wrong):
    positions = [(0, 0, -5), (wrong, 0.0, -5), (0.0, 1.0, -5)]
    places = np.array(((0.0, 0.0, -5), (0.0, 50.0, -5), (50.0, 0.0, -5)))
    assert np.isfinite(change(positions, (0.1, 0.1), places=places, std_m=0.1)).all()
    found = change(positions, (0.1, 0.1), places=places, velocities=[STILL, STILL, (0.0, wrong, 0.0)])
    assert np.isfinite(found).all()


def test_a_lone_uav_avoids_nothing():
    assert np.array_equal(change([(0, 0, -5)], (3.0, 0.0)), (0.0, 0.0))


STEP_S = 0.01


class Crowd:
    """UAVs as points with a position loop like the autopilot's and with estimation errors.

    The velocity loop has PX4's gains and the attitude's lag of 0.15 s; accelerations are limited to 5 m/s^2
    and disturbed by gusts. Position errors have a time constant of 5 s; positions of others are 0.15 s late
    and extrapolated.
    """

    def __init__(self, places, start, seed, *, error_std_m, gust_std_m_s2, avoid=True, plan=None):
        self.n = len(places)
        self.rng = np.random.default_rng(seed)
        self.pos, self.vel = start.copy(), np.zeros((self.n, 3))
        self.acc, self.integral = np.zeros((self.n, 3)), np.zeros((self.n, 3))
        self.stds = (error_std_m, gust_std_m_s2)
        self.error = error_std_m * self.rng.standard_normal((self.n, 2))
        self.gust = gust_std_m_s2 * self.rng.standard_normal((self.n, 3))
        self.references = [FormationReference(climb_speed_m_s=1.5) for _ in range(self.n)]
        for reference, place in zip(self.references, start, strict=True):
            reference.reset(place, STILL)
        self.plan = plan or FormationPlan(places, 0.0, None)
        self.avoidance = None
        if avoid:
            self.avoidance = [Avoidance(own=k, places_ned_m=places, radius_m=1.2) for k in range(self.n)]
        self.setpoints = np.zeros((3, self.n, 3))
        self.history = []
        self.least_m, self.pushes, self.miss_m = math.inf, [], math.inf

    def fly(self, seconds):
        for k in range(round(seconds / STEP_S)):
            self._step(k)
        return self

    def _step(self, k):
        for value, std, tau_s in ((self.error, self.stds[0], 5.0), (self.gust, self.stds[1], 2.0)):
            keep = math.exp(-STEP_S / tau_s)
            value *= keep
            value += std * math.sqrt(1.0 - keep**2) * self.rng.standard_normal(value.shape)
        known = self.pos.copy()
        known[:, :2] += self.error
        self.history.append((known, self.vel.copy()))
        if k % 5 == 0:
            self._set(k, known)
        pos, vel, acc = self.setpoints
        miss = POSITION_P_1_S * (pos - known) + vel - self.vel
        desired = np.clip(1.8 * miss + self.integral + acc, -5.0, 5.0)
        self.integral += 0.4 * miss * STEP_S
        self.acc += (desired - self.acc) * STEP_S / 0.15
        self.vel += (self.acc + self.gust) * STEP_S
        self.pos += self.vel * STEP_S
        way = self.pos[:, None] - self.pos[None]
        apart_m2 = (way**2).sum(axis=2) + 1e9 * np.eye(self.n)
        self.least_m = min(self.least_m, math.sqrt(apart_m2.min()))

    def _set(self, k, known):
        late = min(k, 15)
        seen, moving = self.history[k - late]
        seen = seen + moving * late * STEP_S
        plan = self.plan.at(k * STEP_S)
        for i, reference in enumerate(self.references):
            reference.advance(
                plan.pos_ned_m[i], 0.05, target_vel_ned_m_s=plan.vel_ned_m_s[i],
                target_acc_ned_m_s2=plan.acc_ned_m_s2[i], vehicle_ned_m=known[i],
            )  # fmt: skip
            pos, vel = reference.pos_ned_m, reference.vel_ned_m_s
            self.setpoints[:, i] = (pos, vel, reference.acc_ned_m_s2)
            if self.avoidance is None:
                continue
            positions, velocities = seen.copy(), moving.copy()
            positions[i], velocities[i] = known[i], self.vel[i]
            push = self.avoidance[i].velocity_change_ne_m_s(
                round(k * STEP_S * 1e6), others=as_seen(positions, velocities, 0.2),
                plan_pos_ned_m=plan.pos_ned_m, plan_vel_ned_m_s=plan.vel_ned_m_s,
                goal_ned_m=plan.pos_ned_m[i],
                desired_ne_m_s=POSITION_P_1_S * (pos - known[i])[:2] + vel[:2],
            )  # fmt: skip
            self.pushes.append(math.hypot(*push))
            self.setpoints[1, i, :2] += push
        self.miss_m = float(np.linalg.norm((self.pos - plan.pos_ned_m)[:, :2], axis=1).max())


def scattered(rng, extent_m):
    """Return (8, 3) points at one height, no two within 2.5 m."""
    while True:
        points = np.column_stack((rng.uniform(-extent_m, extent_m, (8, 2)), np.full(8, -10.0)))
        apart = np.linalg.norm(points[:, None] - points[None], axis=2) + 1e9 * np.eye(8)
        if apart.min() > 2.5:
            return points


@pytest.mark.parametrize("extent_m", [6.0, 12.0])
def test_eight_cross_each_other_and_arrive(extent_m):
    """Between random places at one height, with errors of 0.15 m per axis; without avoidance they collide."""
    blind_m = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        start, places = scattered(rng, extent_m), scattered(rng, extent_m)
        errors = {"error_std_m": 0.15, "gust_std_m_s2": 0.35}
        crowd = Crowd(places, start, seed, **errors).fly(45.0)
        assert crowd.least_m > 1.0
        assert crowd.miss_m < 1.0
        blind_m.append(Crowd(places, start, seed, avoid=False, **errors).fly(25.0).least_m)
    assert sum(least_m < 0.7 for least_m in blind_m) >= 1


def test_two_uavs_head_on_pass_each_other():
    """Exactly head-on, and one past another that stays; none waits for ever."""
    ends = np.array(((-6.0, 0.0, -10.0), (6.0, 0.0, -10.0)))
    crowd = Crowd(ends[::-1], ends, 0, error_std_m=0.0, gust_std_m_s2=0.0).fly(30.0)
    assert crowd.least_m > 1.2
    assert crowd.miss_m < 0.1
    places = np.array(((6.0, 0.0, -10.0), (0.0, 0.0, -10.0)))
    start = np.array(((-6.0, 0.0, -10.0), (0.0, 0.0, -10.0)))
    crowd = Crowd(places, start, 0, error_std_m=0.0, gust_std_m_s2=0.0).fly(40.0)
    assert crowd.least_m > 1.2
    assert crowd.miss_m < 0.1


@pytest.mark.parametrize("moving", [False, True])
def test_a_dense_formation_is_hardly_changed(moving):
    """Spacing 1.25 m, position errors of 0.15 m rms, weak gusts, standing and on a racetrack.

    Never nearer than 0.7 m, and hardly any velocity change.
    """
    motion = RacetrackMotion(speed_m_s=3.0, length_m=20.0, radius_m=25.0) if moving else None
    given_ = {"error_std_m": 0.15 / math.sqrt(2.0), "gust_std_m_s2": 0.1}
    for seed in (0, 1):
        plan = FormationPlan(DENSE, 0.0, motion)
        crowd = Crowd(DENSE, DENSE, seed, plan=plan, **given_).fly(40.0)
        assert crowd.least_m > 0.7
        assert np.mean(np.array(crowd.pushes) > 0.0) < 0.02
        assert max(crowd.pushes) < 0.5


def test_strong_gusts_in_a_dense_formation_cause_no_oscillation():
    """Independent gusts of 0.35 m/s^2 push UAVs together; avoidance increases the least distance."""
    nearest_m = []
    for avoid in (True, False):
        found = [
            Crowd(DENSE, DENSE, seed, avoid=avoid, error_std_m=0.1, gust_std_m_s2=0.35).fly(40.0).least_m
            for seed in range(4)
        ]
        nearest_m.append((min(found), np.mean(found)))
    with_it, without = nearest_m
    assert with_it[0] > 0.6
    assert with_it[1] > without[1]


def test_reach_is_within_what_the_places_allow():
    """At any uncertainty: 0.6 of the distance of the pair's places, in place."""
    places = np.array(((0.0, 0.0, -10.0), (0.0, 2.5, -10.0)))
    reach_m = SPACING_SHARE * 2.5
    for apart_m, moves in ((reach_m - 0.01, True), (reach_m + 0.01, False)):
        found = change([(0, 0, -10), (0, apart_m, -10)], places=places, std_m=5.0)
        assert found.any() == moves
