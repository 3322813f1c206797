"""Parts of the localisation filter: odometry history, means of fixes, trust, bending."""

import numpy as np
import pytest

from autopilot.onboard.localisation.members import new_members
from autopilot.onboard.localisation.receivers import add_fix
from autopilot.onboard.localisation.tracks import SAMPLES, Tracks, odometry_at, push
from autopilot.onboard.localisation.trust import ELSEWHERE_LIMIT, Trust, note
from autopilot.onboard.localisation.uncertainty import bend

N = 8
PAIRS = [(i, j) for i in range(N) for j in range(N) if i != j]


def test_odometry_between_samples_is_exact_for_constant_acceleration():
    members, out, step = new_members(2), np.empty(3), np.empty(2)
    rings = Tracks(members).rings

    def moved(k):
        t = 0.1 * k
        return np.array((t**2, -3.0 * t, -5.0, 2.0 * t, -3.0, 0.0))

    for k in range(8):
        push(members, rings, 1, 100_000 * k, moved(k), step)
    for time_us in (0, 30_000, 100_000, 649_999):
        s = time_us * 1e-6
        assert odometry_at(rings, 1, time_us, out)
        assert out == pytest.approx((s**2, -3.0 * s, -5.0), abs=1e-12)
    assert not odometry_at(rings, 1, 700_001, out)
    # One sample more than the capacity overwrites the first one.
    for k in range(8, SAMPLES + 1):
        push(members, rings, 1, 100_000 * k, moved(k), step)
    assert not odometry_at(rings, 1, 50_000, out)
    last_s = 0.1 * SAMPLES - 1e-6
    assert odometry_at(rings, 1, round(1e6 * last_s), out)
    assert out == pytest.approx((last_s**2, -3.0 * last_s, -5.0), abs=1e-12)


def test_the_mean_of_fixes_and_its_time_are_exact():
    members = new_members(1)

    def added(time_us, *pos_ned_m, at_once=False):
        odometry_ned_m = np.full(3, 1.0)
        return add_fix(members, 0, time_us, np.array(pos_ned_m), odometry_ned_m, at_once)

    def mean():
        kept = members[0]
        return (*kept["less_odometry_ned_m"].tolist(), kept["mean_us"], kept["mean_fixes"], kept["span_us"])

    for k in range(4):
        assert not added(200_000 * k, 1.0 + k, 2.0, 4.0)
    assert added(800_000, 5.0, 2.0, 4.0)
    assert mean() == (2.0, 1.0, 3.0, 400_000, 5, 800_000)
    assert added(1_000_000, 2.0, 1.0, 1.0, at_once=True)
    assert mean() == (1.0, 0.0, 0.0, 1_000_000, 1, 0)


def test_wrong_measurements_are_distinguished_from_a_wrong_position():
    """Each pair by both ends, in turn; UAV 3 measures wrongly, or has a wrong position."""
    for elsewhere in (False, True):
        members, third = new_members(N), np.arange(N) == 3
        for _ in range(4):
            for i, j in PAIRS:
                note(members, i, j, i == 3 or (elsewhere and j == 3))
        assert np.array_equal(members["distrusted"] != 0, third & (not elsewhere))
        assert np.array_equal(members["as_end"] > ELSEWHERE_LIMIT, third & elsewhere)
        for _ in range(4):
            for i, j in PAIRS:
                note(members, i, j, badly=False)
        assert not any(members["distrusted"])
        assert not any(members["as_end"] > ELSEWHERE_LIMIT)


def test_lasting_misfits_of_some_uavs_are_suspect_and_those_of_all_are_not():
    """Of four UAVs 0 and 3 misfit to each other: a third of their distances, and none of 1 and 2.

    Blocked lines of sight that spoil 40 % of all distances indicate no wrong position.
    """
    rng = np.random.default_rng(1)
    pairs = [(i, j) for i in range(4) for j in range(4) if i != j]
    for blocked in (False, True):
        members = new_members(4)
        trust = Trust(members)
        for second in range(70):
            for i, j in pairs:
                note(members, i, j, rng.random() < 0.4 if blocked else {i, j} == {0, 3})
            suspects = trust.suspects(second * 1_000_000, range(4))
            # The share exceeds the limit within ten seconds, and is suspected half a minute later.
            assert not suspects or second >= 30
            if suspects:
                break
        assert suspects == (set() if blocked else {0, 3})
        assert not trust.suspects(second * 1_000_000, range(4))


def test_bending_lengthens_a_line_and_turning_nothing():
    """One of three in a line uncertain across it by sigma: sigma^2 / 2 d; a turn of the whole: 0."""
    line_m = np.array([(0.0, -8.0), (0.0, 0.0), (0.0, 8.0)])
    out_m, out_var_m2 = np.empty((2, 3, 3))
    cov = np.zeros((15, 15))
    cov[5, 5] = 1.0  # the middle one, across the line
    bend(line_m, line_m, cov, np.arange(3), out_m, out_var_m2)
    assert out_m[0, 1] == out_m[1, 2] == pytest.approx(1.0 / 16.0)
    assert out_m[0, 2] == pytest.approx(0.0, abs=1e-12)
    turn = np.zeros(15)
    turn[[0, 5, 10]] = 0.1 * line_m[:, 1]
    bend(line_m, line_m, np.outer(turn, turn), np.arange(3), out_m, out_var_m2)
    assert out_m == pytest.approx(np.zeros((3, 3)), abs=1e-12)
    assert out_var_m2 == pytest.approx(np.zeros((3, 3)), abs=1e-12)


def test_the_variance_of_bending_is_that_of_the_distance():
    """That of sqrt(d^2 + y^2) to second order, with y drawn about its estimate with its sigma.

    20 000 draws give a standard deviation to 1 / sqrt(40 000) = 0.5 %, and a mean of 0.1 m to 0.004 m. The
    fourth-order term of the distance, y^4 / 8 d^3, is 2 % of the second-order one here.
    """
    rng = np.random.default_rng(1)
    line_m = np.array([(0.0, -8.0), (0.0, 0.0), (0.0, 8.0)])
    out_m, out_var_m2 = np.empty((2, 3, 3))
    cov = np.zeros((15, 15))
    cov[5, 5] = 0.8**2
    for across_m in (0.0, 1.0, -2.0):
        pos_m = line_m + np.array([(0.0, 0.0), (across_m, 0.0), (0.0, 0.0)])
        bend(line_m, pos_m, cov, np.arange(3), out_m, out_var_m2)
        longer_m = np.hypot(8.0, across_m + rng.normal(0.0, 0.8, 20_000)) - np.hypot(8.0, across_m)
        assert out_m[0, 1] == pytest.approx(longer_m.mean(), abs=0.008)
        assert np.sqrt(out_var_m2[1, 2]) == pytest.approx(longer_m.std(), rel=0.08)
