"""What the localisation filter is made of, each part alone: kernels, fixes, trust, bending."""

import numpy as np
import pytest

from autopilot.onboard import kernels
from autopilot.onboard.fixes import FixGroup, FixMean
from autopilot.onboard.trust import Trust
from autopilot.onboard.uncertainty import bend

N = 8
PAIRS = [(i, j) for i in range(N) for j in range(N) if i != j]


def test_odometry_between_samples_is_exact_for_constant_acceleration():
    times_us = np.arange(8, dtype=np.int64) * 100_000
    t = times_us * 1e-6
    samples = np.column_stack((t**2, -3.0 * t, np.full(8, -5.0), 2.0 * t, np.full(8, -3.0), np.zeros(8)))
    out = np.empty(3)
    for time_us in (0, 30_000, 100_000, 649_999):
        s = time_us * 1e-6
        assert kernels.odometry_at(times_us, samples, 8, time_us, out) == kernels.KNOWN
        assert out == pytest.approx((s**2, -3.0 * s, -5.0), abs=1e-12)
    assert kernels.odometry_at(times_us, samples, 8, 700_001, out) == kernels.NOT_YET
    # The ninth sample takes the first one's slot: what was before the second is forgotten.
    times_us[0], samples[0] = 800_000, (0.64, -2.4, -5.0, 1.6, -3.0, 0.0)
    assert kernels.odometry_at(times_us, samples, 9, 50_000, out) == kernels.TOO_OLD
    assert kernels.odometry_at(times_us, samples, 9, 749_999, out) == kernels.KNOWN
    assert out == pytest.approx((0.749999**2, -3.0 * 0.749999, -5.0), abs=1e-12)


def test_the_mean_of_fixes_is_exact_and_dated():
    group = FixGroup()
    for k in range(4):
        assert group.add(200_000 * k, (1.0 + k, 2.0, 3.0), (1.0, 1.0, 1.0), at_once=False) is None
    mean = group.add(800_000, (5.0, 2.0, 3.0), (1.0, 1.0, 1.0), at_once=False)
    assert mean == FixMean((2.0, 1.0, 2.0), 400_000, 5, 800_000)
    lone = group.add(1_000_000, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), at_once=True)
    assert lone == FixMean((1.0, 0.0, 0.0), 1_000_000, 1, 0)


def test_who_measures_wrongly_is_told_from_who_is_elsewhere():
    """Each pair by both ends, in turn; UAV 3 lies, or stands elsewhere."""
    for elsewhere in (False, True):
        trust = Trust(N)
        for _ in range(4):
            for i, j in PAIRS:
                trust.note(i, j, badly=i == 3 or (elsewhere and j == 3))
        assert trust.distrusted == [not elsewhere and k == 3 for k in range(N)]
        assert [trust.elsewhere(k) for k in range(N)] == [elsewhere and k == 3 for k in range(N)]
        for _ in range(4):
            for i, j in PAIRS:
                trust.note(i, j, badly=False)
        assert not any(trust.distrusted)
        assert not any(trust.elsewhere(k) for k in range(N))


def test_a_part_that_misfits_for_half_a_minute_is_suspect_and_what_spoils_all_is_not():
    """Of four UAVs 0 and 3 misfit to each other: a third of their distances, and none of 1 and 2.

    Blocked lines of sight that spoil two in five everywhere are nobody's place.
    """
    rng = np.random.default_rng(1)
    pairs = [(i, j) for i in range(4) for j in range(4) if i != j]
    for blocked in (False, True):
        trust = Trust(4)
        for second in range(70):
            for i, j in pairs:
                trust.note(i, j, badly=rng.random() < 0.4 if blocked else {i, j} == {0, 3})
            suspects = trust.suspects(second * 1_000_000, range(4))
            # The share is over the limit within ten seconds, and half a minute later it is time.
            assert not suspects or second >= 30
            if suspects:
                break
        assert suspects == (set() if blocked else {0, 3})
        assert not trust.suspects(second * 1_000_000, range(4))


def test_bending_lengthens_a_line_and_turning_nothing():
    """Two of three in a line known across it to sigma: sigma^2 / 2 d; a turn of the whole: nothing."""
    line_m = np.array([(0.0, -8.0), (0.0, 0.0), (0.0, 8.0)])
    out_m, out_var_m2 = np.empty((2, 3, 3))
    cov = np.zeros((15, 15))
    cov[5, 5] = 1.0  # the middle one, across
    bend(line_m, line_m, cov, np.arange(3), out_m, out_var_m2)
    assert out_m[0, 1] == out_m[1, 2] == pytest.approx(1.0 / 16.0)
    assert out_m[0, 2] == pytest.approx(0.0, abs=1e-12)
    turn = np.zeros(15)
    turn[[0, 5, 10]] = 0.1 * line_m[:, 1]
    bend(line_m, line_m, np.outer(turn, turn), np.arange(3), out_m, out_var_m2)
    assert out_m == pytest.approx(np.zeros((3, 3)), abs=1e-12)
    assert out_var_m2 == pytest.approx(np.zeros((3, 3)), abs=1e-12)


def test_the_variance_of_bending_is_that_of_the_distance():
    """Of sqrt(d^2 + y^2) to second order, y drawn about where it is estimated with its own sigma.

    20 000 draws tell a standard deviation to 1 / sqrt(40 000) = 0.5 %, a mean of 0.1 m to 0.004 m; the fourth
    order of the distance, y^4 / 8 d^3, is 2 % of the second here.
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
