"""The filter's arithmetic: Jacobians by finite differences, covariance and updates by textbook forms."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from estimation_fixtures import FIELD_NED_GAUSS, figure_eight, replay, simulate
from paths import SUPPORT
from scipy.spatial.transform import Rotation

from autopilot.estimation import kernels
from autopilot.estimation.estimator import Estimator
from autopilot.estimation.params import EstimatorParams
from foundation.kernels.records import new_records

NO_LIMITS = np.full(2, np.inf)


def some_state(rng):
    x = rng.normal(0.0, 1.0, kernels.STATES)
    x[:4] /= np.linalg.norm(x[:4])
    x[10:] *= 0.05
    return x


def some_covariance(rng):
    root = rng.normal(0.0, 0.3, (kernels.ERRORS, kernels.ERRORS))
    return root @ root.T + 0.1 * np.eye(kernels.ERRORS)


def difference(x_true, x):
    """Form the error state: true minus estimated, attitude as a rotation vector in NED."""
    turn = (
        Rotation.from_quat(x_true[:4], scalar_first=True) * Rotation.from_quat(x[:4], scalar_first=True).inv()
    )
    return np.concatenate((turn.as_rotvec(), x_true[4:] - x[4:]))


def moved(x, error):
    x = x.copy()
    kernels.inject_error(x, error, NO_LIMITS)
    return x


def dense_transition(from_bias, vel_from_attitude, dt_s):
    transition = np.eye(kernels.ERRORS)
    transition[0:3, 9:12] = from_bias
    transition[3:6, 0:3] = vel_from_attitude
    transition[3:6, 12:15] = from_bias
    transition[6:9, 3:6] = dt_s * np.eye(3)
    return transition


def textbook_update(cov, jacobian, noise_cov):
    """Joseph's form."""
    gain = cov @ jacobian.T @ np.linalg.inv(jacobian @ cov @ jacobian.T + noise_cov)
    keep = np.eye(kernels.ERRORS) - gain @ jacobian
    return gain, keep @ cov @ keep.T + gain @ noise_cov @ gain.T


def test_an_injected_error_is_equal_to_the_resulting_difference():
    rng = np.random.default_rng(0)
    x = some_state(rng)
    error = rng.normal(0.0, 0.1, kernels.ERRORS)
    np.testing.assert_allclose(difference(moved(x, error), x), error, atol=1e-13)


def test_biases_stay_within_their_limits():
    x = np.zeros(kernels.STATES)
    x[0] = 1.0
    kernels.inject_error(x, np.array([0.0] * 9 + [9.0, -9.0, 0.1] * 2), np.array([0.15, 0.4]))
    np.testing.assert_array_equal(x[10:], [0.15, -0.15, 0.1, 0.4, -0.4, 0.1])


def test_error_transition_agrees_with_finite_differences():
    rng = np.random.default_rng(2)
    dt_s, h = 1e-3, 1e-6
    for _ in range(5):
        x, gyro_rad_s, accel_m_s2 = some_state(rng), rng.normal(0.0, 2.0, 3), rng.normal(0.0, 10.0, 3)
        after = x.copy()
        kernels.integrate(after, gyro_rad_s, accel_m_s2, dt_s)
        numeric = np.empty((kernels.ERRORS, kernels.ERRORS))
        for column in range(kernels.ERRORS):
            ends = []
            for sign in (1.0, -1.0):
                end = moved(x, sign * h * np.eye(kernels.ERRORS)[column])
                kernels.integrate(end, gyro_rad_s, accel_m_s2, dt_s)
                ends.append(difference(end, after))
            numeric[:, column] = (ends[0] - ends[1]) / (2.0 * h)
        analytic = dense_transition(*kernels.error_transition(x, accel_m_s2, dt_s), dt_s)
        # neglected are terms of dt^2 x (force x rate, up to 30 x 4, halved) and less
        np.testing.assert_allclose(analytic, numeric, atol=60.0 * dt_s**2)
        # and the included ones are far larger
        assert np.abs(analytic[3:6, 0:3]).max() > 1e-3


