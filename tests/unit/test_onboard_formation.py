"""Formation control: the correction when distances come and go, the reference, keeping clear."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onboard_world import article_places_ned_m

from autopilot.onboard.formation import (
    ACCELERATION_M_S2,
    COAST_S,
    FADE_TIME_CONSTANT_S,
    JOIN_SPEED_M_S,
    OFFSET_RATE_M_S,
    Correction,
    Reference,
    separation_radius_limit_m,
)
from autopilot.onboard.kernels import STATES, separation_push

DT_S = 0.05
ZERO = np.zeros(2)


def settled_correction(offset_ne_m=(-1.2, 0.5)):
    """Make a correction on the ground whose autopilot agrees with odometry: it is minus the offset."""
    correction = Correction()
    correction.update(ZERO, np.array(offset_ne_m), DT_S, at_once=True)
    return correction


def test_without_any_distance_there_is_no_correction():
    correction = Correction()
    for k in range(2_000):
        correction.update(np.array((0.01 * k, 1.0)), None, DT_S, at_once=k < 100)
        assert np.array_equal(correction.ne_m, ZERO)


def test_it_is_the_autopilots_position_less_the_true_one():
    # true = odometry + offset, autopilot = odometry + drift: the correction is drift - offset.
    correction = Correction()
    correction.update(np.array((0.3, -0.2)), np.array((-1.2, 0.5)), DT_S, at_once=True)
    assert correction.ne_m == pytest.approx((1.5, -0.7))


def test_the_autopilots_drift_is_followed_without_delay():
    correction = settled_correction()
    before = correction.ne_m.copy()
    correction.update(np.array((0.4, 0.0)), np.array((-1.2, 0.5)), DT_S, at_once=False)
    assert correction.ne_m - before == pytest.approx((0.4, 0.0))


def test_a_new_estimate_is_taken_over_at_bounded_rate_in_the_air():
    correction = settled_correction()
    target = np.array((3.0, -2.0))
    for _ in range(400):
        before = correction.ne_m.copy()
        correction.update(ZERO, target, DT_S, at_once=False)
        assert np.linalg.norm(correction.ne_m - before) <= OFFSET_RATE_M_S * DT_S + 1e-12
    assert correction.ne_m == pytest.approx(-target, abs=1e-3)


def test_when_distances_stop_it_freezes_then_fades():
    correction = settled_correction()
    frozen = correction.ne_m.copy()
    for _ in range(round(COAST_S / DT_S) - 1):
        correction.update(ZERO, None, DT_S, at_once=False)
        assert np.array_equal(correction.ne_m, frozen)
    for _ in range(round(FADE_TIME_CONSTANT_S / DT_S)):
        correction.update(ZERO, None, DT_S, at_once=False)
    assert correction.ne_m == pytest.approx(frozen / np.e, rel=0.01)


def test_after_fading_it_returns_without_a_jump():
    correction = settled_correction()
    for _ in range(1_000):
        correction.update(ZERO, None, DT_S, at_once=False)
    before = correction.ne_m.copy()
    correction.update(np.array((0.1, 0.0)), np.array((-1.2, 0.5)), DT_S, at_once=False)
    assert np.linalg.norm(correction.ne_m - before) <= OFFSET_RATE_M_S * DT_S + 1e-12
    for _ in range(400):
        correction.update(np.array((0.1, 0.0)), np.array((-1.2, 0.5)), DT_S, at_once=False)
    assert correction.ne_m == pytest.approx((1.3, -0.5), abs=1e-3)


@settings(deadline=None, max_examples=15)  # 150 s of simulated motion each
@given(
    st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-20, 0)),
    st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(-20, 0)),
    st.floats(0.3, 3.0),
)
def test_the_reference_reaches_its_target_within_its_limits_and_does_not_pass_it(
    start, target, climb_speed_m_s
):
    reference = Reference(climb_speed_m_s=climb_speed_m_s)
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
    assert reference.pos_ned_m == pytest.approx(target, abs=1e-3)


def push(positions, *, radius_m=1.2, limit_m=np.inf, std_m=0.0):
    cov = np.eye(STATES * len(positions)) * std_m**2
    out = np.zeros(2)
    separation_push(0, np.array(positions, float), cov, np.ones(len(positions), bool), radius_m, limit_m, out)
    return out


def test_a_near_neighbour_pushes_by_what_is_missing():
    assert push([(0, 0, -5), (0.0, 0.9, -5)]) == pytest.approx((0.0, -0.3))
    assert push([(0, 0, -5), (0.0, 1.3, -5)]) == pytest.approx((0.0, 0.0))


def test_uncertainty_widens_the_radius_by_one_sigma_up_to_the_limit():
    # relative standard deviation is sqrt(2) times each one's
    assert push([(0, 0, -5), (1.3, 0.0, -5)], std_m=0.2) == pytest.approx(
        (-(1.2 + 0.2 * np.sqrt(2) - 1.3), 0.0)
    )
    assert push([(0, 0, -5), (1.3, 0.0, -5)], std_m=5.0, limit_m=1.5) == pytest.approx((-0.2, 0.0))


def test_one_above_the_other_part_in_opposite_directions():
    first = push([(0, 0, -5), (0, 0, -5.5)])
    out = np.zeros(2)
    separation_push(
        1, np.array([(0, 0, -5.0), (0, 0, -5.5)]), np.zeros((10, 10)), np.ones(2, bool), 1.2, np.inf, out
    )
    assert np.linalg.norm(first) == pytest.approx(0.7)
    assert out == pytest.approx(-first)


def test_the_limit_lies_below_the_spacing():
    assert separation_radius_limit_m(article_places_ned_m(), 0) == pytest.approx(0.6 * 2.5)
    assert separation_radius_limit_m(np.zeros((1, 3)), 0) == np.inf
