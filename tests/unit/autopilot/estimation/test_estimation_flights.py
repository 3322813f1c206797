"""Accuracy and consistency of the whole estimator over simulated flights with the Iris's sensors."""

import numpy as np
import pytest
from estimation_fixtures import (
    SITE,
    Noise,
    circle,
    errors,
    figure_eight,
    replay,
    rest,
    rms,
    simulate,
    straight,
)

from autopilot.estimation.estimator import Estimator
from autopilot.estimation.params import EstimatorParams
from foundation.geometry.geodesy import geodetic_to_ned

SETTLED = slice(2_500, None)
"""After 10 s: 5 s at rest and the onset of motion."""
QUIET_GPS = Noise(gps_bias_m=0.0, gps_pos_m=0.02, gps_vel_m_s=0.02)


@pytest.mark.parametrize("path", [rest, circle, figure_eight])
@pytest.mark.parametrize("seed", [1, 2])
def test_accuracy_with_gps_errors_of_metres(path, seed):
    flight = simulate(path, 60.0, np.random.default_rng(seed))
    states = replay(Estimator(EstimatorParams()), flight)
    missed = errors(flight, states)
    assert np.degrees(rms(missed.attitude_ned_rad[SETTLED])) < 1.0
    assert rms(missed.vel_m_s[SETTLED]) < 0.15
    assert rms(missed.pos_m[SETTLED, 2:]) < 0.1
    # horizontally the estimate follows the GPS's own slow error, relative to the origin from the first fixes
    state = states[-1]
    origin_m = origin_ned_m(state)
    followed_m = missed.pos_m[SETTLED, :2] + origin_m[:2] - flight.gps_bias_ned_m[SETTLED, :2]
    assert rms(followed_m) < 1.0
    np.testing.assert_allclose(state.gyro_bias_rad_s, [0.008, -0.006, 0.004], atol=1e-3)
    assert state.accel_bias_m_s2[2] == pytest.approx(0.12, abs=0.03)
    assert state.reset_counter == 1  # the origin


def origin_ned_m(state):
    """Compute the estimator's origin from the vehicle's position at rest."""
    return geodetic_to_ned(
        state.origin_lat_deg,
        state.origin_lon_deg,
        state.origin_alt_m,
        origin_lat_deg=SITE.latitude_deg,
        origin_lon_deg=SITE.longitude_deg,
        origin_alt_m=SITE.altitude_m,
    )


def test_manoeuvres_separate_horizontal_accelerometer_bias_from_tilt():
    noise = Noise(accel_bias_m_s2=np.array([0.15, -0.12, 0.05]))
    flight = simulate(figure_eight, 60.0, np.random.default_rng(3), noise)
    states = replay(Estimator(EstimatorParams()), flight)
    # at rest all of it counts as tilt, 0.19 m/s^2 / g = 1.1 degrees; turns in flight make it observable
    assert np.degrees(rms(errors(flight, states).attitude_ned_rad[1_000:1_250, :2])) > 0.8
    assert np.degrees(rms(errors(flight, states).attitude_ned_rad[-5_000:, :2])) < 0.35
    np.testing.assert_allclose(states[-1].accel_bias_m_s2, noise.accel_bias_m_s2, atol=0.05)


def test_at_rest_a_drifting_accelerometer_causes_no_wrong_bias_estimate():
    """There bias and tilt are not separately observable, so the tilt error is the bias over gravity.

    Consumer parts: 0.09 m/s^2 at switch-on, drift of 6e-3 m/s^2 per root second. In the mean of eight flights
    the noise of gyro and GPS adds 6 %; a filter that assumes 0.2 at switch-on adds 55 %.
    """
    wrong_rad, unobserved_rad = [], []
    settled = slice(5_000, None)
    for seed in range(8):
        rng = np.random.default_rng([5, seed])
        noise = Noise(
            accel_bias_m_s2=rng.normal(0.0, 0.0885, 3), accel_bias_walk_m_s2=6e-3,
            gyro_bias_walk_rad_s=3.9e-5,
        )  # fmt: skip
        flight = simulate(rest, 60.0, rng, noise)
        states = replay(Estimator(EstimatorParams()), flight)
        wrong_rad.append(rms(errors(flight, states).attitude_ned_rad[settled, :2]))
        unobserved_rad.append(rms(flight.accel_bias_m_s2[settled, :2]) / 9.80665)
    assert np.mean(wrong_rad) < 1.15 * np.mean(unobserved_rad)


def test_constant_speed_causes_no_lag_unlike_a_filter_without_delay():
    flight = simulate(straight, 30.0, np.random.default_rng(4), QUIET_GPS)
    trailing_m = {}
    for delay_us in (120_000, 0):
        missed = errors(flight, replay(Estimator(EstimatorParams(gps_delay_us=delay_us)), flight))
        trailing_m[delay_us] = -missed.pos_m[5_000:, 0].mean()
    assert trailing_m[120_000] == pytest.approx(0.0, abs=0.03)
    assert trailing_m[0] == pytest.approx(5.0 * 0.12, abs=0.03)


def test_delayed_fusion_is_accurate_while_manoeuvring():
    flight = simulate(circle, 30.0, np.random.default_rng(5), QUIET_GPS)
    compensated = errors(flight, replay(Estimator(EstimatorParams()), flight))
    ignored = errors(flight, replay(Estimator(EstimatorParams(gps_delay_us=0)), flight))
    assert rms(compensated.vel_m_s[5_000:]) < 0.06
    assert rms(compensated.pos_m[5_000:, :2]) < 0.06
    # 0.12 s at 5 m/s^2 and 5 m/s are 0.6 m/s and 0.6 m
    assert rms(ignored.vel_m_s[5_000:]) > 0.4
    assert rms(ignored.pos_m[5_000:, :2]) > 0.4