def test_integration_over_one_step_follows_a_steady_turn():
    """A body yaws and accelerates along its nose: the mean force of a step is rotated by half the angle."""
    x = np.zeros(kernels.STATES)
    x[0] = 1.0
    rate_rad_s, force_m_s2, dt_s = 2.0, 3.0, 0.004
    for _ in range(250):
        kernels.integrate(x, np.array([0.0, 0.0, rate_rad_s]), np.array([force_m_s2, 0.0, -9.80665]), dt_s)
    turned_rad = rate_rad_s * 1.0
    exact_vel = force_m_s2 / rate_rad_s * np.array([np.sin(turned_rad), 1.0 - np.cos(turned_rad), 0.0])
    pos_shape = np.array([1.0 - np.cos(turned_rad), turned_rad - np.sin(turned_rad), 0.0])
    exact_pos = force_m_s2 / rate_rad_s**2 * pos_shape
    # the midpoint rule has a relative error of (rate dt)^2 / 24 in velocity; position adds that of the step's
    # shape
    np.testing.assert_allclose(x[4:7], exact_vel, atol=force_m_s2 * (rate_rad_s * dt_s) ** 2 / 24.0 * 1.1)
    np.testing.assert_allclose(x[7:10], exact_pos, atol=force_m_s2 * rate_rad_s * dt_s**2)


