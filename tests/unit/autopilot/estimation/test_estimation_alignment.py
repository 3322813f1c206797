"""Alignment at rest: estimates, their covariance, and rejected windows."""

import numpy as np
import pytest
from estimation_fixtures import FIELD_NED_GAUSS
from scipy.spatial.transform import Rotation

from autopilot.estimation.alignment import Alignment, align_at_rest
from autopilot.estimation.atmosphere import GRAVITY_M_S2
from autopilot.estimation.params import EstimatorParams
from foundation.types import ImuSample

PARAMS = EstimatorParams()


def at_rest(rotation, accel_bias_m_s2=(0.0, 0.0, 0.0)):
    """Return mean accelerometer and magnetometer readings of a body at rest."""
    force_frd = rotation.inv().apply([0.0, 0.0, -GRAVITY_M_S2])
    return force_frd + accel_bias_m_s2, rotation.inv().apply(FIELD_NED_GAUSS)


def feed(alignment, rng, *, from_s=0.0, seconds=3.0, rate_rad_s=0.0, mag=True):
    """Feed a level body, nose north, turning about down; a window may complete at most once."""
    accel, field = at_rest(Rotation.identity())
    for k in range(round(seconds * 250)):
        if k % 5 == 0:
            alignment.add_baro(488.0 + 0.1 * rng.standard_normal())
            if mag:
                alignment.add_mag(field)
        aligned = alignment.add_imu(
            ImuSample(
                time_us=round(from_s * 1e6) + 4000 * k,
                accel_frd_m_s2=accel + 0.1 * rng.standard_normal(3),
                gyro_frd_rad_s=np.array([0.01, 0.0, rate_rad_s]) + 0.0138 * rng.standard_normal(3),
            )
        )
        if aligned is not None:
            return aligned, k
    return None, None


@pytest.mark.parametrize("yaw_deg", [-170.0, -30.0, 0.0, 95.0, 180.0])
def test_attitude_is_exact_without_sensor_errors(yaw_deg):
    truth = Rotation.from_euler("ZYX", [yaw_deg, -12.0, 25.0], degrees=True)
    x, _ = align_at_rest(PARAMS, *reordered(at_rest(truth)), window_s=1.0)
    found = Rotation.from_quat(x[:4], scalar_first=True)
    assert (found * truth.inv()).magnitude() < 1e-12


def reordered(readings):
    accel, field = readings
    return accel, np.zeros(3), field


def test_gyro_bias_is_the_mean_rate_and_accelerometer_bias_is_observed_along_gravity():
    truth = Rotation.from_euler(
        "ZYX", [40.0, 0.0, 90.0], degrees=True
    )  # right side down: gravity along body y
    accel, field = at_rest(truth, (0.0, 0.15, 0.0))
    x, cov = align_at_rest(PARAMS, accel, np.array([0.01, -0.02, 0.03]), field, 1.0)
    np.testing.assert_array_equal(x[10:13], [0.01, -0.02, 0.03])
    np.testing.assert_allclose(x[13:16], [0.0, 0.15, 0.0], atol=1e-12)
    # a density of 0.15 x sqrt(10 ms) leaves 0.015 m/s^2 after one second
    horizontal_m_s2 = PARAMS.accel_bias_init_m_s2
    np.testing.assert_allclose(
        np.sqrt(cov.diagonal()[12:]), [horizontal_m_s2, 0.015, horizontal_m_s2], rtol=0.01
    )


def test_covariance_is_that_of_the_errors():
    """Many starts with random biases: the normalised squared errors average to their number.

    Biases of 0.1 m/s^2, because the covariance is first order: at 0.2 the average is 11 % too high (2 % of a
    tilt of 20 mrad against the 1.5 mrad of noise that remain once the bias is known).
    """
    params = EstimatorParams(accel_bias_init_m_s2=0.1)
    rng = np.random.default_rng(1)
    truth = Rotation.from_euler("ZYX", [50.0, 6.0, -4.0], degrees=True)
    gyro_psd, accel_psd, _, _ = params.process_noise_psd
    squares = []
    for _ in range(400):
        bias = rng.normal(0.0, params.accel_bias_init_m_s2, 3)
        accel, field = at_rest(truth, bias)
        accel = accel + rng.normal(0.0, np.sqrt(accel_psd), 3)
        gyro = rng.normal(0.0, np.sqrt(gyro_psd), 3)
        field = field + rng.normal(0.0, params.mag_noise_gauss, 3)
        x, cov = align_at_rest(params, accel, gyro, field, 1.0)
        turn = truth * Rotation.from_quat(x[:4], scalar_first=True).inv()
        error = np.concatenate((turn.as_rotvec(), -x[10:13], bias - x[13:16]))
        part = np.r_[0:3, 9:15]
        squares.append(error @ np.linalg.solve(cov[np.ix_(part, part)], error))
    # chi-squared with 9 degrees of freedom: the mean of n draws has a standard deviation of sqrt(18 / n)
    assert np.mean(squares) == pytest.approx(9.0, abs=4.0 * np.sqrt(18.0 / len(squares)))


def test_tilt_and_bias_are_correlated_so_that_one_determines_the_other():
    accel, field = at_rest(Rotation.identity())
    _, cov = align_at_rest(PARAMS, accel, np.zeros(3), field, 1.0)
    # 0.1 m/s^2 of bias along the nose is 10 mrad of pitch, of which 1.5 are noise of 0.015 m/s^2
    bias_m_s2 = PARAMS.accel_bias_init_m_s2
    assert np.sqrt(cov[1, 1]) == pytest.approx(np.hypot(bias_m_s2, 0.015) / GRAVITY_M_S2, rel=1e-3)
    correlation = -bias_m_s2 / np.hypot(bias_m_s2, 0.015)
    assert cov[1, 12] / np.sqrt(cov[1, 1] * cov[12, 12]) == pytest.approx(correlation, abs=1e-3)


def test_a_second_at_rest_aligns():
    aligned, step = feed(Alignment(PARAMS), np.random.default_rng(2))
    assert step == 250
    assert aligned.baro_altitude_m == pytest.approx(488.0, abs=0.06)
    assert aligned.x[10] == pytest.approx(0.01, abs=4 * 0.0138 / np.sqrt(250))


def test_turning_or_a_missing_sensor_delays_the_alignment():
    rng = np.random.default_rng(3)
    alignment = Alignment(PARAMS)
    assert feed(alignment, rng, rate_rad_s=0.3) == (None, None)
    assert feed(alignment, rng, from_s=3.0, mag=False) == (None, None)
    aligned, _ = feed(alignment, rng, from_s=6.0)
    assert aligned is not None
