"""The delayed filter and its prediction to the present."""

import numpy as np
import pytest

from autopilot.estimation import kernels
from autopilot.estimation.estimator import Estimator
from autopilot.estimation.horizon import ACC, ESTIMATE, OMEGA, STD, DelayedHorizon, advance
from autopilot.estimation.kernels import ACCEL_BIAS, GYRO_BIAS, POS, VEL
from autopilot.estimation.params import EstimatorParams

PSD = (1e-6, 1e-4, 1e-8, 1e-6)


def start(delay_us, time_us=0):
    x = np.zeros(kernels.STATES)
    x[0] = 1.0
    x[10:] = [0.01, -0.02, 0.03, 0.1, -0.1, 0.05]
    delayed = DelayedHorizon(x, 0.01 * np.eye(kernels.ERRORS), time_us=time_us, delay_us=delay_us)
    delayed.block["noise"] = PSD
    return delayed


def add(delayed, time_us, gyro_frd_rad_s, accel_frd_m_s2, step_us=4000):
    dt_s = step_us * 1e-6
    return advance(delayed.block, delayed.samples, time_us, dt_s, gyro_frd_rad_s, accel_frd_m_s2)


def samples(count, step_us=4000):
    rng = np.random.default_rng(0)
    return [
        (step_us * (k + 1), rng.normal(0.0, 1.0, 3), rng.normal(0.0, 3.0, 3) - [0.0, 0.0, 9.8])
        for k in range(count)
    ]


def integrated(x, taken, step_us=4000):
    x = x.copy()
    for _, gyro, accel in taken:
        kernels.integrate(x, gyro, accel, step_us * 1e-6)
    return x


def test_the_horizon_is_late_by_the_delay_and_the_estimate_includes_all_samples():
    delayed, taken = start(120_000), samples(200)
    first = delayed.x.copy()
    for k, sample in enumerate(taken):
        add(delayed, *sample)
        assert delayed.horizon_us == max(0, sample[0] - 120_000), k
    np.testing.assert_allclose(delayed.now, integrated(first, taken), atol=1e-12)
    np.testing.assert_allclose(delayed.x, integrated(first, taken[:170]), atol=1e-12)


@pytest.mark.parametrize("delay_us", [0, 20_000, 120_000])
def test_a_correction_at_the_horizon_is_propagated_through_later_samples(delay_us):
    delayed, taken = start(delay_us), samples(100)
    for sample in taken:
        add(delayed, *sample)
    delayed.x[:] = integrated(start(0).x, taken[:5])  # some other state
    expected = integrated(delayed.x, taken[100 - delay_us // 4000 :])
    delayed.corrected()
    np.testing.assert_allclose(delayed.now, expected, atol=1e-12)


def test_without_a_correction_a_new_prediction_changes_nothing():
    delayed = start(120_000)
    for sample in samples(100):
        add(delayed, *sample)
    now, acceleration = delayed.now.copy(), delayed.acc_ned_m_s2.copy()
    delayed.corrected()
    np.testing.assert_allclose(delayed.now, now, atol=1e-12)
    np.testing.assert_allclose(delayed.acc_ned_m_s2, acceleration, atol=1e-12)


def test_samples_faster_than_the_ring_buffer_shorten_the_delay_and_lose_nothing():
    delayed, taken = start(20_000), samples(300, step_us=250)
    first = delayed.x.copy()
    for sample in taken:
        add(delayed, *sample, step_us=250)
    assert 0 < taken[-1][0] - delayed.horizon_us < 20_000
    np.testing.assert_allclose(delayed.now, integrated(first, taken, step_us=250), atol=1e-12)
    delayed.corrected()
    np.testing.assert_allclose(delayed.now, integrated(first, taken, step_us=250), atol=1e-12)


def test_a_gap_is_bridged_by_one_long_sample():
    delayed = start(0)
    delayed.x[10:] = 0.0
    delayed.now[10:] = 0.0
    for time_us, step_us in ((4_000, 4_000), (104_000, 100_000)):
        add(delayed, time_us, np.zeros(3), np.array([1.0, 0.0, -9.80665]), step_us)
    np.testing.assert_allclose(delayed.now[4:7], [0.104, 0.0, 0.0], atol=1e-12)


def test_reset_sets_the_state_and_removes_its_correlations():
    delayed = start(120_000)
    for sample in samples(100):
        add(delayed, *sample)
    others = np.r_[0:6, 8:15]
    kept = delayed.cov[np.ix_(others, others)].copy()
    delayed.reset(kernels.POS, np.array([3.0, -4.0]), np.array([2.0, 5.0]))
    np.testing.assert_array_equal(delayed.x[7:9], [3.0, -4.0])
    np.testing.assert_array_equal(delayed.cov[6:8, 6:8], np.diag([2.0, 5.0]))
    assert not delayed.cov[6:8][:, others].any()
    assert not delayed.cov[others][:, 6:8].any()
    np.testing.assert_array_equal(delayed.cov[np.ix_(others, others)], kept)


def test_a_states_vectors_are_views_of_the_filters_estimate():
    estimate = np.arange(float(ESTIMATE))
    state = Estimator(EstimatorParams()).state
    state.use_memory(estimate)
    begins = {
        "q_ned_frd": 0, "vel_ned_m_s": VEL, "pos_ned_m": POS, "gyro_bias_rad_s": GYRO_BIAS,
        "accel_bias_m_s2": ACCEL_BIAS, "acc_ned_m_s2": ACC, "omega_frd_rad_s": OMEGA,
        "attitude_std_rad": STD, "vel_std_m_s": STD + 3, "pos_std_m": STD + 6,
    }  # fmt: skip
    assert {name: getattr(state, name)[0] for name in begins} == begins
    assert sum(getattr(state, name).size for name in begins) == ESTIMATE
    assert all(np.shares_memory(getattr(state, name), estimate) for name in begins)