def test_covariance_prediction_is_the_dense_product():
    rng = np.random.default_rng(3)
    cov, dt_s = some_covariance(rng), 0.004
    psd = (1e-6, 1e-4, 1e-8, 1e-6)
    process_noise = new_records(kernels.ProcessNoise)
    process_noise[0] = psd
    blocks = kernels.error_transition(some_state(rng), rng.normal(0.0, 10.0, 3), dt_s)
    transition = dense_transition(*blocks, dt_s)
    noise = dt_s * np.diag(np.repeat([psd[0], psd[1], 0.0, psd[2], psd[3]], 3))
    expected = transition @ cov @ transition.T + noise
    kernels.predict_covariance(cov, *blocks, process_noise[0], dt_s)
    np.testing.assert_allclose(cov, expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(cov, cov.T)


@pytest.mark.parametrize(("first", "count"), [(kernels.VEL, 3), (kernels.POS, 2), (kernels.POS + 2, 1)])
def test_fusing_axes_in_turn_equals_the_joint_update(first, count):
    rng = np.random.default_rng(4)
    x, cov = some_state(rng), some_covariance(rng)
    variance = rng.uniform(0.1, 1.0, count)
    # the attitude part of an update is linear only for small corrections
    measured = x[first : first + count] + 1e-5 * rng.normal(size=count)
    jacobian = np.eye(kernels.ERRORS)[first - 1 : first - 1 + count]
    gain, expected_cov = textbook_update(cov, jacobian, np.diag(variance))
    expected_x = moved(x, gain @ (measured - x[first : first + count]))
    innovation = np.empty(count)
    innovation_var = np.empty(count)
    ratio = kernels.fuse_direct(x, cov, first, measured, variance, 5.0, NO_LIMITS, innovation, innovation_var)
    assert ratio < 1.0
    np.testing.assert_allclose(x, expected_x, atol=1e-9)
    np.testing.assert_allclose(cov, expected_cov, atol=1e-12)
    np.testing.assert_array_equal(cov, cov.T)


def test_one_bad_axis_rejects_the_whole_measurement():
    rng = np.random.default_rng(5)
    x, cov = some_state(rng), some_covariance(rng)
    before_x, before_cov = x.copy(), cov.copy()
    variance = np.array([0.5, 0.5])
    sigma = np.sqrt(cov[7, 7] + 0.5)
    innovation = np.empty(2)
    measured = x[7:9] + np.array([0.0, 5.1 * sigma])
    innovation_var = np.empty(2)
    ratio = kernels.fuse_direct(
        x, cov, kernels.POS, measured, variance, 5.0, NO_LIMITS, innovation, innovation_var
    )
    assert ratio == pytest.approx(5.1 / 5.0)
    np.testing.assert_allclose(innovation, [0.0, 5.1 * sigma], atol=1e-12)
    np.testing.assert_array_equal(x, before_x)
    np.testing.assert_array_equal(cov, before_cov)


def test_heading_innovation_is_the_heading_error_at_any_attitude():
    rng = np.random.default_rng(6)
    for _ in range(20):
        x = some_state(rng)
        field_frd = Rotation.from_quat(x[:4], scalar_first=True).inv().apply(FIELD_NED_GAUSS)
        assert kernels.heading_innovation(x, field_frd, FIELD_NED_GAUSS) == pytest.approx(0.0, abs=1e-12)
        estimated = moved(x, np.array([0.0, 0.0, -0.4] + [0.0] * 12))
        assert kernels.heading_innovation(estimated, field_frd, FIELD_NED_GAUSS) == pytest.approx(
            0.4, abs=1e-12
        )


def test_heading_jacobian_agrees_with_finite_differences():
    h_rad = 1e-6
    numeric = np.empty(3)
    truth = some_state(np.random.default_rng(7))
    field_frd = Rotation.from_quat(truth[:4], scalar_first=True).inv().apply(FIELD_NED_GAUSS)
    for axis in range(3):
        error = np.zeros(kernels.ERRORS)
        error[axis] = h_rad
        # the estimate is the true state without the error
        ahead = kernels.heading_innovation(moved(truth, -error), field_frd, FIELD_NED_GAUSS)
        behind = kernels.heading_innovation(moved(truth, error), field_frd, FIELD_NED_GAUSS)
        numeric[axis] = (ahead - behind) / (2.0 * h_rad)
    np.testing.assert_allclose(kernels.heading_jacobian(FIELD_NED_GAUSS), numeric, atol=1e-8)


def test_heading_update_is_the_textbook_one():
    rng = np.random.default_rng(8)
    x, cov = some_state(rng), some_covariance(rng)
    jacobian = np.zeros((1, kernels.ERRORS))
    jacobian[0, :3] = kernels.heading_jacobian(FIELD_NED_GAUSS)
    gain, expected_cov = textbook_update(cov, jacobian, np.array([[0.01]]))
    expected_x = moved(x, gain[:, 0] * 0.02)
    innovation_var = float((jacobian @ cov @ jacobian.T)[0, 0] + 0.01)
    ratio, seen_var = kernels.fuse_heading(x, cov, 0.02, FIELD_NED_GAUSS, 0.01, 2.6, NO_LIMITS, take=True)
    assert seen_var == pytest.approx(innovation_var, rel=1e-12)
    assert ratio == pytest.approx(0.02 / (2.6 * np.sqrt(innovation_var)), rel=1e-12)
    np.testing.assert_allclose(x, expected_x, atol=1e-12)
    np.testing.assert_allclose(cov, expected_cov, atol=1e-12)


FINAL_STATE = """
import sys
sys.path[:0] = sys.argv[1:]
from test_estimation_kernels import final_state
print(*(value.hex() for value in final_state()))
"""


def final_state():
    """State and variances at the end of 2.4 s: alignment, origin, every kind of fusion."""
    estimator = Estimator(EstimatorParams())
    replay(estimator, simulate(figure_eight, 2.4, np.random.default_rng(9)))
    assert estimator.state.position_valid
    return [*estimator.filter.x.tolist(), *estimator.filter.cov.diagonal().tolist()]


def test_the_same_code_gives_the_same_numbers_without_the_compiler():
    plain = subprocess.run(
        [sys.executable, "-c", FINAL_STATE, str(Path(__file__).parent), str(SUPPORT)],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    )
    numbers = [float.fromhex(word) for word in plain.stdout.split()]
    np.testing.assert_allclose(numbers, final_state(), rtol=1e-9, atol=1e-12)
